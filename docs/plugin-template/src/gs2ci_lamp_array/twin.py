"""The device, simulated below its port: it reads the lines as the firmware does, and lights the lamps of a world.

It shares no code with the driver: what both read is the table in firmware/lamp_array.ino.
"""

import numpy as np

from gs2ci_lamp_array.settings import LampArrayOptions
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.panel import Out, Panel, Show
from gs2ci_sims.wires.serial_twin import SerialTwin
from gs2ci_sims.world import World

LATENCY_S = 1e-3


class LampArrayTwin(SerialTwin):
    """An Arduino with lamps."""

    def __init__(self, world: World, settings: LampArrayOptions | None = None, faults: FaultSet | None = None) -> None:
        super().__init__(world.clock, faults, (settings or LampArrayOptions()).baud)
        self.panel = Panel(world, "modulator.out", self.faults)
        self.shutter_open = False
        self._told: list[int] = []
        self._out = Out.NONE
        self._masks: dict[int, np.ndarray] = {}
        self._armed = False

    @property
    def terminators(self) -> bytes:
        return b"\n"

    def _stale(self) -> bytes:
        return b"running 3\n"

    def _line(self, line: bytes) -> None:
        words = line.decode("ascii", "replace").split()
        self._reply((self._answer(words) if words else "no line").encode() + b"\n", line.decode("ascii", "replace"))

    def _answer(self, words: list[str]) -> str:
        match words:
            case ["?"]:
                return "lamp-array 1 TWIN"
            case ["L", *numbers, out] if len(numbers) == 5 and out in Out.__members__:
                self._told, self._out = [int(number) for number in numbers], Out[out]
                self._masks.clear()
                return "ok" if 1 <= self._told[0] <= 32 else "no room"
            case ["M", index, text] if self._told and int(index) < self._told[0] and len(text) == 48:
                rows = np.frombuffer(bytes.fromhex(text), ">u2")
                self._masks[int(index)] = (rows[:, None] >> np.arange(15, -1, -1) & 1).astype(np.uint8)
                return "ok"
            case ["A"] if self._loaded and not self.panel.running:
                self._armed = self.shutter_open = True
                return "ok"
            case ["G"] if self._armed:
                self._armed = False
                count, exposure, dark, pause, repeats = self._told
                times_s = (exposure * 1e-6, dark * 1e-6, pause * 1e-6)
                masks = [self._masks[index] for index in range(count)]
                self.panel.play(Show(masks, 1, *times_s, repeats, self._out), LATENCY_S)
                return "ok"
            case ["S"]:
                self.panel.stop()
                self._armed = self.shutter_open = False
                return "ok"
            case ["Q"]:
                return f"{self._state} {self.panel.shown}"
        return "no such line now"

    @property
    def _loaded(self) -> bool:
        return bool(self._told) and len(self._masks) == self._told[0]

    @property
    def _state(self) -> str:
        if self.panel.running:
            return "running"
        return "armed" if self._armed else "loaded" if self._loaded else "idle"
