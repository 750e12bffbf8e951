"""A modulator's driver on its twin: opened, run, unplugged, opened again; for the tests of all modulators."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from gs2ci_drivers.modulator import Modulator
from gs2ci_drivers.pattern_sequence import PatternSequence

D = TypeVar("D", bound=Modulator)


@dataclass
class ModulatorBench(Generic[D]):
    """A driver on its twin.

    Args:
        driver: Opens it from its name, a link to the twin, a clock and, if it has any, its options.
        name: The modulator's name.
        twin: The device's twin.
        world: The twin's `gs2ci_sims.world.World`.
        settings: The driver's options; None for its own defaults. A change holds from the next opening on.
    """

    driver: Callable[..., D]
    name: str
    twin: Any
    world: Any
    settings: Any = None
    modulator: D = field(init=False)

    def __post_init__(self) -> None:
        self.modulator = self.open()

    def open(self) -> D:
        """Open the driver on the twin's port."""
        options = () if self.settings is None else (self.settings,)
        return self.driver(self.name, self.twin.open(), self.world.clock, *options)

    def reopen(self) -> None:
        """Pull the plug, and open the device again."""
        self.modulator.close()
        self.twin.plug_in()
        self.modulator = self.open()

    def run(self, sequence: PatternSequence, timeout_s: float = 60.0) -> list[Any]:
        """Connect, upload, arm, start, wait; return the masks that were shown."""
        self.modulator.connect()
        self.modulator.upload(sequence)
        self.modulator.arm()
        begin_s = self.world.clock.now_s()
        self.modulator.start()
        self.modulator.wait_done(timeout_s)
        return list(self.world.masks_between(begin_s, self.world.clock.now_s()))
