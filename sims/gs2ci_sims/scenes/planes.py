"""A procedural scene of textured rectangles and boxes, drawn from a generator: for tests and experiments.

Here: the arrangement. Not here: the rectangles (`rectangles`).
"""

from typing import Final

import numpy as np
from pydantic import NonNegativeInt

from gs2ci.core.arrays import F64, Rng
from gs2ci.core.errors import InputError
from gs2ci_sims.scene import Scene, camera_looking_ahead
from gs2ci_sims.scenes.rectangles import Rectangle, box, depth_of, rotation, textured
from gs2ci_sims.scenes.surfels import gaussians_from_parts

FIELD_OF_VIEW_DEG: Final = 50.0
# The backdrop extends this much past the frame, for the camera to move and turn into.
BACKDROP_OVERSIZE: Final = 1.5


def planes(
    rng: Rng,
    size: tuple[int, int] = (96, 128),
    *,
    depths: tuple[float, ...] = (2.0, 2.7, 3.5),
    backdrop: float = 5.0,
    boxes: NonNegativeInt = 1,
    field_of_view_deg: float = FIELD_OF_VIEW_DEG,
) -> Scene:
    """Build tilted rectangles at the given depths in front of a backdrop, with boxes among them.

    Args:
        rng: Generator of positions, tilts and textures.
        size: Height and width of the suggested camera's image, in pixels.
        depths: Depth of each rectangle's centre, in scene units.
        backdrop: Depth of the backdrop, which fills the frame.
        boxes: Number of boxes (each has up to five visible faces).
        field_of_view_deg: Horizontal field of view of the suggested camera.

    Raises:
        InputError: A depth is not positive or lies behind the backdrop.
    """
    if min((*depths, backdrop)) <= 0 or max(depths, default=0) >= backdrop:
        raise InputError(
            f"rectangles at depths {depths} before a backdrop at {backdrop}",
            allowed="positive depths, each in front of the backdrop",
        )
    intrinsics = camera_looking_ahead(size, field_of_view_deg)
    half = 0.5 * np.array([size[1], size[0]]) / intrinsics[0, 0]  # half the frame at depth 1
    rectangles = [backdrop_at(half, backdrop)]
    rectangles += [_tilted(rng, half, depth) for depth in depths]
    for _ in range(boxes):
        rectangles += _box(rng, half, float(rng.uniform(0.4, 0.7)) * backdrop)
    surfels = (textured(rng, rectangle, intrinsics[0, 0]) for rectangle in rectangles)
    return Scene("planes", gaussians_from_parts(surfels), intrinsics, size, depth_of(rectangles, intrinsics, size))


def backdrop_at(half: F64, depth: float) -> Rectangle:
    """Return the rectangle that fills the frame at a depth; `half` is half the frame at depth 1, [2]."""
    wide, high = BACKDROP_OVERSIZE * depth * half
    return Rectangle(np.array([0, 0, depth]), np.array([wide, 0, 0]), np.array([0, high, 0]))


def _tilted(rng: Rng, half: F64, depth: float) -> Rectangle:
    centre = np.array([*(rng.uniform(-0.6, 0.6, 2) * half * depth), depth])
    axes = rotation(rng.uniform(-0.5, 0.5, 3))
    wide, high = rng.uniform(0.25, 0.45, 2) * half.min() * depth
    return Rectangle(centre, wide * axes[:, 0], high * axes[:, 1])


def _box(rng: Rng, half: F64, depth: float) -> list[Rectangle]:
    centre = np.array([*(rng.uniform(-0.5, 0.5, 2) * half * depth), depth])
    return box(centre, rotation(rng.uniform(-0.6, 0.6, 3)) * (rng.uniform(0.15, 0.25, 3) * half.min() * depth))
