"""The simulated surroundings of a rig: one world, and one twin per device.

Here: building them from the rig file. Not here: the choice between twin and device (`gs2ci.rig.opening`), the operator
of that world (`simulated_operator`).
"""

import re
import sys
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gs2ci.core.errors import InputError
from gs2ci.core.records import CfaPattern
from gs2ci.rig.config import RigTable, WorldTable
from gs2ci.rig.patterns import origin
from gs2ci_drivers.display_slm.options import DisplaySlmOptions
from gs2ci_drivers.dlpc900.options import Dlpc900Options
from gs2ci_drivers.genicam.options import GenicamOptions
from gs2ci_drivers.grbl.options import GrblOptions
from gs2ci_drivers.plugin import driver_plugin
from gs2ci_drivers.v4l2.options import V4l2Options
from gs2ci_drivers.video_out.options import VideoOutOptions
from gs2ci_drivers.zaber.options import ZaberOptions
from gs2ci_sims.axis_motion import Mechanics
from gs2ci_sims.effects.base import Effect
from gs2ci_sims.effects.misregistration import Misregistration
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.idealisations import typical
from gs2ci_sims.registration import MaskAlignment
from gs2ci_sims.sensor import Sensor
from gs2ci_sims.wires.display_slm import DisplaySlmTwin
from gs2ci_sims.wires.dlpc900 import Dlpc900Twin
from gs2ci_sims.wires.genicam import GenicamModel, GenicamTwin
from gs2ci_sims.wires.grbl import GrblTwin
from gs2ci_sims.wires.grbl_build import GrblMachine
from gs2ci_sims.wires.scpi_modulator import ScpiModulatorTwin, ScpiPanel
from gs2ci_sims.wires.screen import ScreenTwin
from gs2ci_sims.wires.v4l2 import V4l2Twin
from gs2ci_sims.wires.v4l2_camera import STAMPING, CameraModel
from gs2ci_sims.wires.zaber import ZaberAxis, ZaberTwin
from gs2ci_sims.world import LightPath, Mount, World

if TYPE_CHECKING:
    from gs2ci_sims.bench_light import BenchLight
    from gs2ci_sims.scene import Scene

MODULATOR_SIZES = {
    "dlpc900": (1080, 1920),  # DLP6500
    "scpi": (ScpiPanel.height, ScpiPanel.width),
    "santec": (1200, 1920),
    "video": (1080, 1920),
}
DEFAULT_FULL_SCALE_E_PER_S = 100_000.0
FAULT = re.compile(r"(?P<device>modulator|sensor|stage): *(?P<fault>[\w.]+)(?: after (?P<skip>\d+))?")

ModulatorTwin = Dlpc900Twin | ScpiModulatorTwin | DisplaySlmTwin | ScreenTwin


@dataclass
class SimulatedBench:
    """The world of a simulated rig and the twins in it; it outlives the sessions that drivers open.

    Args:
        world: Clock, trigger bus, light.
        modulator: The modulator's twin.
        sensor: The camera's and its kernel's twin.
        stage: The stage's twin, or None.
        faults: The faults to be injected into each twin.
    """

    world: World
    modulator: ModulatorTwin
    sensor: V4l2Twin | GenicamTwin
    stage: ZaberTwin | GrblTwin | None
    faults: dict[str, FaultSet]

    @property
    def light(self) -> "BenchLight | None":
        """Get the light that exposes the scene of [world], or None if a test uses another light."""
        return _rendering(self.world.light)

    def forget_before(self, when_s: float) -> None:
        """Delete the history before a time, so that a long run takes no more memory than a short one."""
        for index in self.world.forget_before(when_s):
            if self.light is not None:
                self.light.plans.pop(index, None)


def _rendering(light: LightPath) -> "BenchLight | None":
    """Return the light if it renders a scene, otherwise None; the check imports no module of the renderer."""
    module = sys.modules.get("gs2ci_sims.bench_light")
    return light if module is not None and isinstance(light, module.BenchLight) else None


def modulator_size(rig: RigTable) -> tuple[int, int]:
    """Return rows and columns of the simulated modulator.

    Raises:
        InputError: It comes from another package, which does not state its size.
    """
    plugin = driver_plugin("gs2ci.modulators", rig.modulator.kind)
    if plugin is None:
        return MODULATOR_SIZES[rig.modulator.kind]
    if plugin.size is None:
        raise _not_simulated(rig.modulator.kind)
    return plugin.size


