"""Finding an exposure at which the even light fills a share of the sensor's range.

Here: the search. Not here: what is measured then. The procedures of this package import this file.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci_calibration.bench import Bench
from gs2ci_calibration.refusals import CalibrationError, Reason

F64 = NDArray[np.float64]

SHORTEST_S: Final = 0.5e-3
"""Below this the jitter of a trigger, some microseconds, would change the light by more than flicker may."""
LONGEST_S: Final = 2.0
BRIGHT_QUANTILE: Final = 0.99
NO_LIGHT_DN: Final = 3.0
"""A flat field that is brighter than the dark by less than this, at the longest exposure, is none."""
HALF_LIMITS: Final = (0.44, 0.56)
"""Of the signal at half the exposure over that at the whole: outside, readings do not follow the light."""
ROUNDS: Final = 12


@dataclass(frozen=True)
class Level:
    """An exposure that was found.

    Args:
        exposure_s: It.
        rate_dn_per_s: How fast the brighter pixels fill there.
    """

    exposure_s: float
    rate_dn_per_s: float


def limits_s(bench: Bench) -> tuple[float, float]:
    """Return the shortest and the longest exposure that procedures use on this bench."""
    shortest, longest = bench.exposure_limits_s
    return max(shortest, SHORTEST_S), min(longest, LONGEST_S)


def find_exposure(bench: Bench, step: str, dark_dn: F64, share: float) -> Level:
    """Find the exposure at which the bright pixels of the open field reach a share of the range above black.

    The operator has set up the flat field. Clipping is found by halving the exposure, which has to halve the signal,
    so that a full well below the converter's top is found too.

    Args:
        bench: The bench.
        step: For messages.
        dark_dn: Reading without light, [H, W].
        share: Of the range from black to the converter's top.

    Raises:
        CalibrationError: The field is dark, or clipped at the shortest exposure.
    """
    shortest_s, longest_s = limits_s(bench)
    wanted_dn = share * (bench.top_dn - float(np.median(dark_dn)))
    exposure_s = float(np.clip(bench.capture.mask_s, shortest_s, longest_s))
    for _ in range(ROUNDS):
        signal_dn = _signal_dn(bench, dark_dn, exposure_s)
        half_dn = _signal_dn(bench, dark_dn, exposure_s / 2)
        clipped = half_dn > NO_LIGHT_DN and half_dn > HALF_LIMITS[1] * signal_dn
        if clipped or signal_dn > 1.2 * wanted_dn:
            if exposure_s <= shortest_s:
                _refuse_bright(step, signal_dn, exposure_s)
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


def _signal_dn(bench: Bench, dark_dn: F64, exposure_s: float) -> float:
    pattern = bench.flat_pattern(is_open=True)[None]
    frame = bench.grab(pattern, frames=1, exposure_s=exposure_s).readings[0, 0]
    return float(np.quantile(frame - dark_dn, BRIGHT_QUANTILE) - np.quantile(dark_dn - np.median(dark_dn), BRIGHT_QUANTILE))


def _refuse_bright(step: str, signal_dn: float, exposure_s: float) -> None:
    raise CalibrationError(
        step,
        Reason.SATURATED,
        f"the flat field reads {signal_dn:.0f} DN above the dark and is clipped after {exposure_s * 1e3:.3g} ms",
        allowed="readings that follow the exposure",
        remedy="dim the lamp, close the aperture or put a grey filter before it",
    )
