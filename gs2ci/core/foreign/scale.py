"""What reading stands for full scale: of the masks, of the true views, of the measurement.

Masks come as {0, 1}, {0, 255}, grey bytes or calibrated floats; measurements in units of one view's full scale, in
camera counts, or squeezed into the range of a camera that exposed all masks at once. Under masks of multiplicity a(p) =
Σ wᵢ Mᵢ(p) (what a white scene would measure) a pixel reads at most a(p) times the full scale S of one view, and the
brightest parts of a scene read a good share of that: so the ratio reading / a(p) tells S among the usual ones. Not
here: the test against a known truth (`agreement.py`).
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import Array
from gs2ci.core.foreign.pixels import LARGEST

FULL_SCALES: Final[dict[str, float]] = {
    "unit": 1.0,
    "8-bit": 255.0,
    "10-bit": 1023.0,
    "12-bit": 4095.0,
    "14-bit": 16383.0,
    "16-bit": 65535.0,
}
# The brightest thousandth of a scene lies between these shares of full scale: noise may carry it a little over,
# and a scene darker than a twentieth is not exposed for in practice.
OVER: Final = 1.1
WELL_EXPOSED: Final = 0.3
DARK: Final = 0.05
# Of readings that fill a camera's range with the sum over the masks, where the scale is a guess in any case.
FAIRLY_EXPOSED: Final = 0.2
# Calibrated masks may overshoot 1 by noise; beyond this they are in another unit.
MASK_OVERSHOOT: Final = 1.05
# A mask that lets more than this through everywhere is closed nowhere.
OPEN: Final = 0.5
_MISPLACED: Final = 6.0
# All but so many of the values are no defects of single pixels; what stands out from them by this factor is one, and so
# is a reading that exceeds by it what lies two pixels away, in the same colour of a mosaic, along a row or a column.
_SOUND: Final = 0.999
_STANDS_OUT: Final = 1.5
# Lamps and glints are a smaller share of true views than the rest of this.
_ALL_BUT_LAMPS: Final = 0.98


@dataclass(frozen=True)
class Scale:
    """The full scale of one view in the file's unit.

    Args:
        value: A reading.
        reason: How it was found.
        explains: Whether it explains the readings.
        stated: Whether the user or the truth states it, so that a scene that is dark in it is dark.
    """

    value: float
    reason: str
    explains: bool = True
    stated: bool = False


def scale_masks(masks: Array, stack: NDArray[Any], said: float | None, guesses: list[str]) -> F32:
    """Turn masks into transmissions.

    Args:
        masks: For messages.
        stack: The values, [N, H, W].
        said: The reading of a fully open mask, if the user gave it.
        guesses: Sentences are added here.

    Raises:
        InputError: NaN, negative beyond noise or zero everywhere, or above the reading that the user gave.
    """
    values = stack.astype(np.float64)
    bad = int((~(np.abs(values) <= LARGEST)).sum())
    if bad:
        raise InputError(
            f"{masks.where}: {bad} values are NaN, infinite or far too large",
            allowed="transmissions, >= 0",
            remedy="set dead mask pixels to 0 (never open) and mend the same pixels of the measurement",
        )
    high, below = _sound_top(values), int((values < 0).sum())
    if float(np.quantile(values, 1 - _SOUND)) < (1 - MASK_OVERSHOOT) * high:
        raise InputError(
            f"{masks.where}: masks are negative at {below} places, down to {values.min():.4g}",
            allowed="transmissions, >= 0 apart from noise",
            remedy="save the masks themselves, not codes of -1 and 1 or differences",
        )
    if high <= 0:
        raise InputError(
            f"{masks.where}: all masks are zero", remedy="check that the masks were shown, exposed and saved"
        )
    if said is not None and not (np.isfinite(said) and said > 0 and high <= said * MASK_OVERSHOOT):
        raise InputError(
            f"{masks.where}: masks read up to {high:.6g} with --mask-scale {said:.6g}",
            allowed=f"a scale of at least {high:.6g}, the reading of a fully open mask",
            remedy="give that reading, or leave --mask-scale out",
        )
    full = said if said is not None else (1.0 if high <= MASK_OVERSHOOT else high)
    if below:
        guesses.append(
            f"masks: {below} values below 0, down to {values.min():.4g}, as noise leaves them, were set to 0"
        )
    transmissions: F32 = np.clip(values / full, 0, 1).astype(np.float32)
    guesses.extend(_mask_sentences(np.maximum(values, 0), full, said is None))
    return transmissions


def _sound_top(values: F64) -> float:
    """Return the largest value of masks, [N, H, W], but of pixels hot in all of them, or divided by nothing."""
    top = values.max(axis=0)
    closes = values.min(axis=0) <= OPEN * top
    rest = top[closes] if closes.any() else top
    limit = _STANDS_OUT * float(np.quantile(rest, _SOUND))
    return float(top.max()) if limit <= 0 or top.max() <= limit else float(rest[rest <= limit].max())


def _mask_sentences(values: F64, full: float, guessed: bool) -> list[str]:
    levels = np.unique(values[:, ::7, ::7])  # a sample suffices to find grey levels
    binary = len(levels) <= 2 and bool(np.isin(values, (0.0, full)).all())
    sentences = [
        f"masks: {'binary' if binary else 'grey'}, "
        f"{float(values.mean()) / full:.1%} open, fully open = {full:.6g}" + (" (guessed)" if guessed else "")
    ]
    over = int((values > full).sum())
    if over:
        hot = "WARNING: hot or dead pixels? " if values.max() > _STANDS_OUT * full else ""
        sentences.append(f"{hot}masks: {over} values above fully open, up to {values.max():.6g}, were set to 1")
    dark = [i for i, mask in enumerate(values) if not mask.any()]
    if dark:
        sentences.append(f"WARNING: masks {dark} never open: their views cannot be recovered")
    white = [i for i, mask in enumerate(values) if mask.min() > OPEN * full]
    if 0 < len(white) < len(values):
        sentences.append(
            f"WARNING: masks {white} are closed nowhere, as the frame of a white screen is: take them out if the "
            "exposure does not contain them (--views, where they are the last)"
        )
    alike: dict[bytes, list[int]] = {}
    for i, mask in enumerate(values):
        alike.setdefault(mask.tobytes(), []).append(i)
    sentences += [
        f"WARNING: masks {same} are identical: their views cannot be separated"
        for same in alike.values()
        if len(same) > 1
    ]
    return sentences


def scale_views(truth: Array, views: NDArray[Any], guesses: list[str]) -> F32:
    """Turn true views, [N, H, W, C], into float32 with full scale 1.

    Raises:
        InputError: NaN, or negative beyond noise.
    """
    if not (np.abs(views) <= LARGEST).all():
        raise InputError(
            f"{truth.where}: true views hold NaN, infinity or numbers that are far too large",
            remedy="mend them, or say --truth-key none",
        )
    low, high = float(views.min()), float(views.max())
    # Counts are whole numbers: what is brighter than white among others is a lamp.
    whole = views.dtype.kind in "ui" or bool((views == np.rint(views)).all())
    full = smallest_full_scale(high if whole else float(np.quantile(views, _ALL_BUT_LAMPS)))
    if low < -DARK * full or full == 0:
        raise InputError(
            f"{truth.where}: true views reach from {low:.4g} to {high:.4g}",
            allowed="light, >= 0, in units of 1, 255, 1023, 4095, 16383 or 65535",
            remedy="convert them, or say --truth-key none",
        )
    if views.dtype == np.uint8 and high > 1:
        full = 255.0
    guesses.append(f"truth: full scale {full:.6g}")
    return views.astype(np.float32) / np.float32(full)


def smallest_full_scale(high: float) -> float:
    """Find the smallest usual full scale that a reading does not exceed (by more than noise); 0: none."""
    return min((full for full in FULL_SCALES.values() if high <= full * OVER), default=0.0)


def guess_scale(measurement: Array, values: F64, multiplicity: F64, views: int, *, mendable: bool = False) -> Scale:
    """Guess the full scale of one view from readings alone.

    Args:
        measurement: For messages.
        values: Readings above the offset, [K, H, W, C].
        multiplicity: a(p), [H, W].
        views: How many masks there are, N.
        mendable: Whether masks that lie elsewhere, a black level or a unit may explain what no scale does: the masks'
            pattern shows in the readings.

    Raises:
        InputError: Readings are negative beyond noise, or no usual scale explains them.
    """
    high = float(values.max())
    if high <= 0 and not values.any():
        return Scale(1.0, "the measurement is zero everywhere: any scale fits")
    ratio = brightest_ratio(values, multiplicity)
    low = float(np.quantile(values, 0.001))
    if low < -DARK * np.quantile(values, 0.999) and not mendable:
        raise InputError(
            f"{measurement.where}: readings go down to {float(values.min()):.6g} (up to {high:.6g}), "
            "which no light gives",
            allowed="readings >= 0 apart from noise",
            remedy="give the reading without light as --offset",
        )
    found = _plain(ratio, WELL_EXPOSED) or _per_exposure(ratio, high, multiplicity, views) or _plain(ratio, DARK)
    if found is not None:
        return found
    bound = float(multiplicity.max())
    if mendable:
        # Masks that lie elsewhere put bright readings under few open masks, by no more than this.
        nearest = max((full for full in FULL_SCALES.values() if full <= ratio <= _MISPLACED * full), default=1.0)
        return Scale(
            nearest,
            f"{ratio:.4g} per open mask, which no usual scale explains; the masks' pattern shows, and the registration "
            "of `gs2ci reconstruct` finds out whether masks, black level or unit are wrong",
            explains=False,
        )
    raise InputError(
        f"{measurement.where}: readings up to {high:.6g} where at most {bound:.3g} of the masks are open, "
        f"{ratio:.4g} per open mask: no usual scale explains that",
        allowed=f"a full scale of {', '.join(f'{full:g}' for full in FULL_SCALES.values())}, per view or exposure",
        remedy="check that these are the masks of this measurement, or give the full scale of one view as --scale",
    )


def _plain(ratio: float, least: float) -> Scale | None:
    for name, full in FULL_SCALES.items():
        if least * full <= ratio <= OVER * full:
            dark = ", a dark scene" if least < WELL_EXPOSED else ""
            return Scale(full, (f"{name} counts per view" if full > 1 else "full scales of one view") + dark)
    return None


def _per_exposure(ratio: float, high: float, multiplicity: F64, views: int) -> Scale | None:
    """Explain readings that fill a camera's range with the sum over all masks."""
    for name, full in FULL_SCALES.items():
        if not WELL_EXPOSED * full <= high <= OVER * full:
            continue
        mean = full / views
        if 2 * WELL_EXPOSED * mean <= ratio <= OVER * mean:
            return Scale(mean, f"normalised per exposure: the mean over {views} masks, {name}")
        if high == full:
            return Scale(ratio, f"normalised to its own maximum, {name}; its brightest part taken for white")
        # A camera that was exposed so that the scene fills its range; the peers' convention for real data.
        filled = full / float(multiplicity.mean())
        if FAIRLY_EXPOSED * filled <= ratio <= 2 * filled:
            return Scale(filled, f"normalised per exposure: {name} range over the masks' mean multiplicity")
    return None


def brightest_ratio(values: F64, multiplicity: F64) -> float:
    """Get the reading per open mask that all but a thousandth of the well covered, sound pixels, [H, W], stay below."""
    covered = multiplicity >= 0.5 * np.median(multiplicity[multiplicity > 0])
    per_mask = np.where(covered[:, :, None], values / np.where(covered, multiplicity, 1.0)[:, :, None], 0.0)
    beside = [
        ndimage.maximum_filter(per_mask, footprint=np.array([1, 0, 0, 0, 1]).reshape(side), mode="mirror")
        for side in ((1, 5, 1, 1), (1, 1, 5, 1))
    ]
    sound = covered[:, :, None] & (per_mask <= _STANDS_OUT * np.minimum(*beside))
    return float(np.quantile(per_mask[sound if sound.any() else np.full(sound.shape, True)], _SOUND))
