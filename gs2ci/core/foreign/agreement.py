"""Whether masks, measurement and truth belong together, tested on the numbers and not on the shapes.

A coded measurement carries the fine pattern of its masks' sum: that is how masks of another measurement, or turned
ones, are recognised (`pattern`). Where the truth is known, Σ wᵢ Mᵢ ⊙ Xᵢ must give the measurement up to one factor,
the scale; this also finds a colour filter array and a reversed order of the masks, which nothing else can.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import Array
from gs2ci.core.foreign.pattern import FITS_NOT, PatternTrace, fine_of, trace
from gs2ci.core.foreign.scale import FULL_SCALES, Scale
from gs2ci.core.mosaics import GREENS_FALL, GREENS_RISE, greens_of
from gs2ci.core.records import CFA_PATTERNS, CfaPattern

# Below so many pixels such correlations come about by chance.
ENOUGH_PIXELS: Final = 400
# Relative residual of Σ M X against the measurement.
EXPLAINED: Final = 0.1
# A reading without light is one if what the truth leaves is less than this share with it.
_BY_AN_OFFSET: Final = 0.5
# Behind closed masks, more readings than this at or below 0 contradict an offset.
_NONE_AT_ZERO: Final = 0.2
# So much less of the measurement is left by true views that begin with the right mask: only the last one is then wrong.
_MOVED: Final = 0.6
# How close a fitted scale must come to a usual one to be taken for it.
SNAP: Final = 0.02


@dataclass(frozen=True)
class CodingConvention:
    """How views became a measurement.

    Args:
        masks: Transmissions, [N, H, W].
        weights: Share of its interval during which each mask was exposed, [N].
    """

    masks: F32
    weights: F32

    @cached_property
    def multiplicity(self) -> F64:
        """Get what a white scene would measure, a(p) = Σ wᵢ Mᵢ(p), [H, W]."""
        return np.tensordot(self.weights.astype(np.float64), self.masks.astype(np.float64), 1)

    def reversed(self) -> "CodingConvention":
        """Get the same masks in the opposite order."""
        return CodingConvention(self.masks[::-1], self.weights[::-1])

    def forward(self, views: F32, cfa: CfaPattern | None = None) -> F64:
        """Sum masked views [N, H, W, C] into [H, W, C], or into a mosaic [H, W, 1]."""
        coded = np.zeros(views.shape[1:])
        for weight, mask, view in zip(self.weights, self.masks, views, strict=True):
            coded += float(weight) * (mask[..., None] * view)
        return coded if cfa is None else mosaic(coded, cfa)


def mosaic(image: F64, cfa: CfaPattern) -> F64:
    """Keep of each pixel the colour that its filter passes, [H, W, 1]."""
    height, width = image.shape[:2]
    channel = np.array(["RGB".index(colour) for colour in cfa]).reshape(2, 2)
    rows, columns = np.arange(height) % 2, np.arange(width) % 2
    return np.take_along_axis(image, channel[rows[:, None], columns[None, :]][..., None], axis=2)


def fit(measurement: F64, model: F64) -> tuple[float, float]:
    """Find the factor s that brings s · model closest to a measurement of its shape, and the relative residual left."""
    energy, total = float((model**2).sum()), float((measurement**2).sum())
    if energy == 0 or total == 0:
        return 0.0, 0.0 if energy == total else 1.0
    scale = float((measurement * model).sum()) / energy
    return scale, float(np.sqrt(((measurement - scale * model) ** 2).sum() / total))


def find_pattern(image: F64, multiplicity: F64) -> PatternTrace | None:
    """Find where a measurement shows the pattern of its masks.

    Args:
        image: First measurement, colours averaged, [H, W].
        multiplicity: a(p), [H, W].

    Returns:
        The trace; None where the measurement cannot be asked.
    """
    if image.size < ENOUGH_PIXELS:
        return None
    # Masks that always open the same number of pixels leave no pattern in their sum, a dark scene shows none.
    if fine_of(multiplicity).std() < 1e-3 * multiplicity.max() or fine_of(image).std() < 1e-6 * np.abs(image).max():
        return None
    return trace(image, multiplicity)


def report_pattern(found: PatternTrace | None, measurement: Array, masks: Array, guesses: list[str]) -> None:
    """Report if the measurement does not show the masks' pattern at the stated position."""
    if found is None or (found.upright >= FITS_NOT and found.is_in_place):
        return
    beside = f"with correlation {found.correlation:.2f} that way and {found.upright:.2f} as given"
    if not found.shows:
        guesses.append(
            f"WARNING: the measurement shows no trace of these masks (correlation {found.upright:.2f}): do they belong "
            "together?"
        )
    elif found.turn:
        guesses.append(
            f"WARNING: {masks.where}: the masks are {found.turn} against the measurement ({measurement.where}): their "
            f"pattern shows {beside}; the registration of `gs2ci reconstruct` corrects this"
        )
    elif not found.is_in_place:
        guesses.append(
            f"WARNING: {masks.where}: the masks seem to be displaced by {found.down_px:+.1f} px down and "
            f"{found.right_px:+.1f} px to the right: their pattern shows {beside}; the registration of "
            "`gs2ci reconstruct` corrects this"
        )


