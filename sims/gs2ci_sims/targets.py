"""The calibration targets in front of the camera: an even light, a ChArUco board. Drawn without the rasteriser.

Both are `Renderer`s, so that the light path uses them as the scene. Not here: the light path (`exposure`), the order in
which targets are requested (`gs2ci_calibration`).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Final

import cv2
import numpy as np
import torch
from pydantic import PositiveInt
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F32, F64
from gs2ci.core.config import NotNegative
from gs2ci.core.errors import InputError
from gs2ci.render.gaussians import Gaussians
from gs2ci_sims.effects.views import LensDistortion
from gs2ci_sims.radiance import Renderer, binned
from gs2ci_sims.scene import Scene

# Radiance of the board's paper and ink, and of the background; 1 is white.
PAPER: Final = 0.85
INK: Final = 0.04
BEHIND: Final = 0.15
# Pixels of the board's image per square: finer than any sample of a picture of it.
PX_PER_SQUARE: Final = 60
# Share of the frame that the board fills, and its largest tilt and rotation.
FILL: Final = (0.62, 0.95)
TILT_DEG: Final = 32.0
TURN_DEG: Final = 12.0
# The same of a board on a stand.
FIXED_FILL: Final = (0.5, 0.58)
FIXED_TILT_DEG: Final = 8.0


class Target(Renderer):
    """A renderer that draws one target only and ignores the scene's Gaussians."""

    def views(
        self, scene: Scene, world_to_camera: F64, *, gaussians: Gaussians | None = None, margin: int = 0
    ) -> tuple[F32, F32]:
        """Draw the target from each pose; see `Renderer.views`."""
        fine = self.supersampled_views(scene, world_to_camera, margin=margin)
        radiance = binned(torch.from_numpy(fine), self.supersampling)
        return radiance, np.ones(radiance.shape[:3], np.float32)


@dataclass(frozen=True)
class EvenLight(Target):
    """An evenly lit field, as of an integrating sphere.

    Args:
        supersampling: Samples per pixel side; without effect on an even light.
        radiance: Its brightness; 1 is the white of a scene.
    """

    supersampling: PositiveInt = 1
    radiance: NotNegative = 1.0

    def supersampled_views(self, scene: Scene, world_to_camera: F64, *, margin: int = 0) -> F32:
        """Return the same radiance for all samples, [V, H s, W s, 3]."""
        return np.full((len(world_to_camera), *self._enlarged(scene, margin)[1], 3), self.radiance, np.float32)


@dataclass(frozen=True)
class BoardPlane:
    """A ChArUco board as printed, in OpenCV's terms.

    Args:
        columns: Squares across.
        rows: Squares down.
        square: Side of a square, scene units.
        marker: Side of a marker, scene units.
        dictionary: Name of the markers' dictionary in `cv2.aruco`.
    """

    columns: int
    rows: int
    square: float
    marker: float
    dictionary: str = "DICT_4X4_50"

    def __post_init__(self) -> None:
        known = getattr(cv2.aruco, self.dictionary, None)
        if min(self.columns, self.rows) < 3 or not 0 < self.marker < self.square or known is None:
            raise InputError(
                f"a board of {self.columns} x {self.rows} squares of {self.square} with markers of {self.marker} "
                f"out of {self.dictionary!r}",
                allowed="3 x 3 squares or more, markers smaller than squares, a dictionary of cv2.aruco",
            )

    @cached_property
    def image(self) -> F32:
        """Get its radiance with a margin of one square, [(rows + 2) p, (columns + 2) p]; p = `PX_PER_SQUARE`."""
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, dictionary)
        drawn = board.generateImage((self.columns * PX_PER_SQUARE, self.rows * PX_PER_SQUARE))
        framed = np.pad(drawn, PX_PER_SQUARE, constant_values=255)
        return np.asarray(INK + (PAPER - INK) * framed / 255.0, dtype=np.float32)

    def pose(self, index: int, scene: Scene, seed: int, *, fixed: bool = False) -> F64:
        """Return the pose of the board in picture `index`, camera_from_board [4, 4]; its origin is its top left corner.

        It fills most of the frame, tilted and rotated at random within limits; on a stand, it fills the middle half.
        """
        fill, tilt_deg = (FIXED_FILL, FIXED_TILT_DEG) if fixed else (FILL, TILT_DEG)
        rng = np.random.default_rng(np.random.SeedSequence((seed, index)))
        size = np.array([self.columns, self.rows]) * self.square
        frame = np.array([scene.size[1], scene.size[0]]) / scene.intrinsics[[0, 1], [0, 1]]
        distance = float((size / frame).max() / rng.uniform(*fill))
        angles = np.array([*rng.uniform(-tilt_deg, tilt_deg, 2), rng.uniform(-TURN_DEG, TURN_DEG)])
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
        play = np.maximum(frame * distance - size, 0.0) / 2
        aside = rng.uniform(-1, 1, 2) * play * (0.1 if fixed else 1.0)
        pose[:3, 3] = np.array([*aside, distance]) - pose[:3, :3] @ np.array([*(size / 2), 0.0])
        return pose


