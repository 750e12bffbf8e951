"""The light that a DLPC900 makes of a grey level, under a lamp that follows its LED enables or one that stays on.

A pattern of several bits is shown bit plane by bit plane, each for a time in proportion to its weight. Loading the
mirrors takes 105 us (DLPU018, table 2-82, 1 bit), so that a plane of a shorter time stays for that long and its light
is switched off for the rest ("The shorter bit times are achieved by Solid State illumination modulation ... the
illumination is not on the entire time", e2e.ti.com thread 953168). A lamp that stays on lights it for all of it; the
longer planes share what is left of the pattern's time.

Here: the share of light by level. Not here: the sequence (`dlpc900_sequencer`).
"""

from typing import Final, Literal

import numpy as np

from gs2ci.core.arrays import F64, U8, U16

Lamp = Literal["switched", "continuous"]
LOAD_S: Final = 105e-6
FULL: Final = 65_535


def plane_times_s(depth: int, exposure_s: float) -> F64:
    """Return for how long each bit plane is on the mirrors, from the lowest, [depth] s; their sum is the exposure."""
    weights = 2.0 ** np.arange(depth)
    times_s = np.full(depth, LOAD_S)
    for short in range(depth):  # so many planes take the time of a load
        unit_s = (exposure_s - short * LOAD_S) / weights[short:].sum()
        if unit_s * weights[short] >= LOAD_S or short == depth - 1:
            times_s[short:] = unit_s * weights[short:]
            break
    return times_s


def light_of(levels: U8, depth: int, exposure_s: float) -> U16:
    """Return the light of each mirror under a lamp that stays on, [H, W], `FULL` for a mirror that is always open."""
    shares = plane_times_s(depth, exposure_s) / exposure_s
    bits = np.arange(1 << depth)[:, None] >> np.arange(depth) & 1
    return np.rint(FULL * bits @ shares).astype(np.uint16)[levels]