def _not_simulated(kind: str) -> InputError:
    return InputError(f"the plug-in {kind!r} has no twin", remedy="use it on a real port, or ask its makers for a twin")


def _plugged_twin(group: str, table: Any, world: World) -> Any:
    """Make the twin of another package's device; None for a built-in device."""
    plugin = None if table is None else driver_plugin(group, table.kind)
    if plugin is None:
        return None
    if plugin.twin is None:
        raise _not_simulated(table.kind)
    return plugin.twin(world, table)


def with_typical_devices(rig: RigTable) -> RigTable:
    """Return the rig with typical devices' figures in its [world], if requested; its own keys take precedence."""
    world = rig.world
    if world is None or world.devices == "ideal":
        return rig
    kinds = {rig.modulator.kind, rig.sensor.kind, *([] if rig.stage is None else [rig.stage.kind])}
    effects, changed = dict(world.effects), {}
    for one in typical(kinds):
        table, _, name = one.key.rpartition(".")
        if table:
            effects.setdefault(name, one.typical)
        elif one.key not in world.model_fields_set:
            changed[one.key] = one.typical
    return rig.model_copy(update={"world": world.model_copy(update={**changed, "effects": effects})})


def build_bench(rig: RigTable, light: LightPath | None = None) -> SimulatedBench:
    """Build the world of a rig file.

    Args:
        rig: A rig of simulated devices.
        light: Turns exposures into pixels; None renders the scene of [world].

    Raises:
        InputError: The scene, the masks' place or a fault's name is invalid.
    """
    rig = with_typical_devices(rig)
    table = rig.world or WorldTable()
    if driver_plugin("gs2ci.sensors", rig.sensor.kind) is not None:
        raise _not_simulated(rig.sensor.kind)
    faults = {name: FaultSet() for name in ("modulator", "sensor", "stage")}
    if light is None:
        light = _light(rig, table, rig.sensor.cfa)
    world = World(light, _mount(rig, table, light))
    stage = _stage_twin(rig, world, faults["stage"])
    if stage is not None:
        world.carry_camera(stage)
    bench = SimulatedBench(
        world=world,
        modulator=_modulator_twin(rig, world, faults["modulator"]),
        sensor=_sensor_twin(rig, table, world, faults["sensor"]),
        stage=stage,
        faults=faults,
    )
    for text in table.faults:
        _inject(bench, text)
    return bench


def _scene(table: WorldTable) -> "Scene":
    from gs2ci_sims.scenes.planes import planes  # noqa: PLC0415
    from gs2ci_sims.scenes.rgbd import motorcycle  # noqa: PLC0415

    size = (table.height, table.width)
    return motorcycle(size) if table.scene == "motorcycle" else planes(np.random.default_rng(table.seed), size)


def _light(rig: RigTable, table: WorldTable, cfa: CfaPattern | None) -> "BenchLight":
    # Imported here because scenes need torch, and a bench with another light does not.
    from gs2ci_sims.bench_light import BenchLight  # noqa: PLC0415
    from gs2ci_sims.radiance import Renderer  # noqa: PLC0415
    from gs2ci_sims.rig_file import effects_from_tables  # noqa: PLC0415

    scene = _scene(table)
    effects = effects_from_tables(table.effects)
    return BenchLight(
        scene,
        _data_sheet(rig, table),
        _registration(rig, table, scene.size, effects),
        full_scale_e_per_s=rig.optics.full_scale_e_per_s or DEFAULT_FULL_SCALE_E_PER_S,
        seed=table.seed,
        cfa=cfa,
        noise=table.noise,
        effects=[effect for effect in effects if not isinstance(effect, Misregistration)],
        lamp_drift_per_min=table.lamp_drift_per_min,
        tolerance_dn=table.tolerance_dn,
        renderer=Renderer(supersampling=table.supersampling),
    )


