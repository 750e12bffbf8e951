"""The offset between the camera's clock and the computer's, which converts a camera's stamps to the bench's time.

A GenICam camera stamps by a counter of its own, which begins at power-on. Latching that counter (SFNC 2:
TimestampLatch, TimestampLatchValue in nanoseconds; USB3 Vision's own registers, where a camera has no other: Timestamp,
which holds what TimestampLatch latched; GigE Vision 1.x: GevTimestampControlLatch, GevTimestampValue in ticks of
GevTimestampTickFrequency) between two readings of the computer's clock gives their difference, to within half the time
between the two readings. Of a Timestamp that counts on after it was latched, the reading lies between the two as well.

Here: latching and converting. Not here: what a stamp is the time of (`GenicamOptions.stamps`).
"""

from dataclasses import dataclass
from typing import Final

from gs2ci_drivers.genicam.nodes import Features
from gs2ci_drivers.ports import CameraPort

TRIES: Final = 3
"""The shortest of so many exchanges is used, because it is the most precise."""
RENEWED_S: Final = 1.0
"""The offset is measured again after this time, in which two crystals that differ by 100 ppm drift by 0.1 ms."""


@dataclass(frozen=True)
class _Latched:
    offset_ns: float
    ns_per_tick: float
    uncertainty_ns: int
    at_ns: int


class CameraClock:
    """Converts a camera's time stamps to the computer's monotonic clock.

    Args:
        port: The camera.
        features: Its features.
    """

    def __init__(self, port: CameraPort, features: Features) -> None:
        self._port = port
        self._features = features
        self._latched: _Latched | None = None
        self._names = next(
            (
                pair
                for pair in (
                    ("TimestampLatch", "TimestampLatchValue"),
                    ("TimestampLatch", "Timestamp"),
                    ("GevTimestampControlLatch", "GevTimestampValue"),
                )
                if features.has(pair[0]) and features.has(pair[1])
            ),
            None,
        )

    @property
    def uncertainty_s(self) -> float | None:
        """Get the uncertainty of converted stamps; None if the camera's clock cannot be read."""
        return None if self._latched is None else self._latched.uncertainty_ns * 1e-9

    def renew(self) -> None:
        """Measure the offset again, unless it was measured less than `RENEWED_S` ago or the clock cannot be read."""
        if self._names is None:
            return
        if self._latched is not None and self._port.clock_ns() - self._latched.at_ns < RENEWED_S * 1e9:
            return
        latch, value = self._names
        ns_per_tick = 1.0 if latch == "TimestampLatch" else self._ns_per_tick()
        found: list[_Latched] = []
        for _ in range(TRIES):
            before_ns = self._port.clock_ns()
            self._features.execute(latch)
            after_ns = self._port.clock_ns()
            ticks = self._features.number(value)
            if ticks is None:
                return
            if value == "Timestamp":
                after_ns = self._port.clock_ns()
            middle_ns = (before_ns + after_ns) / 2
            found.append(
                _Latched(middle_ns - ticks * ns_per_tick, ns_per_tick, (after_ns - before_ns + 1) // 2, after_ns)
            )
        self._latched = min(found, key=lambda one: one.uncertainty_ns)

    def to_monotonic_ns(self, ticks: int) -> int | None:
        """Return a stamp as nanoseconds of CLOCK_MONOTONIC, or None if the camera's clock cannot be read."""
        if self._latched is None:
            return None
        return round(ticks * self._latched.ns_per_tick + self._latched.offset_ns)

    def _ns_per_tick(self) -> float:
        return 1e9 / (self._features.number("GevTimestampTickFrequency") or 1e9)
