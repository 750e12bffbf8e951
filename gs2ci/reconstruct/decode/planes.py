"""Views as stacks of planes, in which the decoders work, and back. Not here: mosaics (`pnp`, `demosaic`).

In threads, since one spends most of the time in the first touch of so much memory.
"""

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.kernels import in_parts


def planar(views: F32) -> F32:
    """Return views, [N, H, W, C], as planes, [N, C, H, W] float32; always a copy."""
    count, height, width, channels = views.shape
    planes = np.empty((count, channels, height, width), np.float32)
    in_parts(_copy, count, np.asarray(views, np.float32).transpose(0, 3, 1, 2), planes)
    return planes


def interleaved(planes: F32) -> F32:
    """Return planes, [N, C, H, W], as views, [N, H, W, C] float32; those of one channel may be the same memory."""
    count, channels, height, width = planes.shape
    if channels == 1:
        return np.asarray(planes, np.float32).reshape(count, height, width, 1)
    views = np.empty((count, height, width, channels), np.float32)
    in_parts(_copy, count, np.asarray(planes, np.float32), views.transpose(0, 3, 1, 2))
    return views


def repeated(planes: F32, count: int) -> F32:
    """Return planes, [C, H, W], as those of so many views, [N, C, H, W] float32."""
    stack = np.empty((count, *planes.shape), np.float32)
    in_parts(_copy, count, np.broadcast_to(np.asarray(planes, np.float32), stack.shape), stack)
    return stack


def _copy(from_view: int, to_view: int, source: F32, target: F32) -> None:
    np.copyto(target[from_view:to_view], source[from_view:to_view])
