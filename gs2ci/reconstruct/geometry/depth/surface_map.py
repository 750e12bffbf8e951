"""The depth of one view, pixel by pixel: a plane sweep of views that are bright enough.

Here: this. Not here: the sweep (`sweep`).
"""

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings, sweep
from gs2ci.reconstruct.geometry.tracks.brightened import brightened


def surface_map(
    views: F32,
    world_to_camera: F64,
    intrinsics: F64,
    reference: int,
    span: tuple[float, float],
    settings: SweepSettings,
) -> F32:
    """Estimate the inverse depth of every pixel of the reference view, [H, W] float32, within `span`.

    Arguments and errors are those of `sweep`.
    """
    # Penalties are in full scales.
    views = brightened(views)
    return sweep(views, world_to_camera, intrinsics, reference, span, settings)
