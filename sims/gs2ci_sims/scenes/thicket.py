"""A thicket of thin stems and twigs in front of a wall: a procedural scene for structures of one or two pixels.

Here: the arrangement. Not here: floor and wall (`stage`), ribbons as rectangles (`rectangles`).
"""

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.rectangles import SPACING_PX, Rectangle, coloured, samples
from gs2ci_sims.scenes.stage import SuggestedCamera, floor_y, room, staged
from gs2ci_sims.scenes.surfels import Surfels


def thicket(
    rng: np.random.Generator,
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
    rng: np.random.Generator,
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


def _rounded(rng: np.random.Generator, ribbon: Rectangle, bark: F64, focal: float) -> Surfels:
    """Shade a ribbon across its width as a cylinder lit from the left, with nodes along it."""
    columns, rows = samples(ribbon, SPACING_PX * ribbon.centre[2] / focal)
    across = (np.arange(columns) + 0.5) / columns * 2 - 1
    light = 0.35 + 0.65 * np.clip(0.75 * np.sqrt(1 - across**2) - 0.65 * across, 0, 1)
    nodes = 1 + 0.25 * np.sin(np.cumsum(rng.uniform(0.05, 0.6, rows)))
    return coloured(ribbon, np.clip(nodes[:, None, None] * light[None, :, None] * bark, 0.0, 1.0))
