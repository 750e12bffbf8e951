"""GAP-TV: generalised alternating projection with a total-variation denoiser (Yuan 2016, accelerated form).

Here: the decoder that the pipeline calls; the same of a scene's residual; and, told by held-out pixels, how strongly
consecutive views are coupled and how much noise of the readings is weighed. Not here: its loop (`pnp`, `kernels`),
other denoisers, the share of a decoded residual that is added to views
(`gs2ci.reconstruct.fit.combining.refinement`). Its views are good enough for tracking and plane sweeps; they are never
a photometric target of the fit.

A Gaussian scene can show only what all views agree on. The rest (gloss, the grain of real surfaces, detail that the
Gaussians have not resolved) remains in the measurement's residual, which is a coded measurement like any other: a few
steps decode it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from pydantic import PositiveInt

from gs2ci.core.arrays import F32
from gs2ci.core.bounds import Bounded
from gs2ci.core.config import NotNegative, Positive
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot, Truth
from gs2ci.reconstruct.decode.denoisers import Denoiser, TotalVariation, clamped
from gs2ci.reconstruct.decode.pnp import PlugAndPlaySettings, ReadingNoise, plug_and_play
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.reconstruct.measurement.holdout import HELDOUT_SHARE, Holdout

# Total variation of this weight is the right prior for errors of power s² if differences between neighbours are
# Laplacian with a mean absolute value of s² over the weight. In sharp pictures that is 0.02 to 0.1; the largest of
# these trusts the readings most: half of it would gain 1 dB more on a grey wall, but lose 0.6 dB more on photographs
# that the scene explains poorly, so that their noise is overestimated.
_GRADIENT: Final = 0.1
# Masks above this take views of several times as much.
_LARGE_BYTES: Final = 2**26
# The noise that a decode weighs is sought downwards in steps of this factor of power.
_STEP: Final = 4.0
_STEPS: Final = 7


@dataclass(frozen=True)
class GapTvSettings(Bounded):
    """How long and how smooth to decode.

    Args:
        iterations: GAP steps. 24.17 dB after 40 and 24.22 after 60 on one eight-view scene.
        weight: Total-variation weight in units of a view's full scale.
        inner: Denoiser steps in each iteration.
        coupling: Weight of a difference between consecutive views relative to one between neighbouring pixels.
        clamped: Whether every step keeps the views between black and white, and not only the last. Not for residuals,
            which have either sign.
    """

    iterations: PositiveInt = 40
    weight: Positive = 0.07
    inner: PositiveInt = 5
    coupling: NotNegative = 0.0
    clamped: bool = False


def gap_tv(
    shot: Shot | Sequence[Shot],
    settings: GapTvSettings | None = None,
    progress: Progress | None = None,
    noise: F32 | None = None,
) -> F32:
    """Decode one coded measurement into approximate views.

    Args:
        shot: A checked shot: RGB, mono or mosaic; binary or grey masks; saturated pixels are ignored. Several are
            measurements of the same views.
        settings: How long and how smooth to decode.
        progress: Receives each iteration and its relative residual.
        noise: Power of the noise in each reading, [H, W, C] as the measurement; None: readings are explained exactly.

    Returns:
        Views, [N, H, W, C] float32 in [0, 1]; C is 3 with a colour filter array.

    Raises:
        InputError: The settings make no sense.

    Pixels that no mask opens are filled smoothly from their surroundings. A mosaic is projected as it was measured, and
    demosaicked before each denoising: on synthetic mosaics of two scenes this gave 22.1 and 20.1 dB, compared with 20.8
    and 19.3 for decoding the four colour planes separately and joining them afterwards.
    """
    decoded = decode_signed(shot, settings, progress, noise)
    return np.clip(decoded, 0, 1, out=decoded)


def decode_signed(
    shot: Shot | Sequence[Shot],
    settings: GapTvSettings | None = None,
    progress: Progress | None = None,
    noise: F32 | None = None,
) -> F32:
    """Decode without the bounds that light is positive and at most at full scale, for residuals.

    Arguments, errors and shape as for `gap_tv`; the values are not clipped, unless the settings say so.
    """
    settings = (settings or GapTvSettings()).check()
    alone = shot if isinstance(shot, Shot) else shot[0] if len(shot) == 1 else None
    if alone is not None and progress is None and alone.channels > 1 and alone.masks.nbytes > _LARGE_BYTES:
        return _by_channel(alone, settings, noise)
    # The weight stays the same in all iterations: the denoiser's sigma is used as the weight itself.
    schedule = PlugAndPlaySettings(sigmas=(settings.weight,), iterations=settings.iterations)
    denoiser: Denoiser = TotalVariation(weight_per_sigma=1.0, inner=settings.inner, coupling=settings.coupling)
    if settings.clamped:
        denoiser = clamped(denoiser)
    weighed = None if noise is None else ReadingNoise(noise, lambda weight: _GRADIENT * weight)
    return plug_and_play(shot, denoiser, schedule, progress, noise=weighed)


def _by_channel(shot: Shot, settings: GapTvSettings, noise: F32 | None) -> F32:
    """Decode the channels of a large shot, which do not see each other, one by one: a third of the working memory."""
    found = np.empty((*shot.masks.shape, shot.channels), np.float32)
    for channel in range(shot.channels):
        of_one = slice(channel, channel + 1)
        one = replace(shot, measurement=np.ascontiguousarray(shot.measurement[..., of_one]), truth=Truth())
        found[..., of_one] = decode_signed(one, settings, noise=None if noise is None else noise[..., of_one])
    return found


RESIDUAL: Final = GapTvSettings(iterations=5, weight=0.02)
"""How the residual is decoded: in few steps, since it is small, and most of its finest part is noise."""


def decode_residual(
    shot: Shot | Sequence[Shot], scene_views: F32, settings: GapTvSettings, noise: F32 | None = None
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
    return decode_signed(left_over, settings, noise=noise)


def decode_left_over(shot: Shot, predicted: F32, settings: GapTvSettings, noise: F32 | None = None) -> F32:
    """Decode what a predicted measurement, [H, W, C], leaves of a shot's; results and errors as above."""
    return decode_signed(_less(shot, predicted), settings, noise=noise)


