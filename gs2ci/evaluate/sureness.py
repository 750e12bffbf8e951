"""The standard errors of a run: their files, those of the Gaussians' centres, and their figures for the report.

Here: that. Not here: the standard errors themselves (`gs2ci.reconstruct.uncertainty`), the page.
"""

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.cameras import SAME_SURFACE, in_camera
from gs2ci.core.run_records import RunResult
from gs2ci.core.uncertainty import Uncertainty
from gs2ci.evaluate.points import Cameras
from gs2ci.evaluate.report import SurenessSection
from gs2ci.reconstruct.uncertainty.factors import factors
from gs2ci.render.gaussians import Gaussians

VIEWS_ERROR: Final = "views_error.npy"
DEPTH_ERROR: Final = "depth_error.npy"
DEPTH_OTHER: Final = "depth_other.npy"
_FAR_OUT: Final = 0.005
"""Share of the depths at either end that do not tell where a scene's nearest and farthest surfaces lie."""
SURE_OF_VIEWS: Final = 0.05
"""A value of a view surer than this, full scale 1, counts as sure: an error of so much (26 dB) shows at a glance."""
SURE_OF_DEPTH: Final = 0.05
"""A depth surer than this share of it counts as sure."""


def write_errors(folder: Path, errors: Uncertainty | None) -> None:
    """Write the maps of standard errors that there are into a run folder."""
    if errors is None:
        return
    maps = {VIEWS_ERROR: errors.views, DEPTH_ERROR: errors.depth}
    for name, values in maps.items():
        if values is not None:
            np.save(folder / name, values.astype(np.float32, copy=False))


def in_other_order(depth: F32) -> F32:
    """Return depth with near and far exchanged, as a camera on the opposite path would see the same displacements.

    Displacements of a small motion are focal length times travel over depth, and what a turn adds to all pixels alike.
    With the travel reversed, inverse depths d become c - d, with any c (the turn makes up for it): here, that which
    keeps the range of depths. Nothing is fitted; views do not tell the two apart where the order is open.

    Args:
        depth: [N, H, W], along the optical axis; 0 where there is none.
    """
    there = depth > 0
    if not there.any():
        return np.zeros_like(depth)
    far, near = np.quantile(1 / depth[there].astype(np.float64), (_FAR_OUT, 1 - _FAR_OUT))
    inverse = np.clip(1 / np.where(there, depth, 1).astype(np.float64), far, near)
    exchanged: F32 = np.where(there, 1 / (near + far - inverse), 0).astype(np.float32)
    return exchanged


def errors_of_centres(scene: Gaussians, result: RunResult) -> F32 | None:
    """Return the standard errors of the Gaussians' centres, [G], in the unit of the scene (`errors_at`).

    None if depth has no standard errors.
    """
    errors = result.uncertainty
    if errors is None or errors.depth is None or result.depth is None:
        return None
    cameras = Cameras(result.world_to_camera, result.intrinsics, result.distortion)
    return errors_at(scene.means.detach().double().numpy(), result.depth, errors.depth, cameras)


def errors_at(points: F64, depth: F32, errors: F32, cameras: Cameras) -> F32:
    """Return the standard errors of points, [P, 3], in the unit of the path, [P].

    Each is the least share that a view states of the depth where it shows the point, of the point's distance; a point
    that no view shows errs by half its distance from the middle camera.

    Args:
        points: In the world of the path.
        depth: [N, H, W]; 0 where there is none.
        errors: Its standard errors, [N, H, W].
        cameras: Of the views.
    """
    found = np.full(len(points), np.inf)
    size = (depth.shape[1], depth.shape[2])
    for view in range(len(depth)):
        inside, ahead, pixels = cameras.seen(points, view, size)
        columns, rows = np.where(inside[:, None], pixels, 0).astype(np.int64).T
        there, error = depth[view, rows, columns].astype(np.float64), errors[view, rows, columns].astype(np.float64)
        shown = inside & (there > 0) & (np.abs(there - ahead) <= np.maximum(SAME_SURFACE * there, 2 * error))
        share = np.where(shown, error / np.where(there > 0, there, 1), np.inf)
        found = np.minimum(found, share * np.abs(ahead))
    middle = cameras.world_to_camera[len(depth) // 2]
    away = np.linalg.norm(in_camera(points, middle), axis=1)
    return np.where(np.isfinite(found), found, factors.unknown_depth * away).astype(np.float32)


def figures_of_errors(result: RunResult) -> SurenessSection | None:
    """Return the section of the report; None if there are no standard errors."""
    errors = result.uncertainty
    if errors is None:
        return None
    found = SurenessSection(
        views_mean=float(errors.views.mean(dtype=np.float64)),
        views_sure_share=float(np.mean(errors.views <= SURE_OF_VIEWS)),
    )
    if errors.depth is not None and result.depth is not None and (there := result.depth > 0).any():
        relative = errors.depth[there] / result.depth[there]
        close = float(np.mean(relative <= SURE_OF_DEPTH))
        found = replace(found, depth_median=float(np.median(relative)), depth_sure_share=close)
    if errors.positions is not None and errors.rotations is not None:
        rotations_deg = np.degrees(errors.rotations).tolist()
        found = replace(found, positions=errors.positions.tolist(), rotations_deg=rotations_deg)
    return found
