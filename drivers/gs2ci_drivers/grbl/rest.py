"""Where a GRBL controller stands at rest: the position that nothing but a motion or a restart can change.

A restart counts from 0 wherever the carriage stands, and its greeting may be any text, so a position at rest that is
another one than before says what no line says. A position that is not 0 may also come from somebody who moved the
stage by other means; then the count goes on.

Here: positions of reports and their comparison. Not here: what follows from it (`driver`).
"""

from collections.abc import Mapping

from gs2ci_drivers.failures import BadReplyError
from gs2ci_drivers.grbl.packets import Status

MM_PER_INCH = 25.4
REPORT_STEP_MM = 0.001
"""Reports have three decimals; in inches four."""


def report_mm(*, inches: bool) -> float:
    """Return the resolution of the reports."""
    return REPORT_STEP_MM * (MM_PER_INCH / 10 if inches else 1.0)


class Rest:
    """The last position at rest.

    Args:
        device: Name of the stage, for messages.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._at_mm: tuple[float, ...] | None = None
        self._from_mm: tuple[float, ...] | None = None
        self.offset: tuple[float, ...] | None = None
        """Work coordinate offset, in the unit of the reports."""

    @property
    def left(self) -> bool:
        """Get whether a motion was begun since the last rest."""
        return self._at_mm is None

    def settle(self, machine_mm: tuple[float, ...]) -> None:
        """Note where it rests."""
        self._at_mm = machine_mm

    def leave(self) -> None:
        """Note that a motion begins."""
        self._from_mm, self._at_mm = self._at_mm or self._from_mm, None

    def same(self, one_mm: tuple[float, ...], other_mm: tuple[float, ...]) -> bool:
        """Return whether two reports show one position."""
        if len(one_mm) != len(other_mm):
            return False
        return all(abs(one - other) <= 2 * MM_PER_INCH * 1e-4 for one, other in zip(one_mm, other_mm, strict=True))

    def compare(self, machine_mm: tuple[float, ...], *, suspicious: bool) -> tuple[str, bool] | None:
        """Compare a report at rest with the position that was left.

        Returns:
            None if a motion is under way; otherwise what has changed ("" if nothing), and whether that was a restart.
        """
        if self._at_mm is None:
            return None
        before_mm, self._at_mm = self._at_mm, machine_mm
        if self.same(before_mm, machine_mm):
            return "", False
        shown = [", ".join(f"{value:.3f}" for value in values) for values in (before_mm, machine_mm)]
        return f"at rest the position changed from {shown[0]} to {shown[1]} mm", suspicious or not any(machine_mm)

    def lost(self, machine_mm: tuple[float, ...], targets_mm: Mapping[int, float], *, suspicious: bool) -> bool:
        """Return whether the end of a motion lies where no motion to its targets could have ended."""
        if self._from_mm is None or len(self._from_mm) != len(machine_mm):
            return not any(machine_mm)
        slack_mm = MM_PER_INCH * 1e-4
        for i, (begin, end) in enumerate(zip(self._from_mm, machine_mm, strict=True)):
            low_mm, high_mm = sorted((begin, targets_mm.get(i, begin)))
            if not low_mm - slack_mm <= end <= high_mm + slack_mm:
                return True
        return not any(machine_mm) and (suspicious or any(targets_mm.values()))

    def machine_mm(self, status: Status, *, inches: bool) -> tuple[float, ...]:
        """Return the machine position of every axis, in mm.

        Raises:
            BadReplyError: A work position, and its offset is not known.
        """
        if status.offset is not None:
            self.offset = status.offset
        values = status.machine
        if values is None:
            if self.offset is None or status.work is None or len(self.offset) != len(status.work):
                raise BadReplyError(
                    self._device,
                    "?",
                    b"WPos",
                    "a work position without its offset",
                    allowed="machine positions: set $10=1",
                )
            values = tuple(work + offset for work, offset in zip(status.work, self.offset, strict=True))
        unit = MM_PER_INCH if inches else 1.0
        return tuple(value * unit for value in values)
