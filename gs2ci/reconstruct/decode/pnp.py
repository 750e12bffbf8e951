"""Plug-and-play decoding: projections onto the measurement alternate with any denoiser (Yuan 2020).

Here: the scheme, accelerated GAP, for every kind of shot. Not here: its inner loop (`kernels`), the denoisers
(`denoisers`, `learned.onnx_denoiser`). The views are approximate: good enough for tracking and display, never a
photometric target of a fit.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Final

import cv2
import numpy as np
import torch
from pydantic import Field, PositiveInt

from gs2ci.core.arrays import F32, I64, Bool
from gs2ci.core.bounds import Bounded
from gs2ci.core.config import Positive
from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.demosaic import Demosaicer
from gs2ci.reconstruct.decode.denoisers import Denoiser, TotalVariation
from gs2ci.reconstruct.decode.device_gap import gap_on_device
from gs2ci.reconstruct.decode.kernels import are_finite, project_onto_measurement
from gs2ci.reconstruct.decode.planes import interleaved, planar, repeated
from gs2ci.reconstruct.measurement.coding import cfa_channels
from gs2ci.render.places import working_device

# Several measurements of the same views, as equations that can be solved one after the other.
#
# K measurements of N views are K equations at each pixel, y = Φ x. A projection onto all of them solves a system of K
# by K. Turned by the eigenvectors of Φ Φᵀ, Uᵀ y = (Uᵀ Φ) x, the equations stand at right angles to each other:
# projecting onto one after the other is then projecting onto all at once. The turn keeps lengths, so that white noise
# of the readings stays white, and equations that say nearly the same become one that counts K times and others that
# hardly do.

# Rows of pixels that are turned at once, so that memory holds a strip of them.
_STRIP: Final = 32
# Of more measurements than views, an equation whose square is a smaller share of the largest is rounding.
_DEPENDENT: Final = 1e-10


def check_same_views(shots: Sequence[Shot]) -> None:
    """Check that measurements may be of the same views.

    Raises:
        InputError: There are none, or they differ in the number of views, in size or in colours.
    """
    if not shots:
        raise InputError("no measurement to decode", allowed="one or more of the same views")
    first, *others = ((shot.views, shot.size, shot.channels, shot.cfa) for shot in shots)
    if any(other != first for other in others):
        raise InputError(
            "measurements that differ in their number of views, in size or in colours, decoded as of the same views",
            allowed="repeats of one path with one camera",
        )


def turned(shots: Sequence[Shot]) -> tuple[F32, F32]:
    """Return masks and readings of measurements of the same views, as equations at right angles to each other.

    Saturated readings, and those behind closed masks, become zero equations.

    Args:
        shots: K of them.

    Returns:
        Masks of either sign, [K, N, H, W], and readings, [K, C, H, W]; at each pixel ordered by how much they count. No
        more than N of them, however many measurements there are.
    """
    check_same_views(shots)
    parts = [_turned_strip(shots, slice(top, top + _STRIP)) for top in range(0, shots[0].size[0], _STRIP)]
    masks, read = (np.concatenate(of_strips, axis=2) for of_strips in zip(*parts, strict=True))
    return masks, read


def _turned_strip(shots: Sequence[Shot], rows: slice) -> tuple[F32, F32]:
    """Return masks and readings of some rows of pixels."""
    masks, read = zip(*(_equation(shot, rows) for shot in shots), strict=True)
    if len(shots) <= shots[0].views:
        every, readings = np.stack(masks), np.stack(read)
        turn = np.linalg.eigh(np.einsum("knhw,lnhw->hwkl", every, every, dtype=np.float64))[1][..., ::-1]
        turned_masks, turned_read = (np.einsum("hwkl,kchw->lchw", turn, part) for part in (every, readings))
    else:
        # More equations than views say no more than as many as views: Φᵀ Φ and Φᵀ y hold all of it.
        pairs = list(zip(masks, read, strict=True))
        products = sum(np.einsum("nhw,mhw->hwnm", one, one, dtype=np.float64) for one in masks)
        answers = sum(np.einsum("nhw,chw->hwnc", one, values, dtype=np.float64) for one, values in pairs)
        squares, turn = (part[..., ::-1] for part in np.linalg.eigh(products))
        known = squares > _DEPENDENT * squares[..., :1]
        lengths = np.sqrt(np.where(known, squares, 0.0))
        turned_masks = np.einsum("hwnl,hwl->lnhw", turn, lengths)
        inverse = np.where(known, 1 / np.where(known, lengths, 1.0), 0.0)
        turned_read = np.einsum("hwnl,hwnc,hwl->lchw", turn, answers, inverse)
    return np.ascontiguousarray(turned_masks, np.float32), np.ascontiguousarray(turned_read, np.float32)


def _equation(shot: Shot, rows: slice) -> tuple[F32, F32]:
    """Return a measurement's masks, [N, h, W], and readings, [C, h, W]; zeros where it says nothing."""
    masks = shot.masks[:, rows] * shot.weights[:, None, None]
    read = shot.measurement[rows].transpose(2, 0, 1).copy()
    if shot.saturated is not None:
        masks[:, shot.saturated[rows]] = 0
    read[:, ~masks.any(axis=0)] = 0
    return masks, read


