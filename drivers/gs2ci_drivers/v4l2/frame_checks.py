"""Checks of a frame from the kernel: complete, lost, corrupt or stale; its clock; and its pixels.

Here: `KernelFrameChecks`. Not here: the count of frames (`gs2ci_drivers.frame_checks`), where frames come from
(`streaming`). Imported by `driver` only.
"""

from dataclasses import dataclass
from typing import Final

from gs2ci.core.errors import InputError
from gs2ci_drivers.failures import DeviceFaultError, FrameStaleError
from gs2ci_drivers.frame_checks import FrameChecks
from gs2ci_drivers.sensor import Frame, FrameFlag, StampMeaning
from gs2ci_drivers.v4l2 import abi
from gs2ci_drivers.v4l2.formats import FrameGeometry, unpack
from gs2ci_drivers.v4l2.node import Dequeued
from gs2ci_drivers.v4l2.stamps import CLOCKS_OF_THEIR_OWN, meaning_of

_WRAP: Final = 1 << 32
_STAMP_GRAIN_NS: Final = 1000
"""The kernel truncates time stamps to whole microseconds."""
_FUTURE_NS: Final = 1_000_000_000
"""A stamp that lies further behind the frame's arrival is of another clock."""
_PAST_NS: Final = 3600 * 1_000_000_000
"""And so is one that lies further before it: the kernel keeps no frame for so long."""
WHY_MARKED: Final = {
    "tegra-video": "; it does so where 2.5 s pass without a frame: let the first trigger come sooner after the start"
}
"""What a kernel driver may mean by that mark (NVIDIA's vi5_fops.c: vi5_capture_dequeue, CAPTURE_TIMEOUT_MS)."""
FIRSTS: Final = {"unicam": (0, 1)}
"""The numbers that a kernel driver's first frame may have, other than 0: unicam's are 0 or 1, by version
(kbingham/libcamera issue 50; raspberrypi/linux pull 5507). A frame lost before it is then missing at the end."""


def first_numbers(driver: str, stated: int | None) -> tuple[int, ...]:
    """Return what the number of the first frame may be; empty if any.

    Args:
        driver: Name of the kernel driver.
        stated: What the rig file says, -1 for any; None if it says nothing.
    """
    if stated is None:
        return FIRSTS.get(driver, (0,))
    return () if stated < 0 else (stated,)


@dataclass(frozen=True)
class TakenBuffer:
    """A frame taken from the kernel and not yet checked."""

    buffer: Dequeued
    data: bytes
    t_host_ns: int


class KernelFrameChecks(FrameChecks[TakenBuffer]):
    """Checks the frames of one run, whose kernel numbers wrap at 2³².

    Args:
        device: Name of the sensor for messages.
        geometry: What a frame looks like.
        first_numbers: What the kernel's number of the first frame may be; empty if any is accepted.
        started_ns: Kernel time of the start: an earlier frame is stale.
        driver: Name of the kernel driver, which decides what its time stamps mean.
        stamps: Their meaning by the rig file, if it states one.
    """

    def __init__(
        self,
        device: str,
        geometry: FrameGeometry,
        first_numbers: tuple[int, ...],
        started_ns: int,
        driver: str = "",
        stamps: StampMeaning | None = None,
    ) -> None:
        super().__init__(device, first_numbers)
        self._geometry = geometry
        self._started_ns = started_ns
        self._driver = driver
        self._stamps = stamps

    def check(self, taken: TakenBuffer, not_before_ns: int) -> Frame:
        """Return the frame if it is complete, next in order and recent; see `FrameChecks.check`.

        Raises:
            DeviceFaultError: It marks the end of the stream, or its stamp is of another clock than its flag says.
        """
        if abi.BufferFlag.LAST in taken.buffer.flags:
            raise DeviceFaultError(self.device, "VIDIOC_DQBUF", ["LAST: the device ended the stream"])
        self._check_number(taken)
        if abi.BufferFlag.ERROR in taken.buffer.flags:
            self._spoil("the kernel marked it (V4L2_BUF_FLAG_ERROR)" + WHY_MARKED.get(self._driver, ""))
        if len(taken.data) < self._geometry.payload_bytes:
            self._spoil(f"{len(taken.data)} bytes instead of {self._geometry.payload_bytes}")
        monotonic = self._is_monotonic(taken)
        # The stamps of another clock cannot be compared with the trigger's time.
        age_ns = max(not_before_ns, self._started_ns) - taken.buffer.time_ns
        if monotonic and age_ns > _STAMP_GRAIN_NS:
            raise FrameStaleError(self.device, self.frame_index - 1, age_ns * 1e-9)
        try:
            pixels = unpack(taken.data, self._geometry)
        except InputError as error:
            self._spoil(str(error))
        flags = FrameFlag.STAMPED_MONOTONIC if monotonic else FrameFlag.NONE
        flagged = abi.BufferFlag.TSTAMP_SRC_SOE in taken.buffer.flags
        flags |= meaning_of(self._driver, self._stamps, flagged=flagged).flag
        return self._deliver(pixels, taken.buffer.time_ns, taken.t_host_ns, flags)

    def _is_monotonic(self, taken: TakenBuffer) -> bool:
        """Return whether a stamp counts on CLOCK_MONOTONIC.

        Raises:
            DeviceFaultError: It is flagged so and lies after the arrival, or hours before: another clock's.
        """
        ahead_ns = taken.buffer.time_ns - taken.t_host_ns
        flagged = taken.buffer.flags & abi.BufferFlag.TIMESTAMP_MASK == abi.BufferFlag.TIMESTAMP_MONOTONIC
        monotonic = flagged and self._driver not in CLOCKS_OF_THEIR_OWN
        if monotonic and not -_PAST_NS < ahead_ns < _FUTURE_NS:
            when = f"{abs(ahead_ns) * 1e-9:.3g} s {'after' if ahead_ns > 0 else 'before'} the frame's arrival"
            raise DeviceFaultError(
                self.device,
                "VIDIOC_DQBUF",
                [f"a time stamp {when}, flagged as CLOCK_MONOTONIC"],
                remedy="it counts on another clock: for uvcvideo, write CLOCK_MONOTONIC to "
                "/sys/module/uvcvideo/parameters/clock (`options uvcvideo clock=monotonic` in /etc/modprobe.d)",
            )
        return monotonic

    def _if_always(self, number: int) -> str:
        return (
            f"if every start says so, the kernel driver numbers its first frame {number}: "
            f"set first_sequence = {number} in [sensor], or -1 if it changes"
        )

    def _number(self, taken: TakenBuffer) -> int:
        return taken.buffer.sequence

    def _expected(self, following: int, number: int) -> int:
        return number - ((number - following + _WRAP // 2) % _WRAP - _WRAP // 2)
