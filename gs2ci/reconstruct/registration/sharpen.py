"""What masks of open and closed elements were, that are stated softer than they were, or with noise.

A blurred calibration, or a resampled picture of the masks, gives soft masks. If the true elements are either open or
closed, the masks alone show how they were softened: only undoing the right blur, or the right displacement, turn and
change of scale, gives elements that are all open or closed. A blur preserves some frequencies and reduces the others
below rounding or noise; as long as about half of all frequencies are preserved, only one set of masks between closed
and open has them (Mangasarian and Recht, European Journal of Operational Research 214, 2011). That holds up to about
σ 2 px for masks in float32, and 1.2 px for masks known to a thousandth. They are found by Douglas-Rachford steps
between the two sets. Masks interpolated at other places are inverted by projected, accelerated gradient steps (Beck
and Teboulle, SIAM Journal on Imaging Sciences 2, 2009); where they lie is fitted to the stated masks, from the place
that the measurement gives.

What open and closed elements pass is kept as it is stated, with its smooth change over the picture (vignetting): it
decides how bright the views are, which no held-out pixel tells. So the softening has to be known exactly, blur beside
interpolation included: with too little of it, closed elements would seem to pass more than they do, and open ones less.

A calibration of few frames adds noise that differs from pixel to pixel. Crisp elements are told apart all the same, and
the masks are stated again without it. Noise is cut off at 0 and 1, which shifts the means of what closed and open
elements pass.

Here: both. Not here: what elements pass (`levels`), whether the masks are used (`register`, by the measurement), and
filtering, which sharpens masks where all this fails (`misfit`).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy import fft
from scipy.optimize import least_squares, minimize_scalar
from scipy.special import expit

from gs2ci.core.arrays import F32, F64, Bool, Size
from gs2ci.reconstruct.registration.levels import Levels
from gs2ci.reconstruct.registration.local_scene import TINY
from gs2ci.reconstruct.registration.misfit import gaussian, sigma_of, transfer, variance_of
from gs2ci.reconstruct.registration.parameters import AFFINE, BY_NAME, MATTERS_PX
from gs2ci.reconstruct.registration.placement import Placement, from_middle

_LEAST_SIDE_PX: Final = 16
# Frequencies reduced below the first number count as lost, and blurs wider than the second number, px, are not tried:
# for masks exact to float32, and for a noisy calibration.
_LOST: Final = ((1e-6, 2.4), (3e-3, 1.3))
_STEPS: Final = 100
_STEPS_OF_A_TRY: Final = 30
# Steps between fits of where elements lie: those of the first are told apart without any.
_STEPS_TO_FITS: Final = (0, 4, 8)
_STEPS_OF_A_FIT: Final = 8
# Stated masks beyond this mean squared distance from open or closed are soft. Under the right hypothesis the
# unexplained share of their variance is only rounding, or some hundredths if the calibration added noise.
CRISP: Final = 3e-3
_EXPLAINED: Final = 0.05
# Relative distance of the blurs that are tried.
_SIGMA_STEP: Final = 0.04
_SIGMAS_PX: Final = 0.3 * (1 + _SIGMA_STEP) ** np.arange(54)
_FINEST_PX: Final = 3e-4
# An interpolation must leave less than this share of what a blur alone leaves.
_EXPLAINS: Final = 0.97
# Noise of less than this variance is left as it is: single elements of a real modulator differ, too.
_NOISE: Final = 1e-5
# Grey masks are not taken for noisy ones: of evenly grey ones a quarter lies in the middle quarter between open and
# closed, with noise of σ 0.3 a tenth.
_MIDDLE: Final = 0.125
# Masks of at least this share of the largest variance show the elements of all.
_SHOWS: Final = 0.5
# How often levels and elements are found from each other.
_ROUNDS: Final = 2


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
        placement: Where the sharp masks lie relative to the stated ones.
        blur_px2: Variance of the blur of the stated ones, interpolation included.
    """

    masks: F32
    how: str
    placement: Placement = field(default_factory=Placement)
    blur_px2: float = 0.0

    @property
    def unknown(self) -> Bool:
        """Get which pixels the stated masks do not tell, [H, W]."""
        return ~self.placement.known(self.masks.shape[1:])