# From views as the sensor measures them, [N, C or mosaic, H, W], to denoised views: as measured, and in full colour.
_Prior = Callable[[F32, float], tuple[F32, F32]]

# The projection divides by a pixel's transmission, which would amplify the noise of pixels with hardly any light. Below
# this share of the mean energy Σ (wM)² it is damped; with binary masks only 0 is below it.
_ENERGY_FLOOR: Final = 0.02
# Below this share of the damped energy an equation comes from rounding alone.
_NOTHING: Final = 1e-4
# Pixels without a reading start from a weighted mean of those within about this length; the mean of all pixels gets the
# weight of one pixel at three times this length.
_FILL_PX: Final = 2.0
_LEAST_NEARBY: Final = 1e-3


@dataclass(frozen=True)
class PlugAndPlaySettings(Bounded):
    """How the noise level falls.

    Each step projects onto the measurement plus the accumulated residual of earlier ones (accelerated generalised
    alternating projection, λ = 1). ADMM in its place agreed to 0.04 dB (docs/commands/decode.md).

    Args:
        sigmas: Noise levels given to the denoiser, one after the other, full scale 1.
        iterations: Steps at each level.
    """

    sigmas: Annotated[tuple[Positive, ...], Field(min_length=1)] = (50 / 255, 25 / 255, 12 / 255, 6 / 255)
    iterations: PositiveInt = 10


@dataclass(frozen=True)
class ReadingNoise:
    """The noise of the readings, as far as a decode by GAP weighs it; without it readings are explained exactly.

    Each step weighs the noise against the error of the views before it, as half-quadratic splitting does (Zhang et al.,
    Plug-and-play image restoration with deep denoiser prior, 2021). Accelerated GAP accumulates the residual until it
    is zero; here it keeps the share κ / (1 + κ) of what it has accumulated, with 1 + κ = s² Σ (wᵢ Mᵢ)² / σ². At the
    fixed point it then adds κ times the residual, which makes the views the minimum of ‖y − Φx‖² / 2σ² plus the
    denoiser's prior. Where 1 + κ < 1, nothing is accumulated and the step is shortened by it. Without noise this is
    accelerated GAP, bit for bit.

    Args:
        power: σ², in squared units of the measurement, [H, W, C] as the measurement. It is read before each step.
        error_power: Returns s², the expected squared error of a view before a step, from the denoiser's level there.
    """

    power: F32
    error_power: Callable[[float], float]

    def per_energy(self, inverse_energy: F32) -> F32:
        """Return σ² / Σ (wᵢ Mᵢ)², [C, H, W]."""
        return np.ascontiguousarray(self.power.transpose(2, 0, 1) * inverse_energy, np.float32)


