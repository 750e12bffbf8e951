"""Whether a stage's report of where exposures were agrees with what several of them see.

A stage that lost steps between two exposures reports every path rightly and the place of one wrongly. Each exposure is
compared with those that see the same things, pair by pair, so that a wrong one does not accuse the right ones.

Here: the comparison. Not here: what the stage reports (`placing`), what exposures see (`tie`).
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from gs2ci.core.cameras import in_world
from gs2ci.reconstruct.exposures.pictures import depths_of
from gs2ci.reconstruct.exposures.similarity import Similarity
from gs2ci.reconstruct.exposures.tie import Tied, Ties
from gs2ci.reconstruct.geometry.depth.view_depths import grid, project
from gs2ci.reconstruct.geometry.path.motion import rays

# A place disagrees if neighbours see what both see displaced by more than this share of the picture's width: at 128 px
# eight. Ties of decoded rooms are off by up to 5 px where exposures lie in a row (`python -m tests.benchmarks ties`).
LIMIT_SHARE: Final = 0.06
"""Displacement, as a share of the picture's width, from which on a place disagrees."""
# Points are compared at every so many pixels.
_EVERY_PX: Final = 8


def displacements_px(ties: Ties, given: Mapping[int, Similarity]) -> dict[int, float]:
    """Return how far apart given places and ties put what exposures see, in the pictures of those that see the same.

    Args:
        ties: Of all exposures.
        given: common_from_own of some of them, by index, in any common coordinates (`placing.by_stage`).

    Returns:
        For each exposure that is tied and given, and has such partners, the median over them of the median
        displacement, px; by index.
    """
    tied, found = ties.tied, {}
    for number in sorted(set(tied) & set(given)):
        partners = [other for other in tied[number].partners if other in given]
        if partners:
            off = [_displaced_px((tied[number], tied[k]), (given[number], given[k])) for k in partners]
            found[number] = float(np.median(off))
    return found


def disagreeing(ties: Ties, given: Mapping[int, Similarity]) -> dict[int, float]:
    """Return the exposures whose given place disagrees with what they see, with their displacement in px, by index.

    Arguments as of `displacements_px`. If two exposures alone see the same things, both disagree.
    """
    widths = {number: one.geometry.inverse_depth.shape[1] for number, one in ties.tied.items()}
    return {number: off for number, off in displacements_px(ties, given).items() if off > LIMIT_SHARE * widths[number]}


def _displaced_px(pair: tuple[Tied, Tied], given: tuple[Similarity, Similarity]) -> float:
    """Return the median displacement of what the first sees in the picture of the second."""
    one, other = pair
    depth, intrinsics = depths_of(one.geometry)[0], one.geometry.intrinsics
    pixels = grid(depth.inverse_depth.shape, _EVERY_PX)
    along = depth.inverse_depth[pixels[:, 1].astype(int), pixels[:, 0].astype(int)].astype(np.float64)
    points = in_world(rays(pixels, intrinsics) / along[:, None], one.geometry.world_to_camera[depth.view])
    seen_from = other.geometry.world_to_camera[other.geometry.reference]
    places = [
        project(second.inverse.after(first).points(points), seen_from, other.geometry.intrinsics)[0]
        for first, second in ((one.common_from_own, other.common_from_own), given)
    ]
    # What comes behind a camera is as wrong as can be.
    apart = np.linalg.norm(places[0] - places[1], axis=1)
    return float(np.median(np.where(np.isfinite(apart), apart, np.inf)))
