"""The depth of one view, pixel by pixel: a plane sweep, then corrected plain areas and, on request, depth edges.

Here: the steps in their order. Not here: what each does (`sweep`, `plain`, `snapping`).
"""

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.geometry.brightened import brightened
from gs2ci.reconstruct.geometry.plain import continued
from gs2ci.reconstruct.geometry.snapping import snapped
from gs2ci.reconstruct.geometry.sweep import SweepSettings, sweep

# Plain areas are compared with at most so many other views, spread over the path: more cost memory without any gain.
_OTHERS = 4


def surface_map(
    views: F32,
    world_to_camera: F64,
    intrinsics: F64,
    reference: int,
    span: tuple[float, float],
    settings: SweepSettings,
    *,
    edges: bool,
) -> F32:
    """Estimate the inverse depth of every pixel of the reference view, [H, W] float32, within `span`.

    Arguments and errors are those of `sweep`, and one more.

    Args:
        views: See `sweep`.
        world_to_camera: See `sweep`.
        intrinsics: See `sweep`.
        reference: See `sweep`.
        span: See `sweep`.
        settings: See `sweep`.
        edges: Whether jumps of depth are moved to the edges of the view. A decode shows edges too poorly for that: thin
            things in its map are lost, and the fit does not recover them (0.6 dB on a simulated bench of 96 x 128 px).
    """
    # Penalties, and what counts as a plain area, are in full scales.
    views = brightened(views)
    swept = sweep(views, world_to_camera, intrinsics, reference, span, settings)
    others = np.delete(np.arange(len(views)), reference)
    spread = np.unique(np.linspace(0, len(others) - 1, min(_OTHERS, len(others))).round().astype(int))
    order = [reference, *others[spread]]
    if settings.plain:
        swept = continued(swept, views[order], world_to_camera[order], intrinsics, settings.blur_px, settings.window_px)
    return snapped(swept, views[reference]) if edges and settings.snap else swept
