"""The contents of a rig file: the devices' own tables, one for the capture, one for the simulated surroundings.

Every table is a strict model: an unknown key is an error that names the nearest known one. `port = "simulated"` puts a
device's twin below its driver. Not here: opening anything (`gs2ci.rig.opening`).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from pydantic import Field, create_model

from gs2ci.core.config import (
    SIMULATED,
    ConfigTable,
    Count,
    Delay,
    Duration,
    Fraction,
    NotNegative,
    Offset,
    Positive,
    read_toml,
    settings_from,
)
from gs2ci.core.errors import InputError
from gs2ci.core.mechanics import Mechanics
from gs2ci_calibration.options import CalibrationOptions
from gs2ci_drivers.mount import MountOptions
from gs2ci_drivers.plugin import BUILT_IN, driver_plugin, known_driver

if TYPE_CHECKING:
    from gs2ci_drivers.tables import DeviceTable as _Modulator
    from gs2ci_drivers.tables import SensorTable as _Sensor
    from gs2ci_drivers.tables import StageTable as _Stage

# Tables that only a simulation's rig file has; `gs2ci_sims.rig_file` lists those that only a bench's has.
SIMULATION_ONLY = frozenset({"scene", "path", "light", "timing", "plan", "effects", "device_seed"})
# Tables that both kinds of file may have.
SHARED = frozenset({"modulator", "sensor", "optics"})
DEVICE_GROUPS = {"modulator": "gs2ci.modulators", "sensor": "gs2ci.sensors", "stage": "gs2ci.stages"}
"""Table of a rig file -> group of entry points of its drivers."""


class CaptureTable(ConfigTable):
    """[capture]: the capture to be taken."""

    masks: Count = 8
    """Masks shown during one exposure."""
    density: Fraction = 0.25
    """Share of open pixels of a random binary mask."""
    element: Count = 1
    """Sensor pixels per side of a random mask's elements."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Of the random masks."""
    even_masks: bool = True
    """Spread the open elements of each random mask evenly, without the clumps and gaps of independent draws; if `masks`
    times `density` is 2 or more, also open each element in one of them."""
    pattern_file: str = ""
    """An .npy file beside the rig file with mask codes [N, h, w] in 0 to 1, used instead of random ones; grey ones need
    a `bit_depth` that can show them."""
    bit_depth: Annotated[int, Field(ge=1, le=16)] = 1
    """Bits of each mask: 1 for binary ones."""
    mask_s: Duration = 0.01
    """How long each mask is shown."""
    dark_s: Delay = 0.0
    """Dark time between masks."""
    mode: Literal["per-exposure", "gate", "per-mask"] = "per-exposure"
    """How modulator and sensor are synchronised (docs/bench.md)."""
    shots: Count = 1
    """Number of coded exposures, a multiple of `burst`."""
    burst: Count = 1
    """How many of them are taken in one sweep of the stage, or in one start of the modulator."""
    turn_masks: bool = True
    """Begin each start of the modulator with another mask: exposures of one path then tell more together, where those
    under masks in one order only average noise."""
    axis: str = ""
    """Axis that moves during an exposure; "" keeps the camera still."""
    from_mm: float = 0.0
    """Its position when the first mask of an exposure appears."""
    to_mm: float = 0.0
    """Its position at the end of the last mask."""
    margin_s: Delay = 0.0
    """By how much the exposure ends before the last mask does."""
    jitter_s: Delay = 20e-6
    """The latest start of an exposure after its trigger for which the plan allows."""
    retries: Annotated[int, Field(ge=0)] = 0
    """How often a shot is repeated if its frame was lost, late, corrupt or stale, or the stage left its path."""
    continuous: bool = False
    """Take all shots in one run of the modulator, as fast as the devices allow: for a camera at rest. Lost frames are
    named and skipped."""
    ring: Count = 16
    """Shots that may wait in memory while the disk is busy, in a continuous capture."""
    sync: bool = False
    """Wait after each row until the storage device has stored it, so that it survives a loss of power, too."""


class RegistrationTable(ConfigTable):
    """[registration]: which modulator pixels a sensor pixel sees, by design."""

    superpixel: Count = 1
    """Modulator pixels per side of one mask element, which one sensor pixel sees."""
    row: Annotated[int, Field(ge=-1)] = -1
    """First modulator row that the sensor sees; -1 centres the masks."""
    column: Annotated[int, Field(ge=-1)] = -1
    """First modulator column, likewise."""


class OpticsTable(ConfigTable):
    """[optics]: what is known about lens, scene and light; used for the plan and for scaling."""

    focal_px: Positive | None = None
    """Focal length in sensor pixels; without a calibrated camera it is written into the shot file."""
    nearest_mm: Positive | None = None
    """Distance of the nearest point of the scene, for the motion in the picture that the plan states."""
    farthest_mm: Positive | None = None
    """Distance of the farthest point, likewise."""
    full_scale_e_per_s: Positive | None = None
    """Electrons per second in a pixel that sees a white scene through an open mask."""
    full_scale_dn: Positive | None = None
    """Reading above black that a white scene gives under one open mask during the time that a mask is shown."""


