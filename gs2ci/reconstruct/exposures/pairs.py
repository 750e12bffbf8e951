"""Two exposures: the similarity between their coordinates.

    matched features ─► a camera's place among the other's points (RANSAC), both ways ─► scale ─► corners followed, and
    the similarity adjusted to them, in turn

A place among points of the other exposure hardly depends on errors of depth as long as the cameras are near each other.
Three points of each side laid upon each other, as is usual for clouds of points, would be turned by the error of their
depth over the distance between them: by 5 to 10° here.

Here: a pair. Not here: corners (`corners`), many exposures (`loops`, `together`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.optimize import least_squares

from gs2ci.core.arrays import F64
from gs2ci.core.colmap import colmap_camera, pycolmap
from gs2ci.reconstruct.exposures.corners import Matches, followed, matched
from gs2ci.reconstruct.exposures.pictures import MeanPicture
from gs2ci.reconstruct.exposures.similarity import CHANGES, Similarity
from gs2ci.reconstruct.geometry.path.adjustment_kernels import LEAST_RELATIVE_DEPTH
from gs2ci.reconstruct.measurement.noise import MEDIAN_DEVIATE

# A camera's place needs so many matches that agree with it, within so many px. Of proposals that 13 and more agreed
# with none was wrong; of those with 7 to 12 a third was, and their corners were not followed.
_LEAST_AGREEING: Final = 7
_PLACE_PX: Final = 4.0
_TRIALS: Final = 3000
# The best proposals, of both ways, that are followed up.
_TRIED: Final = 2
PLACE_ERROR_PX: Final = 0.7
"""Standard error of the place of a corner in a picture."""
# Rounds of following and adjusting. A pair is tied if so many corners, and so large a share of those that both should
# see, are found in the end; and not followed up if there are far fewer at first.
_ROUNDS: Final = 3
LEAST_FOUND: Final = 20
LEAST_SHARE: Final = 0.15
_LEAST_SHARE_AT_FIRST: Final = 0.05
_STEPS: Final = (0.01, 0.01, 0.01, 0.02, 0.02, 0.02, 0.05)
# A point that comes behind the camera while a similarity is sought stays far out, and finite.
_FARTHEST_PX: Final = 1e4


@dataclass(frozen=True, eq=False)
class Pair:
    """How two exposures lie to each other.

    Args:
        other_from_one: The similarity.
        centre: Of what both see, [3], in the coordinates of the first.
        unit: Its distance from the second's camera, in the unit of the second.
        covariance: Of a small change of the similarity about the centre, [7, 7] (`Similarity.changed`).
        share: Of the corners that both should see, those found.
        matches: They.
    """

    other_from_one: Similarity
    centre: F64
    unit: float
    covariance: F64
    share: float
    matches: Matches


def tie_pair(one: Sequence[MeanPicture], other: Sequence[MeanPicture], guess: Similarity | None = None) -> Pair | None:
    """Find the similarity between the coordinates of two exposures; None if nothing ties them.

    Args:
        one: Pictures of the first.
        other: Of the second.
        guess: other_from_one, roughly, from further exposures; None: features propose it.
    """
    starts = _proposals(one, other) if guess is None else [guess]
    settled = [pair for start in starts if (pair := _settled(one, other, start)) is not None]
    return max(settled, key=lambda pair: len(pair.matches), default=None)


def _proposals(one: Sequence[MeanPicture], other: Sequence[MeanPicture]) -> list[Similarity]:
    """Propose similarities by the place of either's camera among the other's points, most agreeing matches first."""
    matches, found = matched(one, other), []
    for i, j in np.unique(matches.pictures, axis=0):
        these = matches.keep((matches.pictures == (i, j)).all(axis=1))
        if len(these) < _LEAST_AGREEING:
            continue
        if (forward := _place(these, other[j])) is not None:
            found.append(forward)
        if (backward := _place(these.swapped, one[i])) is not None:
            found.append((backward[0], backward[1].inverse))
    found.sort(key=lambda proposal: -proposal[0])
    return [similarity for _, similarity in found[:_TRIED]]


def _place(matches: Matches, picture: MeanPicture) -> tuple[int, Similarity] | None:
    """Place the camera of a picture of the second among points of the first; the second's own depths give the scale.

    Returns:
        How many matches agree, and other_from_one; None if too few agree.
    """
    options, height, width = pycolmap.AbsolutePoseEstimationOptions(), *picture.inverse_depth.shape
    options.ransac.max_error, options.ransac.random_seed = _PLACE_PX, 0
    options.ransac.max_num_trials = _TRIALS
    camera = colmap_camera(picture.intrinsics, (height, width))
    found: Any = pycolmap.estimate_and_refine_absolute_pose(matches.at_other, matches.one, camera, options)
    if found is None or found["num_inliers"] < _LEAST_AGREEING:
        return None
    rigid, agree = found["cam_from_world"].matrix(), found["inlier_mask"]
    depth = matches.one[agree] @ rigid[2, :3] + rigid[2, 3]
    pose = picture.world_to_camera
    ratios = (matches.other[agree] @ pose[2, :3] + pose[2, 3]) / depth
    scale = float(np.median(ratios))
    if not 0 < scale < np.inf:
        return None
    own_from_camera = Similarity(1.0, pose[:3, :3].T, picture.centre)
    return int(found["num_inliers"]), own_from_camera.after(Similarity(scale, rigid[:, :3], scale * rigid[:, 3]))


def _settled(one: Sequence[MeanPicture], other: Sequence[MeanPicture], start: Similarity) -> Pair | None:
    """Follow corners and adjust the similarity in turn; None if too few are found."""
    pair = Pair(start, np.zeros(3), 1.0, np.eye(CHANGES), 0.0, Matches.joined(()))
    for _ in range(_ROUNDS):
        there, visible = followed(one, other, pair.other_from_one)
        back, visible_back = followed(other, one, pair.other_from_one.inverse)
        # A wrong depth of one of the two does not warp the other's picture onto it.
        share = max(len(there) / max(visible, 1), len(back) / max(visible_back, 1))
        if max(len(there), len(back)) < LEAST_FOUND or share < _LEAST_SHARE_AT_FIRST:
            return None
        pair = _adjusted(one, other, pair.other_from_one, Matches.joined((there, back.swapped)), share)
    return pair if pair.share >= LEAST_SHARE else None


def _adjusted(
    one: Sequence[MeanPicture], other: Sequence[MeanPicture], start: Similarity, matches: Matches, share: float
) -> Pair:
    """Adjust a similarity to matches."""
    centre = np.median(matches.one, axis=0)
    unit = float(np.linalg.norm(start.points(centre) - other[0].centre))
    seen = _Seen.of(one, other, matches, start)

    def errors(change: F64) -> F64:
        return seen.errors(start.changed(change, centre, unit))

    found = least_squares(errors, np.zeros(CHANGES), loss="soft_l1", x_scale=_STEPS)
    # Where errors are larger than foretold, so is the covariance.
    variance = max(1.0, float(np.median(np.abs(found.fun)) / MEDIAN_DEVIATE) ** 2)
    jacobian: F64 = np.asarray(found.jac, np.float64)
    covariance: F64 = variance * np.asarray(np.linalg.pinv(jacobian.T @ jacobian), np.float64)
    return Pair(start.changed(found.x, centre, unit), centre, unit, covariance, share, matches)


@dataclass(frozen=True, eq=False)
class _Seen:
    """What the cameras of two exposures should see of their matches, in standard errors.

    An error of depth moves a point in the other's picture along a line; so the standard error along it is larger.
    """

    matches: Matches
    poses: tuple[F64, ...]
    intrinsics: tuple[F64, ...]
    whitening: tuple[F64, ...]
    depth_error: float

    @classmethod
    def of(
        cls, one: Sequence[MeanPicture], other: Sequence[MeanPicture], matches: Matches, start: Similarity
    ) -> "_Seen":
        chosen = [[side[k] for k in which] for side, which in zip((one, other), matches.pictures.T, strict=True)]
        poses, intrinsics, centres = (
            tuple(np.stack([getattr(picture, name) for picture in side]) for side in chosen)
            for name in ("world_to_camera", "intrinsics", "centre")
        )
        errors = one[0].depth_error, other[0].depth_error
        whitening = []
        for side, similarity, points in ((0, start.inverse, matches.other), (1, start, matches.one)):
            home, error = centres[1 - side], errors[1 - side]
            ends = [
                projected(similarity.points(home + share * (points - home)), poses[side], intrinsics[side])[0]
                for share in (1 - error / 2, 1 + error / 2)
            ]
            along = ends[1] - ends[0]
            covariance = PLACE_ERROR_PX**2 * np.eye(2) + along[:, :, None] * along[:, None, :]
            whitening.append(np.linalg.inv(np.linalg.cholesky(covariance)))
        return cls(matches, poses, intrinsics, tuple(whitening), float(np.hypot(*errors)))

    def errors(self, other_from_one: Similarity) -> F64:
        """Return the errors in both pictures and of the depth, [5 M], in standard errors."""
        matches = self.matches
        there, depth = projected(other_from_one.points(matches.one), self.poses[1], self.intrinsics[1])
        back, _ = projected(other_from_one.inverse.points(matches.other), self.poses[0], self.intrinsics[0])
        _, own = projected(matches.other, self.poses[1], self.intrinsics[1])
        in_other = np.einsum("nij,nj->ni", self.whitening[1], there - matches.at_other)
        in_one = np.einsum("nij,nj->ni", self.whitening[0], back - matches.at_one)
        return np.concatenate([in_other.ravel(), in_one.ravel(), np.log(depth / own) / self.depth_error])


def projected(points: F64, poses: F64, intrinsics: F64) -> tuple[F64, F64]:
    """Project each point, [M, 3], by a pose, [M, 4, 4], and camera matrix, [M, 3, 3]: places, [M, 2] px; depths, [M].

    What lies behind the camera is placed far out, at a small depth.
    """
    inside = np.einsum("nij,nj->ni", poses[:, :3, :3], points) + poses[:, :3, 3]
    depth = np.maximum(inside[:, 2], LEAST_RELATIVE_DEPTH)
    flat = np.einsum("nij,nj->ni", intrinsics, inside / depth[:, None])[:, :2]
    return flat.clip(-_FARTHEST_PX, _FARTHEST_PX), depth
