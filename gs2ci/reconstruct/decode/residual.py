"""The decode of a scene's residual.

A Gaussian scene can show only what all views agree on. The rest (gloss, the grain of real surfaces, detail that the
Gaussians have not resolved) remains in the measurement's residual, which is a coded measurement like any other: a few
steps of GAP-TV decode it. Here: that decode. Not here: the share of it that is added to the views
(`gs2ci.reconstruct.fit.combining.refinement`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from pydantic import PositiveInt

from gs2ci.core.arrays import F32
from gs2ci.core.bounds import Bounded
from gs2ci.core.config import Positive
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, decode_signed
from gs2ci.reconstruct.measurement.coding import Coding


@dataclass(frozen=True)
class ResidualSettings(Bounded):
    """How the residual is decoded.

    Args:
        iterations: GAP steps. Few: the residual is small, and most of its finest part is noise.
        weight: Total-variation weight in units of a view's full scale.
        inner: Denoiser steps in each iteration.
    """

    iterations: PositiveInt = 5
    weight: Positive = 0.02
    inner: PositiveInt = 5

    def steps(self) -> GapTvSettings:
        """Return the settings in the form of the decoder.

        Raises:
            InputError: A count below 1, or a weight that is not a positive finite number.
        """
        return GapTvSettings(iterations=self.iterations, weight=self.weight, inner=self.inner).check()


def decode_residual(
    shot: Shot | Sequence[Shot], scene_views: F32, settings: ResidualSettings, noise: F32 | None = None
) -> F32:
    """Decode the measurement's residual by views of a scene.

    Args:
        shot: The measurement, with or without its held-out pixels; several are measurements of the same views.
        scene_views: Views of the scene, [N, H, W, C] float32; need not be clamped.
        settings: How the residual is decoded.
        noise: Power of the noise in each reading, [H, W, C] as the measurement; None: readings are explained exactly.

    Returns:
        The missing part of the views, [N, H, W, C] float32, of either sign.

    Raises:
        InputError: The settings make no sense, or the views do not fit the shot.
    """
    shots = [shot] if isinstance(shot, Shot) else shot
    views = torch.from_numpy(scene_views)
    left_over = [_less(one, Coding.of(one).forward(views).numpy()) for one in shots]
    return decode_signed(left_over, settings.steps(), noise=noise)


def decode_left_over(shot: Shot, predicted: F32, settings: ResidualSettings, noise: F32 | None = None) -> F32:
    """Decode what a predicted measurement, [H, W, C], leaves of a shot's; results and errors as above."""
    return decode_signed(_less(shot, predicted), settings.steps(), noise=noise)


def _less(shot: Shot, predicted: F32) -> Shot:
    return replace(shot, measurement=(shot.measurement - predicted).astype(np.float32))
