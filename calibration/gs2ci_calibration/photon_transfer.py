"""The step `sensor`: an exposure sweep of the flat field, for the photon transfer curve.

Here: taking it and the section. Not here: its evaluation (`transfer_curve`), single pixels (`dark_flat`, whose section
this step needs).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci_calibration.bench import Arrangement, Bench, Stack
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.dark_flat import UNEVEN_LIMIT
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.exposing import Level, find_exposure, limits_s
from gs2ci_calibration.fitting import needed
from gs2ci_calibration.frames import Dark
from gs2ci_calibration.refusals import CalibrationError, Reason
from gs2ci_calibration.transfer_curve import LEVELS, STEP, ExposureSweep, Full, SensorEstimate, estimate

START_SHARE: Final = 0.5
LOWEST_SHARE: Final = 0.04
HIGHEST_SHARE: Final = 1.04
"""Exposures of the sweep, relative to the one that fills the pixels: from nearly zero to just beyond it."""
OVERFULL: Final = (1.6, 2.0)
"""Exposures at which all pixels are full, relative to the one that fills them."""
FULL_TOLERANCE: Final = 0.005
"""Largest relative increase of full pixels' readings between these two."""
DIM_QUANTILE: Final = 0.02


def measure(bench: Bench, known: Bundle) -> Section:
    """Sweep the exposure of the flat field and return the section `sensor`.

    Raises:
        CalibrationError: `dark-flat` is missing; light too strong, too weak or unsteady; readings that do not follow
            the light, or without noise.
        DriverError: A device failed.
    """
    section = needed(known, "dark-flat", bench, STEP)
    dark = Dark.of(section)
    noise = section.estimates["dark_noise_rms_dn"]
    bench.please(Arrangement.FLAT)
    start = find_exposure(bench, STEP, dark, START_SHARE)
    full = _take_full(bench, dark, start)
    sweep = _take_sweep(bench, dark, full)
    found = estimate(sweep, full, dark, (float(noise), float(noise.error)), bench.top_dn)
    return _section(bench, found)


def _take_full(bench: Bench, dark: Dark, start: Level) -> Full:
    """Fill the pixels and check that more light does not change their readings."""
    _, longest_s = limits_s(bench)
    pattern = bench.flat_pattern(is_open=True)[None]
    good, offset_dn = dark.good, float(np.median(dark.offset_dn))
    signal = _mean(bench.grab(pattern, frames=2, exposure_s=start.exposure_s)) - dark.at(start.exposure_s)
    # The first exposure was found by the brighter pixels; the dimmer ones must be full, too.
    dim = max(float(np.quantile(signal[good], DIM_QUANTILE)) / (start.rate_dn_per_s * start.exposure_s), UNEVEN_LIMIT)
    base_s = (bench.top_dn - offset_dn) / (start.rate_dn_per_s * dim)
    if OVERFULL[-1] * base_s > longest_s:
        raise CalibrationError(
            STEP,
            Reason.NO_LIGHT,
            f"the flat field would take {OVERFULL[-1] * base_s:.3g} s to fill the pixels",
            allowed=f"at most {longest_s:.3g} s",
            remedy="brighten the lamp or open the aperture",
        )
    nearly, wholly = (_mean(bench.grab(pattern, frames=4, exposure_s=share * base_s)) for share in OVERFULL)
    full_dn = float(np.mean(wholly[good])) - offset_dn
    growth = float(np.median((wholly - nearly)[good])) / full_dn
    if growth > FULL_TOLERANCE:
        raise CalibrationError(
            STEP,
            Reason.NOT_LINEAR,
            f"readings still grow by {100 * growth:.1f} % at {OVERFULL[1]:.1f} times the exposure that fills the range",
            allowed=f"at most {100 * FULL_TOLERANCE:.1f} %",
            remedy="switch off automatic gain and any tone curve of the sensor",
        )
    return Full(wholly, full_dn / start.rate_dn_per_s)


def _take_sweep(bench: Bench, dark: Dark, full: Full) -> ExposureSweep:
    """Take all levels upwards and then downwards, so that a steady drift of the lamp affects all levels equally."""
    shortest_s, _ = limits_s(bench)
    lowest = max(LOWEST_SHARE, shortest_s / full.fill_s)
    shares = np.linspace(lowest, HIGHEST_SHARE, LEVELS)
    frames = max(bench.options.frames // 4, 2)
    pattern = bench.flat_pattern(is_open=True)[None]
    bench.progress.stage("exposure sweep", 2 * LEVELS)
    stacks = []
    for done, share in enumerate((*shares, *shares[::-1])):
        stacks.append(bench.grab(pattern, frames=frames, exposure_s=float(share) * full.fill_s))
        mean_dn = float(stacks[-1].readings.mean())
        bench.progress.step(done + 1, mean_dn=mean_dn, exposure_ms=1e3 * stacks[-1].exposure_s)
    return ExposureSweep(
        tuple(stack.readings[0] for stack in stacks),
        np.array([stack.exposure_s for stack in stacks]),
        np.array([float(stack.time_s.mean()) for stack in stacks]),
    )


def _mean(stack: Stack) -> F64:
    return stack.readings[0].mean(axis=0, dtype=np.float64)


def _section(bench: Bench, found: SensorEstimate) -> Section:
    notes = [f"readings end at {found.saturation_dn[0]:.0f} DN, by the {found.limited_by}"]
    if found.limited_by == "converter":
        notes.append("the full well is larger than stated: the converter ends before it")
    return Section(
        name=STEP,
        estimates={
            "gain_e_per_dn": Estimate(*found.gain_e_per_dn, "e/DN"),
            "read_noise_e": Estimate(*found.read_noise_e, "e"),
            "full_well_e": Estimate(*found.full_well_e, "e"),
            "saturation_dn": Estimate(*found.saturation_dn, "DN"),
            "linearity_error": Estimate(*found.linearity_error, "1"),
            "linear_to_dn": Estimate(*found.linear_to_dn, "DN"),
        },
        arrays={
            "curve_signal_dn": found.signal_dn,
            "curve_variance_dn2": found.variance_dn2,
            "curve_exposure_s": found.exposures_s,
        },
        facts={
            "limited_by": found.limited_by,
            "flicker": found.flicker,
            "format": bench.devices.sensor.settings.format.fourcc,
            "top_dn": bench.top_dn,
            "gain_db": bench.config.gain_db,
        },
        notes=tuple(notes),
    )