class TrueSensorTable(ConfigTable):
    """[world.sensor]: true properties of the simulated sensor that differ from [sensor]; at 12 bits."""

    full_well_e: Positive | None = None
    """Electrons that a pixel can hold."""
    electrons_per_dn: Positive | None = None
    """Electrons per step of a reading of 12 bits, whatever the format."""
    read_noise_e: NotNegative | None = None
    """Standard deviation of the reading in the dark, electrons."""
    black_level_dn: NotNegative | None = None
    """Reading of 12 bits without light, likewise."""
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)] | None = None
    """Electrons per photon."""


class WorldTable(ConfigTable):
    """[world]: the surroundings of simulated devices; required if any port is "simulated"."""

    scene: str = "motorcycle"
    """What the camera sees: a scene of the simulator's library or of a plug-in, or a scene file (.toml), relative to
    the rig file's folder. It stands still."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Of the scene "planes", and of the noise."""
    scene_units_per_mm: Positive = 0.01
    """How far the camera moves in the scene per mm of the stage."""
    supersampling: Count = 1
    """Samples per pixel side with which the scene is rendered."""
    tolerance_dn: Positive = 0.25
    """Allowed difference in total, rms, from a simulation of every effect; it decides which effects are simulated."""
    height: Count = 400
    """Rows of the picture that the simulated sensor sees, as many as [sensor] reads out."""
    width: Count = 600
    """Its columns, likewise."""
    noise: bool = True
    """Whether readings have noise."""
    stage_start_mm: float | None = None
    """Position of the stage's axes when it is switched on; without it, that of the twin."""
    rest_mm: float | None = None
    """Position of the swept axis from which the camera sees the scene as it was made; without it, the middle of the
    travel, so that captures along other travels see the same."""
    trigger_latency_s: Delay = 0.0
    """True delay from a trigger's edge to the exposure."""
    trigger_jitter_s: Delay = 0.0
    """Standard deviation of that delay."""
    trigger_exposure_offset_s: Offset = 0.0
    """True excess of a triggered exposure over the configured one."""
    trigger_out_2_bit: Literal["disables", "enables"] = "disables"
    """The true effect of bit 0 of a pattern entry's byte 9 on the simulated DLPC900."""
    dlpc900_start_s: Delay = 500e-6
    """Delay from a start to the first mask of the simulated DLPC900; TI states no figure."""
    lamp: Literal["switched", "continuous"] = "switched"
    """Whether the simulated DLPC900's lamp follows its LED enables or stays on, as arc lamps and most others do."""
    camera_driver: Literal["twin", "unicam", "rp1-cfe", "uvcvideo", "other"] = "twin"
    """The kernel driver whose time stamps the simulated camera imitates, also a GenICam one; "twin" stamps the start of
    exposure and flags it, "other" the end of the frame."""
    camera_clock_ppm: Annotated[float, Field(gt=-1e6, lt=1e6)] = 0.0
    """By how much a second of the simulated V4L2 camera is longer than a true one, parts per million."""
    camera_array: tuple[Count, Count] | None = None
    """Rows and columns of the simulated camera's pixel array, of which [sensor] reads out a region; the scene is what
    that region sees. Without it the array is `height` x `width`."""
    camera_readout_s: Delay | None = None
    """True readout time of the simulated camera; without it, 10 us per row."""
    panel_response_s: Delay = 0.0
    """Time constant with which the pixels of a simulated LCoS panel follow their mask."""
    grbl_board: Literal["plain", "uno", "native"] = "plain"
    """How the simulated GRBL controller reacts to the opening of its port: not at all, by a reset, or by answering only
    while DTR is high."""
    devices: Literal["ideal", "typical"] = "typical"
    """Whether properties without a key in [world] are those of ideal or of typical devices (docs/idealisations.md)."""
    flat_radiance: Positive = 0.5
    """Brightness of the flat field that is used to calibrate masks; 1 is the white of a scene."""
    lamp_drift_per_min: float = 0.0
    """Relative change of all light per minute."""
    always: Literal["", "dark", "flat", "board", "scene"] = ""
    """What stands before the camera whatever `gs2ci calibrate` requests; "" is what it requests."""
    mirrored: bool = False
    """Whether the image of the modulator is mirrored left to right."""
    quarter_turns: Annotated[int, Field(ge=0, le=3)] = 0
    """By how many quarters it is then turned clockwise; 2 is upside down."""
    effects: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """[world.effects.NAME]: imperfections of the light path, as in docs/simulation.md."""
    sensor: TrueSensorTable = TrueSensorTable()
    mechanics: dict[str, Mechanics] = Field(default_factory=dict)
    mount: MountOptions | None = None
    """How the stage truly moves the camera; without it, as [stage.mount] says."""
    faults: tuple[str, ...] = ()
    """Faults to inject once each, "device: fault" or "device: fault after N" opportunities; see docs/faults.md."""


