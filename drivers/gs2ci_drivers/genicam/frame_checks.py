"""Checks of a buffer from a GenICam camera: complete, lost, incomplete or stale; and its pixels.

Frame numbers are the transport's: GigE Vision counts from 1 and, before version 2, in 16 bits without a 0 (65535 is
followed by 1); USB3 Vision counts from 0.

Here: `BufferChecks`. Not here: the count of frames (`gs2ci_drivers.frame_checks`), where buffers come from (`driver`).
"""

from dataclasses import dataclass
from typing import Final

from gs2ci.core.errors import InputError
from gs2ci_drivers.failures import FrameStaleError
from gs2ci_drivers.frame_checks import FrameChecks
from gs2ci_drivers.genicam.formats import PfncFormat, unpack_pfnc
from gs2ci_drivers.ports import CameraBuffer
from gs2ci_drivers.sensor import Frame, FrameFlag, StampMeaning

FIRST_IDS: Final = {"GEV": 1, "U3V": 0}
"""The first number after a start, by transport layer; for others it is undefined."""
LARGEST_SHORT_ID: Final = 65_535
LARGEST_GAP: Final = 4096
"""Numbers of 16 bits that seem to go back by more than all but this many have begun anew."""
STAMP_GRAIN_NS: Final = 2_000
"""A stamp earlier than its trigger by less than this still counts as after it: both clocks are rounded."""


@dataclass(frozen=True)
class TakenFrame:
    """A buffer with its time on the computer's clock.

    Args:
        buffer: The buffer.
        stamp_ns: Its stamp on CLOCK_MONOTONIC; None if the camera's clock cannot be read.
        t_host_ns: When it was fetched.
        uncertainty_ns: Uncertainty of the stamp.
    """

    buffer: CameraBuffer
    stamp_ns: int | None
    t_host_ns: int
    uncertainty_ns: int = 0


class BufferChecks(FrameChecks[TakenFrame]):
    """Checks the buffers of one run.

    Args:
        device: Name of the sensor for messages.
        form: What the pixels are.
        size: Rows and columns of a frame.
        first_numbers: What the number of the first frame may be; empty if any is accepted.
        stamps: The event that time stamps mark.
    """

    def __init__(
        self, device: str, form: PfncFormat, size: tuple[int, int], first_numbers: tuple[int, ...], stamps: StampMeaning
    ) -> None:
        super().__init__(device, first_numbers)
        self._form = form
        self._size = size
        self._stamps = stamps

    def check(self, taken: TakenFrame, not_before_ns: int) -> Frame:
        """Return the frame if it is complete, next in order and recent; see `FrameChecks.check`."""
        self._check_number(taken)
        buffer = taken.buffer
        if not buffer.complete:
            self._spoil("the buffer is incomplete: packets were lost on the way")
        age_ns = not_before_ns - (taken.stamp_ns or 0)
        if taken.stamp_ns is not None and age_ns > STAMP_GRAIN_NS + taken.uncertainty_ns:
            raise FrameStaleError(self.device, self.frame_index - 1, age_ns * 1e-9)
        height, width = self._size
        found = (buffer.height or height, buffer.width or width)
        if found != self._size:
            self._spoil(f"{found[0]} x {found[1]} pixels instead of {height} x {width}")
        try:
            pixels = unpack_pfnc(buffer.data, self._form, height, width, buffer.padding_bytes)
        except InputError as error:
            self._spoil(str(error))
        if taken.stamp_ns is None:
            return self._deliver(pixels, taken.t_host_ns, taken.t_host_ns, FrameFlag.NONE)
        flags = FrameFlag.STAMPED_MONOTONIC | self._stamps.flag
        return self._deliver(pixels, taken.stamp_ns, taken.t_host_ns, flags)

    def _if_always(self, number: int) -> str:
        return (
            'if every start says so, the camera goes on counting after a stop: set first_frame_id = "any" in [sensor]'
        )

    def _number(self, taken: TakenFrame) -> int:
        return int(taken.buffer.frame_id)

    def _expected(self, following: int, number: int) -> int:
        """Return the number that should come next; numbers of 16 bits restart at 1, also where frames are lost then."""
        wrapped = number > 0 and 0 <= number + LARGEST_SHORT_ID - following < LARGEST_GAP
        return following - LARGEST_SHORT_ID if wrapped else following