def check_closed_pixels(readings: F64, multiplicity: F64, guesses: list[str]) -> None:
    """Say so if readings, [H, W, C], at pixels that no mask opens show light, which hints at an offset."""
    closed = multiplicity == 0
    if closed.sum() < 50:
        return
    # Noise about no light at all is cut off at 0 in integers without a sign: half of the readings are 0 then.
    if float((readings[closed] <= 0).mean()) > _NONE_AT_ZERO:
        return
    image = readings.mean(axis=2)
    leak, typical = float(np.median(image[closed])), float(np.median(image[~closed]))
    if leak > 0.02 * abs(typical):
        guesses.append(
            f"WARNING: pixels that no mask opens read {leak:.6g} (others {typical:.6g}): give --offset {leak:.6g} "
            "if that is the reading without light"
        )


def doubt_mosaic(image: F64, coding: CodingConvention, cfa: CfaPattern | None, guesses: list[str]) -> None:
    """Say so if a single-channel measurement, [H, W], looks like another colour mosaic than it is taken for."""
    if cfa is None:
        pair = mosaic_of(image, coding)
        if pair is not None:
            guesses.append(f"WARNING: looks like a colour mosaic ({pair}), taken as mono; if it is one, give --cfa")
        return
    pair = greens_of(image, coding.multiplicity)
    if pair is not None and cfa not in pair:
        guesses.append(
            f"WARNING: the greens stand where {pair} has them, not {cfa}: does the picture begin at another row or "
            "column of the sensor? Give the pattern at its upper left pixel by --cfa"
        )


