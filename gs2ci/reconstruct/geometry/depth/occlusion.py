"""What hides what: whether views show the nearer of two surfaces where a scene has one pass in front of the other.

A scene and its depth reversal move alike (`reversal`), and a fit to either explains the measurement about as well. But
where two of its surfaces meet on one line of sight, the views show one of them: the nearer one. In a scene whose order
of depth is reversed they show the farther one, unless its fit has moved the edges until there is nothing left to hide.
So of two fits, one of each order, the right one hides more that the views confirm
(docs/decisions/depth-order.md).

Here: this evidence in one fit, and the comparison of two. Not here: the fits and when they are made
(`hypotheses/turned.py`).
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.ndimage import label, map_coordinates

from gs2ci.core.arrays import F32, F64, I64, Bool
from gs2ci.reconstruct.geometry.depth.carrying import DepthCamera
from gs2ci.reconstruct.geometry.depth.view_depths import in_picture
from gs2ci.reconstruct.measurement.blocks import block_sums
from gs2ci.reconstruct.measurement.holdout import SURE

# Two points lie on different surfaces if they are seen at least this far apart from the view that they are carried
# from: one pixel more is hidden. Closer ones are neighbours on one slanted surface, or an error of the depths.
_APART_PX: Final = 1.0
# Evidence is summed over blocks of this many pixels a side: within them, views err together.
_BLOCK_PX: Final = 8
# The right order shows at least this much: a share of the variance of all pixels looked at. Motions of 1.5 px and less
# showed up to 2.8e-4, those of 3 px and more from 5.8e-4 on.
_LEAST: Final = 3e-4
# It shows at least so many times as much as the other order. Of seventeen pairs of fits with 3 px of parallax and more
# the right one showed 3.2 times as much and more.
_TIMES: Final = 2.0
# Neighbouring blocks belong to one thing if each has at least this share of the most evidence of any.
_OF_A_THING: Final = 0.01


@dataclass(frozen=True, eq=False)
class Occlusion:
    """What views show where surfaces of a scene hide one another.

    Args:
        evidence: By how much they are closer to the nearer than to the farther surface: squares of full scale, summed
            over views, pixels and colours of each block, [Bh, Bw].
        variance: That of the views, summed over all pixels that were looked at.
    """

    evidence: F64
    variance: float

    @property
    def total(self) -> float:
        """Get the evidence of all blocks."""
        return float(self.evidence.sum())

    def without(self, blocks: Bool) -> "Occlusion":
        """Return it without the evidence of some blocks, [Bh, Bw]."""
        return replace(self, evidence=np.where(blocks, 0.0, self.evidence))


@dataclass(frozen=True)
class Preference:
    """How clearly one of two scenes hides what the views do not show.

    Args:
        first: Whether it is the first of the two.
        times: How many times as much evidence it has as the other one; infinite if that has none.
        errors: By how many standard errors its blocks agree.
    """

    first: bool
    times: float
    errors: float


def occlusion(
    views: F32, depth: F32, world_to_camera: F64, intrinsics: F64, distortion: F64 | None = None
) -> Occlusion:
    """Find where surfaces of a scene hide one another, and what the views show there.

    The depths of the first, the middle and the last view are carried to all others.

    Args:
        views: [N, H, W, C].
        depth: Along the optical axis, [N, H, W]; 0 where there is no surface.
        world_to_camera: Poses, [N, 4, 4].
        intrinsics: Camera matrix in px, [3, 3]; pixel centres at +0.5.
        distortion: Of the lens, [5]; None for a pinhole.
    """
    count, height, width, _ = views.shape
    camera = DepthCamera(intrinsics, distortion, (height, width))
    shown = views.astype(np.float64)
    evidence = np.zeros((height, width))
    pairs = [(one, other) for one in sorted({0, count // 2, count - 1}) for other in range(count) if other != one]
    for one, other in pairs:
        moved = world_to_camera[other] @ np.linalg.inv(world_to_camera[one])
        nearest, farthest = _surfaces(depth[one].astype(np.float64), moved, camera)
        back = np.linalg.inv(moved)
        from_near, from_far = camera.carried(nearest, back)[0], camera.carried(farthest, back)[0]
        hidden = np.linalg.norm(from_near - from_far, axis=-1) >= _APART_PX  # not if a place is not a number
        near, far = (_sampled(shown[one], places[hidden]) for places in (from_near, from_far))
        seen = shown[other][hidden]
        evidence[hidden] += np.sum((seen - far) ** 2 - (seen - near) ** 2, axis=-1)
    variance = float(shown.var(axis=(1, 2)).sum(axis=-1).mean()) * height * width * len(pairs)
    return Occlusion(block_sums(evidence, _BLOCK_PX), variance)


def preferred(one: Occlusion, other: Occlusion) -> Preference | None:
    """Tell which of two fits to the same measurement hides what the views do not show; None if neither does clearly."""
    first = one.total >= other.total
    better, worse = (one, other) if first else (other, one)
    if not better.total >= _LEAST * better.variance > 0:
        return None
    times = better.total / worse.total if worse.total > 0 else float("inf")
    if times < _TIMES:
        return None
    # Few blocks have most of the evidence. With square roots, none outvotes all others.
    more = (better.evidence - worse.evidence).ravel()
    roots = np.sign(more) * np.sqrt(np.abs(more))
    errors = float(roots.sum() / np.sqrt(np.sum(roots**2)))
    # In pictures of 72 × 96 px reversed orders had five times as much by 1.6 to 1.8 errors.
    return Preference(first, times, errors) if errors >= SURE else None


def things(one: Occlusion, other: Occlusion) -> I64:
    """Number the things that two fits disagree on, from 1 in the blocks, [Bh, Bw], of each; 0 elsewhere.

    A thing is what has evidence for one of the fits in neighbouring blocks: what hides, and what it hides, on all of
    its sides. The views err alike in all of it, and if it moves by itself, all of it does.
    """
    differs = np.abs(one.evidence - other.evidence)
    found: I64 = label(differs > _OF_A_THING * differs.max(), np.ones((3, 3)))[0].astype(np.int64)
    return found


def doubted_things(things: I64, doubted: Bool) -> Bool:
    """Return the blocks, [Bh, Bw], of those things of which a part is doubted, pixels [H, W]."""
    found: Bool = np.isin(things, things[block_sums(doubted.astype(np.float64), _BLOCK_PX) > 0]) & (things > 0)
    return found


def _surfaces(depth: F64, moved: F64, camera: DepthCamera) -> tuple[F64, F64]:
    """Return the nearest and the farthest depth that fall on each pixel of a moved camera, [H, W]; NaN for none."""
    height, width = camera.size
    places, depths = camera.carried(np.where(depth > 0, depth, np.nan), moved)
    inside = in_picture(places, camera.size)
    columns, rows = np.floor(places[inside]).astype(np.intp).T
    nearest, farthest = np.full(height * width, np.inf), np.full(height * width, -np.inf)
    np.minimum.at(nearest, rows * width + columns, depths[inside])
    np.maximum.at(farthest, rows * width + columns, depths[inside])
    near, far = (np.where(np.isfinite(one), one, np.nan).reshape(height, width) for one in (nearest, farthest))
    return near, far


def _sampled(view: F64, places: F64) -> F64:
    """Sample a view, [H, W, C], at places, [P, 2] px; beyond its border, its border."""
    at = places[:, ::-1].T - 0.5
    return np.stack([map_coordinates(colour, at, order=1, mode="nearest") for colour in np.moveaxis(view, -1, 0)], -1)
