"""A depth map's missing parts: holes in the measurement, and the surfaces hidden behind the foreground.

Here: pure numpy on [H, W] maps of disparity (any quantity that increases towards the camera and is linear on planes,
such as inverse depth). Not here: Gaussians, cameras.

A photograph shows only the nearest surface on each ray. A camera that moves sees behind its edges, so the farther
surface is continued under the nearer one: seeds at every depth edge, flooded under the foreground as far as the camera
can see. Each hidden pixel stores the visible pixel that it continues. Its colour is the reflection of the image at that
pixel (which continues the texture; diffusion would smear it); its disparity is a membrane stretched from the visible
background, which has no cracks.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64, Bool
from gs2ci.core.errors import InputError

Index = NDArray[np.intp]

NEIGHBOURS: Final = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
# Pixels this close to a depth edge, on the far side, may show the near surface: lens and pixel blur, and
# disparities that are one or two pixels off.
RIM_PX: Final = 3
# Rounds of averaging with the neighbours: enough for a membrane over the widest hidden strip (tens of pixels); for
# colour only enough to remove the seams between reflections from different sources.
MEMBRANE_ROUNDS: Final = 150
COLOUR_ROUNDS: Final = 2
# The cost of filling a hole with foreground, as a colour difference (mean over channels, full scale 1): rims are at
# most a few pixels wide, so a foreground pixel farther away than that must have a much more similar colour.
FOREGROUND_COST: Final = 0.05
FOREGROUND_COST_PER_PX: Final = 0.02


@dataclass(frozen=True)
class Layer:
    """One surface per pixel, where there is one: disparity [H, W], colour [H, W, 3], present [H, W]."""

    disparity: F64
    colour: F64
    present: Bool


def without_flying_pixels(disparity: F64, jump: float) -> F64:
    """Mark pixels between two surfaces as unmeasured (NaN): those with a step over `jump` on both sides.

    Down-sampling averages disparities over a depth edge; the mean belongs to neither surface.
    """
    flying = np.zeros(disparity.shape, dtype=bool)
    measured = np.where(np.isfinite(disparity), disparity, np.nan)
    for values, marks in ((measured, flying), (measured.T, flying.T)):
        step = np.diff(values, axis=1)
        before, after = step[:, :-1], step[:, 1:]
        marks[:, 1:-1] |= (np.minimum(before, after) > jump) | (np.maximum(before, after) < -jump)
    return np.where(flying, np.nan, measured)


def fill_holes(disparity: F64, colour: F64, jump: float) -> F64:
    """Fill unmeasured disparities (not finite) from the measured pixels around the hole.

    Args:
        disparity: [H, W].
        colour: [H, W, 3] in [0, 1].
        jump: Smallest difference in disparity that separates two surfaces.

    Stereo has no disparity for points that only one camera sees, which are background: for most holes, the farthest
    of the nearest measured pixels to the left, right, above and below is correct. Stereo also misses the fine rims of
    the foreground: a nearer pixel fills the hole if its colour is more similar by more than the cost of its distance.

    Raises:
        InputError: Nothing is measured.
    """
    known = np.isfinite(disparity)
    if not known.any():
        raise InputError("the disparity map holds no finite value", remedy="give a map with measured pixels")
    beside = _measured_beside(known)
    values = np.where(beside >= 0, disparity.ravel()[beside], np.inf)
    farthest = values.min(axis=0)
    width = disparity.shape[1]
    here = np.arange(disparity.size).reshape(disparity.shape)
    away = np.abs(beside // width - here // width) + np.abs(beside % width - here % width)
    unlike = np.abs(colour.reshape(-1, 3)[beside] - colour).mean(-1)
    cost = unlike + np.where(values > farthest + jump, FOREGROUND_COST + FOREGROUND_COST_PER_PX * away, 0.0)
    best = np.where(np.isfinite(values), cost, np.inf).argmin(axis=0)
    filled = np.where(known, disparity, np.take_along_axis(values, best[None], axis=0)[0])
    # A hole that spans a whole row and column is filled in the next pass, from the pixels filled around it.
    return filled if np.isfinite(filled).all() else fill_holes(filled, colour, jump)


def _measured_beside(known: Bool) -> Index:
    """Get flat indices of the nearest known pixels left, right, above and below, [4, H, W]; -1 for none."""
    here = np.arange(known.size).reshape(known.shape)
    return np.stack(
        [
            _carried(known, here),
            _carried(known[:, ::-1], here[:, ::-1])[:, ::-1],
            _carried(known.T, here.T).T,
            _carried(known.T[:, ::-1], here.T[:, ::-1])[:, ::-1].T,
        ]
    )


def _carried(known: Bool, values: Index) -> Index:
    """Get for each pixel the value at the last known pixel of its row, itself included; -1 where there is none."""
    last = np.maximum.accumulate(np.where(known, np.arange(known.shape[1]), -1), axis=1)
    return np.where(last >= 0, np.take_along_axis(values, np.maximum(last, 0), axis=1), -1)


def clean_rims(front: Layer, jump: float) -> Layer:
    """Recolour the far side of every depth edge, where the photograph mixes the two surfaces."""
    height, width = front.present.shape
    rows, columns = np.mgrid[:height, :width]
    colour = front.colour.copy()
    for away in range(RIM_PX, 0, -1):  # the pixels closest to the edge last, because they locate the edge best
        for dy, dx in NEIGHBOURS[:4]:
            before = np.clip(rows - away * dy, 0, height - 1), np.clip(columns - away * dx, 0, width - 1)
            steps = RIM_PX + 1 - away
            beyond = np.clip(rows + steps * dy, 0, height - 1), np.clip(columns + steps * dx, 0, width - 1)
            farther = front.disparity[before] - front.disparity > jump
            rim: Bool = farther & (np.abs(front.disparity[beyond] - front.disparity) <= jump)
            colour[rim] = front.colour[beyond][rim]
    return Layer(front.disparity, colour, front.present)


def hidden_layer(front: Layer, jump: float, reach: float) -> Layer:
    """Continue the farther surface of every depth edge under the nearer one.

    Args:
        front: The visible surface; present everywhere.
        jump: Smallest difference in disparity that separates two surfaces.
        reach: How far the camera will move, as a share of the baseline that the disparities refer to: a surface d
            behind another, in disparity, comes into view over `reach` x d pixels at most.

    Returns:
        The hidden surface, with `present` for its pixels; elsewhere disparity and colour are the front's.
    """
    source = _flood(front.disparity, jump, reach)
    at = np.flatnonzero(source >= 0)
    disparity, colour = front.disparity.copy(), front.colour.copy()
    disparity.ravel()[at] = front.disparity.ravel()[source[at]]
    colour.reshape(-1, 3)[at] = _reflected(front, at, source[at], jump)
    _relax(disparity, colour, at, source, jump)
    return Layer(disparity, colour, (source >= 0).reshape(front.present.shape))


def _flood(disparity: F64, jump: float, reach: float) -> Index:
    """Find the visible pixel that each hidden one continues: flat indices, [H * W]; -1 without a hidden surface."""
    height, width = disparity.shape
    flat = disparity.ravel()
    source = np.full(flat.size, -1, dtype=np.intp)
    best = np.full(flat.size, np.inf)
    frontier = np.arange(flat.size)
    offers = frontier  # at first every pixel is offered to its neighbours; a neighbour in front of it accepts it
    while len(frontier):
        reached = np.zeros(flat.size, dtype=bool)
        for step in NEIGHBOURS:
            to, inside = _neighbour(frontier, step, (height, width))
            to, offer = to[inside], offers[inside]
            away = np.hypot(to // width - offer // width, to % width - offer % width)
            behind = flat[to] - flat[offer]
            better = (behind > jump) & (away <= np.maximum(reach * behind, RIM_PX)) & (away < best[to])
            source[to[better]], best[to[better]] = offer[better], away[better]
            reached[to[better]] = True
        frontier = np.flatnonzero(reached)
        offers = source[frontier]
    return source


def _neighbour(at: Index, step: tuple[int, int], shape: tuple[int, int]) -> tuple[Index, Bool]:
    """Get each flat index's neighbour (clipped to the image) and whether it lies inside."""
    y, x = at // shape[1] + step[0], at % shape[1] + step[1]
    inside = (y >= 0) & (y < shape[0]) & (x >= 0) & (x < shape[1])
    return np.clip(y, 0, shape[0] - 1) * shape[1] + np.clip(x, 0, shape[1] - 1), inside


