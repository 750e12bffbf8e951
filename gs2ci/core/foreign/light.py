"""Whether readings grow in proportion to the light, and what was done to them if they do not.

Here: the order of the questions and their sentences. Not here: how readings grow (`gs2ci.core.linearity`), what can be
undone (`curves`, `overflow`), which masks were shown (`shown`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import Array
from gs2ci.core.foreign.curves import (
    CURVES,
    DISPLAY_CURVES,
    DIVIDED,
    LOGARITHMS,
    Curve,
    CurveName,
    as_counts,
    full_scale,
)
from gs2ci.core.foreign.overflow import unwrapped, wrap_of
from gs2ci.core.linearity import Growth, growth

# Right measurements of 2 to 32 views, noise of 10 %, in 8 bits lie within this of slope 1 and curvature 0; clipped
# ones, whose readings are selected for being dark, within more (`python -m tests.benchmarks imports`).
_SLOPE, _CURVATURE = 0.12, 0.06
_SLOPE_CLIPPED, _CURVATURE_CLIPPED = 0.2, 0.15
_SLOPE_OVER: Final = 0.15
_SLOPE_BIASED: Final = 0.72
_SIGMAS: Final = 4.0
# Once the right curve is undone.
_SLOPE_UNDONE, _CURVATURE_UNDONE = 0.08, 0.09
# By which candidates are compared; smaller differences come from texture.
_SLOPE_UNIT, _CURVATURE_UNIT = 0.03, 0.04
# Readings that were divided by the masks' sum are as even as the scene, and do not depend on it.
_EVEN: Final = 0.6
_FLAT: Final = 0.12
# No leak or blur of masks that anyone uses leaves less than this of the slope.
_STEEP_LEAST: Final = 0.75
# Readings that went round, put back, leave less than this of what was unexplained, if so many did; undoing a curve
# makes more than so many times of it (3 and more; 1.5 where a curve is what it was).
_PUT_BACK: Final = 0.8
_STRETCHED: Final = 2.0
_FEWEST_ROUND: Final = 3e-4
_PILE_UP: Final = 5e-4
_FEWEST_PILED: Final = 4
# Readings whose bytes are exchanged hardly depend on the masks.
_SWAPPED: Final = 0.5
_CLOSE_BELOW: Final = 0.98


@dataclass(frozen=True)
class Examined:
    """Readings in proportion to light, as far as the file shows how.

    Args:
        readings: Above the offset, [K, H, W, C].
        undone: What was undone; None: they stayed as they are.
        curved: Whether they still are not in proportion to light.
        growth: How the readings as given grow; None: it cannot be told.
    """

    readings: F64
    undone: CurveName | None = None
    curved: bool = False
    growth: Growth | None = None


@dataclass(frozen=True)
class LightQuestion:
    """Readings and the masks under which they were taken.

    Args:
        measurement: As stored, for its type and for messages.
        readings: Above the offset, [K, H, W, C].
        open_masks: a(p) = Σ wᵢ Mᵢ(p) where the masks show, [H, W].
        saturation: What the user says of it, above the offset.
        is_mosaic: Whether neighbouring pixels are of different colours.
    """

    measurement: Array
    readings: F64
    open_masks: F64
    saturation: float | None = None
    is_mosaic: bool = False

    @property
    def image(self) -> F64:
        """Get the plane that is asked: of the first measurement, its green."""
        return self.readings[0, :, :, self.readings.shape[3] // 2]

    @property
    def closed_are_dark(self) -> bool:
        """Get whether pixels that no mask opens, if there are any, read less than half of what others do."""
        closed = self.open_masks <= 0
        if not closed.any() or closed.all():
            return True
        return bool(self.image[closed].mean() < 0.5 * self.image[~closed].mean())

    def grow(self, curve: Curve | None = None) -> Growth | None:
        """Draw readings over open masks, as given or with a curve undone."""
        full = full_scale(self.measurement.values)
        clip = clip_of(self.image, self.saturation)
        if curve is None:
            return growth(self.image, self.open_masks, clip=clip, is_mosaic=self.is_mosaic)
        if curve is DIVIDED:
            image = self.image * self.open_masks
            return growth(image, self.open_masks, clip=clip_of(image, None), is_mosaic=self.is_mosaic)
        return growth(
            self.image,
            self.open_masks,
            clip=clip,
            is_mosaic=self.is_mosaic,
            undo=lambda readings, opened: curve.undo(readings, opened, full),
        )

    def undone(self, curve: Curve) -> F64:
        """Return the readings with a curve undone."""
        full = full_scale(self.measurement.values)
        readings = curve.undo(self.readings, self.open_masks[None, :, :, None], full)
        return as_counts(readings) if curve is DIVIDED else readings

    def put_back(self, wrap: float) -> F64:
        """Return the readings with those that went round put back."""
        result = np.empty_like(self.readings)
        for k in range(self.readings.shape[0]):
            for c in range(self.readings.shape[3]):
                plane = self.readings[k, :, :, c]
                result[k, :, :, c] = unwrapped(plane, self.open_masks, wrap, is_mosaic=self.is_mosaic)
        return result


def clip_of(image: F64, said: float | None) -> float:
    """Return the reading from which an image is clipped: as the user says, or where it piles up at its largest."""
    if said is not None:
        return said if said > 0 else np.inf
    high = float(image.max())
    level = high - 1e-6 * abs(high)
    piled = int((image >= level).sum())
    # The highest code of 8 bits is as frequent as any other where a sum went round.
    close = int((image >= _CLOSE_BELOW * high).sum()) - piled
    return level if piled >= max(_FEWEST_PILED, _PILE_UP * image.size, close) else np.inf


def examine(question: LightQuestion, said: CurveName, guesses: list[str]) -> Examined:
    """Ask whether readings are in proportion to light, and undo what the file shows to have been done to them.

    Args:
        question: The readings and their masks.
        said: How they are stored, if the user says so.
        guesses: Sentences are added here.

    Raises:
        InputError: The user says that a sum overflowed, and readings are no whole numbers of a range that it fills.
    """
    if said != "auto":
        return _as_said(question, said, guesses)
    found = question.grow()
    _check_byte_order(question, found)
    around = _gone_round(question, found, guesses)
    if around is not None:
        return around
    if found is None:
        guesses.append(
            "light: whether readings grow in proportion to the open masks cannot be told here (too few pixels that are "
            "well lit and not clipped, or masks without contrast)"
        )
        return Examined(question.readings)
    clipped = bool(np.isfinite(clip_of(question.image, question.saturation)))
    over = _SLOPE_CLIPPED if clipped else _SLOPE_OVER
    if not found.is_biased and found.slope > 1 + over + _SIGMAS * found.slope_error:
        guesses.append(
            f"WARNING: {question.measurement.where}: readings grow {found.slope:.2f} times as fast as the masks open: "
            "was too much subtracted as the reading without light, or do the masks lie on a background, or are they "
            "stored with a display's gamma?"
        )
        return Examined(question.readings, growth=found)
    if _is_line(found, clipped=False) and not found.is_biased:
        return Examined(question.readings, growth=found)
    return _which_curve(question, found, clipped, guesses)


def _as_said(question: LightQuestion, said: CurveName, guesses: list[str]) -> Examined:
    if said == "linear":
        return Examined(question.readings)
    if said == "overflow":
        wrap = wrap_of(question.measurement.values)
        if wrap is None:
            raise InputError(
                f"{question.measurement.where}: --curve overflow, but no range of whole numbers that the readings fill",
                allowed="readings of whole numbers >= 0 up to the end of 8, 10, 12, 14 or 16 bits",
                remedy="leave --curve out",
            )
        guesses.append(f"readings that went round after {wrap:.6g} were put back, as stated")
        return Examined(question.put_back(wrap), "overflow")
    curve = next(curve for curve in CURVES if curve.name == said)
    guesses.append(f"readings: {curve.words} was undone, as stated")
    return Examined(question.undone(curve), said)


def _is_line(found: Growth, clipped: bool) -> bool:
    if found.is_biased:
        return found.slope >= _SLOPE_BIASED
    slope, curvature = (_SLOPE_CLIPPED, _CURVATURE_CLIPPED) if clipped else (_SLOPE, _CURVATURE)
    return (
        found.slope >= 1 - slope - _SIGMAS * found.slope_error
        and found.curvature >= -curvature - _SIGMAS * found.curvature_error
    )


def _check_byte_order(question: LightQuestion, found: Growth | None) -> None:
    """Refuse numbers of 16 bits whose two bytes are exchanged.

    Raises:
        InputError: They grow with the open masks once the bytes are exchanged, and not as they are.
    """
    stored = question.measurement.values
    if stored.dtype.kind != "u" or stored.dtype.itemsize != 2 or found is None or found.slope > _SWAPPED:
        return
    swapped = np.rint(np.maximum(question.image, 0)).astype(np.uint16).byteswap().astype(np.float64)
    other = growth(swapped, question.open_masks, is_mosaic=question.is_mosaic)
    if other is not None and _is_undone(other, clipped=False):
        raise InputError(
            f"{question.measurement.where}: the two bytes of each reading are exchanged: only so do readings grow in "
            f"proportion to the open masks ({_told(other)})",
            allowed="numbers in the order of bytes that their type states",
            remedy="read the camera's file as '>u2' instead of '<u2', or the reverse, and save again",
        )


def _gone_round(question: LightQuestion, found: Growth | None, guesses: list[str]) -> Examined | None:
    """Put readings back that went round, if that explains them."""
    wrap = wrap_of(question.measurement.values)
    if wrap is None or found is None or np.isfinite(clip_of(question.image, question.saturation)):
        return None
    image = unwrapped(question.image, question.open_masks, wrap, is_mosaic=question.is_mosaic)
    share = float((image > question.image).mean())
    if share < _FEWEST_ROUND:
        return None
    better = growth(image, question.open_masks, is_mosaic=question.is_mosaic)
    if better is None or better.unexplained > _PUT_BACK * found.unexplained:
        return None
    if not _is_line(better, clipped=False) or _distance(better) > _distance(found):
        return None
    # Bright places that a curve has squeezed look as if some had gone round; nothing smooth undoes what has, but
    # stretches its jumps.
    smooth = [grown for curve in (*DISPLAY_CURVES, *LOGARITHMS) if (grown := question.grow(curve)) is not None]
    smooth = [
        one for one in smooth if _is_undone(one, clipped=False) and one.unexplained < _STRETCHED * found.unexplained
    ]
    if any(_distance(one) < _distance(better) for one in smooth):
        return None
    doubt = "" if _is_undone(better, clipped=False) else ": too many for all to be put back, and views will be wrong"
    guesses.append(
        f"WARNING: {question.measurement.where}: {share:.1%} of the readings went round at {wrap:.6g}, as a sum does "
        f"in integers that are too small for it: against the open masks they have {_told(found)}. Put back by what "
        f"their neighbours read, they have {_told(better)}{doubt}. Sum in larger integers, or say --curve linear if "
        "that is wrong"
    )
    return Examined(question.put_back(wrap), "overflow", growth=found)


def _which_curve(question: LightQuestion, found: Growth, clipped: bool, guesses: list[str]) -> Examined:
    tried = {curve: grown for curve in (*CURVES, *LOGARITHMS) if (grown := question.grow(curve)) is not None}
    fitting = {curve: grown for curve, grown in tried.items() if _is_undone(grown, clipped)}
    if found.is_biased:
        # Selection bends right readings as well, and undoing a curve then overshoots by half.
        fitting = {curve: grown for curve, grown in fitting.items() if abs(grown.slope - 1) < _SLOPE_UNDONE}
    if DIVIDED in fitting and not (question.closed_are_dark and _is_divided(found, fitting[DIVIDED])):
        del fitting[DIVIDED]
    best = min(fitting, key=lambda curve: _distance(fitting[curve]), default=None)
    beyond = _SIGMAS * found.curvature_error
    # What a leak, a black level or softer masks leave straight, and what a power of that slope would bend.
    is_straight = found.curvature >= -0.03 - beyond
    is_power = found.curvature - 0.5 * found.slope * (found.slope - 1) <= 0.03 + beyond
    where = question.measurement.where
    lenient = _is_line(found, clipped)
    if best is not None and lenient and not (best.is_known and found.slope < 1 - 0.5 * _SLOPE_CLIPPED):
        best = None
    if best is not None and not best.is_known:
        guesses.append(
            f"WARNING: {where}: readings do not grow in proportion to the open masks ({_told(found)}) but as "
            f"{best.words} does, whose constants the file does not tell: save camera readings as they are"
        )
        return Examined(question.readings, curved=True, growth=found)
    if best is not None and (best is DIVIDED or not is_straight) and _distance(fitting[best]) < 0.5 * _distance(found):
        alike = [other.words for other in fitting if other is not best and other in DISPLAY_CURVES]
        doubt = f" (hardly to be told from {', '.join(alike)})" if alike and best is not DIVIDED else ""
        guesses.append(
            f"WARNING: {where}: readings do not grow in proportion to the open masks ({_told(found)}) but as "
            f"{best.words} does{doubt}; undone, they do ({_told(fitting[best])}). Save camera readings as they are, or "
            "say --curve linear if these are"
        )
        return Examined(question.undone(best), best.name, growth=found)
    if lenient:
        return Examined(question.readings, growth=found)
    if is_straight and not is_power and abs(found.slope) > _FLAT:
        # Registration estimates a leak, a black level and the blur of masks.
        return Examined(question.readings, growth=found)
    if is_straight and found.slope > _STEEP_LEAST:
        return Examined(question.readings, growth=found)
    guesses.append(
        f"WARNING: {where}: readings do not grow in proportion to the open masks ({_told(found)}): were they divided "
        "by the masks' sum, stored with a display's gamma or a logarithm, or did a sum overflow? Is a mask missing, or "
        "are these the masks of another measurement? Save camera readings as they are, or say --curve"
    )
    return Examined(question.readings, curved=True, growth=found)


def _is_undone(found: Growth, clipped: bool) -> bool:
    more = 2.5 if clipped else 1.0
    return (
        abs(found.slope - 1) <= more * _SLOPE_UNDONE + 3 * found.slope_error
        and abs(found.curvature) <= more * _CURVATURE_UNDONE + 3 * found.curvature_error
    )


def _is_divided(found: Growth, undone: Growth) -> bool:
    """Tell a picture that was divided by the masks' sum from one that shows nothing of the masks for other reasons."""
    if abs(found.slope) <= _FLAT + 3 * found.slope_error and abs(found.curvature) < 0.1 + 3 * found.curvature_error:
        return found.roughness < _EVEN * found.contrast
    return _distance(undone) < 0.5 * _distance(found)


def _distance(found: Growth) -> float:
    return float(
        np.hypot(
            (found.slope - 1) / max(_SLOPE_UNIT, found.slope_error),
            found.curvature / max(_CURVATURE_UNIT, found.curvature_error),
        )
    )


def _told(found: Growth) -> str:
    return (
        f"slope {found.slope:.2f} ± {found.slope_error:.2f}, curvature {found.curvature:+.2f} ± "
        f"{found.curvature_error:.2f}; light gives 1 and 0"
    )
