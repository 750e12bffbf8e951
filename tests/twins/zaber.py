"""Zaber devices beyond the usual one: old firmware, servo axes and direct drives, ramps of other shapes.

On a servo axis a step is a count of the encoder, of which it moves by some at rest, within `cloop.settle.tolerance`
(µm; the maker's library converts it as a length). Begin and end of moves may have accelerations of their own
(`motion.accelonly`, `motion.decelonly`), which may grow and fall within a time in ms (`motion.accel.ramptime`; that it
is linear in time is an assumption).
"""

from dataclasses import dataclass
from math import copysign, sin, sqrt
from typing import Any

from gs2ci_sims.axis_motion import AxisMotion
from gs2ci_sims.wires import zaber
from gs2ci_sims.wires.zaber import SPEED_SCALE, ZaberAxis
from gs2ci_sims.world import VirtualClock

STEPS = 8
"""Pieces of constant acceleration in which one grows."""


@dataclass
class OddAxis(ZaberAxis):
    """An axis of any build.

    Args:
        deceleration: `motion.decelonly`, in the same data; None: that of `acceleration`, which `motion.accelonly` is.
        rounding_ms: `motion.accel.ramptime`; None for firmware that has no such setting.
        resolution: Microsteps per full step; None for a direct drive, which has no such setting.
        temperature_c: `driver.temperature`; None for a device that has no such setting.
        settle_um: `cloop.settle.tolerance` of a servo axis; None for a device that has no such setting.
        restless_steps: By how many counts its position changes at rest.
    """

    deceleration: int | None = None
    rounding_ms: float | None = 0.0
    resolution: int | None = 64
    temperature_c: float | None = 31.4
    settle_um: float | None = None
    restless_steps: int = 0


class OddMotion(AxisMotion):
    """An axis whose moves from rest to rest have other ramps.

    Args:
        axis: The axis as built.
    """

    def __init__(self, axis: OddAxis) -> None:
        per_data = 1e4 / SPEED_SCALE * axis.microstep_mm
        super().__init__(axis.start_mm, axis.acceleration * per_data, axis.mechanics)
        self._braking_mm_s2 = (axis.deceleration or axis.acceleration) * per_data
        self._rounding_s = (axis.rounding_ms or 0.0) * 1e-3

    def _legs_to(self, target_mm: float, speed_mm_s: float, now_s: float) -> list[tuple[float, float]]:
        if self.speed_at(now_s):
            return super()._legs_to(target_mm, speed_mm_s, now_s)
        distance = target_mm - self.position_at(now_s)
        ends = self.acceleration_mm_s2, self._braking_mm_s2
        return self._rounded(copysign(1.0, distance), abs(distance), speed_mm_s, *ends)

    def _rounded(self, way: float, distance: float, speed: float, a: float, b: float) -> list[tuple[float, float]]:
        """Return a move from rest to rest whose accelerations grow and fall in steps, over `rounding_s` each."""
        slowness, rounding_s = 1 / a + 1 / b, self._rounding_s
        peak = min(speed, (sqrt(rounding_s**2 + 2 * slowness * distance) - rounding_s) / slowness)
        gone, ends = 0.0, []
        for most in (a, b):
            grows_s = min(rounding_s, peak / most)
            rise = [(most * (k + 0.5) / STEPS, grows_s / STEPS) for k in range(STEPS)]
            ends.append([*rise, (most, peak / most - grows_s), *reversed(rise)])
            gone += peak / 2 * (peak / most + grows_s)
        begin, end = ends
        cruise = (0.0, max(distance - gone, 0.0) / peak if peak else 0.0)
        return [*((way * one, s) for one, s in begin), cruise, *((-way * one, s) for one, s in end)]


class ZaberTwin(zaber.ZaberTwin):
    """A Zaber device with one axis of any build.

    Args:
        clock: The world's clock.
        axis: Its axis.
        firmware: Its version. From 7.25 on `move abs` accepts a speed and an acceleration for this move; from 6.06 on
            the two ends of a move have accelerations of their own.
        options: What any twin takes.
    """

    def __init__(
        self,
        clock: VirtualClock,
        axis: OddAxis,
        *,
        firmware: str = "7.28",
        **options: Any,
    ) -> None:
        super().__init__(clock, {"x": axis}, **options)
        version = tuple(int(part) for part in firmware.split("."))
        self._takes_speeds = version >= (7, 25)
        self._built = axis
        self._axes[0].motion = OddMotion(axis)
        braking = axis.deceleration or axis.acceleration
        self._odd = {
            "version": firmware,
            "motion.accelonly": axis.acceleration if version >= (6, 6) else None,
            "motion.decelonly": braking if version >= (6, 6) else None,
            "motion.accel.ramptime": axis.rounding_ms,
            "resolution": axis.resolution,
            "driver.temperature": axis.temperature_c,
            "cloop.settle.tolerance": axis.settle_um,
        }

    def _do_get(self, number: int, words: list[str]) -> str:
        if words == ["pos"]:
            rest = self._built.restless_steps * sin(2e3 * self.clock.now_s())
            return str(round(self._axes[0].motion.position_at(self.clock.now_s()) / self._built.microstep_mm + rest))
        if not words or words[0] not in self._odd:
            return super()._do_get(number, words)
        if self._odd[words[0]] is None:
            raise zaber._RejectedError("BADCOMMAND")
        return str(self._odd[words[0]])

    def _do_move(self, number: int, words: list[str]) -> None:
        if not self._takes_speeds and len(words) > 1 + bool({"abs", "rel", "vel"} & set(words)):
            raise zaber._RejectedError("BADCOMMAND")
        super()._do_move(number, words)
