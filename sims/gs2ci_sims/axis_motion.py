"""How an axis really moves: ramps of constant acceleration, remembered, and the ways in which truth differs.

Here: the velocity profile of one axis as pieces of constant acceleration, and the mechanical errors between what the
controller counts and where the carriage is. Not here: commands (`gs2ci_sims.wires.zaber`, `.grbl`).
"""

from bisect import bisect_right
from dataclasses import dataclass, replace
from itertools import pairwise
from math import copysign, inf, pi, sin, sqrt

import numpy as np

from gs2ci.core.mechanics import Mechanics

HISTORY = 4096
"""Pieces of motion that are remembered: some thousand moves, far more than one exposure sees."""


@dataclass(frozen=True)
class _Piece:
    start_s: float
    position_mm: float
    speed_mm_s: float
    acceleration_mm_s2: float
    slack_mm: float  # how far the carriage lies behind the counted position, from 0 to the backlash
    astray_mm: float = 0.0  # what repeatability and slipping add to the true position
    origin_mm: float = 0.0  # where along the screw the counter's zero lies

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
        self.moves = 0
        """Counts what it was told to do: a move, a stop, a halt."""
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
        turned = counted + piece.origin_mm
        true = m.scale * (turned - behind) + piece.astray_mm
        if m.ripple_mm:
            true += m.ripple_mm * sin(2 * pi * turned / m.pitch_mm)
        return -true if m.reversed_sign else true

    def counted_mm(self, screw_mm: float) -> float:
        """Return what the counter will show where a perfect axis, counting since it was built, shows `screw_mm`."""
        piece = self._pieces[-1]
        return screw_mm - piece.astray_mm / self.mechanics.scale - piece.origin_mm

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
        """Call the present position something else (homing, a restart); the carriage stays where it is.

        The history before keeps its old numbers.
        """
        piece, here = self._piece(now_s), self.position_at(now_s)
        slack, origin_mm = self._slack_at(piece, here), piece.origin_mm + here - position_mm
        while self._pieces[-1].start_s >= now_s and len(self._pieces) > 1:
            self._pieces.pop()
        self._pieces.append(_Piece(now_s, position_mm, 0.0, 0.0, slack, piece.astray_mm, origin_mm))
        self.ends_s = now_s

    def disturb(self, now_s: float, *, pause_s: float = 0.0, speed_factor: float = 1.0, jump_mm: float = 0.0) -> float:
        """Change the rest of the present move, as its own counter or encoder sees it; return when it will end.

        Args:
            now_s: From when on.
            pause_s: It halts at once for so long, then goes on as planned.
            speed_factor: The rest of the way is covered at so many times the planned speed.
            jump_mm: It is displaced at once by so much, and stays so.
        """
        here, index = self.position_at(now_s), self._index(now_s)
        planned, kept = self._pieces[index:], [piece for piece in self._pieces[: index + 1] if piece.start_s < now_s]
        slack = self._slack_at(planned[0], here)
        first = replace(
            planned[0], start_s=now_s, position_mm=here, speed_mm_s=planned[0].speed_at(now_s), slack_mm=slack
        )
        if pause_s:
            kept.append(replace(first, position_mm=here + jump_mm, speed_mm_s=0.0, acceleration_mm_s2=0.0))
        warped = [
            replace(
                piece,
                start_s=now_s + pause_s + (piece.start_s - now_s) / speed_factor,
                position_mm=piece.position_mm + jump_mm,
                speed_mm_s=piece.speed_mm_s * speed_factor,
                acceleration_mm_s2=piece.acceleration_mm_s2 * speed_factor**2,
            )
            for piece in [first, *planned[1:]]
        ]
        self._pieces = kept + warped
        self.ends_s = now_s + pause_s + (self.ends_s - now_s) / speed_factor
        return self.ends_s

    def _legs_to(self, target_mm: float, speed_mm_s: float, now_s: float) -> list[tuple[float, float]]:
        """Return accelerations and durations that end at rest on the target."""
        a, v0 = self.acceleration_mm_s2, self.speed_at(now_s)
        distance = target_mm - self.position_at(now_s)
        braking = v0 * abs(v0) / (2 * a)
        legs: list[tuple[float, float]] = []
        if v0 and (distance * v0 < 0 or abs(braking) > abs(distance)):
            legs.append((-copysign(a, v0), abs(v0) / a))  # wrong way or too fast: come to rest first
            distance, v0 = distance - braking, 0.0
        way, distance, v0 = copysign(1.0, distance), abs(distance), abs(v0)
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
        self.moves += 1
        piece = self._piece(now_s)
        astray_mm = piece.astray_mm if astray_mm is None else astray_mm
        slack, origin_mm = self._slack_at(piece, here), piece.origin_mm
        while self._pieces[-1].start_s >= now_s and len(self._pieces) > 1:
            self._pieces.pop()
        t = now_s
        for acceleration, duration_s in legs:
            if duration_s <= 0:
                continue
            piece = _Piece(t, here, speed, acceleration, slack, astray_mm, origin_mm)
            self._pieces.append(piece)
            t += duration_s
            if t == inf:
                self.ends_s = inf
                return piece.start_s
            here, speed = piece.position_at(t), piece.speed_at(t)
            slack = self._slack_at(piece, here)
        self._pieces.append(_Piece(t, here, 0.0, 0.0, slack, astray_mm, origin_mm))
        del self._pieces[:-HISTORY]
        self.ends_s = t
        return t

    def _slack_at(self, piece: _Piece, counted_mm: float) -> float:
        """Return how far the carriage lies behind: the play is taken up in the direction of motion."""
        taken = piece.slack_mm + counted_mm - piece.position_mm
        return min(max(taken, 0.0), self.mechanics.backlash_mm)

    def _piece(self, when_s: float) -> _Piece:
        return self._pieces[self._index(when_s)]

    def _index(self, when_s: float) -> int:
        return max(bisect_right(self._pieces, when_s, key=lambda piece: piece.start_s) - 1, 0)
