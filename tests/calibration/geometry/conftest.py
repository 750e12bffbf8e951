"""Boards seen by known cameras: as rendered pictures, and as corners alone where statistics need hundreds of them."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci_calibration.geometry.board import Board, Sighting
from gs2ci_calibration.options import BoardSpec
from gs2ci_calibration.refusals import CalibrationError
from gs2ci_sims.effects.views import LensDistortion
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.targets import BoardPlane, board_scene
from tests.benchmarks.calibration_geometry import random_bench

SPEC = BoardSpec()
SIZE = (160, 200)


@dataclass(frozen=True)
class Camera:
    """A camera of known figures, and a board before it."""

    values: np.ndarray  # fx, fy, cx, cy, k1, k2, p1, p2
    size: tuple[int, int] = SIZE

    @property
    def matrix(self):
        fx, fy, cx, cy = self.values[:4]
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])

    def project(self, points, rotation, translation):
        at, _ = cv2.projectPoints(
            np.asarray(points).reshape(-1, 1, 3), rotation, translation, self.matrix, self.values[4:]
        )
        return at.reshape(-1, 2)

    def sight(self, rng, rotation, translation, noise_px=0.02, spec=SPEC):
        """Corners inside the frame with independent errors."""
        corners = Board(spec).corners_mm
        at = self.project(corners, rotation, translation)
        inside = ((at > 0) & (at < np.array(self.size[::-1]))).all(axis=1)
        ids = np.flatnonzero(inside)
        return Sighting(ids, at[ids] + rng.normal(0, noise_px, (len(ids), 2)), corners[ids], 0.4)

    def held(self, rng, count=12, noise_px=0.02, tilt_deg=32.0, fill=(0.62, 0.95)):
        """Sightings of a board held in `count` poses."""
        sightings = []
        for _ in range(count):
            rotation, translation = self.pose(rng, tilt_deg, fill)
            sightings.append(self.sight(rng, rotation, translation, noise_px))
        return sightings

    def pose(self, rng, tilt_deg=32.0, fill=(0.62, 0.95), spec=SPEC):
        """Rotation vector and translation of a board that fills a share of the frame."""
        size = np.array([spec.columns, spec.rows]) * spec.square_mm
        frame = np.array(self.size[::-1]) / self.values[:2]
        distance = float((size / frame).max() / rng.uniform(*fill))
        turn = Rotation.from_euler("xyz", [*rng.uniform(-tilt_deg, tilt_deg, 2), rng.uniform(-12, 12)], degrees=True)
        aside = rng.uniform(-1, 1, 2) * np.maximum(frame * distance - size, 0) / 2
        middle = np.array([*aside, distance]) - turn.apply(np.array([*(size / 2), 0.0]))
        return turn.as_rotvec(), middle


def random_camera(rng, size=SIZE):
    """Focal length, axis and barrel or pincushion within what lenses have."""
    focal = rng.uniform(0.8, 1.6) * size[1]
    axis = 0.5 * np.array(size[::-1]) + rng.uniform(-0.03, 0.03, 2) * size[1]
    k1 = rng.uniform(-0.06, 0.06) / (0.5 * np.hypot(*size) / focal) ** 2
    return Camera(np.array([focal, focal * rng.uniform(0.995, 1.005), *axis, k1, 0.0, 0.0, 0.0]), size)


@pytest.fixture
def camera():
    """One camera."""
    return random_camera(np.random.default_rng(7))


@pytest.fixture
def cameras():
    """Make any number of cameras, each with its generator."""

    def make(count, size=SIZE):
        for seed in range(count):
            rng = np.random.default_rng((seed, 77))
            yield random_camera(rng, size), rng

    return make


@pytest.fixture(scope="session")
def room():
    """A scene whose camera is replaced by others; the board hides it."""
    return planes(np.random.default_rng(0), (8, 8))


@pytest.fixture
def photograph(room):
    """Render a board before a camera, with noise; return readings and where its corners truly are."""

    def take(camera, index=0, *, noise=True, blur_px=0.0, plane=None, seed=3, white_dn=1500.0, fixed=False):
        plane = plane or BoardPlane(SPEC.columns, SPEC.rows, SPEC.square_mm, SPEC.marker_mm)
        scene = replace(room, size=camera.size, intrinsics=camera.matrix, depth=np.ones(camera.size))
        lens = LensDistortion(camera.values[4], camera.values[5])
        seen, renderer = board_scene(scene, plane, index, seed, lens, fixed=fixed)
        image = renderer.views(seen, scene.world_to_camera[None])[0][0][..., 0].astype(np.float64) * white_dn
        if blur_px:
            image = cv2.GaussianBlur(image, (0, 0), blur_px)
        if noise:
            rng = np.random.default_rng((seed, index))
            image = np.rint(64 + (rng.poisson(image * 2.7) + rng.normal(0, 3, image.shape)) / 2.7)
        pose = plane.pose(index, scene, seed, fixed=fixed)
        corners = Board(
            BoardSpec(columns=plane.columns, rows=plane.rows, square_mm=plane.square, marker_mm=plane.marker)
        ).corners_mm
        return image, camera.project(corners, cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3])

    return take


SMALL = (160, 200)


@pytest.fixture
def bench():
    """Make a simulated bench of a small sensor, and its truth; `world` changes what surrounds it."""
    opened = []

    def make(seed=0, axes=("x",), views=8, **world):
        made, rig, truth = random_bench(seed, SMALL, axes, **world)
        opened.append(made)
        return replace(made, options=made.options.model_copy(update={"board_views": views})), rig, truth

    yield make
    for made in opened:
        made.devices.close()


def refused_by(step, *arguments):
    """Return the refusal that a step ends with."""
    with pytest.raises(CalibrationError) as caught:
        step(*arguments)
    return caught.value


@pytest.fixture
def refusal():
    """Run a step that must refuse, and return why."""
    return refused_by