def _registration(rig: RigTable, table: WorldTable, size: tuple[int, int], effects: list[Effect]) -> MaskAlignment:
    """Return where the modulator's image truly lies; misregistration among the effects displaces it further."""
    row, column = origin(rig.registration, size, modulator_size(rig))
    moved = next((effect for effect in effects if isinstance(effect, Misregistration)), Misregistration())
    return MaskAlignment(
        rig.registration.superpixel,
        row,
        column,
        mirrored=table.mirrored,
        quarter_turns=table.quarter_turns,
        right_px=moved.right_px,
        down_px=moved.down_px,
        turn_mrad=moved.turn_mrad,
        magnification=moved.magnification,
    )


def _data_sheet(rig: RigTable, table: WorldTable) -> Sensor:
    """Return the sensor's true figures: those of the rig file unless [world.sensor] states others.

    Those of [world.sensor] and of the result are at 12 bits, those of [sensor] in readings of its format.
    """
    default, true = Sensor(), table.sensor
    steps = 2.0 ** (default.bits - (rig.sensor.bits or default.bits))
    black, stated = rig.sensor.black_level_dn * steps, rig.sensor.electrons_per_dn
    return Sensor(
        full_well_e=true.full_well_e or rig.sensor.full_well_e or default.full_well_e,
        electrons_per_dn=true.electrons_per_dn or (default.electrons_per_dn if stated is None else stated / steps),
        black_level_dn=black if true.black_level_dn is None else true.black_level_dn,
        read_noise_e=default.read_noise_e if true.read_noise_e is None else true.read_noise_e,
        quantum_efficiency=true.quantum_efficiency or default.quantum_efficiency,
    )


def _mount(rig: RigTable, table: WorldTable, light: LightPath) -> Mount:
    """Mount the camera so that it has the scene's suggested pose in the middle of the travel."""
    directions = Mount().directions
    mount = table.mount or (rig.stage.mount if rig.stage is not None else None)
    if mount is not None:
        directions = {"x": mount.x, "y": mount.y, "z": mount.z}
    scale = table.scene_units_per_mm
    rendering = _rendering(light)
    rest = np.eye(4) if rendering is None else rendering.scene.world_to_camera
    return Mount(
        rest_world_to_camera=rest,
        directions={axis: (x * scale, y * scale, z * scale) for axis, (x, y, z) in directions.items()},
        rest_mm=_rest_mm(rig, table),
    )


def _rest_mm(rig: RigTable, table: WorldTable) -> dict[str, float]:
    """Return each axis's true position in the rest pose: counted in the middle of its travel, else at its start."""
    capture = rig.capture
    rest = _start_mm(rig, table) | ({capture.axis: (capture.from_mm + capture.to_mm) / 2} if capture.axis else {})
    for axis, one in table.mechanics.items():
        if axis in rest:
            rest[axis] *= -one.scale if one.reversed_sign else one.scale
    return rest


def _start_mm(rig: RigTable, table: WorldTable) -> dict[str, float]:
    """Return the counted positions at power-on."""
    start_mm = table.stage_start_mm
    if isinstance(rig.stage, ZaberOptions):
        return dict.fromkeys(rig.stage.axes, ZaberAxis().start_mm if start_mm is None else start_mm)
    if isinstance(rig.stage, GrblOptions):
        return dict(zip("xyz", _grbl(table).start_mm, strict=True))
    return {}


def _grbl(table: WorldTable) -> GrblMachine:
    machine = GrblMachine(mechanics={axis: Mechanics(**one.model_dump()) for axis, one in table.mechanics.items()})
    start_mm = table.stage_start_mm
    return machine if start_mm is None else replace(machine, start_mm=(start_mm, start_mm, -10.0))


def _modulator_twin(rig: RigTable, world: World, faults: FaultSet) -> ModulatorTwin:
    table = rig.world or WorldTable()
    plugged = _plugged_twin("gs2ci.modulators", rig.modulator, world)
    if plugged is not None:
        return plugged  # type: ignore[no-any-return]
    if isinstance(rig.modulator, Dlpc900Options):
        enables, start_s = table.trigger_out_2_bit == "enables", table.dlpc900_start_s
        return Dlpc900Twin(world, faults, name="modulator", bit_enables=enables, start_latency_s=start_s)
    if isinstance(rig.modulator, DisplaySlmOptions):
        ends = (rig.modulator.dark_level, rig.modulator.bright_level)
        return DisplaySlmTwin(world, faults, name="modulator", response_s=table.panel_response_s, greys=ends)
    if isinstance(rig.modulator, VideoOutOptions):
        late, patch = rig.modulator.frames_late, rig.modulator.trigger_patch
        greys = rig.modulator.greys
        return ScreenTwin(world, faults, name="modulator", frames_late=late, patch=patch, greys=greys)
    return ScpiModulatorTwin(world, faults, name="modulator", baud=rig.modulator.baud)