def sources(masks: F32, place: Placement | None = None) -> list[SharpMasks]:
    """Find what masks of open and closed elements may have been that are stated as the given ones, [N, H, W].

    Args:
        masks: As stated.
        place: Where the measurement shows them, right to half a pixel; None: where they are stated.

    Returns:
        The sharp masks, if a blur or an interpolation of them gives the stated ones; crisp ones without their noise, if
        they have any. None if the stated ones are sharp and exact, or grey.
    """
    if min(masks.shape[1:]) < _LEAST_SIDE_PX or ((masks == 0) | (masks == 1)).all():
        return []
    stated, one = masks.astype(np.float64), one_of(masks)
    crisp = _crisp(stated)
    without_noise = [] if crisp is None else _without_noise(stated, crisp)
    if softness(one) < CRISP:
        return without_noise
    softening, levels = _softened(one, place or Placement())
    opened = softening.undone(levels.removed_from(stated) if levels.differ else stated)
    softened = softening.redone(opened)
    levels = Levels.of(levels.uncut(stated, softened), softened, softening.seen(stated))
    left = softening.left(stated, np.clip(levels.given_to(softened), 0.0, 1.0))
    if crisp is not None and softening.left(stated, crisp) <= left / _EXPLAINS:
        return without_noise
    if left > _EXPLAINED:
        return []
    passed = _transmissions(levels.given_to(opened))
    size = (one.shape[1], one.shape[2])
    return [SharpMasks(passed, softening.how(size), softening.placement, softening.blur_px2(size))]


