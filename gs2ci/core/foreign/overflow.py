"""Readings that went round: a sum too large for its integers, or a difference below zero in integers without a sign.

Here: finding them by what their neighbours read, and putting them back. Not here: other curves (`curves`).
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64
from gs2ci.core.linearity import lattices, local_mean

BITS: Final = (8, 10, 12, 14, 16)
# A sum that overflows anywhere comes close to the end of the range somewhere.
_NEAR_END: Final = 0.9
# Numbers in float32 are whole multiples up to this share of one; so many of them are asked.
_WHOLE: Final = 0.02
_SAMPLE: Final = 4096
_MOST_ROUNDS: Final = 16
_STEPS: Final = 40
# Of readings below zero, a few codes at the very end of the range are taken, and next to none below them.
_END: Final = 0.98
_EMPTY_FROM: Final = 0.5
_EMPTY: Final = 0.02
_FEWEST: Final = 3


def wrap_of(stored: NDArray[Any]) -> float | None:
    """Return the range after which readings of whole numbers begin again at 0 if they overflow; None: they cannot.

    Whole numbers that were divided by the end of their range, to lie in 0..1, count as well.
    """
    low, high = float(stored.min()), float(stored.max())
    if low < 0:
        return None
    unit = 1.0
    if stored.dtype.kind not in "ui" and not bool((stored == np.rint(stored)).all()):
        ends = (end for bits in BITS for end in (2**bits - 1, 2**bits)) if high <= 1 else ()
        sample = stored.reshape(-1)[:: max(stored.size // _SAMPLE, 1)].astype(np.float64)
        unit = next(
            (1 / end for end in ends if float(np.abs(sample * end - np.rint(sample * end)).max()) < _WHOLE), 0.0
        )
    wrap = next((2.0**bits for bits in BITS if unit and high < 2**bits * unit * (1 - 1e-6)), None)
    return wrap * unit if wrap is not None and high >= _NEAR_END * wrap * unit else None


def unwrapped(readings: F64, open_masks: F64, wrap: float, *, is_mosaic: bool = False) -> F64:
    """Add to readings, [H, W], as many rounds as bring each closest to what its neighbours make of its open masks.

    What neighbours read is too low at first where many of them went round; so this is repeated until nothing changes.
    """
    result = readings.copy()
    for plane, opened in zip(lattices(result, is_mosaic), lattices(open_masks, is_mosaic), strict=True):
        stored, rounds = plane.copy(), np.zeros(plane.shape)
        share = opened / np.maximum(local_mean(opened), 1e-9)
        for _ in range(_STEPS):
            found = np.clip(np.rint((local_mean(plane) * share - stored) / wrap), 0, _MOST_ROUNDS)
            if np.array_equal(found, rounds):
                break
            rounds = found
            plane[:] = stored + wrap * rounds
    return result


def below_zero(stored: NDArray[Any]) -> NDArray[np.int64] | None:
    """Return readings with a sign if small negative numbers were stored in integers without one; None: there are none.

    So -3 became 65533 in 16 bits. They fill a few codes at the end of the range, and the other readings end far below;
    clipped readings and hot pixels are at one code.
    """
    if stored.dtype.kind != "u" or stored.dtype.itemsize > 4:
        return None
    size = 2 ** (8 * stored.dtype.itemsize)
    end = stored >= _END * size
    count = int(end.sum())
    if count < _FEWEST or int(((stored >= _EMPTY_FROM * size) & ~end).sum()) > _EMPTY * count:
        return None
    if len(np.unique(stored[end])) < 2:
        return None
    return np.where(end, stored.astype(np.int64) - size, stored.astype(np.int64))


def with_sign(where: str, stored: NDArray[Any], guesses: list[str]) -> NDArray[Any]:
    """Give readings below zero their sign back if they were stored in integers without one, and say so."""
    signed = below_zero(stored)
    if signed is None:
        return stored
    guesses.append(
        f"WARNING: {where}: {int((signed < 0).sum())} readings below zero were stored in integers without a sign "
        f"({int(signed.min())} as {int(stored[signed == signed.min()].max())}); they were given it back. Subtract in "
        "signed integers"
    )
    return signed
