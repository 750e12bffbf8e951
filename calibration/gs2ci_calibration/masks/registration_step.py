"""The step `registration`: find the modulator on the sensor, in any orientation, to thousandths of a pixel.

First stripes of a Gray code are shown, then textures in the part of the modulator that the sensor sees. Here: which
patterns are shown and what is refused. Not here: decoding (`gray_code`), the fit (`registration`).
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64, U8
from gs2ci_calibration.bench import Bench
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.masks.gray_code import GrayCode, coarse_map
from gs2ci_calibration.masks.imaging import PixelMap
from gs2ci_calibration.masks.predicted import Kernel, fit_kernel
from gs2ci_calibration.masks.registration import Registration, register, require_orientation, require_ratio
from gs2ci_calibration.masks.taking import Field, light_up, refined, take
from gs2ci_calibration.masks.texture import checker
from gs2ci_calibration.refusals import CalibrationError, Reason

STEP: Final = "registration"
STRIPE_PX: Final = 4
"""Width of the finest stripes, sensor pixels."""
STRIPE_FRAMES: Final = 2
CELL_PX: Final = 3
"""Side of the checkers' squares, sensor pixels: wide enough to start from the stripes, with edges everywhere."""
CHECKERS: Final = 2
FINE: Final = 3
"""Number of patterns of single elements, which show the relay's blur up to the finest detail of masks."""
MARGIN_PX: Final = 8
"""By how many sensor pixels textures extend beyond the region that the sensor probably sees."""
ACCURACY_PX: Final = 0.05
"""Standard error of the map, rms over the sensor, beyond which it is refused."""


def measure_registration(bench: Bench, known: Bundle) -> Section:
    """Measure the map between modulator and sensor, and the relay's blur.

    Raises:
        CalibrationError: Light or modulator are unsuitable; the modulator is not found, or has an orientation or a
            pixel ratio other than the rig file's; the map is not precise enough.
        DriverError: A device failed.
    """
    began_s = bench.devices.clock.now_s()
    field = light_up(bench, known, STEP)
    coarse = _coarse(bench, field)
    require_orientation(coarse, bench.options.orientation)
    patterns = _textures(bench, coarse)
    frames = bench.options.mask_frames
    sums = take(bench, field, bench.deep(patterns), frames=frames, step=STEP)
    sharper = refined(field, sums).references
    shares = [sharper.shares(sums.mean(i)) for i in range(len(patterns))]
    light = sharper.on - sharper.off
    start = register(patterns[:CHECKERS], shares[:CHECKERS], sharper.valid, coarse, light=light, degree=1)
    found = register(patterns, shares, sharper.valid, start.pixels, light=light)
    require_ratio(found.pixels, bench.superpixel)
    if not found.rms_se_px <= ACCURACY_PX:
        raise CalibrationError(
            STEP,
            Reason.NOT_REGISTERED,
            f"the map is known to {found.rms_se_px:.3f} px only",
            allowed=f"{ACCURACY_PX} px",
            remedy="more frames (mask_frames in [calibration]), more light, or a sharper relay",
        )
    kernel = fit_kernel(found.pixels, found.variance_px2, patterns[CHECKERS:], shares[CHECKERS:], sharper.valid)
    return _section(bench, field, found, kernel, {"frames": frames, "seconds": bench.devices.clock.now_s() - began_s})


def _coarse(bench: Bench, field: Field) -> PixelMap:
    code = GrayCode(bench.modulator_size, STRIPE_PX * bench.superpixel)
    stripes = code.patterns()
    sums = take(bench, field, bench.deep(stripes), frames=STRIPE_FRAMES, step=STEP)
    sharper = refined(field, sums).references
    shares = np.stack([sharper.shares(sums.mean(i)) for i in range(len(stripes))])
    return coarse_map(code, shares, sharper.valid)


