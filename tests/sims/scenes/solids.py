"""Solids of known size in front of a wall, to compare with measured lengths.

Here: a slanted panel, a ball and a staircase, as triangles with exact true depth. Not here: textures and their shading
(`meshes`), lengths (`gs2ci.evaluate.measuring`).
"""

from typing import Final

import numpy as np

from gs2ci.core.errors import InputError
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.meshes import MeshBuilder, scene_from_mesh
from gs2ci_sims.scenes.rectangles import Rectangle, rotation
from gs2ci_sims.scenes.stage import SuggestedCamera

SOLIDS: Final = ("plane", "ball", "staircase")
# Depth of the solid's middle as a share of the wall's, and the share of the picture's shorter side that it fills there.
_MIDDLE: Final = 0.7
_SIZE: Final = 0.7
_STEPS: Final = 4


def solid(which: str, rng: np.random.Generator, frame: SuggestedCamera, *, backdrop: float = 6.0) -> Scene:
    """Place one solid in front of a wall: a panel that leans back, a ball, or a staircase of four steps.

    Args:
        which: One of `SOLIDS`.
        rng: Generator of textures and of the solid's rotation about its vertical axis.
        frame: The camera.
        backdrop: Depth of the wall, scene units.

    Raises:
        InputError: The solid is unknown, or the wall is not in front of the camera.
    """
    if which not in SOLIDS or not 0 < backdrop < np.inf:
        raise InputError(f"a {which} before a wall at {backdrop}", allowed=f"{', '.join(SOLIDS)}; a depth above 0")
    builder = MeshBuilder(rng, frame)
    wide, high = 2 * backdrop * frame.half
    builder.rectangle(Rectangle(np.array([0, 0, backdrop]), np.array([wide, 0, 0]), np.array([0, high, 0])))
    middle = np.array([0, 0, _MIDDLE * backdrop])
    half = _SIZE * _MIDDLE * backdrop * float(frame.half.min())
    turn = rotation(np.array([0, rng.uniform(-0.3, 0.3), 0]))
    if which == "ball":
        builder.ball(middle, half)
    elif which == "plane":
        lean = turn @ rotation(np.array([rng.uniform(0.3, 0.6), 0, 0]))
        builder.rectangle(Rectangle(middle, 1.2 * half * lean[:, 0], half * lean[:, 1]))
    else:
        for face in staircase(2.4 * half, 2 * half, 1.2 * half):
            builder.rectangle(Rectangle(middle + turn @ face.centre, turn @ face.half_u, turn @ face.half_v))
    return scene_from_mesh(which, builder.mesh(), frame.size, frame.intrinsics)


def staircase(wide: float, high: float, deep: float, steps: int = _STEPS) -> list[Rectangle]:
    """List risers and treads of a staircase about the origin that climbs away from the camera.

    Args:
        wide: Its extent to the right (x).
        high: Its extent downwards (y).
        deep: Its extent ahead (z).
        steps: Number of steps.
    """
    rise, run = high / steps, deep / steps
    faces = []
    for step in range(steps):
        top, front = high / 2 - (step + 1) * rise, -deep / 2 + step * run
        across = np.array([wide / 2, 0, 0])
        faces.append(Rectangle(np.array([0, top + rise / 2, front]), across, np.array([0, rise / 2, 0])))
        faces.append(Rectangle(np.array([0, top, front + run / 2]), across, np.array([0, 0, run / 2])))
    return faces
