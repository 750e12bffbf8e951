"""How far the camera path depends on which of the tracks it was found from.

The path is adjusted again to halves of the tracks. What the halves disagree about, the tracks do not determine: few
points, points on a small part of the frame (where a turn of the camera looks like a shift), little parallax, much
residue of the masks. Here: that disagreement as one number. Not here: how much of it is worth a word (`validity`).

If one half errs independently of the other, it differs from the whole by as much as the whole from the truth (the
delete-half jackknife: Shao and Wu 1989). Neighbouring tracks do not err independently, as they see the same residue.
So halves are made of cells of a grid. The covariance of the adjustment's own normal equations, which takes every
sighting for independent and the path for nearly right, said too little by factors of 2 to 6.

What all tracks share, halves cannot show among themselves; most of all the residue in the reference view, against which
every other view is seen. So the halves are adjusted with that view's sightings taken for exact (`motion.adjust`), and
compared with a path that was not (`bundle`): what these sightings do to a path is then part of the difference.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64, Bool
from gs2ci.reconstruct.geometry.motion import CameraMotion, MotionSettings, adjust
from gs2ci.reconstruct.geometry.tracks import Tracks

# More ways to halve the tracks changed the number by a tenth as a rule; three take a third of the path's own time.
HALVINGS: Final = 3
# In views of 256 px a cell is wider than the tracker's patch. Tracks that support a path lie in seven cells or more.
CELLS: Final = 8
# A similarity brings any two places onto any two others.
_LEAST_VIEWS: Final = 3


def expected_path_error(
    motion: CameraMotion,
    tracks: Tracks,
    intrinsics: F64,
    size: tuple[int, int],
    settings: MotionSettings | None = None,
    seed: int = 0,
) -> float | None:
    """Estimate the error of a path that was adjusted to tracks, from what halves of the tracks say instead.

    A wrong camera matrix, a scene that moves or one turned inside out make errors that all tracks share; they do not
    show, nor does a rotation of all cameras against their path.

    Args:
        motion: As adjusted to these tracks.
        tracks: The tracks that it explains.
        intrinsics: Camera matrix in px, [3, 3].
        size: Height and width of the views, px.
        settings: How to adjust.
        seed: Of the halvings.

    Returns:
        Root mean square over halves and views of the distance between camera centres after a similarity, as a share
        of the diagonal of the path's bounding box; always finite, and never above 1, as a half that
        finds no motion errs by the whole path. None where there is no path to speak of: no tracks, fewer than three
        views that see them, a camera that stays where it is.
    """
    placed = tracks.seen.any(axis=0)
    path = camera_centres(motion)[placed]
    if len(path) < _LEAST_VIEWS:
        return None
    extent = float(np.linalg.norm(np.ptp(path, axis=0)))
    if extent == 0:
        return None
    cell = _cells(tracks, size)
    occupied, rng, squares = np.unique(cell), np.random.default_rng(seed), []
    for _ in range(HALVINGS):
        first = np.isin(cell, rng.permutation(occupied)[: len(occupied) // 2])
        for half in (first, ~first):
            again = _found_again(motion, tracks, half, intrinsics, settings)
            squares.append(squared_distance(again[placed], path))
    return float(np.sqrt(np.mean(squares))) / extent


def camera_centres(motion: CameraMotion) -> F64:
    """Get where the cameras stand in the reference view's axes, [N, 3]."""
    centres: F64 = -np.einsum("nji,nj->ni", motion.rotations, motion.translations)
    return centres


def squared_distance(centres: F64, path: F64) -> float:
    """Get the mean squared distance, over the views, of centres [N, 3] from a path after the best similarity.

    Centres that are all one place are brought to the middle of the path.
    """
    a, b = centres - centres.mean(axis=0), path - path.mean(axis=0)
    spread, whole = float((a**2).sum()), float((b**2).sum())
    if spread == 0:
        return whole / len(path)
    u, values, v = np.linalg.svd(b.T @ a)
    if np.linalg.det(u @ v) < 0:  # a mirrored path is not the same path
        values[-1] = -values[-1]
    # What is left under the least-squares scale. Rounding may put it a hair below zero.
    return max(whole - float(values.sum()) ** 2 / spread, 0.0) / len(path)


def _cells(tracks: Tracks, size: tuple[int, int]) -> NDArray[np.int64]:
    """Number the cell of the reference view that each track starts in, [P]."""
    column, row = (tracks.positions[:, tracks.reference] / (size[1], size[0]) * CELLS).astype(np.int64).T
    return np.asarray(row.clip(0, CELLS - 1) * CELLS + column.clip(0, CELLS - 1))


def _found_again(
    motion: CameraMotion, tracks: Tracks, chosen: Bool, intrinsics: F64, settings: MotionSettings | None
) -> F64:
    """Find camera centres from some of the tracks, [N, 3], beginning where all of them led.

    A view that none of them sees stays where it was.
    """
    if not chosen.any():
        return np.zeros_like(motion.translations)
    start = replace(motion, inverse_depth=motion.inverse_depth[chosen])
    return camera_centres(adjust(tracks.keep(chosen), intrinsics, settings, start))
