"""What the scene leaves unexplained, decoded.

A Gaussian scene shows every view what all views agree on. What they do not agree on (gloss, the grain of real
surfaces, whatever the Gaussians have not resolved) is left in the measurement's residual, and the residual is a
coded measurement like any other: a few steps of GAP-TV decode it. Here: that. Not here: how much of it is put back into
the views (`gs2ci.reconstruct.fit.refinement`).
"""

from dataclasses import dataclass, replace

import numpy as np
import torch

from gs2ci.core.arrays import F32
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, decode_signed
from gs2ci.reconstruct.measurement.coding import Coding


@dataclass(frozen=True)
class ResidualSettings:
    """How the residual is decoded.

    Args:
        iterations: GAP steps. Few: the residual is small, and most of its finest part is noise.
        weight: Total-variation weight in units of a view's full scale.
        inner: Denoiser steps in each iteration.
    """

    iterations: int = 5
    weight: float = 0.02
    inner: int = 5

    def steps(self) -> GapTvSettings:
        """Return them as the decoder takes them.

        Raises:
            InputError: A count below 1, or a weight that is not a positive finite number.
        """
        return GapTvSettings(iterations=self.iterations, weight=self.weight, inner=self.inner).check()


def decode_residual(shot: Shot, scene_views: F32, settings: ResidualSettings) -> F32:
    """Decode what views of a scene leave of the measurement.

    Args:
        shot: The measurement, or the part of it that may be seen.
        scene_views: Views of the scene, [N, H, W, C] float32; need not be clamped.
        settings: How the residual is decoded.

    Returns:
        What the views lack, [N, H, W, C] float32, of either sign.

    Raises:
        InputError: The settings make no sense, or the views do not fit the shot.
    """
    predicted = Coding.of(shot).forward(torch.from_numpy(scene_views)).numpy()
    left_over = replace(shot, measurement=(shot.measurement - predicted).astype(np.float32))
    return decode_signed(left_over, settings.steps())