def _crisp(stated: F64) -> F64 | None:
    """Return crisp masks, [N, H, W], without their noise; None if they are grey.

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
    return np.clip(levels.given_to(probable), 0.0, 1.0)


def _without_noise(stated: F64, crisp: F64) -> list[SharpMasks]:
    noise = float(np.mean((stated - crisp) ** 2))
    return [SharpMasks(_transmissions(crisp), f"with noise of σ {np.sqrt(noise):.2g}")] if noise >= _NOISE else []


def _softened(one: F64, place: Placement) -> "tuple[_Softening, Levels]":
    """Find the softening that explains one mask, [1, H, W], best, and what its elements pass.

    Elements are told apart better where what they pass is known, and that is known better where elements are. A
    calibration that divides by a dim reference is cut off at 1: what would lie beyond is taken from what was found.
    """
    softening = _Softening.of(one, place)
    softened, seen = softening.redone(softening.undone(one)), softening.seen(one)
    levels = Levels.of(one, softened, seen)
    for _ in range(_ROUNDS if levels.differ else 0):
        share = levels.removed_from(levels.uncut(one, softened))
        softening = softening.again(share)
        softened, seen = softening.redone(softening.undone(share)), softening.seen(one)
        levels = Levels.of(levels.uncut(one, softened), softened, seen)
        if not levels.cut:
            break
    return softening, levels


def _transmissions(values: F64) -> F32:
    return np.clip(values, 0.0, 1.0).astype(np.float32)


@dataclass(frozen=True)
class _Softening:
    """How elements became soft masks: they were blurred, or lie elsewhere and were interpolated, and blurred as well.

    Args:
        placement: Where the elements lie relative to the stated masks.
        sigma_px: Standard deviation of the blur.
        lost: Without a placement: frequencies that the blur reduces below this share are lost.
    """

    placement: Placement = field(default_factory=Placement)
    sigma_px: float = 0.0
    lost: float = 0.0

    @classmethod
    def of(cls, sample: F64, place: Placement) -> "_Softening":
        """Find the softening that explains one mask, [1, H, W], best."""
        elsewhere, blurred = cls(place), cls._blur_of(sample)
        for steps in _STEPS_TO_FITS:
            elsewhere = elsewhere._fitted(sample, elsewhere.undone(sample, steps))
        size = (sample.shape[1], sample.shape[2])
        if np.linalg.norm(elsewhere.placement.displacement_px(size), axis=1).max() <= MATTERS_PX:
            return blurred
        left = [one._left_after(sample, _STEPS) for one in (elsewhere, blurred)]
        return elsewhere if left[0] < _EXPLAINS * left[1] else blurred

    @classmethod
    def _blur_of(cls, sample: F64) -> "_Softening":
        every = (cls(sigma_px=float(s), lost=lost) for lost, most in _LOST for s in _SIGMAS_PX if s <= most)
        return min(every, key=lambda one: one._left_after(sample, 0)).again(sample)

    def again(self, sample: F64) -> "_Softening":
        """Return the softening of the same kind, near this one, that explains one mask, [1, H, W], best."""
        if not self.placement.is_identity:
            return self._fitted(sample, self.undone(sample, _STEPS_OF_A_TRY))

        found = minimize_scalar(
            lambda sigma_px: replace(self, sigma_px=sigma_px)._left_after(sample, _STEPS_OF_A_TRY),
            bounds=(self.sigma_px * (1 - _SIGMA_STEP), self.sigma_px * (1 + _SIGMA_STEP)),
            method="bounded",
            options={"xatol": _FINEST_PX},
        )
        return replace(self, sigma_px=float(found.x))

    def _left_after(self, sample: F64, steps: int) -> float:
        return self.left(sample, self.redone(self.undone(sample, steps)))

    def _fitted(self, sample: F64, elements: F64) -> "_Softening":
        """Return the affine placement and the blur under which elements give a mask, both [1, H, W], best."""
        size, names = (sample.shape[1], sample.shape[2]), (*AFFINE, "blur_px2")
        steps = np.array([BY_NAME[name].step_at(float(np.hypot(*size)) / 2, 1.0) for name in names])
        seen = self.seen(sample)

        def trial(unknown: F64) -> _Softening:
            *placed, blur = (unknown * steps).tolist()
            sigma = sigma_of(blur) if blur > 0 else 0.0
            return replace(self, placement=Placement(**dict(zip(AFFINE, placed, strict=True))), sigma_px=sigma)

        def unexplained(unknown: F64) -> F64:
            return _unexplained(sample[:, seen], trial(unknown).redone(elements)[:, seen]).ravel()

        start = np.array([*(getattr(self.placement, name) for name in AFFINE), variance_of(self.sigma_px)]) / steps
        return trial(least_squares(unexplained, start, max_nfev=_STEPS_OF_A_FIT).x)

    def undone(self, masks: F64, steps: int = _STEPS) -> F64:
        """Return which elements of masks, [N, H, W], are open (1) and closed (0)."""
        if self.placement.is_identity:
            return _open_or_closed(unblur(masks, self.sigma_px, self.lost, steps))
        found = trial = np.clip(self.placement.sample(masks), 0.0, 1.0)
        momentum = 1.0
        for _ in range(min(steps, _STEPS_OF_A_TRY)):
            nearer = np.clip(trial + self.placement.sample(masks - self.redone(trial)), 0.0, 1.0)
            before, momentum = momentum, (1 + np.sqrt(1 + 4 * momentum**2)) / 2
            found, trial = nearer, nearer + (before - 1) / momentum * (nearer - found)
        return _open_or_closed(found)

    def redone(self, elements: F64) -> F64:
        """Return elements, [N, H, W], as softly as they are stated."""
        moved = elements if self.placement.is_identity else self._back.sample(elements)
        return gaussian(moved, variance_of(self.sigma_px)) if self.sigma_px else moved

    @cached_property
    def _back(self) -> Placement:
        """Get where the stated masks lie relative to the elements."""
        matrix = np.linalg.inv(self.placement.matrix).astype(np.float64)
        return Placement.from_affine(matrix, -matrix @ self.placement.shift_px)

    def seen(self, masks: F64) -> Bool:
        """Return the pixels of masks, [N, H, W], that are interpolated from elements within the picture, [H, W]."""
        size = masks.shape[1:]
        return np.ones(size, bool) if self.placement.is_identity else self._back.known(size, 0.0)

    def left(self, stated: F64, given: F64) -> float:
        """Return the unexplained share of the variance of stated masks, [N, H, W], whatever open and closed pass."""
        seen = self.seen(stated)
        inside = stated[:, seen]
        return float(np.mean(_unexplained(inside, given[:, seen]) ** 2)) / max(float(inside.var()), TINY)

    def how(self, size: Size) -> str:
        """Return the softening of masks of a size in words."""
        far = float(np.linalg.norm(self.placement.displacement_px(size), axis=1).max())
        words = f"up to {far:.2f} px off and interpolated there" if far else ""
        blur = f"blurred by σ {self.sigma_px:.2f} px" if variance_of(self.sigma_px) >= BY_NAME["blur_px2"].least else ""
        return " and ".join(filter(None, (words, blur)))

    def blur_px2(self, size: tuple[int, ...]) -> float:
        """Return the variance of blur and interpolation; the latter is f (1 − f) along each axis."""
        fractions = self._back.stated_at(from_middle(size)) + (np.array(size) - 1) / 2
        fractions -= np.floor(fractions)
        return float(np.mean(fractions * (1 - fractions))) + variance_of(self.sigma_px)


def _open_or_closed(masks: F64) -> F64:
    return (masks > 0.5).astype(np.float64)


def _unexplained(stated: F64, given: F64) -> F64:
    """Return what given masks leave of stated ones, whatever is passed where all is open or closed."""
    one, other = stated - stated.mean(), given - given.mean()
    return one - float(np.vdot(one, other)) / max(float(np.vdot(other, other)), TINY) * other


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
        return fft.idctn(spectrum, axes=(1, 2), norm="ortho")

    guess: F64 = fft.idctn(given, axes=(1, 2), norm="ortho")
    found = guess
    for _ in range(steps):
        guess = guess + np.clip(2 * found - guess, 0.0, 1.0) - found
        found = as_given(guess)
    return found
