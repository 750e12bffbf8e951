"""A shot at a fraction of its resolution, and its views back at full size.

Averaged over blocks, y = Σ Mᵢ Xᵢ stays nearly the same equation with the averaged masks, as far as views are smooth
within a block: an approximation that buys speed.
"""

from dataclasses import replace

import cv2
import numpy as np

from gs2ci.core.arrays import F32, Bool
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot, Truth


def shrunk(shot: Shot, factor: int) -> Shot:
    """Average a shot over blocks of `factor` × `factor` samples of one colour.

    A mosaic keeps its pattern: each of its four phases is averaged by itself. Rows and columns beyond the last whole
    block are left out. Saturated samples make their block saturated. The truth is not included.

    Raises:
        InputError: The factor is below 1, or no whole block fits.
    """
    period = 2 if shot.cfa else 1
    step = factor * period
    height, width = (side // step * step for side in shot.size) if factor >= 1 else (0, 0)
    if not height or not width:
        raise InputError(f"size {list(shot.size)} at 1/{factor} of its resolution", allowed=f"sides >= {step} px")
    intrinsics = shot.intrinsics
    if intrinsics is not None:
        intrinsics = np.diag([1 / factor, 1 / factor, 1.0]) @ intrinsics  # pixel centres at +0.5 stay so
    saturated = None if shot.saturated is None else touched(shot.saturated, factor, period)
    return replace(
        shot,
        measurement=_averaged(shot.measurement[None, :height, :width], factor, period)[0],
        masks=_averaged(shot.masks[:, :height, :width, None], factor, period)[..., 0],
        intrinsics=intrinsics,
        saturated=saturated,
        truth=Truth(None, shot.truth.world_to_camera),
    ).check()


def touched(pixels: Bool, factor: int, period: int) -> Bool:
    """Return which blocks of a shrunk shot hold a pixel of some, [h, w].

    Args:
        pixels: Of the shot, [H, W].
        factor: As for `shrunk`.
        period: Of its colours: 2 for a mosaic, otherwise 1.
    """
    height, width = (side // (factor * period) * factor * period for side in pixels.shape)
    share = _averaged(pixels[None, :height, :width, None].astype(np.float32), factor, period)
    return share[0, ..., 0] > 0


def enlarged(views: F32, factor: int, size: tuple[int, int]) -> F32:
    """Enlarge views [N, h, w, C] of a shrunk shot to [N, H, W, C], by cubic interpolation; borders repeat the last row.

    Args:
        views: Of `shrunk(shot, factor)`.
        factor: As there.
        size: Height and width of the shot.
    """
    height, width = (side * factor for side in views.shape[1:3])
    large = np.stack([cv2.resize(view, (width, height), interpolation=cv2.INTER_CUBIC) for view in views])
    large = large.reshape(len(views), height, width, views.shape[3])  # OpenCV drops a single channel
    margins = ((0, 0), (0, size[0] - height), (0, size[1] - width), (0, 0))
    return np.pad(large, margins, mode="edge").astype(np.float32)


def _averaged(stack: F32, factor: int, period: int) -> F32:
    """Average [N, H, W, C] over blocks of `factor` samples at a distance of `period` along both sides."""
    count, height, width, channels = stack.shape
    rows, columns = height // (factor * period), width // (factor * period)
    blocks = stack.reshape(count, rows, factor, period, columns, factor, period, channels)
    mean: F32 = np.ascontiguousarray(blocks.mean(axis=(2, 5), dtype=np.float64), dtype=np.float32)
    return mean.reshape(count, rows * period, columns * period, channels)
