"""The naive proxy of the paper's table S-II: the measurement times each mask, Y ⊙ Mᵢ, dark elsewhere.

Here: that proxy. It exists for comparison: the light of the views is still mixed, and each shows the pattern of a mask.
"""

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.records import Shot
from gs2ci.reconstruct.paper.proxies.eni import complete
from gs2ci.reconstruct.paper.proxies.planes import coded_planes


def masked_measurements(shot: Shot) -> F32:
    """Multiply the measurement by each transmission wᵢ Mᵢ.

    Args:
        shot: A checked shot. A mosaic's colours are completed before, each from its own pixels; saturated pixels are
            completed as well, from their neighbours.

    Returns:
        [N, H, W, C] float32, full scale of one view 1, not clamped: where several masks are open their views add up.
        A colour of which no pixel is open in any mask is dark.
    """
    transmissions = shot.masks.astype(np.float64) * shot.weights.astype(np.float64)[:, None, None]
    views = np.zeros((shot.views, *shot.size, shot.channels), np.float32)
    for plane in coded_planes(shot):
        seen = plane.transmissions.sum(axis=0) > 0
        if not seen.any():
            continue
        # A pixel that no mask opens carries no information, and no mask transmits it.
        measured = complete(plane.measured, seen)
        views[..., plane.channels] = transmissions[..., None] * measured
    return views
