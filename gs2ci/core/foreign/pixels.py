"""Single pixels that need care: unreadable ones and clipped ones."""

from typing import Final, Literal

import numpy as np

from gs2ci.core.arrays import F64, Bool
from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import Array

BadPixels = Literal["refuse", "median"]

# No camera reads more; larger numbers are damage, and their squares overflow.
LARGEST: Final = 1e15
# More than this share of mended pixels is no longer a measurement with a few dead ones.
MOST_BAD: Final = 0.1
# Highest code of the usual converters, of 10, 12 and 14 bits also as the high bits of 16; and the share of readings
# there that only clipping explains.
TOP_CODES: Final = (255, 1023, 4095, 16383, 65472, 65520, 65532, 65535)
PILE_UP: Final = 5e-4
# Elsewhere readings count as piled up at the largest if so many are there, and no fewer than close below it.
_FEWEST_PILED: Final = 10
_CLOSE_BELOW: Final = 0.95
# Behind masks that differ by less, a white scene gives equal readings.
_SAME_MULTIPLICITY: Final = 0.01
# Noise about 0 leaves half of the readings of a dark picture below it.
MOST_NEGATIVE: Final = 0.9
# Noise does not carry readings as far below 0 as this share of the bright ones.
_FAR_BELOW: Final = 0.3
# Highlights may clip; a picture that clips over more than this was exposed for too long.
MANY_CLIPPED: Final = 0.05


def lit(measurement: Array, readings: F64, guesses: list[str]) -> F64:
    """Return readings above the one without light, [K, H, W, C]: light has no negative sign.

    Raises:
        InputError: Nearly all are below 0.
    """
    share = float((readings < 0).mean())
    if share > MOST_NEGATIVE:
        raise InputError(
            f"{measurement.where}: {share:.0%} of the readings lie below the reading without light",
            allowed=f"at most {MOST_NEGATIVE:.0%} below 0 once it is subtracted",
            remedy="subtract the dark frame from the lit one, not the reverse; or correct --offset",
        )
    low, high = np.quantile(readings, (0.001, 0.999))
    if low < -_FAR_BELOW * high:
        guesses.append(
            f"WARNING: {measurement.where}: {share:.0%} of the readings lie below the one without light, down to "
            f"{low:.6g} (up to {high:.6g}), as after a mean is subtracted: give --offset, or save them as they were"
        )
    return readings


def mend(
    measurement: Array, readings: F64, offset: float, multiplicity: F64, how: BadPixels, guesses: list[str]
) -> F64:
    """Replace NaN, infinity and numbers that are far too large in a measurement.

    Args:
        measurement: For messages.
        readings: As stored, [K, H, W, C].
        offset: Reading without light: only what lies above it grows with the open masks.
        multiplicity: a(p) = Σ wᵢ Mᵢ(p), [H, W].
        how: "refuse", or "median": the neighbours' median reading per open mask, times the masks open there.
        guesses: Sentences are added here.

    Raises:
        InputError: There are any and they are refused, or too many to be mended.
    """
    bad = ~(np.abs(readings) <= LARGEST)
    readings = np.where(bad, np.nan, readings)
    count = int(bad.any(axis=3).sum())
    if not count:
        return readings
    if how == "refuse" or count > MOST_BAD * bad[..., 0].size:
        row, column = np.argwhere(bad.any(axis=(0, 3)))[0].tolist()
        mendable = count <= MOST_BAD * bad[..., 0].size
        raise InputError(
            f"{measurement.where}: {count} pixels are NaN, infinite or far too large, "
            f"the first at row {row}, column {column}",
            allowed=f"finite readings, or with --bad-pixels median up to {MOST_BAD:.0%} bad ones",
            remedy="say --bad-pixels median to replace them" if mendable else "mend the measurement before saving",
        )
    guesses.append(f"{count} bad pixels replaced: median of their neighbours per open mask")
    mended = readings.copy()
    for k in range(readings.shape[0]):
        for channel in range(readings.shape[3]):
            _mend_plane(mended[k, :, :, channel], offset, multiplicity)
    return mended


def _mend_plane(plane: F64, offset: float, multiplicity: F64) -> None:
    """Fill NaN in place; neighbours lie an even number of pixels away, so in a mosaic they share the colour."""
    with np.errstate(invalid="ignore", divide="ignore"):
        per_mask = np.where(multiplicity > 0, (plane - offset) / multiplicity, np.nan)
    for row, column in np.argwhere(~np.isfinite(plane)):
        for reach in range(2, 2 * max(plane.shape), 2):
            top, left = (p - reach if p >= reach else p % 2 for p in (row, column))
            window = per_mask[top : row + reach + 1 : 2, left : column + reach + 1 : 2]
            good = window[np.isfinite(window)]
            if good.size:
                plane[row, column] = offset + float(np.median(good)) * multiplicity[row, column]
                break
        else:
            plane[row, column] = offset


def clipped(readings: F64, said: float | None, multiplicity: F64, guesses: list[str]) -> Bool | None:
    """Find readings that say only «at least».

    Args:
        readings: As stored, before any offset, [K, H, W, C].
        said: Level from which readings are clipped; 0: none is; None: guess from a pile-up at a top code. One at
            another level, as after the subtraction of a black level, is only pointed out.
        multiplicity: a(p) = Σ wᵢ Mᵢ(p), [H, W].
        guesses: Sentences are added here.

    Returns:
        [K, H, W], or None where no pixel is clipped.

    Raises:
        InputError: The level is no reading.
    """
    if said is not None and not 0 <= said < np.inf:
        raise InputError(f"--saturation {said:g}", allowed="the reading from which on pixels are clipped; 0: none is")
    level = said
    if level is None:
        high = float(readings.max())
        piled = int((readings == high).sum())
        if high not in TOP_CODES or piled < max(2.0, PILE_UP * readings.size):
            _doubt_largest(readings, high, multiplicity, guesses)
            return None
        level = high
    if level == 0:
        return None
    found: Bool = np.any(readings >= level, axis=3)
    warning = "WARNING: " if found.mean() > MANY_CLIPPED else ""
    guesses.append(
        f"{warning}{int(found.sum())} pixels ({found.mean():.2g} of all) at {level:.6g} or above count as clipped"
    )
    return found if found.any() else None


def _doubt_largest(readings: F64, high: float, multiplicity: F64, guesses: list[str]) -> None:
    """Say so if readings pile up at the largest one, which is no converter's highest code, as clipped ones do."""
    there = readings == high
    count = int(there.sum())
    close = int((readings >= _CLOSE_BELOW * high).sum()) - count
    open_there = multiplicity[there.any(axis=(0, 3))]
    if high <= 0 or count < max(_FEWEST_PILED, PILE_UP * readings.size, close):
        return
    if np.ptp(open_there) > _SAME_MULTIPLICITY * open_there.max():
        guesses.append(
            f"WARNING: {count} readings ({count / readings.size:.2g} of all) are exactly {high:.6g}, the largest, "
            f"behind different numbers of open masks, as clipped ones are: give --saturation {high!r} if they are, or "
            "--saturation 0 if they are exact"
        )
