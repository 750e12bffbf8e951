"""The expected error of a camera path, from halves of the tracks.

The path is estimated again from halves of the tracks. Where the halves disagree, the tracks do not determine it: few
points, points on a small part of the frame (where a turn of the camera looks like a shift), little parallax, much
residue of the masks. Here: that disagreement as one number, and whether a path from one half predicts the other half
better than given poses do. Not here: how much of either is reported (`validity`).

If the errors of the two halves are independent, the path of a half differs from that of all tracks by as much as the
latter from the truth (the delete-half jackknife: Shao and Wu 1989). The errors of neighbouring tracks are not
independent, since they see the same residue; so halves are made of cells of a grid. The covariance from the
adjustment's normal equations, which assumes independent observations and a nearly right path, was too small by factors
of 2 to 6.

Halves cannot show errors that all tracks share, most of all those from the residue in the reference view, from which
all positions are measured. So the halves are adjusted with that view's positions taken as exact (`motion.adjust`), and
compared with a path for which they were not (`bundle`): the effect of these positions is then part of the difference.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64, I64, Bool, Size
from gs2ci.core.cameras import camera_centres, rigid
from gs2ci.core.errors import GeometryError
from gs2ci.reconstruct.geometry.path.motion import USUAL_MOTION, CameraMotion, MotionSettings, adjust, wander_px
from gs2ci.reconstruct.geometry.path.telemetry import place_points
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks

# More halvings typically changed the number by a tenth; three take a third of the time of the path's own estimate.
HALVINGS: Final = 3
# In views of 256 px a cell is wider than the tracker's patch. Tracks that may support a path lie in at least seven
# cells.
CELLS: Final = 8
# A similarity maps any two positions exactly onto any two others, so that two views show no error.
LEAST_VIEWS: Final = 3


def expected_path_error(
    motion: CameraMotion,
    tracks: Tracks,
    intrinsics: F64,
    size: Size,
    settings: MotionSettings = USUAL_MOTION,
) -> float | None:
    """Estimate the error of a path that was adjusted to tracks, from the paths of halves of the tracks.

    Errors that all tracks share do not show: those of a wrong camera matrix, a moving scene, or a reversed order of
    depth; nor does a rotation of all cameras against their path.

    Args:
        motion: Adjusted to these tracks.
        tracks: The tracks that it explains.
        intrinsics: Camera matrix in px, [3, 3].
        size: Height and width of the views, px.
        settings: How to adjust.

    Returns:
        The error, as `error_from_halves`; None if there is no path: no tracks, fewer than three views that see them, a
        camera that stays in place.
    """
    placed = tracks.seen.any(axis=0)
    path = motion.world_to_camera[placed]
    if len(path) < LEAST_VIEWS:
        return None

    def again(half: Bool) -> F64:
        return _found_again(motion, tracks, half, intrinsics, settings)[placed]

    return error_from_halves(path, cells(tracks, size), again)


def times_better_foretold(
    given: CameraMotion,
    adjusted: CameraMotion,
    tracks: Tracks,
    intrinsics: F64,
    size: Size,
    settings: MotionSettings = USUAL_MOTION,
) -> float:
    """Compare what given poses leave of tracks with what poses leave that were adjusted to the other half of them.

    Poses adjusted to the same tracks follow the tracks' errors too, which neighbours share: of small pictures they left
    up to a quarter less than the exact poses did, however wrong they were.

    Args:
        given: The given poses.
        adjusted: Where each half's adjustment starts; adjusted to all tracks.
        tracks: The tracks of both motions.
        intrinsics: Camera matrix in px, [3, 3].
        size: Height and width of the views, px.
        settings: How to adjust.

    Returns:
        Root mean square variation of errors along a half's tracks under the given poses, as a multiple of that under
        poses adjusted to the other half, median over halves: up to about 1 for exact poses. 0 if no half tells.
    """
    squares = []
    for half in _halves(cells(tracks, size)):
        if not (half.any() and (~half).any()):
            continue
        start = replace(adjusted, inverse_depth=adjusted.inverse_depth[half])
        found = adjust(tracks.keep(half), intrinsics, settings, start)
        left, of_given = (_left(motion, tracks.keep(~half), intrinsics, settings) for motion in (found, given))
        if left > 0:
            squares.append(of_given / left)
    return float(np.sqrt(np.median(squares))) if squares else 0.0


def error_from_halves(path: F64, group: I64, again: Callable[[Bool], F64]) -> float | None:
    """Return how far the paths of halves are from that of all.

    Args:
        path: World-to-camera poses, [N, 4, 4].
        group: Of each observation, [P]: a half has whole groups.
        again: Estimates the poses, [N, 4, 4], from some of the observations, [P].

    Returns:
        Distance between camera centres after a similarity, root mean square over halves and views, as a share of the
        diagonal of the path's bounding box; finite, and at most 1, since a half without a motion errs by the whole
        path. None if the camera stays in place.
    """
    centres = camera_centres(path)
    extent = float(np.linalg.norm(np.ptp(centres, axis=0)))
    if extent == 0:
        return None
    far = np.mean([squared_distance(camera_centres(again(half)), centres) for half in _halves(group)])
    return float(np.sqrt(far)) / extent


def squared_distance(centres: F64, path: F64) -> float:
    """Get the mean squared distance, over the views, of centres [N, 3] from a path after the best similarity.

    Centres that coincide are moved to the middle of the path.
    """
    a, b = centres - centres.mean(axis=0), path - path.mean(axis=0)
    spread, whole = float((a**2).sum()), float((b**2).sum())
    if spread == 0:
        return whole / len(path)
    u, values, v = np.linalg.svd(b.T @ a)
    if np.linalg.det(u @ v) < 0:  # a mirrored path is not the same path
        values[-1] = -values[-1]
    # The residual at the least-squares scale. Rounding may make it slightly negative.
    return max(whole - float(values.sum()) ** 2 / spread, 0.0) / len(path)


def squared_turn(poses: F64, path: F64) -> float:
    """Get the mean squared angle between the cameras of two paths, after the turn that all have in common, rad²."""
    between = Rotation.from_matrix(poses[:, :3, :3].transpose(0, 2, 1) @ path[:, :3, :3])
    return float(np.square((between * between.mean().inv()).magnitude()).mean())


def _halves(group: I64) -> Iterator[Bool]:
    """Yield each halving's two halves of the observations, [P], of whole groups [P]."""
    groups, rng = np.unique(group), np.random.default_rng(0)
    for _ in range(HALVINGS):
        first = np.isin(group, rng.permutation(groups)[: len(groups) // 2])
        yield first
        yield ~first


def _left(motion: CameraMotion, tracks: Tracks, intrinsics: F64, settings: MotionSettings) -> float:
    """Get the mean square variation of errors along tracks under a motion's poses, px²; infinite if they lie behind."""
    try:
        placed, _ = place_points(tracks, motion.world_to_camera, intrinsics, settings.huber_px, np.inf)
    except GeometryError:
        return np.inf
    return wander_px(placed.errors_px, unknowns=1) ** 2


def cells(tracks: Tracks, size: Size) -> I64:
    """Number the cell of the reference view that each track starts in, [P]."""
    column, row = (tracks.positions[:, tracks.reference] / (size[1], size[0]) * CELLS).astype(np.int64).T
    return row.clip(0, CELLS - 1) * CELLS + column.clip(0, CELLS - 1)


def _found_again(motion: CameraMotion, tracks: Tracks, chosen: Bool, intrinsics: F64, settings: MotionSettings) -> F64:
    """Estimate poses from some of the tracks, [N, 4, 4], starting from the path of all tracks.

    A view that none of them reaches keeps its pose.
    """
    if not chosen.any():
        return rigid(np.eye(3), np.zeros_like(motion.translations))
    start = replace(motion, inverse_depth=motion.inverse_depth[chosen])
    return adjust(tracks.keep(chosen), intrinsics, settings, start).world_to_camera
