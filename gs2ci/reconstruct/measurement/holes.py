"""Regions where no mask opens, filled for the fit with the decoder's continuation of their surroundings.

Here: `fill_holes`. Not here: doubts about such regions (`doubts`), dead lines (`dead_lines`).
"""

from dataclasses import replace
from typing import Final

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt

from gs2ci.core.arrays import F32
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import Coding

# First Gaussians are three pixels apart: those nearer to an open pixel than this are constrained by its light.
_REACH_PX: Final = 3.0


def fill_holes(shot: Shot, decoded: F32) -> Shot:
    """Return a measurement as if grey masks had shown the decoded views, [N, H, W, C], in wide dark regions.

    Gaussians that reach no measured pixel are changed only by the term that makes them fade, and a dark region would
    turn black whatever surrounds it. Masks are set to their mean over the open pixels there, so that the brightness of
    the measurement does not jump at the region's border.
    """
    hole = distance_transform_edt(~shot.lit) > _REACH_PX
    if not hole.any():
        return shot
    level = np.float32(shot.masks[:, shot.lit].mean())
    filled = replace(shot, masks=np.where(hole, level, shot.masks))
    expected = Coding.of(filled).forward(torch.from_numpy(decoded)).numpy()
    return replace(filled, measurement=np.where(hole[..., None], expected, shot.measurement))
