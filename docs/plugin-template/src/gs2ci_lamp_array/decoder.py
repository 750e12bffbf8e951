"""A decoder: from a shot to its views, [N, H, W, C] float32 with full scale 1."""

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot


def mean_views(shot: Shot, progress: Progress) -> F32:
    """Return N times the same view: the measurement divided by the light that each pixel was let through."""
    light = np.maximum((shot.masks * shot.weights[:, None, None]).sum(axis=0), 1e-6)
    view = shot.measurement / light[..., None]
    if shot.cfa is not None:
        view = np.repeat(view, 3, axis=2)
    return np.repeat(view[None], len(shot.masks), axis=0).astype(np.float32)
