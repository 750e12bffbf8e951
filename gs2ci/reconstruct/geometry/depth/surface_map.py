"""The depth of one view, pixel by pixel: a plane sweep, then corrected plain areas.

Here: the steps in their order. Not here: what each does (`sweep`, `plain`).
"""

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.geometry.depth.plain import continued
from gs2ci.reconstruct.geometry.depth.sweep import BestPlanes, SweepSettings, sweep
from gs2ci.reconstruct.geometry.tracks.brightened import brightened

# Plain areas are compared with at most so many other views, spread over the path: more cost memory without any gain.
_OTHERS = 4


def surface_map(
    views: F32,
    world_to_camera: F64,
    intrinsics: F64,
    reference: int,
    span: tuple[float, float],
    settings: SweepSettings,
    best_planes: BestPlanes | None = None,
) -> F32:
    """Estimate the inverse depth of every pixel of the reference view, [H, W] float32, within `span`.

    Arguments and errors are those of `sweep`.
    """
    # Penalties, and what counts as a plain area, are in full scales.
    views = brightened(views)
    swept = sweep(views, world_to_camera, intrinsics, reference, span, settings, best_planes)
    others = np.delete(np.arange(len(views)), reference)
    spread = np.unique(np.linspace(0, len(others) - 1, min(_OTHERS, len(others))).round().astype(int))
    order = [reference, *others[spread]]
    if not settings.plain:
        return swept
    return continued(swept, views[order], world_to_camera[order], intrinsics, settings.blur_px, settings.window_px)
