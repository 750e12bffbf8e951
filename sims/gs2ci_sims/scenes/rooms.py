"""Procedural scenes with a floor and walls: boxes, one of which may move; a corridor; a plain room; a thicket.

Here: their arrangement. Not here: floor and wall (`stage`), faces and strips with their discs (`rectangles`), the
motion of an object (`gs2ci_sims.effects.object_motion`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F64, Rng
from gs2ci.core.errors import InputError
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.rectangles import (
    SPACING_PX,
    Rectangle,
    box,
    chequered,
    coloured,
    grain,
    receding,
    rotation,
    samples,
    shade,
    strip_samples,
)
from gs2ci_sims.scenes.stage import FLOOR_COLOURS, OVERSIZE, SuggestedCamera, floor_y, painted, room, staged
from gs2ci_sims.scenes.surfels import Surfels


def boxes(rng: Rng, frame: SuggestedCamera, *, count: int = 7, backdrop: float = 6.0) -> Scene:
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
    rng: Rng,
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
    rng: Rng, frame: SuggestedCamera, count: int, backdrop: float, nearest: float = 0.5
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


def corridor(
    rng: Rng,
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


def _plaster(rng: Rng, strip: Rectangle, colour: F64, bay: int, focal: float) -> Surfels:
    """Cover a strip with grainy plaster; every second bay has a lamp, brightest in its middle."""
    columns, rows = strip_samples(strip, focal)
    along = (np.arange(rows) + 0.5) / rows
    light = np.where(bay % 2 == 0, 0.6 + 0.4 * np.sin(np.pi * along), 0.6 - 0.2 * np.sin(np.pi * along))
    paint = light[:, None, None] * colour * (1 + grain(rng, (rows, columns), 1.0))
    return coloured(strip, np.clip(paint, 0.0, 1.0))


# The side walls meet the back wall within the frame, at this share of half its breadth.
CORNER: Final = 0.8


def textureless(
    rng: Rng, frame: SuggestedCamera, *, edge: float = 0.5, depth: float = 4.0, backdrop: float = 6.0
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


def thicket(
    rng: Rng,
    frame: SuggestedCamera,
    *,
    stems: int = 60,
    twigs: int = 3,
    width_px: tuple[float, float] = (1.2, 5.0),
    near: float = 2.0,
    backdrop: float = 6.0,
) -> Scene:
    """Place stems with twigs on the floor, between `near` and the wall.

    Stems are ribbons that face the camera and are shaded as if they were round; twigs are half as wide.

    Args:
        rng: Generator of all random choices.
        frame: The camera.
        stems: Number of stems.
        twigs: Number of twigs of each stem.
        width_px: Narrowest and widest stem, in pixels of the suggested camera.
        near: Depth of the nearest stem.
        backdrop: Depth of the wall.

    Raises:
        InputError: No stems, a width that is not positive, or no room between near and wall.
    """
    if stems < 1 or twigs < 0 or not 0 < width_px[0] <= width_px[1] or not 0 < near < 0.95 * backdrop:
        raise InputError(
            f"{stems} stems with {twigs} twigs, {width_px} px wide, between {near} and a wall at {backdrop}",
            allowed="stems >= 1, twigs >= 0, 0 < narrowest <= widest, 0 < near < 0.95 backdrop",
        )
    faces, surfels = room(rng, frame, backdrop)
    for depth in np.linspace(0.95 * backdrop, near, stems):
        for ribbon, bark in _stem(rng, frame, float(depth), twigs, width_px, floor_y(frame, backdrop)):
            faces.append(ribbon)
            surfels.append(_rounded(rng, ribbon, bark, frame.focal))
    return staged("thicket", frame, faces, surfels)


def _stem(
    rng: Rng,
    frame: SuggestedCamera,
    depth: float,
    twigs: int,
    width_px: tuple[float, float],
    down: float,
) -> list[tuple[Rectangle, F64]]:
    half = frame.half * depth
    foot = np.array([rng.uniform(-1.1, 1.1) * half[0], min(down, 1.1 * half[1]), depth])
    axis = np.array([rng.uniform(-0.25, 0.25), -1.0, rng.uniform(-0.05, 0.05)])
    axis /= np.linalg.norm(axis)
    length = rng.uniform(0.6, 1.6) * half[1]
    width = float(np.exp(rng.uniform(*np.log(width_px)))) * depth / frame.focal
    bark = rng.uniform(0.6, 1.0) * np.array([rng.uniform(0.3, 0.8), rng.uniform(0.45, 0.8), rng.uniform(0.1, 0.35)])
    grown = [(_ribbon(foot, axis, length, width), bark)]
    for _ in range(twigs):
        angle = rng.choice([-1, 1]) * rng.uniform(0.4, 1.0)
        turned = np.array(
            [
                axis[0] * np.cos(angle) - axis[1] * np.sin(angle),
                axis[0] * np.sin(angle) + axis[1] * np.cos(angle),
                axis[2],
            ]
        )
        start = foot + rng.uniform(0.3, 0.95) * length * axis - np.array([0, 0, width])  # just in front of the stem
        grown.append((_ribbon(start, turned, rng.uniform(0.15, 0.4) * length, 0.5 * width), bark))
    return grown


def _ribbon(foot: F64, axis: F64, length: float, width: float) -> Rectangle:
    """Return a rectangle along the axis that faces the camera."""
    centre = foot + 0.5 * length * axis
    across = np.cross(axis, centre)
    return Rectangle(centre, 0.5 * width * across / np.linalg.norm(across), 0.5 * length * axis)


def _rounded(rng: Rng, ribbon: Rectangle, bark: F64, focal: float) -> Surfels:
    """Shade a ribbon across its width as a cylinder lit from the left, with nodes along it."""
    columns, rows = samples(ribbon, SPACING_PX * ribbon.centre[2] / focal)
    across = (np.arange(columns) + 0.5) / columns * 2 - 1
    light = 0.35 + 0.65 * np.clip(0.75 * np.sqrt(1 - across**2) - 0.65 * across, 0, 1)
    nodes = 1 + 0.25 * np.sin(np.cumsum(rng.uniform(0.05, 0.6, rows)))
    return coloured(ribbon, np.clip(nodes[:, None, None] * light[None, :, None] * bark, 0.0, 1.0))