def mosaic_of(image: F64, coding: CodingConvention) -> str | None:
    """Name the pair of colour mosaics that a picture, [H, W], looks like, if it looks like one."""
    pair = greens_of(image, coding.multiplicity)
    if pair is not None:
        return pair
    height, width = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    if min(height, width) < 8:
        return None
    cells = image[:height, :width].reshape(height // 2, 2, width // 2, 2)
    means, noise = cells.mean(axis=(0, 2)), cells.std() / np.sqrt(cells[:, 0, :, 0].size)
    spread = float(means.max() - means.min())
    # In every Bayer pattern the two greens stand on a diagonal and agree, the other two differ from them.
    for a, b, pair in ((means[0, 0], means[1, 1], GREENS_FALL), (means[0, 1], means[1, 0], GREENS_RISE)):
        if abs(a - b) < 0.2 * spread and spread > max(0.1 * means.mean(), 8 * noise):
            return pair
    return None


def guess_cfa(measurement: F64, coding: CodingConvention, views: F32, guesses: list[str]) -> CfaPattern | None:
    """Find the colour filter array of a single-channel measurement whose true views have colour.

    Args:
        measurement: One measurement above the offset, [H, W, 1].
        coding: Masks and weights.
        views: True views, [N, H, W, 3].
        guesses: Sentences are added here.
    """
    coded = coding.forward(views)
    residuals: dict[CfaPattern, float] = {cfa: fit(measurement, mosaic(coded, cfa))[1] for cfa in CFA_PATTERNS}
    grey = fit(measurement, coded.mean(axis=2, keepdims=True))[1]
    best = min(residuals, key=lambda cfa: residuals[cfa])
    others = min([grey, *(residual for cfa, residual in residuals.items() if cfa != best)])
    if residuals[best] < min(EXPLAINED, 0.5 * others):
        guesses.append(f"Bayer mosaic {best}: with it the truth explains the measurement")
        return best
    return None


def check_truth(
    truth: Array, measurement: F64, coding: CodingConvention, views: F32, cfa: CfaPattern | None, *, guesses: list[str]
) -> Scale | None:
    """Find the measurement's scale from the truth.

    Args:
        truth: For messages.
        measurement: One measurement above the offset, [H, W, C].
        coding: Masks and weights.
        views: True views, [N, H, W, C].
        cfa: Colour filter array.
        guesses: Sentences are added here.

    Returns:
        The scale, snapped to a usual one within 2 %; None where the truth does not explain the measurement.

    Raises:
        InputError: The truth explains the measurement only with the masks in reversed order, or with red and blue
            exchanged.
    """
    model = coding.forward(views, cfa)
    scale, residual = fit(measurement, model)
    slope, _ = fit(measurement, model - model.mean())
    above = float(measurement.mean()) - slope * float(model.mean())
    lifted, beside = fit(measurement - above, model)
    if beside * float(np.linalg.norm(measurement - above)) < _BY_AN_OFFSET * residual * np.linalg.norm(measurement):
        guesses.append(
            f"WARNING: {truth.where}: the true views explain the measurement above a reading of {above:.6g} without "
            f"light (residual {beside:.2g}, without it {residual:.2g}): give --offset, {above:.6g} above the present"
        )
        scale, residual = lifted, beside
    _, reverse = fit(measurement, coding.reversed().forward(views, cfa))
    _refuse_if_explained(
        truth,
        "the masks in reversed order",
        reverse,
        residual,
        allowed="masks and true views in the order of exposure",
        remedy="say --reverse-masks, reverse the true views, or leave them out with --truth-key none",
    )
    if views.shape[-1] > 1:
        _, swapped = fit(measurement, coding.forward(views[..., ::-1], cfa))
        _refuse_if_explained(
            truth,
            "red and blue exchanged",
            swapped,
            residual,
            allowed="red, green, blue; OpenCV reads and writes blue, green, red",
            remedy="reverse the colours of one of the two, or leave the true views out with --truth-key none",
        )
    _doubt_first(truth, measurement, coding, views, cfa, residual, guesses)
    if residual < EXPLAINED and scale > 0:
        guesses.append(f"truth: explains the measurement to {residual:.2g} (relative)")
        return Scale(_snapped(scale, len(views)), "from the truth", stated=True)
    even = np.broadcast_to(views.mean(axis=(1, 2), keepdims=True), views.shape)
    _, grey = fit(measurement, coding.forward(even, cfa))
    word = "WARNING: the truth does not explain" if residual >= grey else "truth: explains only roughly"
    guesses.append(f"{word} the measurement (relative residual {residual:.2f}, of even views {grey:.2f})")
    return None


def _refuse_if_explained(truth: Array, how: str, changed: float, residual: float, *, allowed: str, remedy: str) -> None:
    """Refuse true views that explain the measurement, to a residual, only if they are changed in some way."""
    if changed < EXPLAINED and changed < 0.2 * residual:
        raise InputError(
            f"{truth.where}: the true views explain the measurement with {how} (residual {changed:.2%}), not as given "
            f"({residual:.2%})",
            allowed=allowed,
            remedy=remedy,
        )


def _doubt_first(
    truth: Array,
    measurement: F64,
    coding: CodingConvention,
    views: F32,
    cfa: CfaPattern | None,
    residual: float,
    guesses: list[str],
) -> None:
    """Say if the true views explain the measurement better when they begin one mask earlier or later."""
    for words, moved in (
        ("one mask later", np.concatenate([views[:1], views[:-1]])),
        ("one mask earlier", np.concatenate([views[1:], views[-1:]])),
    ):
        _, beside = fit(measurement, coding.forward(moved, cfa))
        if beside < _MOVED * residual:
            guesses.append(
                f"WARNING: {truth.where}: the true views explain the measurement better {words} (residual "
                f"{beside:.2g}, as given {residual:.2g}): scores compare each with the view of its mask; is a frame "
                "missing or too many?"
            )


def _snapped(scale: float, views: int) -> float:
    usual = [full / divisor for full in FULL_SCALES.values() for divisor in (1, views)]
    nearest = min(usual, key=lambda value: abs(np.log(value / scale)))
    return nearest if abs(nearest / scale - 1) < SNAP else scale