def _kinds(group: str) -> Any:
    """Return the tables of a group's built-in devices, told apart by their `kind`."""
    tables = tuple(known_driver(group, kind).settings for kind in BUILT_IN[group])
    return Annotated[Union[tables], Field(discriminator="kind")]  # noqa: UP007  the tables are known at run time only


if not TYPE_CHECKING:  # for a type checker they are what every device's table has
    _Modulator, _Sensor, _Stage = (_kinds(group) for group in DEVICE_GROUPS.values())


class RigTable(ConfigTable):
    """A rig file."""

    name: str = "rig"
    """Of the bench, for shots and logs."""
    modulator: _Modulator
    sensor: _Sensor
    stage: _Stage | None = None
    capture: CaptureTable = CaptureTable()
    registration: RegistrationTable = RegistrationTable()
    optics: OpticsTable = OpticsTable()
    calibration: CalibrationOptions = CalibrationOptions()
    world: WorldTable | None = None
    metadata: dict[str, str | int | float | bool] = Field(default_factory=dict)
    """[metadata]: entries of the operator's choice that are stored with every shot; exports use `operator`, `sample`,
    `institution` and `experiment`."""
    session: Literal["off", "info", "debug"] = "info"
    """How much is written into the session log beside the shot file; "debug" includes every command and answer."""
    trace: bool = False
    """Whether to write every byte that passes the ports beside the shot file."""

    @property
    def simulated(self) -> tuple[str, ...]:
        """Get the names of the devices that are twins."""
        tables = {"modulator": self.modulator, "sensor": self.sensor, "stage": self.stage}
        return tuple(name for name, table in tables.items() if table is not None and table.port == SIMULATED)


def with_plugins(tables: Mapping[str, Any]) -> type[RigTable]:
    """Return the model of a rig file whose devices may come from other packages (`gs2ci_drivers.plugin`).

    Raises:
        PluginError: A plug-in that the file names cannot be used.
    """
    changed: dict[str, Any] = {}
    for key, group in DEVICE_GROUPS.items():
        table = tables.get(key)
        kind = table.get("kind") if isinstance(table, dict) else None
        plugin = None if isinstance(kind, str) and kind in BUILT_IN[group] else driver_plugin(group, kind)
        if plugin is not None:
            changed[key] = (plugin.settings, ...)
    return create_model("RigTable", __base__=RigTable, **changed) if changed else RigTable


def describes_simulation(tables: Mapping[str, Any]) -> bool:
    """Return whether a file describes a simulation only, without devices: docs/simulation.md."""
    keys = tables.keys()
    kinds = [name for name in SHARED if isinstance(tables.get(name), dict) and "kind" in tables[name]]
    return not kinds and not keys & (RigTable.model_fields.keys() - SHARED)


def read_rig(path: Path) -> tuple[RigTable, str]:
    """Read a rig file.

    Returns:
        The rig, and the file's text for keeping in shot files.

    Raises:
        InputError: It cannot be read; it describes a simulation and no bench; a key is unknown or a value is invalid;
            simulated and real devices are mixed, which cannot share one clock; or simulated ones have no [world].
    """
    tables, text = read_toml(path)
    if tables.keys() & SIMULATION_ONLY and describes_simulation(tables):
        raise InputError(
            f"{path} describes a simulation, not a bench",
            allowed="a bench's rig file: docs/bench.md, docs/rigs/simulated.toml",
            remedy=f"to see what it would simulate: gs2ci plan {path}",
        )
    return rig_from_tables(tables, path), text


def rig_from_tables(tables: Mapping[str, Any], path: Path) -> RigTable:
    """Turn the tables of a bench's rig file into settings.

    Args:
        tables: The tables.
        path: Their file, for error messages.

    Raises:
        InputError: A key is unknown or a value cannot be; simulated and real devices are mixed; or simulated ones have
            no [world].
    """
    rig = settings_from(tables, with_plugins(tables), path)
    devices = 2 + (rig.stage is not None)
    if rig.simulated and len(rig.simulated) != devices:
        raise InputError(
            f"{path}: only {', '.join(rig.simulated)} of {devices} devices are simulated",
            allowed="all of them or none: virtual and real time cannot be mixed",
            remedy='set every port to "simulated", or none',
        )
    if rig.simulated and rig.world is None:
        raise InputError(f"{path}: simulated devices without a [world]", remedy="add a [world] table")
    if rig.world is not None and rig.world.scene.endswith(".toml"):
        world = rig.world.model_copy(update={"scene": str(path.parent / rig.world.scene)})
        rig = rig.model_copy(update={"world": world})
    return rig