def plug_and_play(
    shot: Shot | Sequence[Shot],
    denoise: Denoiser,
    settings: PlugAndPlaySettings | None = None,
    progress: Progress | None = None,
    start: F32 | None = None,
    enough: Callable[[F32], bool] | None = None,
    noise: ReadingNoise | None = None,
) -> F32:
    """Decode one coded measurement into approximate views.

    Args:
        shot: A checked shot: RGB, mono or mosaic; binary or grey masks; saturated pixels are ignored. A mosaic is
            projected as it was measured, and demosaicked before each denoising. Several are measurements of the same
            views, each of which adds an equation at every pixel.
        denoise: The denoiser.
        settings: The schedule.
        progress: Receives each iteration and its relative residual.
        start: First views, in the form that is returned; None: the measurement divided by its total exposure.
        enough: Called after each step with its views in full colour, [N, C, H, W]; if it returns True, that step is the
            last.
        noise: Of the readings, which GAP weighs; None: readings are explained exactly. For several measurements, of
            each of their readings alike; without it, equations that nearly repeat others amplify noise.

    Returns:
        Views, [N, H, W, C] float32, full scale 1, not clamped; C is 3 with a colour filter array. Pixels that no mask
        opens are filled by the denoiser from their surroundings.

    Raises:
        InputError: The settings make no sense, or several measurements are not of the same views.
        NumericsError: The denoiser changed the shape, or returned numbers that are not finite.
    """
    settings = (settings or PlugAndPlaySettings()).check()
    progress = progress or Silent()
    equations = _equations([shot] if isinstance(shot, Shot) else shot)
    shot = shot if isinstance(shot, Shot) else shot[0]
    channels = None if shot.cfa is None else cfa_channels(shot.cfa, shot.size).numpy()
    prior = _plane_prior(denoise) if channels is None else _mosaic_prior(channels, denoise)
    levels = np.repeat(settings.sigmas, settings.iterations)
    # The measurement plus accumulated residual: it is zero before a first average, and the measurement for given views.
    known = start is not None or noise is not None
    targets = [one.measured.copy() if known else np.zeros_like(one.measured) for one in equations.each]
    if start is not None:
        views = _as_measured(planar(start), channels)
    else:
        views = _average_exposure(equations.masks, equations.measured, equations.counts, channels)
    device = working_device()
    if device is not None and channels is None and enough is None and len(targets) == 1:
        smooth = _total_variation(denoise)
        if smooth is not None:
            return _on_device(views, equations, targets[0], levels.tolist(), smooth, noise, progress, device)
    seen = views = repeated(views[0], shot.views) if len(views) < shot.views else views
    progress.stage("decode", len(levels))
    for iteration, sigma in enumerate(levels.tolist()):
        error_power = 1.0 if noise is None else noise.error_power(sigma)
        left = 0.0
        for one, target in zip(equations.each, targets, strict=True):
            weighed = np.zeros((0, 0, 0), np.float32) if noise is None else noise.per_energy(one.inverse_energy)
            left += project_onto_measurement(
                views, one.masks, one.inverse_energy, one.measured, target, weighed, error_power
            ).sum()
        progress.step(iteration + 1, residual=_relative(left, equations.each))
        views, seen = prior(views, sigma)
        if enough is not None and enough(seen):
            break
    return interleaved(seen)


def _total_variation(denoise: Denoiser) -> tuple[float, int] | None:
    """Return weight per level and steps of a denoiser that a device has too; None: it is another one."""
    if not isinstance(denoise, TotalVariation) or denoise.coupling:
        return None
    return denoise.weight_per_sigma, denoise.inner


def _on_device(
    views: F32,
    equations: "_Equations",
    target: F32,
    sigmas: list[float],
    smooth: tuple[float, int],
    noise: ReadingNoise | None,
    progress: Progress,
    device: torch.device,
) -> F32:
    """Make all steps of accelerated GAP on a device."""
    (one,) = equations.each
    weighed = None if noise is None else noise.per_energy(one.inverse_energy)
    levels = [(sigma, weighed, 1.0 if noise is None else noise.error_power(sigma)) for sigma in sigmas]
    progress.stage("decode", len(levels))

    def told(step: int, left: float) -> None:
        progress.step(step, residual=_relative(left, equations.each))

    given = (one.masks, one.measured, one.inverse_energy)
    return gap_on_device(views, given, target, levels, smooth, told, device)


@dataclass(frozen=True)
class _Equation:
    """An equation at every pixel: masks, [N, H, W], readings, [C, H, W], and the inverse of its energy, [H, W]."""

    masks: F32
    measured: F32
    inverse_energy: F32


@dataclass(frozen=True)
class _Equations:
    """Equations at right angles to each other; the sum of masks and of readings as measured; which pixels count."""

    each: tuple[_Equation, ...]
    masks: F32
    measured: F32
    counts: Bool


