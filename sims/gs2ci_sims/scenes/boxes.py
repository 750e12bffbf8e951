"""Boxes on a floor in front of a wall, at rest or with one that moves: procedural scenes.

Here: the arrangement. Not here: floor and wall (`stage`), faces (`rectangles`), the motion of an object
(`gs2ci_sims.effects.object_motion`).
"""

import numpy as np

from gs2ci.core.errors import InputError
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.rectangles import Rectangle, box, rotation
from gs2ci_sims.scenes.stage import SuggestedCamera, floor_y, painted, room, staged


def boxes(rng: np.random.Generator, frame: SuggestedCamera, *, count: int = 7, backdrop: float = 6.0) -> Scene:
    """Place boxes of random size, colour and rotation on a floor, from the wall towards the camera.

    Raises:
        InputError: A count below 1, or a wall behind the camera.
    """
    faces, surfels = room(rng, frame, backdrop)
    for each in _standing(rng, frame, count, backdrop):
        colour = rng.uniform(0.3, 0.95, 3)
        faces += each
        surfels += [painted(rng, face, frame.focal, colour) for face in each]
    return staged("boxes", frame, faces, surfels)


def moving_box(
    rng: np.random.Generator,
    frame: SuggestedCamera,
    *,
    centre: tuple[float, float, float] = (-0.4, -0.25, 3.0),
    radius: float = 0.45,
    count: int = 3,
    backdrop: float = 6.0,
) -> Scene:
    """Build a scene with a tilted box in the air, in front of boxes on a floor and a complete background.

    Args:
        rng: Generator of positions, rotations and textures.
        frame: The camera.
        centre: Centre of the box in the air, scene units.
        radius: Radius of its circumscribed sphere, whose content the effect `object_motion` moves.
        count: Number of boxes on the floor.
        backdrop: Depth of the wall.

    Raises:
        InputError: The sphere reaches behind the camera or into the wall; a count below 1.
    """
    if not 0 < radius < centre[2] or centre[2] + radius >= backdrop:
        raise InputError(
            f"a box at depth {centre[2]} within a radius of {radius} before a wall at {backdrop}",
            allowed="a ball in front of the camera and of the wall",
        )
    faces, surfels = room(rng, frame, backdrop)
    # A cube's corners are sqrt(3) half edges from its centre; discs extend a little over its edges.
    cube = box(np.array(centre), rotation(np.array([0.5, 0.6, 0.3])) * (0.97 * radius / np.sqrt(3)))
    far = max(0.6, (centre[2] + radius) / backdrop + 0.1)  # the others stand behind it
    for each in (cube, *_standing(rng, frame, count, backdrop, nearest=far)):
        colour = np.array([0.9, 0.45, 0.15]) if each is cube else rng.uniform(0.3, 0.95, 3)
        faces += each
        surfels += [painted(rng, face, frame.focal, colour) for face in each]
    return staged("moving", frame, faces, surfels)


def _standing(
    rng: np.random.Generator, frame: SuggestedCamera, count: int, backdrop: float, nearest: float = 0.5
) -> list[list[Rectangle]]:
    if count < 1:
        raise InputError(f"{count} boxes", allowed="1 or more")
    down = floor_y(frame, backdrop)
    columns = rng.permutation(count)  # apart from each other, across and in depth
    stand = []
    for k in range(count):
        depth = backdrop * float(np.interp(k, [0, max(count - 1, 1)], [0.88, nearest]))
        across = ((columns[k] + rng.uniform(0.3, 0.7)) / count * 2 - 1) * 0.85 * frame.half[0] * depth
        wide, high, deep = rng.uniform(0.08, 0.13) * backdrop, rng.uniform(0.07, 0.2) * backdrop, 0.1 * backdrop
        turn = rotation(np.array([0.0, rng.uniform(-0.6, 0.6), 0.0]))
        edges = turn * np.array([0.5 * wide, 0.5 * high, 0.5 * deep])
        stand.append(box(np.array([across, down - 0.5 * high, depth]), edges))
    return stand
