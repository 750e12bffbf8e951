"""A rig as calibration uses it: its devices, and an operator who does the manual steps.

Here: the bench of a rig file, the operator at the terminal, the bundle's provenance. Not here: the simulated operator
(`simulated_operator`), the procedures (`gs2ci_calibration`).
"""

from collections.abc import Callable

from gs2ci.core.arrays import U16
from gs2ci.core.progress import Progress, Silent
from gs2ci.rig.config import RigTable, WorldTable
from gs2ci.rig.intent import intended
from gs2ci.rig.opening import Rig
from gs2ci.rig.patterns import on_modulator
from gs2ci_calibration.bench import Arrangement, Bench, Operator, Patterns
from gs2ci_calibration.bundle import Provenance
from gs2ci_drivers.acquisition import Devices

REQUESTS = {
    Arrangement.DARK: "put the lens cap on",
    Arrangement.FLAT: "take the lens cap off and let an evenly lit field fill the view (opal glass, or a white screen "
    "far out of focus)",
    Arrangement.BOARD: "hold the ChArUco board before the camera: picture {number}, tilted in another direction, "
    "filling the view",
    Arrangement.FIXED_BOARD: "fix the ChArUco board on a stand, square to the camera and filling half of its view, "
    "with the stage in mid-travel",
    Arrangement.SCENE: "point the camera at a textured scene at rest",
}


class TerminalOperator:
    """A person at a terminal who sets up what is requested and confirms it.

    Args:
        ask: Shows a request and returns when the person has confirmed it.
    """

    def __init__(self, ask: Callable[[str], object]) -> None:
        self._ask = ask
        self._now: tuple[Arrangement, int] | None = None

    def please(self, setup: Arrangement, index: int) -> None:
        """Request an arrangement, unless it is already set up."""
        if self._now != (setup, index):
            self._ask(REQUESTS[setup].format(number=index + 1))
            self._now = (setup, index)


def operator_of(rig: Rig, ask: Callable[[str], object]) -> Operator:
    """Return the operator of this rig: a person, or the simulated one."""
    if rig.bench is None:
        return TerminalOperator(ask)
    # Imported here because a real bench does not need the simulator.
    from gs2ci.rig.simulated_operator import SimulatedOperator  # noqa: PLC0415

    return SimulatedOperator(rig.bench, rig.table.world or WorldTable(), rig.table.calibration.board)


def bench_of(
    rig: Rig, devices: Devices, operator: Operator, *, fast: bool = False, progress: Progress | None = None
) -> Bench:
    """Connect and return the bench of a rig file; nothing moves and nothing is uploaded.

    Raises:
        DriverError: A device does not answer.
        InputError: The masks do not fit on the modulator.
    """
    codes, capture, config = intended(rig, devices)
    modulator = devices.modulator.connect()
    size = (modulator.height, modulator.width)

    def lay_out(drawn: U16) -> Patterns:
        return on_modulator(drawn, rig.table.registration, size)

    return Bench(
        devices=devices,
        operator=operator,
        config=config,
        capture=capture.rounded_for(modulator),
        codes=codes,
        lay_out=lay_out,
        options=rig.table.calibration,
        superpixel=rig.table.registration.superpixel,
        directions=_directions(rig.table),
        fast=fast,
        progress=progress or Silent(),
    )


def _directions(table: RigTable) -> dict[str, tuple[float, float, float]]:
    """Return the direction in which each axis moves the camera by the rig file; empty if it states none."""
    mount = table.stage.mount if table.stage is not None else None
    return {} if mount is None else {"x": mount.x, "y": mount.y, "z": mount.z}


def provenance_of(rig: Rig, devices: Devices) -> Provenance:
    """Return which bench this is: the rig file, and the identities that the devices report."""
    modulator, sensor = devices.modulator.connect(), devices.sensor.connect()
    named = {
        "modulator": (modulator.model, modulator.serial, modulator.firmware),
        "sensor": (sensor.model, sensor.serial, sensor.driver),
    }
    if devices.stage is not None:
        stage = devices.stage.connect()
        named["stage"] = (stage.model, stage.serial, stage.firmware)
    return Provenance(rig.text, named, rig.bench is not None, rig.table.calibration.temperature_c)