def _equations(shots: Sequence[Shot]) -> _Equations:
    if len(shots) == 1:
        (shot,) = shots
        masks = np.ascontiguousarray(shot.transmissions, np.float32)
        measured = np.ascontiguousarray(shot.measurement.transpose(2, 0, 1), np.float32)
        inverse = _inverse_energy(masks, shot.saturated)
        return _Equations((_Equation(masks, measured, inverse),), masks, measured, inverse > 0)
    every, read = turned(shots)
    energy = np.square(every, dtype=np.float64).sum(axis=1)
    # Of an equation that hardly counts, what it says is mostly noise.
    floor = _ENERGY_FLOOR * energy[0].mean()
    inverse_energy = np.where(energy > _NOTHING * floor, 1.0 / np.maximum(energy, floor), 0.0)
    each = tuple(
        _Equation(masks, measured, inverse)
        for masks, measured, inverse in zip(every, read, inverse_energy.astype(np.float32), strict=True)
    )
    lit = [shot.usable for shot in shots]
    pairs = list(zip(shots, lit, strict=True))
    masks = np.sum([shot.transmissions * ok for shot, ok in pairs], axis=0)
    read_sum = np.sum([shot.measurement * ok[..., None] for shot, ok in pairs], axis=0)
    measured = np.ascontiguousarray(read_sum.transpose(2, 0, 1), np.float32)
    return _Equations(each, masks.astype(np.float32), measured, masks.any(axis=0))


def _relative(left: float, equations: Sequence[_Equation]) -> float:
    scale = sum(float(np.square(one.measured, dtype=np.float64).sum()) for one in equations)
    return float(np.sqrt(left / max(scale, np.finfo(np.float32).tiny)))


def _inverse_energy(masks: F32, saturated: Bool | None) -> F32:
    """Invert the diagonal of ΦΦᵀ, [H, W], damped where it is small; 0 at pixels that do not count."""
    energy = np.zeros(masks.shape[1:])
    for mask in masks:  # one by one, since memory may not hold the squares of all masks of a large shot
        energy += np.square(mask, dtype=np.float64)
    inverse = 1.0 / np.maximum(energy, _ENERGY_FLOOR * energy.mean())
    counts = energy > 0
    if saturated is not None:
        counts &= ~saturated
    return np.where(counts, inverse, 0.0).astype(np.float32)


def _average_exposure(masks: F32, measured: F32, counts: Bool, channels: I64 | None) -> F32:
    """Start every view from the measurement divided by its total exposure, [1, C, H, W]; a mosaic stays one.

    Pixels that do not count start from a mean of those nearby of their own colour, or of all of it if none is near:
    smoothing alone would take long to fill them, and never fill a wide hole.
    """
    exposure = masks.sum(0)
    read = counts[None] if channels is None else np.stack([counts & (channels == c) for c in range(3)])
    average = np.where(read, measured / np.maximum(exposure, _ENERGY_FLOOR * exposure.mean()), 0.0)
    mean = average.sum(axis=(1, 2), dtype=np.float64) / np.maximum(read.sum(axis=(1, 2)), 1)
    nearby = [_blur(plane.astype(np.float32)) for plane in read]
    filled = [
        (_blur(plane.astype(np.float32)) + _LEAST_NEARBY * level) / (around + _LEAST_NEARBY)
        for plane, level, around in zip(average, mean, np.broadcast_to(nearby, average.shape), strict=True)
    ]
    average = np.where(read, average, filled).astype(np.float32)
    return _as_measured(average[None], channels)


def _blur(plane: F32) -> F32:
    return cv2.GaussianBlur(plane, (0, 0), _FILL_PX, borderType=cv2.BORDER_REPLICATE)


def _plane_prior(denoise: Denoiser) -> _Prior:
    def prior(views: F32, sigma: float) -> tuple[F32, F32]:
        denoised = _checked(denoise, views, sigma)
        return denoised, denoised

    return prior


def _as_measured(colour: F32, channels: I64 | None) -> F32:
    """Return planes, [N, C, H, W]; with a colour filter array, of channel indices [H, W], their mosaic."""
    if channels is None:
        return colour
    return np.take_along_axis(colour, np.broadcast_to(channels, (len(colour), 1, *channels.shape)), axis=1)


def _mosaic_prior(channels: I64, denoise: Denoiser) -> _Prior:
    demosaic = Demosaicer(channels)

    def prior(views: F32, sigma: float) -> tuple[F32, F32]:
        colour = _checked(denoise, np.stack([demosaic(view[0]) for view in views]), sigma)
        return _as_measured(colour, channels), colour

    return prior


def _checked(denoise: Denoiser, views: F32, sigma: float) -> F32:
    shape = views.shape
    denoised = np.ascontiguousarray(denoise(views, sigma), np.float32)
    if denoised.shape != shape:
        raise NumericsError(f"the denoiser made {list(denoised.shape)} of {list(shape)}", allowed="the same shape")
    if not are_finite(denoised).all():
        raise NumericsError(
            f"the denoiser returned numbers that are not finite at sigma {sigma:.4g}",
            remedy="use another denoiser; for a model, check that it takes images in [0, 1]",
        )
    return denoised
