"""What is put before the camera to calibrate it: an even light, a ChArUco board. Drawn without the rasteriser.

Both are `Renderer`s, so that the light path takes them for the scene. Not here: the light path (`exposure`), what is
asked for when (`gs2ci_calibration`). `bench_light`, `gs2ci.rig` and tests import this file.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import InputError
from gs2ci.render.gaussians import Gaussians
from gs2ci_sims.radiance import Renderer, binned, with_margin
from gs2ci_sims.scenes.base import Scene

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Radiance of the board's paper and ink, and of what is behind it; 1 is white.
PAPER: Final = 0.85
INK: Final = 0.04
BEHIND: Final = 0.15
# Pixels of the board's image per square: finer than any sample of a picture of it.
PX_PER_SQUARE: Final = 60
# Share of the frame that the board fills, and how far it is tilted and turned, at most.
FILL: Final = (0.62, 0.95)
TILT_DEG: Final = 32.0
TURN_DEG: Final = 12.0


class Target(Renderer):
    """A renderer that draws one thing only, whatever the scene's Gaussians are."""

    def views(
        self, scene: Scene, world_to_camera: F64, *, gaussians: Gaussians | None = None, margin: int = 0
    ) -> tuple[F32, F32]:
        """Draw the target from each pose; see `Renderer.views`."""
        fine = self.supersampled_views(scene, world_to_camera, margin=margin)
        radiance = binned(torch.from_numpy(fine), self.supersampling)
        return radiance, np.ones(radiance.shape[:3], np.float32)

    def masked(self, scene: Scene, world_to_camera: F64, mask: F64, *, gaussians: Gaussians | None = None) -> F64:
        """Draw one view times a mask, [H, W, 3]."""
        return np.asarray(self.views(scene, world_to_camera)[0][0] * mask[..., None], dtype=np.float64)


@dataclass(frozen=True)
class EvenLight(Target):
    """An evenly lit field, as of an integrating sphere.

    Args:
        supersampling: Of no consequence.
        radiance: Its brightness; 1 is the white of a scene.
    """

    supersampling: int = 1
    radiance: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.radiance < np.inf:
            raise InputError(f"a flat field of radiance {self.radiance}", allowed="finite, 0 or more")

    def supersampled_views(self, scene: Scene, world_to_camera: F64, *, margin: int = 0) -> F32:
        """Return the same everywhere, [V, H s, W s, 3]."""
        height, width = ((side + 2 * margin) * self.supersampling for side in scene.size)
        return np.full((len(world_to_camera), height, width, 3), self.radiance, np.float32)


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

    def pose(self, index: int, scene: Scene, seed: int) -> F64:
        """Return where the board is held for picture `index`, camera_from_board [4, 4]: origin at its top left corner.

        It fills most of the frame, tilted and turned at random within limits.
        """
        rng = np.random.default_rng(np.random.SeedSequence((seed, index)))
        size = np.array([self.columns, self.rows]) * self.square
        frame = np.array([scene.size[1], scene.size[0]]) / scene.intrinsics[[0, 1], [0, 1]]
        distance = float((size / frame).max() / rng.uniform(*FILL))
        angles = np.array([*rng.uniform(-TILT_DEG, TILT_DEG, 2), rng.uniform(-TURN_DEG, TURN_DEG)])
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
        play = np.maximum(frame * distance - size, 0.0) / 2
        aside = rng.uniform(-1, 1, 2) * play
        pose[:3, 3] = np.array([*aside, distance]) - pose[:3, :3] @ np.array([*(size / 2), 0.0])
        return pose


@dataclass(frozen=True)
class Board(Target):
    """A board held before the camera.

    Args:
        supersampling: Samples per pixel side.
        plane: What it is.
        world_from_board: Where it is, [4, 4], scene units; x right, y down on the board, origin at its top left.
    """

    supersampling: int = 4
    plane: BoardPlane = field(default_factory=lambda: BoardPlane(7, 5, 1.0, 0.7))
    world_from_board: F64 | None = None

    def supersampled_views(self, scene: Scene, world_to_camera: F64, *, margin: int = 0) -> F32:
        """Draw it by the homography between its plane and the image, [V, H s, W s, 3]."""
        factor = self.supersampling
        large = with_margin(scene.intrinsics, margin) * np.array([[factor], [factor], [1.0]])
        height, width = ((side + 2 * margin) * factor for side in scene.size)
        scale = self.plane.square / PX_PER_SQUARE
        # From indices of the drawn image's pixels to points of the board; its margin is one square.
        board_from_index = np.array(
            [
                [scale, 0, 0.5 * scale - self.plane.square],
                [0, scale, 0.5 * scale - self.plane.square],
                [0, 0, 1],
            ]
        )
        index_from_point = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1.0]])
        views = []
        for pose in world_to_camera:
            camera_from_board = pose @ (np.eye(4) if self.world_from_board is None else self.world_from_board)
            homography = large @ camera_from_board[:3][:, [0, 1, 3]]
            drawn = cv2.warpPerspective(
                self.plane.image,
                index_from_point @ homography @ board_from_index,
                (width, height),
                flags=cv2.INTER_LINEAR,
                borderValue=BEHIND,
            )
            views.append(np.repeat(drawn[..., None], 3, axis=2))
        return np.stack(views).astype(np.float32)


def board_scene(scene: Scene, plane: BoardPlane, index: int, seed: int) -> tuple[Scene, Board]:
    """Hold a board before a scene's camera; return it as a scene of the same camera, and its renderer."""
    pose = plane.pose(index, scene, seed)
    world_from_board = np.linalg.inv(scene.world_to_camera) @ pose
    middle = pose @ np.array([plane.columns * plane.square / 2, plane.rows * plane.square / 2, 0.0, 1.0])
    depth = np.full(scene.size, float(middle[2]))
    return replace(scene, name="board", depth=depth, harmonics=None), Board(
        plane=plane, world_from_board=world_from_board
    )
