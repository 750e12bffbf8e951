"""Checks of a frame from the kernel: complete, lost, corrupt or stale; and its pixels.

Here: `FrameJudge`, which keeps the count of frame numbers. Not here: where frames come from (`streaming`).
Imported by `driver` only.
"""

from dataclasses import dataclass, field
from typing import Final, NoReturn

from gs2ci.core.errors import InputError
from gs2ci_drivers.failures import (
    DeviceFaultError,
    FrameCorruptError,
    FrameLostError,
    FrameStaleError,
)
from gs2ci_drivers.sensor import Frame, FrameFlag, StampMeaning
from gs2ci_drivers.v4l2 import abi
from gs2ci_drivers.v4l2.formats import FrameGeometry, unpack
from gs2ci_drivers.v4l2.node import Dequeued
from gs2ci_drivers.v4l2.stamps import meaning_of

_WRAP: Final = 1 << 32
_STAMP_GRAIN_NS: Final = 1000
"""The kernel truncates time stamps to whole microseconds."""


@dataclass(frozen=True)
class TakenBuffer:
    """A frame taken from the kernel and not yet judged."""

    buffer: Dequeued
    data: bytes
    t_host_ns: int

    @property
    def monotonic(self) -> bool:
        """Get whether its time stamp counts on CLOCK_MONOTONIC."""
        return self.buffer.flags & abi.BufferFlag.TIMESTAMP_MASK == abi.BufferFlag.TIMESTAMP_MONOTONIC


@dataclass
class FrameJudge:
    """Judges the frames of one run, from start to stop.

    Args:
        device: Name of the sensor for messages.
        geometry: What a frame looks like.
        first_sequence: The kernel's number of the first frame; None if any number is accepted.
        started_ns: Kernel time of the start: an earlier frame is stale.
        driver: Name of the kernel driver, which decides what its time stamps mean.
        stamps: Their meaning by the rig file, if it states one.
    """

    device: str
    geometry: FrameGeometry
    first_sequence: int | None
    started_ns: int
    driver: str = ""
    stamps: StampMeaning | None = None
    delivered: int = field(default=0, init=False)
    lost: int = field(default=0, init=False)
    corrupt: int = field(default=0, init=False)
    frame_index: int = field(default=0, init=False)
    """Index of the frame that should come next, from 0: the kernel's numbers since the start, unwrapped."""
    held: TakenBuffer | None = field(default=None, init=False)
    """A frame that came after a gap; it is judged next."""

    def __post_init__(self) -> None:
        self._next = self.first_sequence
        self._after_loss = False

    def judge(self, taken: TakenBuffer, not_before_ns: int) -> Frame:
        """Return the frame if it is complete, next in order and no older than `not_before_ns`.

        Raises:
            DeviceFaultError: It marks the end of the stream.
            FrameLostError: Frames before it are missing; it is held for the next call.
            FrameCorruptError: It is marked bad, too short, repeated, or holds values beyond its format.
            FrameStaleError: It is older than the trigger or the start.
        """
        if abi.BufferFlag.LAST in taken.buffer.flags:
            raise DeviceFaultError(self.device, "VIDIOC_DQBUF", ["LAST: the device ended the stream"])
        self._check_number(taken)
        self._check_payload(taken)
        self._check_age(taken, not_before_ns)
        return self._frame(taken)

    def pass_over(self, taken: TakenBuffer) -> None:
        """Count a frame that is not delivered."""
        number = taken.buffer.sequence
        if self._next is not None:
            ahead = (number + 1 - self._next) % _WRAP
            self.frame_index += ahead if ahead < _WRAP // 2 else 0  # otherwise it is a repetition, or out of order
        self._next = (number + 1) % _WRAP

    def _check_number(self, taken: TakenBuffer) -> None:
        """Compare the kernel's number with the expected one; numbers wrap at 2³²."""
        number = taken.buffer.sequence
        if self._next is None:
            self._next = number
        ahead = (number - self._next) % _WRAP
        if 0 < ahead < _WRAP // 2:
            first, self._next = self.frame_index, number
            self.frame_index += ahead
            self.lost += ahead
            self.held, self._after_loss = taken, True
            raise FrameLostError(self.device, first, ahead)
        self._next = (number + 1) % _WRAP
        if ahead:
            self._spoil(self.frame_index, f"its number {number} arrived before, or out of order")
        self.frame_index += 1

    def _check_payload(self, taken: TakenBuffer) -> None:
        if abi.BufferFlag.ERROR in taken.buffer.flags:
            self._spoil(self.frame_index - 1, "the kernel marked it (V4L2_BUF_FLAG_ERROR)")
        if len(taken.data) < self.geometry.payload_bytes:
            self._spoil(self.frame_index - 1, f"{len(taken.data)} bytes instead of {self.geometry.payload_bytes}")

    def _spoil(self, frame_index: int, why: str) -> NoReturn:
        self.corrupt += 1
        raise FrameCorruptError(self.device, frame_index, why)

    def _check_age(self, taken: TakenBuffer, not_before_ns: int) -> None:
        """Compare the kernel's time stamp with the trigger's, unless it is of another clock."""
        age_ns = max(not_before_ns, self.started_ns) - taken.buffer.time_ns
        if taken.monotonic and age_ns > _STAMP_GRAIN_NS:
            raise FrameStaleError(self.device, self.frame_index - 1, age_ns * 1e-9)

    def _frame(self, taken: TakenBuffer) -> Frame:
        try:
            pixels = unpack(taken.data, self.geometry)
        except InputError as error:
            self._spoil(self.frame_index - 1, str(error))
        flags = FrameFlag.STAMPED_MONOTONIC if taken.monotonic else FrameFlag.NONE
        flagged = abi.BufferFlag.TSTAMP_SRC_SOE in taken.buffer.flags
        flags |= meaning_of(self.driver, self.stamps, flagged=flagged).flag
        if self._after_loss:
            flags |= FrameFlag.AFTER_LOSS
            self._after_loss = False
        self.delivered += 1
        return Frame(pixels, self.frame_index - 1, taken.buffer.time_ns, taken.t_host_ns, flags)
