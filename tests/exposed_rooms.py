"""Rooms of textured planes, and exposures of them along several paths, for tests and benchmarks of many exposures.

Views are rendered from the room's Gaussians by the solver's renderer, coded by random masks and read with white noise:
there is no light path and no camera error in them. The room fills a wider field than a camera sees.
"""

from typing import Final

import numpy as np
import torch

from gs2ci.core.arrays import F32, F64
from gs2ci.core.cameras import pinhole
from gs2ci.core.records import Shot, Truth
from gs2ci.render.backend import load_backend
from gs2ci_sims.masks import random_masks
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.planes import planes

VIEWS: Final = 8
OPEN_SHARE: Final = 0.25
ROOM_DEG, CAMERA_DEG = 80.0, 42.0
NEAREST, BACKDROP = 2.4, 5.0
# Length of a path, and distance of neighbouring ones, in scene units.
PATH, STEP = 0.16, 0.36


def room(seed: int, size: tuple[int, int]) -> Scene:
    """Draw a room of seven tilted rectangles and two boxes before a backdrop."""
    rng = np.random.default_rng([seed, 0])
    depths = tuple(np.sort(rng.uniform(NEAREST, 4.6, 7)).tolist())
    return planes(rng, size, depths=depths, backdrop=BACKDROP, boxes=2, field_of_view_deg=ROOM_DEG)


def camera(size: tuple[int, int]) -> F64:
    """Return the camera's matrix, px, [3, 3]."""
    return pinhole(size[1] / 2 / np.tan(np.radians(CAMERA_DEG / 2)), size)


def line(x: float, y: float = 0.0, length: float = PATH, views: int = VIEWS) -> F64:
    """Return a path along the rows about a place, with a little bend, [N, 4, 4]; all cameras look ahead."""
    along = np.linspace(-0.5, 0.5, views)
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, 0, 3] = -(x + length * along)
    poses[:, 1, 3] = -(y + 0.3 * length * along**2)
    return poses


def seen(scene: Scene, poses: F64, size: tuple[int, int]) -> tuple[F32, F32]:
    """Render views, [N, H, W, 3], and depths, [N, H, W]."""
    backend, matrix = load_backend("cpu"), torch.from_numpy(camera(size)).float()
    path = torch.from_numpy(poses).float()
    views, _ = backend.views(scene.gaussians, path, matrix, size)
    return views.clamp(0, 1).numpy(), backend.depths(scene.gaussians, path, matrix, size).surface().numpy()


def exposed(
    scene: Scene,
    poses: F64,
    size: tuple[int, int],
    seed: int,
    *,
    noise: float = 0.0,
    name: str = "room",
    masks: F32 | None = None,
    staged: bool = True,
) -> Shot:
    """Code the views of a path by masks, random ones unless others are given, and read them with noise, full scale 1.

    `staged`: whether a stage reports the path, without error.
    """
    rng = np.random.default_rng([seed, 1])
    views, depth = seen(scene, poses, size)
    masks = random_masks(len(poses), size, OPEN_SHARE, rng) if masks is None else masks
    coded = (masks[..., None] * views).sum(axis=0) + noise * rng.standard_normal(views.shape[1:])
    return Shot(
        coded.astype(np.float32),
        masks,
        intrinsics=camera(size),
        truth=Truth(views, poses, depth),
        telemetry_world_to_camera=poses if staged else None,
        name=name,
    )


def adjacent(
    scene: Scene, size: tuple[int, int], seed: int, count: int = 4, *, step: float = STEP, **options: object
) -> list[Shot]:
    """Expose paths one beside the other."""
    places = step * (np.arange(count) - (count - 1) / 2)
    return [
        exposed(scene, line(float(x)), size, 100 * seed + k, name=f"path {k}", **options)  # type: ignore[arg-type]
        for k, x in enumerate(places)
    ]


def between(count: int = 4) -> F64:
    """Return a pose in the middle of each gap between such paths, [count − 1, 4, 4]."""
    gaps = STEP * (np.arange(count - 1) - (count - 2) / 2)
    return np.concatenate([line(float(x), length=0.0, views=1) for x in gaps])


def repeated(scene: Scene, size: tuple[int, int], seed: int, count: int, **options: object) -> list[Shot]:
    """Expose one path several times, by fresh masks."""
    return [
        exposed(scene, line(0.0), size, 100 * seed + k, name=f"repeat {k}", **options)  # type: ignore[arg-type]
        for k in range(count)
    ]
