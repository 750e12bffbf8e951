"""Checks of a buffer from a GenICam camera: complete, lost, incomplete or stale; and its pixels.

Frame numbers are the transport's: GigE Vision counts from 1 and, before version 2, in 16 bits without a 0 (65535 is
followed by 1); USB3 Vision counts from 0.

Here: `BufferJudge`, which keeps the count. Not here: where buffers come from (`driver`).
"""

from dataclasses import dataclass, field
from typing import Final, NoReturn

from gs2ci.core.errors import InputError
from gs2ci_drivers.failures import FrameCorruptError, FrameLostError, FrameStaleError
from gs2ci_drivers.genicam.formats import PfncFormat, unpack_pfnc
from gs2ci_drivers.ports import CameraBuffer
from gs2ci_drivers.sensor import Frame, FrameFlag, StampMeaning

FIRST_IDS: Final = {"GEV": 1, "U3V": 0}
"""The first number after a start, by transport layer; for others it is undefined."""
LARGEST_SHORT_ID: Final = 65_535
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

    @property
    def number(self) -> int:
        """Get the transport's number of it."""
        return int(self.buffer.frame_id)


@dataclass
class BufferJudge:
    """Judges the buffers of one run, from start to stop.

    Args:
        device: Name of the sensor for messages.
        form: What the pixels are.
        height: Rows of a frame.
        width: Columns.
        first_id: Number of the first frame; None if any number is accepted.
        stamps: The event that time stamps mark.
    """

    device: str
    form: PfncFormat
    height: int
    width: int
    first_id: int | None
    stamps: StampMeaning
    delivered: int = field(default=0, init=False)
    lost: int = field(default=0, init=False)
    corrupt: int = field(default=0, init=False)
    frame_index: int = field(default=0, init=False)
    """Index of the frame that should come next, from 0."""
    held: TakenFrame | None = field(default=None, init=False)
    """A frame that came after a gap; it is judged next."""

    def __post_init__(self) -> None:
        self._next = self.first_id
        self._after_loss = False

    def judge(self, taken: TakenFrame, not_before_ns: int) -> Frame:
        """Return the frame if it is complete, next in order and no older than `not_before_ns`.

        Raises:
            FrameLostError: Frames before it are missing; it is held for the next call.
            FrameCorruptError: It is incomplete, of another size, repeated, or holds values beyond its format.
            FrameStaleError: It is older than the trigger.
        """
        self._check_number(taken)
        if not taken.buffer.complete:
            self._spoil("the buffer is incomplete: packets were lost on the way")
        age_ns = not_before_ns - (taken.stamp_ns or 0)
        if taken.stamp_ns is not None and age_ns > STAMP_GRAIN_NS + taken.uncertainty_ns:
            raise FrameStaleError(self.device, self.frame_index - 1, age_ns * 1e-9)
        return self._frame(taken)

    def pass_over(self, taken: TakenFrame) -> None:
        """Count a frame that is not delivered."""
        ahead = self._ahead(taken)
        self.frame_index += max(ahead, 0) + 1
        self._next = self._expected(taken) + max(ahead, 0) + 1

    def _expected(self, taken: TakenFrame) -> int:
        """Return the number that this frame should have; 16-bit numbers restart at 1."""
        number = taken.number
        if self._next is None:
            self._next = max(number, 0)
        if self._next > LARGEST_SHORT_ID and 0 < number <= LARGEST_SHORT_ID // 2:
            self._next -= LARGEST_SHORT_ID
        return self._next

    def _ahead(self, taken: TakenFrame) -> int:
        expected = self._expected(taken)
        return 0 if taken.number < 0 else taken.number - expected

    def _check_number(self, taken: TakenFrame) -> None:
        ahead = self._ahead(taken)
        if ahead > 0:
            first, self._next = self.frame_index, taken.number
            self.frame_index += ahead
            self.lost += ahead
            self.held, self._after_loss = taken, True
            raise FrameLostError(self.device, first, ahead)
        if ahead < 0:
            self.frame_index += 1
            self._next = taken.number + 1
            self._spoil(f"its number {taken.number} arrived before, or out of order")
        self._next = self._expected(taken) + 1
        self.frame_index += 1

    def _spoil(self, why: str) -> NoReturn:
        self.corrupt += 1
        raise FrameCorruptError(self.device, self.frame_index - 1, why)

    def _frame(self, taken: TakenFrame) -> Frame:
        buffer = taken.buffer
        size = (buffer.height or self.height, buffer.width or self.width)
        if size != (self.height, self.width):
            self._spoil(f"{size[0]} x {size[1]} pixels instead of {self.height} x {self.width}")
        try:
            pixels = unpack_pfnc(buffer.data, self.form, self.height, self.width, buffer.padding_bytes)
        except InputError as error:
            self._spoil(str(error))
        flags = FrameFlag.NONE
        if taken.stamp_ns is not None:
            flags = FrameFlag.STAMPED_MONOTONIC | self.stamps.flag
        if self._after_loss:
            flags |= FrameFlag.AFTER_LOSS
            self._after_loss = False
        self.delivered += 1
        stamp_ns = taken.t_host_ns if taken.stamp_ns is None else taken.stamp_ns
        return Frame(pixels, self.frame_index - 1, stamp_ns, taken.t_host_ns, flags)
