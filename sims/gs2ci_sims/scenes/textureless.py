"""A small textured box in a room of plain paint: a procedural scene in which most pixels do not determine depth.

Here: the room, whose walls and floor have no texture, and the box. Not here: faces and their discs (`rectangles`),
a room with texture (`stage`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.rectangles import (
    SPACING_PX,
    Rectangle,
    box,
    coloured,
    receding,
    rotation,
    samples,
    shade,
    strip_samples,
)
from gs2ci_sims.scenes.stage import OVERSIZE, SuggestedCamera, floor_y, painted, staged
from gs2ci_sims.scenes.surfels import Surfels

# The side walls meet the back wall within the frame, at this share of half its breadth.
CORNER: Final = 0.8


def textureless(
    rng: np.random.Generator, frame: SuggestedCamera, *, edge: float = 0.5, depth: float = 4.0, backdrop: float = 6.0
) -> Scene:
    """Place a small textured box in a room of plain paint, in which each side has a single colour.

    Args:
        rng: Generator of the paints, and of the box's rotation and texture.
        frame: The camera.
        edge: Edge of the box, a cube.
        depth: Depth of its centre.
        backdrop: Depth of the back wall.

    Raises:
        InputError: The box has no size, or reaches behind the camera or into the wall.
    """
    if not 0 < edge < depth or not depth + edge < backdrop < np.inf:
        raise InputError(
            f"a box with edges of {edge} at {depth} before a wall at {backdrop}",
            allowed="0 < edge < depth, depth + edge < backdrop, all finite",
        )
    walls, floor = _room_walls(frame, backdrop)
    paint, ground = rng.uniform(0.6, 0.9, 3), rng.uniform(0.4, 0.7, 3)
    surfels = [_plain(face, paint, frame.focal) for face in walls] + [
        _plain(face, ground, frame.focal) for face in floor
    ]
    centre = np.array([0.0, floor_y(frame, backdrop) - 0.5 * edge, depth])
    cube = box(centre, rotation(np.array([0.0, rng.uniform(0.3, 0.6), 0.0])) * (0.5 * edge))
    colour = rng.uniform(0.3, 0.95, 3)
    surfels += [painted(rng, face, frame.focal, colour) for face in cube]
    return staged("textureless", frame, [*walls, *floor, *cube], surfels)


def _room_walls(frame: SuggestedCamera, backdrop: float) -> tuple[list[Rectangle], list[Rectangle]]:
    """List the faces of back wall and side walls, and those of the floor."""
    wide, high = OVERSIZE * backdrop * frame.half
    aside, down = CORNER * backdrop * frame.half[0], floor_y(frame, backdrop)
    walls = [Rectangle(np.array([0, 0, backdrop]), np.array([wide, 0, 0]), np.array([0, high, 0]))]
    for x in (-aside, aside):
        walls += receding(np.array([x, 0]), np.array([0, high]), 0.8 * aside / frame.half[0], backdrop)
    floor = receding(np.array([0, down]), np.array([aside, 0]), 0.8 * down / frame.half[1], backdrop)
    return walls, floor


def _plain(face: Rectangle, colour: F64, focal: float) -> Surfels:
    """Cover a face with one colour, with shading."""
    if face.half_v[2]:  # it recedes
        columns, rows = strip_samples(face, focal)
    else:
        columns, rows = samples(face, SPACING_PX * face.centre[2] / focal)
    return coloured(face, np.broadcast_to(shade(face) * colour, (rows, columns, 3)))
