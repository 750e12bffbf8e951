"""Moves that do not go as commanded, as the device's own counter or encoder sees them: what all stage twins share.

What an axis does when it is hindered: it halts and goes on (Zaber's flag WS, "stalled and recovered"), goes slower or
faster than asked (a step timer at its limit, a speed override), begins late, is displaced.

Here: when and on which axes. Not here: how the motion changes (`AxisMotion.disturb`), what the device says of it.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypedDict, Unpack

from gs2ci_sims.axis_motion import AxisMotion
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.world import VirtualClock


class Disturbance(TypedDict, total=False):
    """Arguments of `AxisMotion.disturb`."""

    pause_s: float
    speed_factor: float
    jump_mm: float


class Disturbances:
    """What will hinder the next move.

    Args:
        clock: The world's clock.
        faults: The twin's faults.
    """

    def __init__(self, clock: VirtualClock, faults: FaultSet) -> None:
        self._clock = clock
        self._faults = faults
        self._waiting: list[tuple[float, Disturbance]] = []
        self.struck = 0
        """How many have hindered a move."""

    def add(self, share: float, **how: Unpack[Disturbance]) -> None:
        """Hinder the next move from this share of its time on; see `AxisMotion.disturb`."""
        self._waiting.append((share, how))

    def schedule(
        self, axes: Sequence[AxisMotion], ends_s: float, about: str, changed: Callable[[float], None] | None = None
    ) -> None:
        """Let what is waiting hinder the move that these axes begin now.

        Args:
            axes: The axes that move.
            ends_s: When the move would end.
            about: What the twin calls it, for faults.
            changed: Is told when the move will end instead.
        """
        take, values = self._faults.take, []
        if fault := take("stage.halts", about):
            values.append((0.5, Disturbance(pause_s=fault.value or 0.05)))
        if fault := take("stage.slower", about):
            values.append((0.5, Disturbance(speed_factor=fault.value or 0.5)))
        if fault := take("stage.faster", about):
            values.append((0.5, Disturbance(speed_factor=fault.value or 1.5)))
        if fault := take("stage.late", about):
            values.append((0.0, Disturbance(pause_s=fault.value or 0.3)))
        if fault := take("stage.displaced", about):
            values.append((0.5, Disturbance(jump_mm=fault.value or 0.3)))
        waiting, self._waiting = [*self._waiting, *values], []
        now_s = self._clock.now_s()
        moves = {axis: axis.moves for axis in axes}

        def hinder(how: Disturbance) -> None:
            same = [axis for axis, move in moves.items() if axis.moves == move and axis.moving_at(self._clock.now_s())]
            self.struck += bool(same)
            ends_s = [axis.disturb(self._clock.now_s(), **how) for axis in same]
            if ends_s and changed is not None:
                changed(max(ends_s))

        for share, how in waiting:
            self._clock.at(now_s + share * (ends_s - now_s), partial(hinder, how))