def _textures(bench: Bench, coarse: PixelMap) -> U8:
    """Draw the textures in the part that the sensor sees; elsewhere the modulator stays closed, which uploads fast."""
    height, width = bench.modulator_size
    ratio = max(coarse.ratio)
    u, v = coarse.everywhere()
    reach = MARGIN_PX * ratio
    left, right = max(int(u.min() - reach), 0), min(int(u.max() + reach) + 1, width)
    first, last = max(int(v.min() - reach), 0), min(int(v.max() + reach) + 1, height)
    element = max(round(ratio), 1)
    rng = np.random.default_rng(0)
    patterns = np.zeros((CHECKERS + FINE, height, width), np.uint8)
    for i, pattern in enumerate(patterns):
        cell = CELL_PX * element if i < CHECKERS else element
        # Squares of the second checker are offset by half a square, so that edges cover the field evenly.
        start = (cell // 2, cell // 2) if i % 2 else (0, 0)
        drawn = checker((last - first, right - left), cell, rng, start=start)
        pattern[first:last, left:right] = drawn
    return patterns


def _section(bench: Bench, field: Field, found: Registration, kernel: Kernel, facts: dict[str, Any]) -> Section:
    affine, affine_se = sensor_from_modulator(found)
    spread = max(found.variance_px2, 0.0)
    # Near zero the derivative of the square root is infinite: the variance's error then bounds the deviation itself.
    sigma_se = found.variance_se_px2 / (2 * max(np.sqrt(spread), np.sqrt(found.variance_se_px2) / 2, 1e-6))
    scatter = found.residual_rms_px
    pixels = found.pixels
    notes = [
        f"The modulator's image is {found.orientation}, turned by {found.turn_mrad:+.2f} mrad beyond that; one sensor "
        f"pixel spans {pixels.ratio[0]:.4f} x {pixels.ratio[1]:.4f} modulator pixels.",
        f"The map is known to {found.rms_se_px:.4f} px (rms over the sensor), from {found.tiles} tiles.",
    ]
    if pixels.degree > 1:
        notes.append(
            f"The map bends by {found.bend_px():.3f} px rms: a polynomial of degree {pixels.degree} describes it."
        )
    if found.dropped:
        notes.append(f"{found.dropped} tiles show something other than the pattern (dust?) and were left out.")
    return Section(
        name=STEP,
        estimates={
            "sensor_from_modulator": Estimate(affine, affine_se, "px"),
            "modulator_from_sensor": Estimate(pixels.coefficients, found.coefficient_se, "modulator px"),
            "psf_sigma_px": Estimate(np.sqrt(spread), sigma_se, "px"),
            "psf_kernel": Estimate(kernel.taps, kernel.standard_error, "1"),
        },
        arrays={"covariance": found.covariance},
        facts={
            "size": list(bench.size),
            "region": bench.region,
            "modulator_size": list(bench.modulator_size),
            "orientation": found.orientation,
            "degree": pixels.degree,
            "rms_se_px": found.rms_se_px,
            "residual_rms_px": scatter,
            "tiles": found.tiles,
            "tiles_left_out": found.dropped,
            "exposure_s": field.exposure_s,
            **facts,
        },
        notes=tuple(notes),
    )


def sensor_from_modulator(found: Registration) -> tuple[F64, F64]:
    """Return the affine map from modulator to sensor (the tangent at the sensor's middle), [2, 3], and its errors."""
    size, affine = found.pixels.size, found.pixels.coefficients[:3]

    def inverse(coefficients: NDArray[Any]) -> F64:
        return PixelMap(size, coefficients).sensor_from_modulator

    value = inverse(affine)
    # The map is smooth over such steps, which are far above rounding errors.
    step = 1e-4
    slopes = []
    for k, axis in np.ndindex(3, 2):
        moved = np.zeros((3, 2))
        moved[k, axis] = step
        slopes.append((inverse(affine + moved) - inverse(affine - moved)).ravel() / (2 * step))
    jacobian = np.stack(slopes, axis=1)
    variance = np.einsum("ij,jk,ik->i", jacobian, found.covariance[:6, :6], jacobian)
    return value, np.sqrt(np.maximum(variance, 0.0)).reshape(2, 3)
