"""The simulated surroundings of a rig: one world, and one twin per device.

Here: building them from the rig file. Not here: the choice between twin and device (`gs2ci.rig.opening`), the operator
of that world (`simulated_operator`).
"""

import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gs2ci.core.errors import InputError
from gs2ci.core.mechanics import Mechanics
from gs2ci.rig.config import DEVICE_GROUPS, RigTable, WorldTable
from gs2ci.rig.patterns import origin
from gs2ci_drivers.plugin import known_driver
from gs2ci_sims.effects.masks import Misregistration
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.idealisations import typical
from gs2ci_sims.registration import MaskAlignment
from gs2ci_sims.sensor import SensorFigures
from gs2ci_sims.stated import Stated
from gs2ci_sims.world import LightPath, Motion, Mount, World

if TYPE_CHECKING:
    from gs2ci_sims.bench_light import BenchLight
    from gs2ci_sims.scene import Scene

DEFAULT_FULL_SCALE_E_PER_S = 100_000.0
FAULT = re.compile(r"(?P<device>modulator|sensor|stage): *(?P<fault>[\w.]+)(?: after (?P<skip>\d+))?")


@dataclass
class SimulatedBench:
    """The world of a simulated rig and the twins in it; it outlives the sessions that drivers open.

    Args:
        world: Clock, trigger bus, light.
        modulator: The modulator's twin, as its record makes it (`gs2ci_drivers.plugin.DriverPlugin.twin`).
        sensor: The camera's twin, likewise.
        stage: The stage's twin, likewise, or None.
        faults: The faults to be injected into each twin.
    """

    world: World
    modulator: Any
    sensor: Any
    stage: Any
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
    size = known_driver("gs2ci.modulators", rig.modulator.kind).size
    if size is None:
        raise InputError(
            f"the plug-in {rig.modulator.kind!r} states no size of its modulator",
            remedy="use it on a real port, or ask its makers for that",
        )
    return size


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
        InputError: The scene, the masks' place or a fault's name is invalid; a plug-in has no twin.
    """
    rig = with_typical_devices(rig)
    table = rig.world or WorldTable()
    if light is None:
        scene = scene_of(table)
        light = bench_light(rig, table, scene, _registration(rig, table, scene.size))
    modulator = known_driver("gs2ci.modulators", rig.modulator.kind)
    line = modulator.gate_line if rig.capture.mode == "gate" else modulator.pulse_line
    world = World(light, stated=Stated(table, f"modulator.{line}"))
    tables = {"modulator": rig.modulator, "sensor": rig.sensor, "stage": rig.stage}
    twins = {
        device: None if one is None else known_driver(DEVICE_GROUPS[device], one.kind).simulated(world, one)
        for device, one in tables.items()
    }
    world.mount = _mount(rig, table, light, twins["stage"], world.clock.now_s())
    if twins["stage"] is not None:
        world.carry_camera(twins["stage"])
    bench = SimulatedBench(world=world, faults=dict(world.stated.faults), **twins)
    for text in table.faults:
        _inject(bench, text)
    return bench


def scene_of(table: WorldTable) -> "Scene":
    """Return the scene of a [world].

    Raises:
        InputError: There is no such scene, or something in it moves.
    """
    from gs2ci_sims.scenes.files import load_scene  # noqa: PLC0415
    from gs2ci_sims.scenes.planes import planes  # noqa: PLC0415

    size = (table.height, table.width)
    if table.scene == "planes":
        return planes(np.random.default_rng(table.seed), size)
    loaded = load_scene(table.scene, size=size)
    if loaded.file.object_motion is not None:
        raise InputError(
            f"something in the scene {table.scene!r} moves",
            allowed="a scene that stands still before a bench",
            remedy="state what moves as [world.effects.object_motion], before another scene",
        )
    return loaded.scene


def bench_light(rig: RigTable, table: WorldTable, scene: "Scene", registration: MaskAlignment) -> "BenchLight":
    """Return the light of a bench before a scene.

    Args:
        rig: The rig.
        table: Its [world], with typical devices' figures if it requests them.
        scene: What is seen.
        registration: Where the modulator's image lies.

    Raises:
        InputError: An effect's name or a value is invalid.
    """
    # Imported here because scenes need torch, and a bench with another light does not.
    from gs2ci_sims.bench_light import BenchLight  # noqa: PLC0415
    from gs2ci_sims.radiance import Renderer  # noqa: PLC0415
    from gs2ci_sims.rig_file import effects_from_tables  # noqa: PLC0415

    return BenchLight(
        scene,
        _data_sheet(rig, table),
        registration,
        full_scale_e_per_s=rig.optics.full_scale_e_per_s or DEFAULT_FULL_SCALE_E_PER_S,
        seed=table.seed,
        cfa=rig.sensor.cfa,
        noise=table.noise,
        effects=[effect for effect in effects_from_tables(table.effects) if not isinstance(effect, Misregistration)],
        lamp_drift_per_min=table.lamp_drift_per_min,
        tolerance_dn=table.tolerance_dn,
        renderer=Renderer(supersampling=table.supersampling),
    )


def _registration(rig: RigTable, table: WorldTable, size: tuple[int, int]) -> MaskAlignment:
    """Return where the modulator's image truly lies; misregistration among the effects displaces it further."""
    from gs2ci_sims.rig_file import effects_from_tables  # noqa: PLC0415  as in `bench_light`

    effects = effects_from_tables(table.effects)
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