def _less(shot: Shot, predicted: F32) -> Shot:
    return replace(shot, measurement=(shot.measurement - predicted).astype(np.float32))


COUPLINGS: Final = (0.0, 0.3, 0.6)


def choose_coupling(
    shot: Shot, settings: GapTvSettings, seed: int, candidates: Sequence[float] = COUPLINGS
) -> GapTvSettings:
    """Set the coupling with which a decode predicts held-out pixels best.

    Args:
        shot: A checked shot.
        settings: Everything but the coupling.
        seed: Of the draw of the held-out pixels.
        candidates: Couplings to try, each at the cost of one decode. The first is used if no pixel can be held out.

    Raises:
        InputError: The settings make no sense.
    """
    holdout = Holdout.of(shot, HELDOUT_SHARE, seed)
    choices = [replace(settings, coupling=coupling).check() for coupling in candidates]

    def unexplained(choice: GapTvSettings) -> float:
        return holdout.residual_rms(decode_signed(holdout.seen, choice)) or 0.0

    return min(choices, key=unexplained) if holdout.pixels.any() else choices[0]


def decode_weighing(holdouts: Sequence[Holdout], settings: GapTvSettings, most: F32) -> tuple[F32, F32]:
    """Decode measurements of the same views without their held-out pixels, which tell the noise of the readings.

    It is what leaves least of them: a decode that weighs too much lacks detail, one that weighs too little shows noise.

    Args:
        holdouts: The measurements, with held-out pixels.
        settings: Of the decoder.
        most: Power of the noise in each reading at most, [H, W, C].

    Returns:
        The views, [N, H, W, C], and the noise that was weighed, [H, W, C].
    """
    seen, best, found = [one.seen for one in holdouts], math.inf, None
    for step in range(_STEPS):
        noise = most * np.float32(_STEP**-step)
        views = gap_tv(seen, settings, noise=noise)
        left = float(np.mean([(one.residual_rms(views) or math.inf) ** 2 for one in holdouts]))
        if found is not None and left >= best:
            break
        best, found = left, (views, noise)
    assert found is not None
    return found