def _reflected(front: Layer, at: Index, source: Index, jump: float) -> F64:
    """Colour each hidden pixel by its mirror image in its source, or as the source if that is another surface."""
    height, width = front.present.shape
    y, x, sy, sx = at // width, at % width, source // width, source % width
    # The rim itself is a mixture: reflect about the first clean pixel.
    my = np.clip(2 * sy - y + RIM_PX * np.sign(sy - y), 0, height - 1)
    mx = np.clip(2 * sx - x + RIM_PX * np.sign(sx - x), 0, width - 1)
    clean = np.abs(front.disparity[my, mx] - front.disparity[sy, sx]) <= 2 * jump
    return np.where(clean[:, None], front.colour[my, mx], front.colour[sy, sx])


def _relax(disparity: F64, colour: F64, at: Index, source: Index, jump: float) -> None:
    """Average hidden pixels with their neighbours, in place: other hidden ones and the visible background."""
    shape = (disparity.shape[0], disparity.shape[1])
    neighbours = np.zeros((len(at), 8), dtype=np.intp)
    weights: F64 = np.zeros((len(at), 8))
    d, c = disparity.ravel(), colour.reshape(-1, 3)
    for k, step in enumerate(NEIGHBOURS):
        to, inside = _neighbour(at, step, shape)
        background = np.abs(d[to] - d[at]) <= 2 * jump
        neighbours[:, k], weights[:, k] = to, inside & ((source[to] >= 0) | background)
    weights /= np.maximum(weights.sum(1, keepdims=True), 1)
    alone: Bool = weights.sum(1) == 0
    for _ in range(MEMBRANE_ROUNDS):
        d[at] = np.where(alone, d[at], np.sum(weights * d[neighbours], axis=1))
    for _ in range(COLOUR_ROUNDS):
        c[at] = 0.5 * c[at] + 0.5 * np.where(alone[:, None], c[at], np.einsum("nk,nkc->nc", weights, c[neighbours]))
