"""Mask codes and where they lie on the modulator.

Here: drawing or reading codes at the sensor's resolution, and laying them out on the modulator's own pixels. Not here:
measuring the masks as the sensor sees them (`gs2ci_calibration`).
"""

from itertools import product
from pathlib import Path
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, U8, U16, Bool
from gs2ci.core.errors import InputError
from gs2ci.core.foreign.opening import load_single
from gs2ci.rig.config import CaptureTable, RegistrationTable

MOST_ROUNDED: Final = 0.05
"""Transmissions are rounded to the nearest level that a mask of the stated depth can show, by no more than this. Beyond
it, grey masks would be shown as other ones: at one bit as binary ones."""

SPREAD_FROM: Final = 1.9
"""From so many open masks an element on, in the mean, each is opened. With fewer nearly all would be open in just one,
and the masks' sum would lose the pattern by which they are found in a reading."""

ROUNDS: Final = 2
"""Of the search for even masks: a third gives 0.02 dB at most."""

NEAR: Final = {-2: 1, -1: 4, 0: 6, 1: 4, 2: 1}
"""How elements count as near, along rows and columns: whole numbers, so that a seed gives the same masks anywhere."""

STEPS: Final = (1, 2)
"""From element to element: of all, and of those of one colour of a mosaic, which has to be covered evenly as well."""


def draw_codes(table: CaptureTable, size: tuple[int, int], folder: Path) -> U16:
    """Return mask codes as levels 0 to 2**bit_depth − 1, [N, H, W] uint16.

    Args:
        table: The [capture] table.
        size: The sensor's height and width.
        folder: Where a relative `pattern_file` lies.

    Raises:
        InputError: The pattern file cannot be used.
    """
    top = 2**table.bit_depth - 1
    if table.pattern_file:
        shares = _read_codes(folder / table.pattern_file, size)
        levels = np.rint(shares * top)
        rounded = float(np.abs(levels / top - shares).max())
        if rounded > MOST_ROUNDED:
            raise InputError(
                f"pattern_file {table.pattern_file} holds levels that bit_depth = {table.bit_depth} in [capture] "
                f"cannot show: they would be rounded by up to {rounded:.2g}",
                allowed=f"multiples of 1/{top}, or rounding by up to {MOST_ROUNDED:g}",
                remedy="set bit_depth = 8 in [capture] for grey masks, or round the masks yourself",
            )
        return np.asarray(levels, dtype=np.uint16)
    rng = np.random.default_rng(np.random.SeedSequence(table.seed))
    side = table.element
    is_open = rng.random((table.masks, *(-(-edge // side) for edge in size))) < table.density
    if table.even_masks:
        is_open = _even(is_open, rng)
    is_open = is_open.repeat(side, axis=1).repeat(side, axis=2)[:, : size[0], : size[1]]
    return np.asarray(np.where(is_open, top, 0), dtype=np.uint16)


def _even(masks: Bool, rng: np.random.Generator) -> Bool:
    """Choose anew which masks open an element, so that the open elements of each mask lie evenly: as blue noise.

    In independent draws they lie in clumps, with gaps in which a view is not seen at all (codes for several exposures
    are designed likewise: Correa, Arguello and Arce, Spatiotemporal blue noise coded aperture design, JOSA A 33, 2016).
    And what is behind an element that stays closed is never seen, of eight masks a quarter open a tenth: it is opened
    once, and one that is open more often is closed once.
    """
    times = masks.sum(axis=0)
    if masks.mean() * len(masks) >= SPREAD_FROM:
        closed, shared = (np.flatnonzero(one) for one in (times == 0, times > 1))
        count = min(len(closed), len(shared))
        times.flat[rng.choice(closed, count, replace=False)] += 1
        times.flat[rng.choice(shared, count, replace=False)] -= 1
    even = masks.copy()
    apart = 2 * max(STEPS)
    for _ in range(ROUNDS):
        # What is chosen at once is not near each other.
        for row, column in rng.permutation(list(product(range(apart), repeat=2))):
            some = np.s_[:, row::apart, column::apart]
            around = np.pad(even, ((0, 0), (apart, apart), (apart, apart)), mode="wrap").view(np.uint8)
            shape = even[some].shape
            near = np.zeros(shape, np.uint16)
            for step in STEPS:
                in_rows = np.zeros((*around.shape[:2], shape[2]), np.uint8)
                for right, wide in NEAR.items():
                    in_rows += np.uint8(wide) * around[..., apart + column + step * right :: apart][..., : shape[2]]
                for down, high in NEAR.items():
                    near += np.uint16(high) * in_rows[:, apart + row + step * down :: apart][:, : shape[1]]
                near -= np.uint16(NEAR[0] ** 2) * even[some]
            order = near + rng.random(shape, np.float32)  # among equals chance decides
            even[some] = order.argsort(axis=0, kind="stable").argsort(axis=0) < times[some[1:]]
    return even


def _read_codes(path: Path, size: tuple[int, int]) -> F32:
    try:
        codes = load_single(path).values
    except InputError as error:
        raise InputError(f"pattern_file {error.problem}", allowed=error.allowed, remedy=error.remedy) from error
    if codes.ndim != 3 or codes.shape[1:] != size or not len(codes):
        raise InputError(
            f"pattern_file {path} holds {codes.dtype} of shape {list(codes.shape)}",
            allowed=f"numbers of shape [N, {size[0]}, {size[1]}], N of 1 or more",
        )
    shares: F32 = np.asarray(codes, dtype=np.float32)
    if not np.isfinite(shares).all() or shares.min() < 0 or shares.max() > 1:
        raise InputError(f"pattern_file {path} holds values outside [0, 1]", allowed="[0, 1]")
    return shares


def origin(table: RegistrationTable, size: tuple[int, int], modulator: tuple[int, int]) -> tuple[int, int]:
    """Return the modulator's first row and column that the sensor sees.

    Raises:
        InputError: The masks do not fit on the modulator.
    """
    k = table.superpixel
    first = []
    for given, side, there in zip((table.row, table.column), size, modulator, strict=True):
        start = (there - k * side) // 2 if given < 0 else given
        if start < 0 or start + k * side > there:
            raise InputError(
                f"masks of {size[0]} x {size[1]} elements at {k} modulator pixels each do not fit",
                allowed=f"inside {modulator[0]} x {modulator[1]} modulator pixels",
                remedy="change [registration], or the sensor's height and width",
            )
        first.append(start)
    return first[0], first[1]


def on_modulator(codes: U16, table: RegistrationTable, modulator: tuple[int, int]) -> U8 | U16:
    """Lay codes out on the modulator's pixels; pixels that the sensor does not see stay closed.

    Args:
        codes: [N, H, W].
        table: The [registration] table.
        modulator: The modulator's height and width.

    Returns:
        [N, Hm, Wm], uint8 if the levels fit.

    Raises:
        InputError: The masks do not fit on the modulator.
    """
    k = table.superpixel
    height, width = codes.shape[1:]
    row, column = origin(table, (height, width), modulator)
    kind = np.uint8 if codes.max(initial=0) < 256 else np.uint16
    laid = np.zeros((len(codes), *modulator), kind)
    rows = codes.astype(kind).repeat(k, axis=2)
    for first in range(row, row + k):
        laid[:, first : first + k * height : k, column : column + k * width] = rows
    return laid