def _data_sheet(rig: RigTable, table: WorldTable) -> SensorFigures:
    """Return the sensor's true figures: those of the rig file unless [world.sensor] states others.

    Those of [world.sensor] and of the result are at 12 bits, those of [sensor] in readings of its format.
    """
    default, true = SensorFigures(), table.sensor
    steps = 2.0 ** (default.bits - (rig.sensor.bits or default.bits))
    black, stated = rig.sensor.black_level_dn * steps, rig.sensor.electrons_per_dn
    return SensorFigures(
        full_well_e=true.full_well_e or rig.sensor.full_well_e or default.full_well_e,
        electrons_per_dn=true.electrons_per_dn or (default.electrons_per_dn if stated is None else stated / steps),
        black_level_dn=black if true.black_level_dn is None else true.black_level_dn,
        read_noise_e=default.read_noise_e if true.read_noise_e is None else true.read_noise_e,
        quantum_efficiency=true.quantum_efficiency or default.quantum_efficiency,
    )


def _mount(rig: RigTable, table: WorldTable, light: LightPath, stage: Motion | None, now_s: float) -> Mount:
    """Mount the camera so that it has the scene's suggested pose at `rest_mm`, or in the middle of the travel."""
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
        rest_mm=_rest_mm(rig, table, {} if stage is None else stage.positions_mm_at(now_s)),
    )


def _rest_mm(rig: RigTable, table: WorldTable, start_mm: Mapping[str, float]) -> dict[str, float]:
    """Return each axis's true position in the rest pose: where it stands at first; of the swept axis, as stated."""
    capture, rest = rig.capture, dict(start_mm)
    if capture.axis:
        one = table.mechanics.get(capture.axis, Mechanics())
        counted_mm = (capture.from_mm + capture.to_mm) / 2 if table.rest_mm is None else table.rest_mm
        rest[capture.axis] = counted_mm * (-one.scale if one.reversed_sign else one.scale)
    return rest


def _inject(bench: SimulatedBench, text: str) -> None:
    match = FAULT.fullmatch(text.strip())
    if match is None:
        raise InputError(
            f"fault {text!r} in [world]",
            allowed='"device: fault" or "device: fault after N", device one of modulator, sensor, stage',
        )
    bench.faults[match["device"]].inject(match["fault"], skip=int(match["skip"] or 0))
