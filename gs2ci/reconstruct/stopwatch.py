"""How long each stage of a reconstruction takes, by the wall clock."""

import time
from collections.abc import Mapping
from typing import Self


class Stopwatch:
    """Wall-clock seconds by stage."""

    def __init__(self) -> None:
        self.began_s = self._lap_s = time.monotonic()
        self._stages: dict[str, float] = {}

    @classmethod
    def after(cls, seconds: Mapping[str, float]) -> Self:
        """Return one that goes on from what another has counted (`seconds`)."""
        watch = cls()
        watch._stages = {stage: spent for stage, spent in seconds.items() if stage != "total"}
        watch.began_s -= seconds.get("total", 0.0)
        return watch

    def lap(self, stage: str) -> None:
        """Add the time since the last lap to a stage."""
        now = time.monotonic()
        self._stages[stage] = self._stages.get(stage, 0.0) + now - self._lap_s
        self._lap_s = now

    def seconds(self) -> dict[str, float]:
        """Return the seconds of each stage, and of all as "total"."""
        return {**self._stages, "total": self._lap_s - self.began_s}
