"""What the scene leaves unexplained, decoded and put back into the views.

A Gaussian scene shows every view what all views agree on. What they do not agree on (gloss, the grain of real
surfaces, whatever the Gaussians have not resolved) is left in the measurement's residual, and the residual is a
coded measurement like any other: a few steps of GAP-TV decode it. Here: that. Not here: the judgement whether the
result is better (`gs2ci.reconstruct.pipeline` asks the held-out pixels). For `gs2ci.reconstruct.pipeline`.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch

from gs2ci.core.records import F32, Shot
from gs2ci.reconstruct.coding import Coding
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, decode_signed


@dataclass(frozen=True)
class ResidualSettings:
    """How the residual is decoded.

    Args:
        iterations: GAP steps. Few: the residual is small, and most of its finest part is noise.
        weight: Total-variation weight in units of a view's full scale.
        inner: Denoiser steps in each iteration.
    """

    iterations: int = 5
    weight: float = 0.05
    inner: int = 5

    def steps(self) -> GapTvSettings:
        """Return them as the decoder takes them.

        Raises:
            InputError: A count below 1, or a weight that is not a positive finite number.
        """
        return GapTvSettings(iterations=self.iterations, weight=self.weight, inner=self.inner).check()


def refine_views(shot: Shot, scene_views: F32, settings: ResidualSettings) -> F32:
    """Add to the scene's views what its residual decodes to.

    Args:
        shot: The measurement, or the part of it that may be seen.
        scene_views: Views of the scene, [N, H, W, C] float32; need not be clamped.
        settings: How the residual is decoded.

    Returns:
        Views, [N, H, W, C] float32, not clamped.

    Raises:
        InputError: The settings make no sense, or the views do not fit the shot.
    """
    predicted = Coding.of(shot).forward(torch.from_numpy(scene_views)).numpy()
    left_over = replace(shot, measurement=(shot.measurement - predicted).astype(np.float32))
    refined: F32 = scene_views + decode_signed(left_over, settings.steps())
    return refined
