"""How long each stage of a reconstruction takes, by the wall clock."""

import time


class Stopwatch:
    """Wall-clock seconds by stage."""

    def __init__(self) -> None:
        self.began_s = self._lap_s = time.monotonic()
        self._stages: dict[str, float] = {}

    def lap(self, stage: str) -> None:
        """Add the time since the last lap to a stage."""
        now = time.monotonic()
        self._stages[stage] = self._stages.get(stage, 0.0) + now - self._lap_s
        self._lap_s = now

    def seconds(self) -> dict[str, float]:
        """Return the seconds of each stage, and of all as "total"."""
        return {**self._stages, "total": self._lap_s - self.began_s}
