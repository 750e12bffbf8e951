"""Exposures of a bench with a small picture to a simulated scene, without its devices.

Here: the bench before the scene, the exposures that ideal devices would take of a [capture], and what is there to be
seen. Not here: what can be tried (`candidates`), what exposures tell (`telling`), a simulated bench with its twins
(`gs2ci.rig.simulated`).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gs2ci.core.arrays import F32, F64, U16
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot, Truth
from gs2ci.rig.config import CaptureTable, RigTable, WorldTable
from gs2ci.rig.foreseen import DEFAULT_BITS
from gs2ci.rig.patterns import draw_codes
from gs2ci.rig.recording import FULL_WELL_SHARE
from gs2ci.rig.simulated import bench_light, scene_of, with_typical_devices
from gs2ci_drivers.mount import MountOptions
from gs2ci_drivers.plan import first_mask
from gs2ci_sims.bench_light import BenchLight
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.registration import MaskAlignment
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.files import load_scene
from gs2ci_sims.world import BOOT_S, Exposure, MaskInterval, Mount


@dataclass(frozen=True, eq=False)
class SmallBench:
    """A bench whose picture is small, before a simulated scene.

    Args:
        table: The rig file, with a [world] that has the imperfections of its devices.
        scene: What the camera sees; its size is the small picture's.
        light: What the sensor collects of it.
        directions: How each axis moves the camera, scene units per mm.
    """

    table: RigTable
    scene: Scene
    light: BenchLight
    directions: dict[str, tuple[float, float, float]]

    @property
    def supersampling(self) -> int:
        """Get the samples per pixel side with which the scene is rendered."""
        return 1 if self.table.world is None else self.table.world.supersampling

    @property
    def bits(self) -> int:
        """Get the bits of a reading."""
        return self.table.sensor.bits or DEFAULT_BITS

    def poses(self, capture: CaptureTable, shares: F64) -> F64:
        """Return the camera's poses, [P, 4, 4], at shares of a capture's travel; in its middle, that of the scene."""
        if not capture.axis:
            return np.repeat(self.scene.world_to_camera[None], len(shares), axis=0)
        middle_mm = (capture.from_mm + capture.to_mm) / 2
        mount = Mount(self.scene.world_to_camera, self.directions, {capture.axis: middle_mm})
        places_mm = capture.from_mm + shares * (capture.to_mm - capture.from_mm)
        return np.stack([mount.world_to_camera({capture.axis: float(place)}) for place in places_mm])

    def seen(self, world_to_camera: F64) -> tuple[F32, F32]:
        """Return sharp views, [P, H, W, C], and depths, [P, H, W], 0 where nothing is, from poses."""
        renderer = Renderer(supersampling=self.supersampling)
        views = renderer.views(self.scene, world_to_camera)[0]
        depths = np.stack([renderer.depth(self.scene, pose) for pose in world_to_camera])
        mono = self.table.sensor.cfa is None
        return views.mean(axis=3, keepdims=True) if mono else views, np.nan_to_num(depths).astype(np.float32)

    def expose(self, capture: CaptureTable, index: int = 0) -> Shot:
        """Take one exposure as ideal devices would, under masks that are calibrated, with its truth.

        Args:
            capture: What is to be taken; its seed gives the masks.
            index: Which exposure: it gives the mask that is shown first, and draws the noise.

        Raises:
            InputError: The masks cannot be drawn.
        """
        codes, top = self._codes(capture, index)
        period_s = capture.mask_s + capture.dark_s
        span_s = period_s * len(codes) - capture.dark_s
        begins_s = BOOT_S + period_s * np.arange(len(codes))
        exposure = Exposure(
            index=index,
            start_s=BOOT_S,
            end_s=BOOT_S + span_s,
            masks=tuple(
                MaskInterval(code, top, float(begin_s), float(begin_s) + capture.mask_s)
                for code, begin_s in zip(codes, begins_s, strict=True)
            ),
            world_to_camera_at=lambda when_s: self.poses(capture, np.array([(when_s - BOOT_S) / span_s]))[0],
            height=self.scene.size[0],
            width=self.scene.size[1],
            bits=self.bits,
        )
        readings = self.light.collect(exposure)
        views, poses = self.light.truth(exposure)
        sensor = self.light.nominal_rig(self.bits).sensor
        scale_dn = self.full_scale_e(capture) / sensor.electrons_per_dn
        most_dn = sensor.black_level_dn + FULL_WELL_SHARE * sensor.full_well_e / sensor.electrons_per_dn
        lens = self.light.lens
        return Shot(
            ((readings.astype(np.float64) - sensor.black_level_dn) / scale_dn).astype(np.float32)[..., None],
            self.light.true_masks(codes, top),
            cfa=self.table.sensor.cfa,
            intrinsics=self.scene.intrinsics,
            distortion=None if lens is None else lens.coefficients,
            truth=Truth(views=views, world_to_camera=poses, depth=self.light.true_depth(exposure)),
            telemetry_world_to_camera=poses if capture.axis else None,
            saturated=readings >= min(most_dn, 2**self.bits - 1),
            name=self.scene.name,
        ).check()

    def masks(self, capture: CaptureTable, index: int = 0) -> F32:
        """Return the masks of an exposure as a calibration measures them, [N, H, W].

        Raises:
            InputError: They cannot be drawn.
        """
        return self.light.true_masks(*self._codes(capture, index))

    def _codes(self, capture: CaptureTable, index: int) -> tuple[U16, int]:
        codes = draw_codes(capture, self.scene.size, Path())
        return np.roll(codes, -first_mask(index, len(codes)), axis=0), 2**capture.bit_depth - 1

    def full_scale_e(self, capture: CaptureTable) -> float:
        """Return the electrons that white gives in a pixel through one open mask of a capture."""
        photons = self.light.nominal_rig(self.bits).light.full_scale_photons
        return photons * self.light.sensor.quantum_efficiency * capture.mask_s


def small_bench(table: RigTable, scene: str, size: tuple[int, int]) -> SmallBench:
    """Put a bench with a small picture before a scene.

    Near and far of the scene move against each other, per mm of the stage, by as large a share of the picture as those
    of the rig file's [optics] or of its own [world].

    Args:
        table: The rig file.
        scene: A name of `gs2ci_sims.scenes.files.scene_names`, or a scene file (.toml).
        size: Height and width of the small picture.

    Raises:
        InputError: There is no such scene, or the rig file says nothing of light or distances of a real bench.
    """
    seen = load_scene(scene, size=size).scene
    world = with_typical_devices(table).world if table.world is not None else None
    if world is None:
        if table.optics.full_scale_e_per_s is None:
            raise InputError(
                f"the light of {table.name!r} is not known",
                allowed="a bench whose [optics] says full_scale_e_per_s: noise and saturation follow from it",
                remedy="state the electrons per second in a pixel that sees white through an open mask",
            )
        world = with_typical_devices(table.model_copy(update={"world": WorldTable()})).world
        assert world is not None
    light = bench_light(table, world, seen, MaskAlignment(1, 0, 0))
    per_mm = _units_per_mm(table, seen)
    stated = world.mount if world.mount is not None else None if table.stage is None else table.stage.mount
    mount = MountOptions() if stated is None else stated
    axes = {"x": mount.x, "y": mount.y, "z": mount.z}
    directions = {axis: (x * per_mm, y * per_mm, z * per_mm) for axis, (x, y, z) in axes.items()}
    return SmallBench(table.model_copy(update={"world": world}), seen, light, directions)


def _units_per_mm(table: RigTable, scene: Scene) -> float:
    """Return how far the camera moves in a scene per mm of the stage."""
    near, far = scene.depth_range()
    share = scene.intrinsics[0, 0] / scene.size[1] * (1 / near - 1 / far)
    return float(_share_per_mm(table) / share)


def _share_per_mm(table: RigTable) -> float:
    """Return by how large a share of the picture's width near and far move against each other per mm of the stage.

    Raises:
        InputError: A real bench's rig file does not say.
    """
    optics, world = table.optics, table.world
    if optics.focal_px and optics.nearest_mm and table.sensor.width:
        apart = 1 / optics.nearest_mm - (1 / optics.farthest_mm if optics.farthest_mm else 0.0)
        return optics.focal_px / table.sensor.width * apart
    if world is None:
        raise InputError(
            f"the distances of {table.name!r} are not known",
            allowed="a bench whose [optics] says focal_px, nearest_mm and farthest_mm, and whose [sensor] says width",
            remedy="state them: the motion in the picture follows from them",
        )
    own = scene_of(world)
    near, far = own.depth_range()
    return float(own.intrinsics[0, 0]) / own.size[1] * (1 / near - 1 / far) * world.scene_units_per_mm


def middles(count: int) -> F64:
    """Return where the middles of so many masks lie, as shares of a travel, [N]."""
    return (np.arange(count) + 0.5) / count


def full_size(table: RigTable) -> tuple[int, int]:
    """Return height and width of a bench's picture.

    Raises:
        InputError: The rig file of a real bench does not say.
    """
    world, (height, width) = table.world, (table.sensor.height, table.sensor.width)
    if world is not None:
        return height or world.height, width or world.width
    if not height or not width:
        raise InputError(
            f"the size of the picture of {table.name!r} is not known",
            allowed="a bench whose [sensor] says height and width",
            remedy="state them; `gs2ci devices` lists what the sensor offers",
        )
    return height, width
