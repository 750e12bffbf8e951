"""The source of this suite's measurements: a simulated bench, and scenes that are too extreme for the library.

Here: `Bench`, one exposure with all its settings, and the scenes made to be hard. Not here: changes of a measurement
by hand (`changes`), the list of cases (`cases`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from gs2ci.core.records import Shot
from gs2ci_sims.effects.base import Effect
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.light_path import generator, sensor_effects
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import CameraPath, ReversingMove, StageMove, stage_move_for_parallax
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures, Timing
from gs2ci_sims.scene import Scene, camera_looking_ahead
from gs2ci_sims.scenes.files import load_scene, scene_names
from gs2ci_sims.scenes.planes import backdrop_at, planes
from gs2ci_sims.scenes.rectangles import coloured, depth_of, samples
from gs2ci_sims.scenes.surfels import gaussians_from_surfels
from gs2ci_sims.sensor import SensorFigures
from tests.exposing import expose
from tests.stability.laboratory import laboratory_masks

INTERVAL_S = 0.02
# Motions are stated for a picture of this width, and scale with it.
WIDTH_PX = 64.0
# The share of the well that is filled where as many masks are open as open on average.
WELL_SHARE = 0.4


@dataclass(frozen=True)
class Scale:
    """How large and how long: the same cases are run quickly in the tests, and at leisure for the table."""

    size: tuple[int, int]
    iterations: int


QUICK = Scale((48, 64), 60)
FULL = Scale((72, 96), 250)


@dataclass(frozen=True)
class Bench:
    """One simulated exposure; the defaults are the easy case.

    Args:
        scene: The name of one in the library, or of one below.
        views: Masks during the exposure.
        open_share: Of a mask's elements.
        kind: How masks are drawn: "binary", "grey" (even in [0, 1]), or "laboratory" (blurred and leaking).
        feature_px: Side of one mask element.
        parallax_px: How far near and far shift against each other, in a picture of `WIDTH_PX`.
        path: A path instead of the move for a parallax, from the scene and the duration of the exposure.
        photons: At full scale of one view; as many as the well allows for if None.
        sensor: Its data sheet.
        effects: Imperfections beside motion blur and what every sensor does.
    """

    scene: str = "planes"
    views: int = 8
    open_share: float = 0.25
    kind: str = "binary"
    feature_px: int = 1
    parallax_px: float = 3.0
    path: Callable[[Scene, float], CameraPath] | None = None
    photons: float | None = None
    sensor: SensorFigures = field(default_factory=SensorFigures)
    effects: tuple[Effect, ...] = ()

    def expose(self, size: tuple[int, int], seed: int = 0) -> Shot:
        """Expose once, at this size in pixels."""
        scene = build(self.scene, size)
        rig = RigFigures(
            light=Light(self._photons()),
            modulator=ModulatorFigures(masks=self.views, open_share=self.open_share, feature_px=self.feature_px),
            timing=Timing(INTERVAL_S),
            sensor=self.sensor,
        )
        given = {effect.name for effect in self.effects}
        implied = [effect for effect in (MotionBlur(), *sensor_effects(self.sensor)) if effect.name not in given]
        path = self._path(scene, rig.exposure_s)
        return expose(scene, path, self._masks(size, seed), rig, effects=(*implied, *self.effects), seed=seed)

    def _photons(self) -> float:
        if self.photons is not None:
            return self.photons
        open_masks = max(1.0, self.views * self.open_share)
        return WELL_SHARE * self.sensor.full_well_e / self.sensor.quantum_efficiency / open_masks

    def _masks(self, size: tuple[int, int], seed: int) -> np.ndarray:
        rng = generator(seed, "masks")
        if self.kind == "grey":
            return rng.random((self.views, *size), dtype=np.float32)
        if self.kind == "laboratory":
            return laboratory_masks(self.views, size, self.open_share, rng)
        return random_masks(self.views, size, self.open_share, rng, feature_px=self.feature_px)

    def _path(self, scene: Scene, duration_s: float) -> CameraPath:
        if self.path is not None:
            return self.path(scene, duration_s)
        if self.parallax_px == 0:
            return still(scene, duration_s)
        parallax_px = self.parallax_px * scene.size[1] / WIDTH_PX
        return stage_move_for_parallax(scene, parallax_px, duration_s, wobble_deg=0.02)


def still(scene: Scene, _duration_s: float) -> CameraPath:
    """Leave the camera where it is."""
    return StageMove((0.0, 0.0, 0.0), reference_world_to_camera=scene.world_to_camera)


def turning(degrees: float) -> Callable[[Scene, float], CameraPath]:
    """Turn the camera on the spot by about so much over the exposure."""

    def path(scene: Scene, duration_s: float) -> CameraPath:
        # The middle third of a sine's period turns steadily enough.
        return StageMove((0.0, 0.0, 0.0), 0.58 * degrees, 1 / (3 * duration_s), scene.world_to_camera)

    return path


def ahead(share: float) -> Callable[[Scene, float], CameraPath]:
    """Drive ahead by a share of the nearest depth, without a step aside."""

    def path(scene: Scene, duration_s: float) -> CameraPath:
        return StageMove(
            (0.0, 0.0, share * scene.depth_range()[0] / duration_s), reference_world_to_camera=scene.world_to_camera
        )

    return path


def aside(share: float) -> Callable[[Scene, float], CameraPath]:
    """Move sideways by a share of the median depth."""

    def path(scene: Scene, duration_s: float) -> CameraPath:
        return StageMove(
            (share * scene.median_depth / duration_s, 0.0, 0.0), reference_world_to_camera=scene.world_to_camera
        )

    return path


def to_and_fro(turns: int) -> Callable[[Scene, float], CameraPath]:
    """Run sideways and back, turning so often, as fast as the easy case."""

    def path(scene: Scene, duration_s: float) -> CameraPath:
        move = stage_move_for_parallax(scene, 3.0 * scene.size[1] / WIDTH_PX, duration_s)
        return ReversingMove(move.velocity, 2 * duration_s / turns, scene.world_to_camera)

    return path


@lru_cache(maxsize=32)
def build(name: str, size: tuple[int, int]) -> Scene:
    """Build a scene by its name."""
    if name in WALLS:
        return _wall(name, size)
    if name == "planes":
        return planes(np.random.default_rng(3), size)
    if name not in scene_names():
        raise KeyError(name)
    return load_scene(name, size=size).scene


def _wall(name: str, size: tuple[int, int]) -> Scene:
    """Cover a wall with a paint that gives little to hold on to."""
    intrinsics = camera_looking_ahead(size, 50.0)
    focal = float(intrinsics[0, 0])
    far = backdrop_at(0.5 * np.array([size[1], size[0]]) / focal, 4.0)
    columns, rows = samples(far, 0.6 * 4.0 / focal)
    x, y = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows))
    radiance = np.broadcast_to(WALLS[name](x, y)[..., None], (rows, columns, 3))
    surfels = coloured(far, np.ascontiguousarray(radiance))
    return Scene(name, gaussians_from_surfels(surfels), intrinsics, size, depth_of([far], intrinsics, size))


def _spots(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 0.2 + 0.6 * ((np.sin(40 * np.pi * x) > 0.6) & (np.sin(30 * np.pi * y) > 0.6))


# Brightness over the wall, x and y from 0 to 1; the camera sees the middle two thirds.
WALLS: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "grey wall": lambda x, _y: np.full_like(x, 0.5),
    "soft gradient": lambda x, y: 0.3 + 0.2 * x + 0.2 * y,
    "chequerboard": lambda x, y: 0.25 + 0.5 * ((np.floor(24 * x) + np.floor(18 * y)) % 2),
    "stripes": lambda x, _y: 0.5 + 0.3 * np.sign(np.sin(2 * np.pi * 16 * x)),
    "spots": _spots,
    "black wall": lambda x, _y: np.zeros_like(x),
    "lamp": lambda x, y: 0.15 + 0.1 * np.sin(30 * x) * np.cos(25 * y) + 8.0 * (np.hypot(x - 0.45, y - 0.5) < 0.06),
    "sun": lambda x, y: 0.15 + 0.1 * np.sin(30 * x) * np.cos(25 * y) + 500.0 * (np.hypot(x - 0.45, y - 0.5) < 0.04),
}
