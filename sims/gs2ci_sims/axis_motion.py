"""How an axis really moves: ramps of constant acceleration, remembered, and the ways in which truth differs.

Here: the velocity profile of one axis as pieces of constant acceleration, and the mechanical errors between what the
controller counts and where the carriage is. Not here: commands (`gs2ci_sims.wires.zaber`, `.grbl`).
"""

from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from math import copysign, inf, pi, sin, sqrt

import numpy as np

HISTORY = 4096
"""Pieces of motion that are remembered: some thousand moves, far more than one exposure sees."""


@dataclass(frozen=True)
class Mechanics:
    """What lies between the counted and the true position; the default is a perfect axis.

    Args:
        scale: True distance per counted distance.
        backlash_mm: Lost motion at a reversal.
        lag_s: Following error as a delay of the carriage behind the controller.
        ripple_mm: Amplitude of the screw's periodic error.
        pitch_mm: Its period.
        reversed_sign: Whether the carriage goes the other way.
        speed_error: Relative error of its speed.
        repeatability_mm: Standard deviation of where a move truly ends; the next move forgets it.
        slip_mm: What a move may lose for good in a slipping coupling, at most; evenly distributed.
        seed: Of both.
    """

    scale: float = 1.0
    backlash_mm: float = 0.0
    lag_s: float = 0.0
    ripple_mm: float = 0.0
    pitch_mm: float = 1.0
    reversed_sign: bool = False
    speed_error: float = 0.0
    repeatability_mm: float = 0.0
    slip_mm: float = 0.0
    seed: int = 0


@dataclass(frozen=True)
class _Piece:
    start_s: float
    position_mm: float
    speed_mm_s: float
    acceleration_mm_s2: float
    slack_mm: float  # how far the carriage lies behind the counted position, from 0 to the backlash
    astray_mm: float = 0.0  # what repeatability and slipping add to the true position

    def position_at(self, when_s: float) -> float:
        t = when_s - self.start_s
        return self.position_mm + self.speed_mm_s * t + 0.5 * self.acceleration_mm_s2 * t * t

    def speed_at(self, when_s: float) -> float:
        return self.speed_mm_s + self.acceleration_mm_s2 * (when_s - self.start_s)


