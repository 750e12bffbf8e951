"""What masks of open and closed elements were, that are stated softer than they were, or with noise.

A blurred calibration, or a resampled picture of the masks, gives soft masks. If the true elements are either open or
closed, the masks alone show how they were softened: only undoing the right blur, or the right fraction of a pixel,
gives elements that are all open or closed. A blur preserves some frequencies and reduces the others below rounding or
noise; as long as about half of all frequencies are preserved, only one set of masks between closed and open has them
(Mangasarian and Recht, European Journal of Operational Research 214, 2011). That holds up to about σ 2 px for masks in
float32, and 1.2 px for masks known to a thousandth. They are found by Douglas-Rachford steps between the two sets.

What open and closed elements pass is kept as it is stated, with its smooth change over the picture (vignetting): it
decides how bright the views are, which no held-out pixel tells. So the softening has to be known exactly, blur beside
interpolation included: with too little of it, closed elements would seem to pass more than they do, and open ones less.

A calibration of few frames adds noise that differs from pixel to pixel. Elements are told apart all the same, and the
masks are stated again without it, as soft as they were: elements, levels and softness explain far more pixels than they
have parameters. Noise is cut off at 0 and 1, which shifts the means of what closed and open elements pass.

Here: both. Not here: what elements pass (`levels`), whether the masks are used (`register`, by the measurement), and
filtering, which sharpens masks where all this fails (`misfit`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Self

import numpy as np
from scipy import fft
from scipy.ndimage import correlate1d
from scipy.optimize import minimize
from scipy.special import expit

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.registration.levels import Levels
from gs2ci.reconstruct.registration.local_scene import TINY
from gs2ci.reconstruct.registration.misfit import gaussian, transfer, variance_of
from gs2ci.reconstruct.registration.parameters import MATTERS_PX

_LEAST_SIDE_PX: Final = 16
# Frequencies reduced below the first number count as lost, and blurs wider than the second number, px, are not tried:
# for masks exact to float32, and for a noisy calibration.
_LOST: Final = ((1e-6, 2.4), (3e-3, 1.3))
_STEPS: Final = 100
_STEPS_OF_A_TRY: Final = 30
# Stated masks beyond this mean squared distance from open or closed are soft. Under the right hypothesis the
# unexplained share of their variance is only rounding, or some hundredths if the calibration added noise.
CRISP: Final = 3e-3
_EXPLAINED: Final = 0.05
_SAMPLE_PX: Final = 128
# Relative distance of the blurs that are tried.
_SIGMA_STEP: Final = 0.04
_SIGMAS_PX: Final = 0.3 * (1 + _SIGMA_STEP) ** np.arange(54)
_FRACTIONS: Final = np.linspace(-0.5, 0.5, 21)
_FINEST_PX: Final = 1e-3
# A blur besides an interpolation must leave less than this share of what the interpolation alone leaves, and not be
# smaller than this, px: taps of less are rounding.
_BLUR_EXPLAINS: Final = 0.97
_LEAST_BLUR_PX: Final = 0.15
# Where the search for both begins, px: so far down and right from the interpolation found alone, and with this blur.
_NEARBY: Final = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, 0.4), (0.05, 0.0, 0.4), (0.0, 0.05, 0.4)])
# Noise of less than these variances is left as it is, in crisp masks and in soft ones: single elements of a real
# modulator differ, too, and a blur is only nearly Gaussian.
_NOISE_OF_CRISP: Final = 1e-5
_NOISE_OF_SOFT: Final = 1e-4
# Grey masks are not taken for noisy ones: of evenly grey ones a quarter lies in the middle quarter between open and
# closed, with noise of σ 0.3 a tenth; and rounded they explain three quarters of their variance.
_MIDDLE: Final = 0.125
_GREY: Final = 0.2
# Masks of at least this share of the largest variance show the elements of all.
_SHOWS: Final = 0.5
# How often levels and elements are found from each other.
_ROUNDS: Final = 2

_Hypothesis = tuple[float, float]


def one_of(masks: F32) -> F64:
    """Return the first mask, [1, H, W], that shows the elements of all: one that is wholly open or closed does not."""
    spreads = masks.var(axis=(1, 2), dtype=np.float64)
    first = int(np.argmax(spreads >= _SHOWS * spreads.max()))
    return masks[first : first + 1].astype(np.float64)


def softness(masks: F64) -> float:
    """Return the mean squared distance of transmissions from open or closed, whichever is nearer."""
    return float(np.mean(np.minimum(masks**2, (1 - masks) ** 2)))


@dataclass(frozen=True)
class SharpMasks:
    """Masks of open and closed elements, and how the stated ones were softened from them.

    Args:
        masks: Transmissions, [N, H, W], of elements that are either open or closed.
        how: In words.
        shift_px: Displacement of the sharp masks from the stated ones, (down, right).
        blur_px2: Variance of the blur of the stated ones.
    """

    masks: F32
    how: str
    shift_px: tuple[float, float] = (0.0, 0.0)
    blur_px2: float = 0.0


def sources(masks: F32) -> list[SharpMasks]:
    """Find what masks of open and closed elements may have been that are stated as the given ones, [N, H, W].

    Returns:
        The sharp masks, if a blur or an interpolation of them gives the stated ones; the stated ones without their
        noise, if they have any. Neither if the stated ones are sharp and exact, or grey.
    """
    if min(masks.shape[1:]) < _LEAST_SIDE_PX or ((masks == 0) | (masks == 1)).all():
        return []
    stated, one = masks.astype(np.float64), one_of(masks)
    crisp = _crisp(stated)
    without_noise = [] if crisp is None else crisp.without_noise(stated, _NOISE_OF_CRISP)
    if softness(one) < CRISP:
        return without_noise
    softened = _softened(stated, one)
    left = softened.left(stated)
    if crisp is not None and crisp.left(stated) <= left / _BLUR_EXPLAINS:
        return without_noise
    ways = [softened.sharp] if left <= _EXPLAINED else []
    return [*ways, *(softened.without_noise(stated, _NOISE_OF_SOFT) if left <= _GREY else ())]


def _crisp(stated: F64) -> "_Softened | None":
    """Tell the elements of crisp masks with noise, [N, H, W], apart; None if they are grey.

    An element between open and closed is open with the probability that the noise gives it, and passes as much.
    """
    opened = _open_or_closed(Levels.of(stated, _open_or_closed(stated)).removed_from(stated))
    levels = Levels.of(stated, opened).without_cuts(stated, opened)
    share = levels.removed_from(stated)
    # Noise is not cut off between the levels.
    between = (share > 0) & (share < 1)
    deviations = np.minimum(share, 1 - share)[between]
    if not between.any() or np.mean(deviations > 0.5 - _MIDDLE) * between.mean() > _MIDDLE:
        return None
    variance, odds = float(np.mean(deviations**2)), (opened.mean() + TINY) / (1 - opened.mean() + TINY)
    probable = expit((share - 0.5) / max(variance, TINY) + np.log(odds))
    return _Softened(opened, probable, levels, "")


def _softened(stated: F64, one: F64) -> "_Softened":
    """Undo the softening that explains stated masks, [N, H, W], best; one of them, [1, H, W], tells it.

    Elements are told apart better where what they pass is known, and that is known better where elements are. A
    calibration that divides by a dim reference is cut off at 1: what would lie beyond is taken from what was found.
    """
    softening = _Softening.of(one)
    found = softening.undone(one)
    levels = Levels.of(one, found.softened)
    for _ in range(_ROUNDS if levels.differ else 0):
        share = levels.removed_from(levels.uncut(one, found.softened))
        softening = _Softening.of(share)
        found = softening.undone(share)
        levels = Levels.of(levels.uncut(one, found.softened), found.softened)
        if not levels.cut:
            break
    found = softening.undone(levels.removed_from(stated) if levels.differ else stated)
    return replace(found, levels=Levels.of(levels.uncut(stated, found.softened), found.softened))


@dataclass(frozen=True)
class _Softened:
    """Elements of masks, as they are and as they are stated.

    Args:
        opened: Open (1) and closed (0), [N, H, W].
        softened: The same as softly as they are stated.
        levels: What they pass.
        how: In words.
        shift_px, blur_px2: As for `SharpMasks`.
    """

    opened: F64
    softened: F64
    levels: Levels
    how: str
    shift_px: tuple[float, float] = (0.0, 0.0)
    blur_px2: float = 0.0

    @property
    def sharp(self) -> SharpMasks:
        """Get the masks before they were softened."""
        return SharpMasks(_transmissions(self.levels.given_to(self.opened)), self.how, self.shift_px, self.blur_px2)

    def without_noise(self, stated: F64, least: float) -> list[SharpMasks]:
        """Return the masks as soft as they are stated, [N, H, W], without what differs from mask to mask at one pixel.

        What is alike in all masks is a pixel's own: it is kept, as far as the mean over masks is not noise. Masks that
        have less than the given variance of noise have none.
        """
        given = np.clip(self.levels.given_to(self.softened), 0.0, 1.0)
        if self.blur_px2 > 0 and len(stated) > 1:
            residual = stated - given
            own = residual.mean(axis=0)
            noise = residual.var(axis=0, ddof=1).mean() / len(stated)
            given += max(0.0, 1 - noise / max(float(np.mean(own**2)), TINY)) * own
        noise = float(np.mean((stated - given) ** 2))
        return [SharpMasks(_transmissions(given), f"with noise of σ {np.sqrt(noise):.2g}")] if noise >= least else []

    def left(self, stated: F64) -> float:
        """Return the share of the variance of the stated masks, [N, H, W], that they leave."""
        return _left(stated, np.clip(self.levels.given_to(self.softened), 0.0, 1.0))


def _transmissions(values: F64) -> F32:
    return np.clip(values, 0.0, 1.0).astype(np.float32)


@dataclass(frozen=True)
class _Softening:
    """The two ways in which masks may have been softened, and how much.

    Args:
        told_at: Fractions of a pixel, down and right, whose undoing tells elements apart best; it sharpens a blur, too.
        shift: Interpolated at these fractions of a pixel,
        also_px: after a blur of this standard deviation;
        blur: or blurred by the first number, px, with frequencies lost below the second one.
    """

    told_at: _Hypothesis
    shift: _Hypothesis
    also_px: float
    blur: _Hypothesis

    @classmethod
    def of(cls, sample: F64) -> Self:
        """Find those that explain one mask, [1, H, W], best."""
        part = np.ascontiguousarray(sample[:, :_SAMPLE_PX, :_SAMPLE_PX])
        shift = _search([(float(a), float(b)) for a in _FRACTIONS for b in _FRACTIONS], part, unshifted, _shifted)
        step = float(_FRACTIONS[1] - _FRACTIONS[0]) / 2
        while step > _FINEST_PX:
            around = [(shift[0] + a * step, shift[1] + b * step) for a in (-1, 0, 1) for b in (-1, 0, 1)]
            shift, step = _search(around, part, unshifted, _shifted), step / 2
        tried = [(float(s), lost) for lost, widest in _LOST for s in _SIGMAS_PX if s <= widest]
        blur = _search(tried, sample, partial(unblur, steps=0), _blurred)
        step = _SIGMA_STEP / 2
        while step * blur[0] > _FINEST_PX:
            around = [(blur[0] * (1 + a * step), blur[1]) for a in (-1, 0, 1)]
            blur, step = _search(around, sample, partial(unblur, steps=_STEPS_OF_A_TRY), _blurred), step / 2
        return cls(shift, *_interpolation_and_blur(part, shift), blur)

    def undone(self, masks: F64) -> _Softened:
        """Return the elements of masks, [N, H, W], by the way that explains these better."""
        unblurred = _open_or_closed(unblur(masks, *self.blur, _STEPS))
        blurred = _blurred(unblurred, *self.blur)
        if max(np.abs(self.shift)) > MATTERS_PX:
            interpolated = _open_or_closed(unshifted(masks, *self.told_at))
            moved = _moved(interpolated, *self.shift, self.also_px)
            if _left(masks, moved) < _left(masks, blurred):
                shift_px = (-self.shift[0], -self.shift[1])
                return _Softened(interpolated, moved, Levels.of(masks, moved), self._how, shift_px, self._blur_px2)
        how = f"blurred by σ {self.blur[0]:.2f} px"
        return _Softened(unblurred, blurred, Levels.of(masks, blurred), how, blur_px2=variance_of(self.blur[0]))

    @property
    def _how(self) -> str:
        how = f"interpolated {self.shift[0]:+.2f} px down and {self.shift[1]:+.2f} px to the right"
        return f"{how} and blurred by σ {self.also_px:.2f} px" if self.also_px else how

    @property
    def _blur_px2(self) -> float:
        """Get the variance of interpolation and blur; the former is f (1 − f) along its axis."""
        return float(np.mean([abs(f) * (1 - abs(f)) for f in self.shift])) + variance_of(self.also_px)


def _interpolation_and_blur(soft: F64, shift: _Hypothesis) -> tuple[_Hypothesis, float]:
    """Return the fraction of a pixel, near one, and the blur in px that explain soft masks best; 0 for hardly any blur.

    Pictures are often blurred before they are interpolated; elements of a slight blur are told apart all the same.
    """
    elements = _open_or_closed(unshifted(soft, *shift))

    def left(unknown: F64) -> float:
        down, right = np.clip(unknown[:2], -0.5, 0.5).tolist()
        return _left(soft, _moved(elements, down, right, abs(float(unknown[2]))))

    simplex = np.array([*shift, 0.0]) + _NEARBY
    found = minimize(left, simplex[0], method="Nelder-Mead", options={"initial_simplex": simplex, "xatol": _FINEST_PX})
    (down, right), sigma = np.clip(found.x[:2], -0.5, 0.5).tolist(), abs(float(found.x[2]))
    if sigma >= _LEAST_BLUR_PX and found.fun < _BLUR_EXPLAINS * _left(soft, _moved(elements, *shift, 0.0)):
        return (down, right), sigma
    return shift, 0.0


def _moved(elements: F64, down: float, right: float, also_px: float) -> F64:
    """Interpolate elements at a fraction of a pixel, and blur them by a standard deviation in px, which may be 0."""
    return gaussian(_shifted(elements, down, right), variance_of(also_px))


_Way = Callable[[F64, float, float], F64]


def _search(hypotheses: list[_Hypothesis], masks: F64, undo: _Way, redo: _Way) -> _Hypothesis:
    """Return the hypothesis under which masks of open and closed elements reproduce the stated ones best."""
    left = [_left(masks, redo(_open_or_closed(undo(masks, *one)), *one)) for one in hypotheses]
    return hypotheses[int(np.argmin(left))]


def _open_or_closed(masks: F64) -> F64:
    opened: F64 = (masks > 0.5).astype(np.float64)
    return opened


def _left(stated: F64, given: F64) -> float:
    """Return the unexplained share of the variance of stated masks, whatever is passed where all is open or closed."""
    one, other = stated - stated.mean(), given - given.mean()
    step = float(np.vdot(one, other)) / max(float(np.vdot(other, other)), TINY)
    return float(np.mean((one - step * other) ** 2)) / max(float(stated.var()), TINY)


def unblur(masks: F64, sigma: float, lost: float, steps: int) -> F64:
    """Find transmissions between 0 and 1 whose blur gives these masks, [N, H, W].

    Args:
        masks: Blurred ones.
        sigma: Standard deviation of the blur, px.
        lost: Frequencies that the blur reduces below this share are free.
        steps: Of Douglas and Rachford; 0 sets the free frequencies to zero.
    """
    left = transfer(variance_of(sigma), masks.shape[1:])
    known = left > lost
    given = np.where(known, fft.dctn(masks, axes=(1, 2), norm="ortho") / np.where(known, left, 1.0), 0.0)

    def as_given(trial: F64) -> F64:
        spectrum = np.where(known, given, fft.dctn(trial, axes=(1, 2), norm="ortho"))
        return np.asarray(fft.idctn(spectrum, axes=(1, 2), norm="ortho"), np.float64)

    guess: F64 = fft.idctn(given, axes=(1, 2), norm="ortho")
    found = guess
    for _ in range(steps):
        guess = guess + np.clip(2 * found - guess, 0.0, 1.0) - found
        found = as_given(guess)
    return found


def _blurred(masks: F64, sigma: float, _lost: float) -> F64:
    return gaussian(masks, variance_of(sigma))


def unshifted(masks: F64, down: float, right: float) -> F64:
    """Undo bilinear interpolation at a fraction of a pixel, up to a half in each direction, with repeated borders."""
    return _undone(_undone(masks, down).swapaxes(1, 2), right).swapaxes(1, 2)


def _undone(masks: F64, fraction: float) -> F64:
    """Solve B[i] = (1 − f) M[i] + f M[i − 1] along the rows' index, from the end from which values were shifted."""
    f = min(abs(fraction), 0.5)
    out = np.empty(masks.shape)
    given, found = (masks, out) if fraction >= 0 else (masks[:, ::-1], out[:, ::-1])
    for k in range(masks.shape[1]):
        last = found[:, k - 1] if k else given[:, 0]
        # Transmissions outside [0, 1] are rounding errors, which would propagate.
        found[:, k] = np.clip((given[:, k] - f * last) / (1 - f), 0.0, 1.0)
    return out


def _shifted(masks: F64, down: float, right: float) -> F64:
    """Move pictures by a fraction of a pixel, up to a half in each direction, with repeated borders."""
    for axis, fraction in ((1, down), (2, right)):
        f = min(max(fraction, -0.5), 0.5)
        masks = correlate1d(masks, (max(f, 0.0), 1 - abs(f), max(-f, 0.0)), axis, mode="nearest")
    return masks
