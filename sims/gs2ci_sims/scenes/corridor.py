"""A deep corridor, lit in bays: a procedural scene with a depth range of one to twenty and more.

Here: walls, floor, ceiling and the end. Not here: strips and their discs (`rectangles`).
"""

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.rectangles import Rectangle, chequered, coloured, grain, receding, strip_samples
from gs2ci_sims.scenes.stage import FLOOR_COLOURS, SuggestedCamera, painted, staged
from gs2ci_sims.scenes.surfels import Surfels


def corridor(
    rng: np.random.Generator,
    frame: SuggestedCamera,
    *,
    half_width: float = 1.0,
    half_height: float = 0.8,
    length: float = 30.0,
) -> Scene:
    """Build a corridor around the line of sight.

    Args:
        rng: Generator of colours and textures.
        frame: The camera.
        half_width: Distance from the line of sight to each wall.
        half_height: Distance from the line of sight to floor and ceiling.
        length: Depth of its end.

    Raises:
        InputError: The corridor is too short, or a side has no size.
    """
    near = 0.75 * min(half_width / frame.half[0], half_height / frame.half[1])
    if min(half_width, half_height) <= 0 or not near < length < np.inf:
        raise InputError(
            f"a corridor of {2 * half_width} x {2 * half_height} x {length}",
            allowed=f"sides above 0, and a length above {near:.3g}, where its walls come into view",
        )
    floor = receding(np.array([0, half_height]), np.array([half_width, 0]), near, length)
    ceiling = receding(np.array([0, -half_height]), np.array([half_width, 0]), near, length)
    walls = [
        receding(np.array([side * half_width, 0]), np.array([0, half_height]), near, length) for side in (-1.0, 1.0)
    ]
    end = Rectangle(np.array([0, 0, length]), np.array([half_width, 0, 0]), np.array([0, half_height, 0]))
    surfels = [chequered(rng, strip, 0.4 * half_width, FLOOR_COLOURS, frame.focal) for strip in floor]
    surfels += [_plaster(rng, strip, np.array([0.8, 0.78, 0.72]), k, frame.focal) for k, strip in enumerate(ceiling)]
    for wall in walls:
        colours = rng.uniform(0.35, 0.85, (2, 3))
        surfels += [_plaster(rng, strip, colours[k % 2], k, frame.focal) for k, strip in enumerate(wall)]
    surfels.append(painted(rng, end, frame.focal, np.array([0.9, 0.85, 0.6])))
    return staged("corridor", frame, [*floor, *ceiling, *walls[0], *walls[1], end], surfels)


def _plaster(rng: np.random.Generator, strip: Rectangle, colour: F64, bay: int, focal: float) -> Surfels:
    """Cover a strip with grainy plaster; every second bay has a lamp, brightest in its middle."""
    columns, rows = strip_samples(strip, focal)
    along = (np.arange(rows) + 0.5) / rows
    light = np.where(bay % 2 == 0, 0.6 + 0.4 * np.sin(np.pi * along), 0.6 - 0.2 * np.sin(np.pi * along))
    paint = light[:, None, None] * colour * (1 + grain(rng, (rows, columns), 1.0))
    return coloured(strip, np.clip(paint, 0.0, 1.0))
