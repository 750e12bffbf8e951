"""Finding an exposure at which the flat field fills a share of the sensor's range.

Here: the search. Not here: the measurements at that exposure.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.ndimage import uniform_filter

from gs2ci_calibration.bench import Bench
from gs2ci_calibration.frames import Dark
from gs2ci_calibration.refusals import CalibrationError, Reason

SHORTEST_S: Final = 0.5e-3
"""Below this the jitter of a trigger, some microseconds, would change the light by more than the limit for flicker."""
LONGEST_S: Final = 2.0
BRIGHT_QUANTILE: Final = 0.99
SMOOTH_PX: Final = 5
"""Side of the square over which a frame is averaged before its brightest part is searched for, against noise."""
NO_LIGHT_DN: Final = 3.0
"""If the flat field is brighter than the dark by less than this at the longest exposure, there is no light."""
LONGER: Final = 1.5
HEADROOM: Final = 1.42
"""An exposure longer by the first factor must raise the signal by the second one, or readings are clipped."""
CLIP_SHARE: Final = 0.05
"""Readings below this share of the converter's range do not count as clipped: noise is too large a part of them."""
ROUNDS: Final = 12


@dataclass(frozen=True)
class Level:
    """The result of the search.

    Args:
        exposure_s: The exposure.
        rate_dn_per_s: How fast the brighter pixels fill.
    """

    exposure_s: float
    rate_dn_per_s: float


def limits_s(bench: Bench) -> tuple[float, float]:
    """Return the shortest and the longest exposure that procedures use on this bench."""
    shortest, longest = bench.exposure_limits_s
    return max(shortest, SHORTEST_S), min(longest / LONGER, LONGEST_S)


def find_exposure(bench: Bench, step: str, dark: Dark, share: float) -> Level:
    """Find the exposure at which the bright pixels of the open field reach a share of their range.

    The operator has set up the flat field. Clipping is detected by a longer exposure, which must give more signal; so
    a full well below the converter's top is detected, too, and the share then refers to the well.

    Args:
        bench: The bench.
        step: For messages.
        dark: The sensor's readings without light.
        share: Share of the range from black to the converter's top, or to the full well.

    Raises:
        CalibrationError: The field is dark, or clipped at the shortest exposure.
    """
    shortest_s, longest_s = limits_s(bench)
    wanted_dn = share * (bench.top_dn - float(np.median(dark.offset_dn)))
    exposure_s = float(np.clip(bench.capture.mask_s, shortest_s, longest_s))
    signal_dn = 0.0
    for _ in range(ROUNDS):
        signal_dn = _signal_dn(bench, dark, exposure_s)
        more_dn = _signal_dn(bench, dark, LONGER * exposure_s)
        clipped = signal_dn > CLIP_SHARE * bench.top_dn and more_dn < HEADROOM * signal_dn
        if clipped or signal_dn > 1.2 * wanted_dn:
            if exposure_s <= shortest_s:
                _refuse_bright(step, signal_dn, exposure_s)
            wanted_dn = min(wanted_dn, share * more_dn) if clipped else wanted_dn
            exposure_s = max(exposure_s / 4 if clipped else exposure_s * wanted_dn / signal_dn, shortest_s)
        elif signal_dn < 0.8 * wanted_dn and exposure_s < longest_s:
            exposure_s = min(exposure_s * min(wanted_dn / max(signal_dn, 1.0), 16.0), longest_s)
        else:
            break
    if signal_dn < NO_LIGHT_DN:
        raise CalibrationError(
            step,
            Reason.NO_LIGHT,
            f"the flat field is {signal_dn:.2f} DN above the dark frames after {exposure_s:.3g} s",
            allowed=f"{NO_LIGHT_DN:.0f} DN or more",
            remedy="take the lens cap off, switch the lamp on, check that the modulator lets light through",
        )
    return Level(exposure_s, signal_dn / exposure_s)


def _signal_dn(bench: Bench, dark: Dark, exposure_s: float) -> float:
    pattern = bench.flat_pattern(is_open=True)[None]
    frame = bench.grab(pattern, frames=1, exposure_s=exposure_s).readings[0, 0]
    signal = np.where(dark.hot, 0.0, frame - dark.at(exposure_s))
    return float(np.quantile(uniform_filter(signal, SMOOTH_PX), BRIGHT_QUANTILE))


def _refuse_bright(step: str, signal_dn: float, exposure_s: float) -> None:
    raise CalibrationError(
        step,
        Reason.SATURATED,
        f"the flat field reads {signal_dn:.0f} DN above the dark and is clipped after {exposure_s * 1e3:.3g} ms",
        allowed="readings that follow the exposure",
        remedy="dim the lamp, close the aperture or put a grey filter before it",
    )
