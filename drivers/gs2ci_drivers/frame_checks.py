"""The count of a run's frames, and the checks that all cameras share.

Here: `FrameChecks`, the base of the checks of V4L2 frames (`v4l2/frame_checks.py`) and of GenICam buffers
(`genicam/frame_checks.py`), which say what a complete and recent frame is. Not here: where frames come from.
"""

from abc import ABC, abstractmethod
from typing import Generic, NoReturn, TypeVar

from gs2ci.core.arrays import U16
from gs2ci_drivers.failures import FrameCorruptError, FrameLostError
from gs2ci_drivers.sensor import Frame, FrameFlag

Taken = TypeVar("Taken")


class FrameChecks(ABC, Generic[Taken]):
    """Checks the frames of one run, from start to stop, and counts them.

    Args:
        device: Name of the sensor for messages.
        first_numbers: What the first frame's number may be, the one to be expected first; empty if any is accepted.
    """

    def __init__(self, device: str, first_numbers: tuple[int, ...]) -> None:
        self.device = device
        self._firsts = first_numbers
        self.delivered = self.lost = self.corrupt = 0
        self.frame_index = 0
        """Index of the frame that should come next, from 0: the numbers since the start, unwrapped."""
        self.held: Taken | None = None
        """A frame that came after a gap; it is checked next."""
        self._next = first_numbers[0] if first_numbers else None
        self._after_loss = False

    @abstractmethod
    def check(self, taken: Taken, not_before_ns: int) -> Frame:
        """Return the frame if it is complete, next in order and no older than `not_before_ns`.

        Raises:
            FrameLostError: Frames before it are missing; it is held for the next call.
            FrameCorruptError: It is marked bad, incomplete, of another size, repeated, or holds values beyond its
                format.
            FrameStaleError: It is older than the trigger or the start.
        """

    @abstractmethod
    def _number(self, taken: Taken) -> int:
        """Return a frame's number, below 0 if it has none."""

    @abstractmethod
    def _expected(self, following: int, number: int) -> int:
        """Return the number that should come next, which may have wrapped; `following` is the last one plus 1."""

    @abstractmethod
    def _if_always(self, number: int) -> str:
        """Return what to do if the first frame has this number after every start, so that none was lost."""

    def pass_over(self, taken: Taken) -> None:
        """Count a frame that is not delivered."""
        numbered = self._next is not None
        ahead = self._ahead(taken)
        self._follow(ahead)
        if numbered:
            self.frame_index += max(ahead + 1, 0)  # one that is repeated or out of order does not count

    def _ahead(self, taken: Taken) -> int:
        """Return how many numbers a frame is ahead of the expected one; below 0 if it is repeated or out of order."""
        number = self._number(taken)
        firsts, self._firsts = self._firsts, ()
        if self._next is None or number in firsts:
            self._next = max(number, 0)
        self._next = self._expected(self._next, number)
        return 0 if number < 0 else number - self._next

    def _follow(self, ahead: int) -> None:
        assert self._next is not None
        self._next += ahead + 1

    def _check_number(self, taken: Taken) -> None:
        """Compare the frame's number with the expected one, and count it."""
        ahead = self._ahead(taken)
        if ahead > 0:
            first, self._next = self.frame_index, self._number(taken)
            self.frame_index += ahead
            self.lost += ahead
            self.held, self._after_loss = taken, True
            also = "" if first else self._if_always(self._next)
            raise FrameLostError(self.device, first, ahead, also=also)
        self._follow(ahead)
        if ahead < 0:
            self.corrupt += 1
            why = f"its number {self._number(taken)} arrived before, or out of order"
            raise FrameCorruptError(self.device, self.frame_index, why)
        self.frame_index += 1

    def _spoil(self, why: str) -> NoReturn:
        """Refuse the frame that was counted last."""
        self.corrupt += 1
        raise FrameCorruptError(self.device, self.frame_index - 1, why)

    def _deliver(self, pixels: U16, stamp_ns: int, t_host_ns: int, flags: FrameFlag) -> Frame:
        if self._after_loss:
            flags |= FrameFlag.AFTER_LOSS
            self._after_loss = False
        self.delivered += 1
        return Frame(pixels, self.frame_index - 1, stamp_ns, t_host_ns, flags)