def _stage_twin(rig: RigTable, world: World, faults: FaultSet) -> ZaberTwin | GrblTwin | None:
    table = rig.world or WorldTable()
    plugged = _plugged_twin("gs2ci.stages", rig.stage, world)
    if plugged is not None:
        return plugged  # type: ignore[no-any-return]
    if isinstance(rig.stage, ZaberOptions):
        mechanics = {axis: Mechanics(**one.model_dump()) for axis, one in table.mechanics.items()}
        start_mm = _start_mm(rig, table)
        axes = {
            axis: ZaberAxis(
                microstep_mm=microstep_mm, start_mm=start_mm[axis], mechanics=mechanics.get(axis, Mechanics())
            )
            for axis, microstep_mm in rig.stage.microstep_mm.items()
        }
        return ZaberTwin(world.clock, axes, faults, address=rig.stage.address)
    if isinstance(rig.stage, GrblOptions):
        return GrblTwin(world.clock, _grbl(table), faults, board=table.grbl_board)
    return None


def _sensor_twin(rig: RigTable, table: WorldTable, world: World, faults: FaultSet) -> V4l2Twin | GenicamTwin:
    rng = np.random.default_rng(table.seed)
    line = "modulator.out"
    if isinstance(rig.modulator, Dlpc900Options):
        line += "1" if rig.capture.mode == "gate" else "2"
    if isinstance(rig.sensor, GenicamOptions):
        return GenicamTwin(world, _genicam_model(rig.sensor, table, line), faults, rng=rng)
    return V4l2Twin(world, _camera(rig.sensor, table, line), faults, rng=rng)


def _genicam_model(sensor: GenicamOptions, table: WorldTable, line: str) -> GenicamModel:
    offered = GenicamModel().formats
    first = (sensor.format,) if sensor.format else ()
    rows, columns = table.camera_array or (table.height, table.width)
    return GenicamModel(
        height=rows,
        width=columns,
        formats=(*first, *(name for name in offered if name not in first)),
        trigger_line=line,
        trigger_input=sensor.trigger_line,
        stamps=STAMPING[table.camera_driver][0],
        latency_s=table.trigger_latency_s,
        jitter_s=table.trigger_jitter_s,
        exposure_offset_s=table.trigger_exposure_offset_s,
        readout_s=table.height * CameraModel.line_s if table.camera_readout_s is None else table.camera_readout_s,
    )


def _camera(sensor: V4l2Options, table: WorldTable, line: str) -> CameraModel:
    offered = CameraModel().formats
    rows, columns = table.camera_array or (table.height, table.width)
    stamps, flags_start = STAMPING[table.camera_driver]
    first = (sensor.format.ljust(4),) if sensor.format else ()
    return CameraModel(
        height=rows,
        width=columns,
        formats=(*first, *(code for code in offered if code not in first)),
        trigger=sensor.trigger_adapter,
        module=sensor.trigger_module,
        trigger_line=line,
        latency_s=table.trigger_latency_s,
        jitter_s=table.trigger_jitter_s,
        exposure_offset_s=table.trigger_exposure_offset_s,
        readout_s=table.height * CameraModel.line_s if table.camera_readout_s is None else table.camera_readout_s,
        clock_ppm=table.camera_clock_ppm,
        driver=table.camera_driver,
        stamps=stamps,
        flags_start=flags_start,
        crops=table.camera_array is not None,
        on_subdevice=bool(sensor.subdevice),
    )


def _inject(bench: SimulatedBench, text: str) -> None:
    match = FAULT.fullmatch(text.strip())
    if match is None:
        raise InputError(
            f"fault {text!r} in [world]",
            allowed='"device: fault" or "device: fault after N", device one of modulator, sensor, stage',
        )
    bench.faults[match["device"]].inject(match["fault"], skip=int(match["skip"] or 0))