class AxisMotion:
    """One axis: where it is, was and will be.

    Args:
        position_mm: Where it stands at first.
        acceleration_mm_s2: Of all its ramps.
        mechanics: What lies between counted and true position.
    """

    def __init__(self, position_mm: float, acceleration_mm_s2: float, mechanics: Mechanics | None = None) -> None:
        self.acceleration_mm_s2 = acceleration_mm_s2
        self.mechanics = mechanics or Mechanics()
        self.ends_s = -inf
        self._pieces = [_Piece(-1e12, position_mm, 0.0, 0.0, 0.0)]
        self._rng = np.random.default_rng(self.mechanics.seed)
        self._slipped_mm = 0.0

    def position_at(self, when_s: float) -> float:
        """Return the counted position, in mm."""
        return self._piece(when_s).position_at(when_s)

    def speed_at(self, when_s: float) -> float:
        """Return the counted speed, in mm/s."""
        return self._piece(when_s).speed_at(when_s)

    def moving_at(self, when_s: float) -> bool:
        """Return whether a move is under way."""
        return when_s < self.ends_s

    def true_position_at(self, when_s: float) -> float:
        """Return where the carriage is, in mm, with all mechanical errors."""
        m = self.mechanics
        piece = self._piece(when_s - m.lag_s)
        counted = piece.position_at(when_s - m.lag_s)
        behind = self._slack_at(piece, counted)
        true = m.scale * (counted - behind) + piece.astray_mm
        if m.ripple_mm:
            true += m.ripple_mm * sin(2 * pi * counted / m.pitch_mm)
        return -true if m.reversed_sign else true

    def move_to(self, target_mm: float, speed_mm_s: float, now_s: float) -> float:
        """Begin a move from whatever it does now; return when it will end."""
        true_speed = speed_mm_s * (1 + self.mechanics.speed_error)
        astray_mm = self._astray_mm(target_mm - self.position_at(now_s))
        return self._run(self._legs_to(target_mm, true_speed, now_s), now_s, astray_mm)

    def move_at(self, speed_mm_s: float, now_s: float) -> float:
        """Go on at a signed speed until told otherwise; return when the ramp ends."""
        a, v0, v1 = self.acceleration_mm_s2, self.speed_at(now_s), speed_mm_s * (1 + self.mechanics.speed_error)
        # Where it turns round a piece ends, since there the play changes sides.
        steps = [v0, 0.0, v1] if v0 * v1 < 0 else [v0, v1]
        ramps = [(copysign(a, after - before), abs(after - before) / a) for before, after in pairwise(steps)]
        ends_s = self._run([*ramps, (0.0, inf)], now_s)
        self.ends_s = inf
        return ends_s

    def stop(self, now_s: float) -> float:
        """Brake to rest; return when it rests."""
        speed = self.speed_at(now_s)
        return self._run([(-copysign(self.acceleration_mm_s2, speed), abs(speed) / self.acceleration_mm_s2)], now_s)

    def halt(self, now_s: float) -> None:
        """Stand still at once: a stall, an end stop, a power cut."""
        self._run([], now_s)

    def set_position(self, position_mm: float, now_s: float) -> None:
        """Call the present position something else (homing); the history before keeps its old numbers."""
        self._pieces.append(_Piece(now_s, position_mm, 0.0, 0.0, 0.0, self._piece(now_s).astray_mm))
        self.ends_s = now_s

    def _legs_to(self, target_mm: float, speed_mm_s: float, now_s: float) -> list[tuple[float, float]]:
        """Return accelerations and durations that end at rest on the target."""
        a, v0 = self.acceleration_mm_s2, self.speed_at(now_s)
        distance = target_mm - self.position_at(now_s)
        braking = v0 * abs(v0) / (2 * a)
        legs: list[tuple[float, float]] = []
        if v0 and (distance * v0 < 0 or abs(braking) > abs(distance)):
            legs.append((-copysign(a, v0), abs(v0) / a))  # wrong way or too fast: come to rest first
            distance, v0 = distance - braking, 0.0
        way = copysign(1.0, distance)
        distance, v0 = abs(distance), abs(v0)
        peak = min(speed_mm_s, sqrt(a * distance + v0 * v0 / 2))
        cruise = distance - (abs(peak * peak - v0 * v0) + peak * peak) / (2 * a)
        ramp = (way * copysign(a, peak - v0), abs(peak - v0) / a)
        legs += [ramp, (0.0, max(cruise, 0.0) / peak if peak else 0.0), (-way * a, peak / a)]
        return legs

    def _astray_mm(self, distance_mm: float) -> float:
        """Draw how far from its target the next move truly ends, all slips before included."""
        m = self.mechanics
        if m.slip_mm:
            self._slipped_mm -= copysign(m.slip_mm * float(self._rng.uniform()), distance_mm)
        return self._slipped_mm + (m.repeatability_mm * float(self._rng.normal()) if m.repeatability_mm else 0.0)

    def _run(self, legs: list[tuple[float, float]], now_s: float, astray_mm: float | None = None) -> float:
        """Replace what was planned from now on by these legs, then rest; `None` goes on as far astray as before."""
        here, speed = self.position_at(now_s), self.speed_at(now_s)
        piece = self._piece(now_s)
        astray_mm = piece.astray_mm if astray_mm is None else astray_mm
        slack = self._slack_at(piece, here)
        while self._pieces[-1].start_s >= now_s and len(self._pieces) > 1:
            self._pieces.pop()
        t = now_s
        for acceleration, duration_s in legs:
            if duration_s <= 0:
                continue
            piece = _Piece(t, here, speed, acceleration, slack, astray_mm)
            self._pieces.append(piece)
            t += duration_s
            if t == inf:
                self.ends_s = inf
                return piece.start_s
            here, speed = piece.position_at(t), piece.speed_at(t)
            slack = self._slack_at(piece, here)
        self._pieces.append(_Piece(t, here, 0.0, 0.0, slack, astray_mm))
        del self._pieces[:-HISTORY]
        self.ends_s = t
        return t

    def _slack_at(self, piece: _Piece, counted_mm: float) -> float:
        """Return how far the carriage lies behind: the play is taken up in the direction of motion."""
        taken = piece.slack_mm + counted_mm - piece.position_mm
        return min(max(taken, 0.0), self.mechanics.backlash_mm)

    def _piece(self, when_s: float) -> _Piece:
        return self._pieces[max(bisect_right(self._pieces, when_s, key=lambda piece: piece.start_s) - 1, 0)]
