"""What a rig file states of a simulated bench's surroundings, as far as a twin's maker may need it.

Here: the record that a `World` carries. Not here: reading the file (`gs2ci.rig.config`), building the bench
(`gs2ci.rig.simulated`), what a twin makes of it (`simulated` in each module of `wires`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from gs2ci.core.mechanics import Mechanics
from gs2ci_sims.faults import FaultSet

DEVICES: Final = ("modulator", "sensor", "stage")


@dataclass(frozen=True)
class Stated:
    """The part of a rig file that is about the simulated surroundings.

    Args:
        table: The [world] table, by its fields (`gs2ci.rig.config.WorldTable`); None in a world without a rig file.
        trigger_line: The line of the bus that triggers or gates the sensor.
        faults: The faults that each device will have.
    """

    table: Any = None
    trigger_line: str = "modulator.out"
    faults: Mapping[str, FaultSet] = field(default_factory=lambda: {name: FaultSet() for name in DEVICES})

    def mechanics(self, axis: str) -> Mechanics:
        """Return the stated errors between an axis's counted and true position; none if none are stated."""
        return Mechanics() if self.table is None else self.table.mechanics.get(axis, Mechanics())

    def start_mm(self, built_mm: float) -> float:
        """Return the stated counted position at power-on, or else that which the twin is built with."""
        stated = None if self.table is None else self.table.stage_start_mm
        return built_mm if stated is None else float(stated)
