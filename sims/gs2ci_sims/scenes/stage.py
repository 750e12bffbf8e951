"""The common parts of the procedural scenes: a suggested camera, a floor with a wall behind it, and the final `Scene`.

Not here: the objects on the floor (the other modules of this folder).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64, Rng
from gs2ci.core.errors import InputError
from gs2ci_sims.scene import Scene, camera_looking_ahead
from gs2ci_sims.scenes.rectangles import (
    SPACING_PX,
    Rectangle,
    chequered,
    coloured,
    depth_of,
    grain,
    receding,
    samples,
    shade,
)
from gs2ci_sims.scenes.surfels import Surfels, gaussians_from_parts

# The wall extends this much past the frame, for the camera to move and turn into.
OVERSIZE: Final = 1.25
FLOOR_COLOURS: Final = np.array([[0.62, 0.55, 0.45], [0.25, 0.24, 0.26]])


@dataclass(frozen=True)
class SuggestedCamera:
    """The suggested camera: at the origin, looking along z.

    Args:
        size: Height and width, px.
        field_of_view_deg: Horizontal.
    """

    size: tuple[int, int]
    field_of_view_deg: float

    @cached_property
    def intrinsics(self) -> F64:
        """Get the camera matrix, [3, 3]."""
        return camera_looking_ahead(self.size, self.field_of_view_deg)

    @property
    def focal(self) -> float:
        """Get the focal length, px."""
        return float(self.intrinsics[0, 0])

    @property
    def half(self) -> F64:
        """Get half the breadth and height of the field of view at depth 1, [2]."""
        return 0.5 * np.array([self.size[1], self.size[0]]) / self.focal


def floor_y(frame: SuggestedCamera, backdrop: float) -> float:
    """Return the distance of the floor below the line of sight: it meets the wall in the middle of the lower half."""
    return float(0.5 * frame.half[1] * backdrop)


def room(rng: Rng, frame: SuggestedCamera, backdrop: float) -> tuple[list[Rectangle], list[Surfels]]:
    """Build a chequered floor that runs up to a textured wall.

    Raises:
        InputError: The wall is not in front of the camera.
    """
    if not 0 < backdrop < np.inf:
        raise InputError(f"a wall at depth {backdrop}", allowed="finite, more than 0")
    wide, high = OVERSIZE * backdrop * frame.half
    wall = Rectangle(np.array([0, 0, backdrop]), np.array([wide, 0, 0]), np.array([0, high, 0]))
    down = floor_y(frame, backdrop)
    floor = receding(np.array([0, down]), np.array([wide, 0]), 0.8 * down / frame.half[1], backdrop)
    tile = backdrop / 12
    surfels = [painted(rng, wall, frame.focal, rng.uniform(0.35, 0.75, 3))]
    surfels += [chequered(rng, strip, tile, FLOOR_COLOURS, frame.focal) for strip in floor]
    return [wall, *floor], surfels


def painted(rng: Rng, face: Rectangle, focal: float, colour: F64) -> Surfels:
    """Cover a face with a grainy paint, with shading."""
    nearest = min(face.centre[2], abs(face.centre[2] - np.abs([face.half_u[2], face.half_v[2]]).sum()))
    columns, rows = samples(face, SPACING_PX * max(nearest, 0.5 * face.centre[2]) / focal)
    paint = colour * (1 + grain(rng, (rows, columns), float(rng.uniform(0.8, 1.4))))
    return coloured(face, np.clip(shade(face) * paint, 0.0, 1.0))


def staged(name: str, frame: SuggestedCamera, faces: list[Rectangle], surfels: list[Surfels]) -> Scene:
    """Combine discs to a scene whose true depth is that of the faces."""
    depth = depth_of(faces, frame.intrinsics, frame.size)
    return Scene(name, gaussians_from_parts(surfels), frame.intrinsics, frame.size, depth)
