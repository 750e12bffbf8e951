"""Whether a case's data determine the order of depth, and when a rank correlation is only chance.

Here: the reasons why the order is undetermined, from the true path, depths and views; the standard error of a rank
correlation between two maps that vary slowly. Not here: the grades that follow from them (`judge`).
"""

from typing import Final

import numpy as np
from scipy.fft import irfft2 as inverse_rfft2
from scipy.fft import next_fast_len, rfft2
from scipy.spatial.transform import Rotation
from scipy.stats import rankdata

from gs2ci.core.arrays import F32, F64
from gs2ci.core.records import Shot
from gs2ci_sims.scene import Scene

# Corners that are followed in decoded views of these sizes err by 0.6 to 1.4 px (what the runs say of them): a motion
# that leaves so little beyond a turn drowns. The easy case leaves 0.8 px at 64 px, 2 views leave 0.45 px.
DROWNS_PX: Final = 0.4
# Views that change by less than this per px, full scales, show nothing to follow.
EVEN_PER_PX: Final = 0.005
# Beyond so many standard errors a rank correlation is not chance.
CHANCE_ERRORS: Final = 2.0
# Few large patches could bring more than this by chance, but so much the wrong way round is wrong all the same.
MOST_CHANCE: Final = 0.3
# So many points along each side show how a picture moves.
_POINTS: Final = 24
_MOST_VIEWS: Final = 16


def unknowable(shot: Shot, scene: Scene) -> str:
    """Say why nobody could tell near from far in a shot of a scene; "" where one could, or where no truth tells."""
    path, views = shot.truth.world_to_camera, shot.truth.views
    if views is not None and np.isfinite(views).all() and texture_per_px(views) <= EVEN_PER_PX:
        return "the scene shows nothing to follow"
    if path is not None and (moved_px := beyond_a_turn_px(path, scene.depth, scene.intrinsics)) <= DROWNS_PX:
        return f"a turn explains the true motion to {moved_px:.2f} px"
    return ""


def texture_per_px(views: F32) -> float:
    """Return by how much views, [N, H, W, C] in full scales, change from pixel to pixel, rms."""
    grey = views.mean(axis=3, dtype=np.float64)
    across, down = (np.diff(grey, axis=axis) for axis in (2, 1))
    return float(np.sqrt(sum(np.mean(np.square(change)) for change in (across, down) if change.size)))


def beyond_a_turn_px(world_to_camera: F64, depth: F64, intrinsics: F64) -> float:
    """Return what the best turn leaves of how points move between two views, px rms: the most of any two.

    Order of depth and direction of travel are read from this part of a motion alone: none of it is left of a camera
    that only turns, nor where a wall at one depth fills a narrow field of view.

    Args:
        world_to_camera: True poses, [N, 4, 4].
        depth: Of the middle view, [H, W]; not finite or 0 where nothing is seen.
        intrinsics: [3, 3], px.
    """
    height, width = depth.shape
    rows, columns = (np.unique(np.linspace(0, side - 1, _POINTS).astype(int)) for side in (height, width))
    z = depth[np.ix_(rows, columns)]
    pixels = np.stack([*np.meshgrid(columns + 0.5, rows + 0.5), np.ones(z.shape)], axis=-1)
    seen = np.isfinite(z) & (z > 0)
    if not seen.any():
        return 0.0
    points = (pixels @ np.linalg.inv(intrinsics).T * np.where(seen, z, 0)[..., None])[seen]
    from_middle = world_to_camera @ np.linalg.inv(world_to_camera[len(world_to_camera) // 2])
    chosen = np.unique(np.linspace(0, len(from_middle) - 1, _MOST_VIEWS).round().astype(int))
    rays = points @ from_middle[chosen, :3, :3].swapaxes(1, 2) + from_middle[chosen, None, :3, 3]
    rays /= np.maximum(np.linalg.norm(rays, axis=2, keepdims=True), np.finfo(np.float64).tiny)
    pairs = [(one, other) for one in range(len(rays)) for other in range(one)]
    left = [_left_by_a_turn(rays[one], rays[other]) for one, other in pairs]
    return float(intrinsics[0, 0]) * max(left, default=0.0)


def _left_by_a_turn(one: F64, other: F64) -> float:
    """Return the rms distance of unit vectors, [P, 3], from others, as near as one rotation brings them."""
    turn, _ = Rotation.align_vectors(one, other)
    return float(np.sqrt(np.mean(np.sum(np.square(one - turn.apply(other)), axis=1))))


def rank_error(found: F32 | F64, true: F32 | F64) -> float:
    """Return the standard error of Spearman's rank correlation of two unrelated maps, [H, W].

    Pixels are not independent: neighbours lie at one depth. Clifford, Richardson and Hémon (Biometrics 1989): the
    variance is the sum over all distances h of n(h) C1(h) C2(h), with the covariances C of either map's ranks with
    themselves at that distance and the number n of pairs of pixels, relative to what the maps vary. 1 / N for N
    independent pixels. 0 where either is the same everywhere.

    Args:
        found: Depth; 0 or not finite where nothing is known.
        true: The same shape.
    """
    both = np.isfinite(found) & (found > 0) & np.isfinite(true) & (true > 0)
    ranks = [np.zeros(both.shape), np.zeros(both.shape)]
    for rank, depth in zip(ranks, (found, true), strict=True):
        values = rankdata(depth[both])
        rank[both] = values - values.mean() if values.size else values
    spread = float(np.sqrt(np.prod([np.square(rank).sum() for rank in ranks])))
    if spread == 0:
        return 0.0
    pairs = np.maximum(_with_itself(both.astype(np.float64)), 0.5)
    return float(np.sqrt(max((_with_itself(ranks[0]) * _with_itself(ranks[1]) / pairs).sum(), 0.0)) / spread)


def by_chance(rank: float, error: float) -> bool:
    """Tell whether a rank correlation, and its standard error, say nothing of the order of depth."""
    return abs(rank) <= min(CHANCE_ERRORS * error, MOST_CHANCE)


def _with_itself(values: F64) -> F64:
    """Return a map's sums of products with itself at every distance, [2H - 1 or more, 2W - 1 or more]."""
    size = [next_fast_len(2 * side - 1, real=True) for side in values.shape]
    sums: F64 = inverse_rfft2(np.abs(rfft2(values, size)) ** 2, size)
    return sums