@dataclass(frozen=True)
class BoardTarget(Target):
    """A board in front of the camera.

    Args:
        supersampling: Samples per pixel side.
        plane: The printed board.
        world_from_board: Its pose, [4, 4], scene units; x right, y down on the board, origin at its top left.
        lens: Distortion of its image. It is applied here, before sampling: resampling afterwards would move edges as
            sharp as a board's by hundredths of a pixel.
    """

    supersampling: PositiveInt = 4
    plane: BoardPlane = field(default_factory=lambda: BoardPlane(7, 5, 1.0, 0.7))
    world_from_board: F64 | None = None
    lens: LensDistortion | None = None

    def supersampled_views(self, scene: Scene, world_to_camera: F64, *, margin: int = 0) -> F32:
        """Draw it at the intersections of each sample's ray with its plane, [V, H s, W s, 3]."""
        large, size = self._enlarged(scene, margin)
        rays = _rays(size, tuple(large.ravel()), self.lens)
        scale = self.plane.square / PX_PER_SQUARE
        # From points of the board to indices of the drawn image's pixels; its margin is one square.
        index_from_board = np.array(
            [[1 / scale, 0, PX_PER_SQUARE - 0.5], [0, 1 / scale, PX_PER_SQUARE - 0.5], [0, 0, 1.0]]
        )
        views = []
        for pose in world_to_camera:
            camera_from_board = pose @ (np.eye(4) if self.world_from_board is None else self.world_from_board)
            index_from_ray = index_from_board @ np.linalg.inv(camera_from_board[:3][:, [0, 1, 3]])
            drawn = cv2.remap(
                self.plane.image,
                *_divided(index_from_ray, rays),
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=BEHIND,
            )
            views.append(np.repeat(drawn[..., None], 3, axis=2))
        return np.stack(views).astype(np.float32)


@lru_cache(maxsize=4)
def _rays(size: tuple[int, int], intrinsics: tuple[float, ...], lens: LensDistortion | None) -> F64:
    """Return the direction of each sample's ray as tangents of the field angle, [2, H, W]; x and y."""
    matrix = np.reshape(intrinsics, (3, 3))
    if lens is None:
        rows, columns = np.mgrid[: size[0], : size[1]] + 0.5
    else:
        rows, columns = lens.sources_px(size, matrix)
    return np.stack([(columns - matrix[0, 2]) / matrix[0, 0], (rows - matrix[1, 2]) / matrix[1, 1]])


def _divided(homography: F64, points: F64) -> tuple[F32, F32]:
    """Map points [2, H, W] by a homography; points behind the camera are mapped outside of any image."""
    x, y = points
    u, v, w = (row[0] * x + row[1] * y + row[2] for row in homography)
    front = np.sign(homography[2, 2]) * w > 0
    inverse = 1.0 / np.where(front, w, np.inf)
    return tuple(np.where(front, part * inverse, -1e4).astype(np.float32) for part in (u, v))  # type: ignore[return-value]


def board_scene(
    scene: Scene, plane: BoardPlane, index: int, seed: int, lens: LensDistortion | None = None, *, fixed: bool = False
) -> tuple[Scene, BoardTarget]:
    """Place a board in front of a scene's camera; return it as a scene of the same camera, and its renderer."""
    pose = plane.pose(index, scene, seed, fixed=fixed)
    world_from_board = np.linalg.inv(scene.world_to_camera) @ pose
    middle = pose @ np.array([plane.columns * plane.square / 2, plane.rows * plane.square / 2, 0.0, 1.0])
    depth = np.full(scene.size, float(middle[2]))
    return replace(scene, name="board", depth=depth), BoardTarget(
        plane=plane, world_from_board=world_from_board, lens=lens
    )
