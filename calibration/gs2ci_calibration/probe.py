"""A quick check of one mask in front of any scene: is it the mask, and in the place, that the bundle states?

Here: taking the frames and judging them. Not here: measuring masks (their own step).

With the mask, all on and all off, (mask − off)/(on − off) is the mask itself, for any lit scene at rest before the
camera. The bundle's masks M include the leakage c and predict (M − c)/(1 − c).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64, Bool
from gs2ci_calibration.bench import GUARD_S, Bench, Stack
from gs2ci_calibration.estimates import Section
from gs2ci_calibration.exposing import SHORTEST_S
from gs2ci_calibration.refusals import CalibrationError, Reason

STEP: Final = "check"
FRAMES: Final = 4
ROOM: Final = 0.9
"""Share of the range that the brightest pixels may fill."""
CLEAR: Final = 8.0
"""A pixel is used if on exceeds off by this many standard deviations of their difference."""
LEAST_PIXELS: Final = 200
DIFFERENCE_LIMIT: Final = 0.05
"""Largest rms difference from the bundle's prediction, beyond noise: that of a random mask displaced by 0.1 px."""
SHIFT_LIMIT_PX: Final = 0.1
STRUCTURED: Final = 0.5
"""Share of the masks' largest standard deviation over the pixels that the mask to be shown has at least: of one that is
open everywhere, as the first of Hadamard's, neither the place nor the polarity could be seen."""
ALIKE: Final = 0.5
"""Correlation from which on a mask of the bundle, or an inverted one, is recognised."""


@dataclass(frozen=True)
class Probe:
    """The comparison of one mask with the bundle.

    Args:
        mask: Index of the mask.
        difference: Rms difference from the prediction, noise subtracted.
        correlation: Correlation with the prediction.
        shift_px: Displacement of the modulator's image since calibration, right and down.
        shift_error_px: Standard error of each.
        pixels: How many pixels were lit well enough to be compared.
        most_alike: The mask of the bundle that it resembles most; None if it resembles none.
        off_dn: Mean reading of these pixels with all mirrors off.
        on_dn: And with all mirrors on.
    """

    mask: int
    difference: float
    correlation: float
    shift_px: tuple[float, float]
    shift_error_px: tuple[float, float]
    pixels: int
    most_alike: int | None
    off_dn: float
    on_dn: float

    def require(self) -> "Probe":
        """Return self if the mask agrees with the prediction.

        Raises:
            CalibrationError: Another mask is shown, it is inverted, or the modulator's image is displaced.
        """
        remedy = "run `gs2ci calibrate registration` and `masks` again"
        if self.correlation < -ALIKE:
            raise CalibrationError(
                STEP,
                Reason.WRONG_POLARITY,
                f"mask {self.mask} appears inverted, correlation {self.correlation:.2f}",
                remedy="check `invert` in [modulator]; then " + remedy,
            )
        if self.most_alike not in (None, self.mask) and self.correlation < ALIKE:
            raise CalibrationError(
                STEP,
                Reason.WRONG_ORDER,
                f"the picture of mask {self.mask} resembles mask {self.most_alike} of the bundle",
                remedy=remedy,
            )
        if self.difference > DIFFERENCE_LIMIT or self.moved:
            if self.most_alike is None:  # nor is a displacement then told by the slopes
                raise CalibrationError(
                    STEP,
                    Reason.DOES_NOT_FIT,
                    f"the picture of mask {self.mask} resembles none of the bundle's masks, correlation "
                    f"{self.correlation:.2f}: the image of the modulator is turned, mirrored or displaced by half an "
                    "element or more, or the scene moves",
                    allowed=f"a correlation of {ALIKE:g} or more",
                    remedy=f"{remedy}, or leave the probe out with --no-probe before a scene that moves",
                )
            right, down = self.shift_px
            raise CalibrationError(
                STEP,
                Reason.DOES_NOT_FIT,
                f"mask {self.mask} differs from the bundle's by {100 * self.difference:.1f} % rms; the image of the "
                f"modulator has moved by {right:+.2f} px right and {down:+.2f} px down",
                allowed=f"{100 * DIFFERENCE_LIMIT:.0f} % and {SHIFT_LIMIT_PX} px",
                remedy=f"{remedy}; or take a shot of a textured scene with --no-probe and run `gs2ci calibrate update`",
            )
        return self

    @property
    def moved(self) -> bool:
        """Get whether the image is significantly displaced by more than the limit."""
        pairs = zip(self.shift_px, self.shift_error_px, strict=True)
        return any(abs(shift) - 2 * error > SHIFT_LIMIT_PX for shift, error in pairs)


def probe_mask(bench: Bench, masks: Section) -> Probe:
    """Show the first mask with structure between all off and all on, and compare it with the bundle.

    Args:
        bench: The bench, before a scene at rest.
        masks: The section `masks`.

    Raises:
        CalibrationError: Too little light to decide.
        DriverError: A device failed.
    """
    valid = masks.known
    known, leakage = (masks.array(name).astype(np.float64) for name in ("masks", "contrast"))
    spreads = np.array([mask[valid].std() for mask in known])
    index = int(np.argmax(spreads >= STRUCTURED * spreads.max()))
    return compare(_take(bench, index), known, leakage, valid, index)


def compare(stack: Stack, masks: F64, leakage: F64, valid: Bool, index: int) -> Probe:
    """Compare frames with a bundle's masks.

    Args:
        stack: Frames with all mirrors off, the mask, and all on, [3, K, H, W] with K of 2 or more.
        masks: The bundle's masks, leakage included, [N, H, W].
        leakage: Off over on, [H, W].
        valid: Pixels where the masks are known, [H, W].
        index: Which mask was shown.

    Raises:
        CalibrationError: Too little light to decide.
    """
    readings = stack.readings.astype(np.float64)
    off, shown, on = readings.mean(axis=1)
    # Variance of a mean of frames. It is not pooled over neighbours, because the light differs from pixel to pixel.
    noises: F64 = readings.var(axis=1, ddof=1) / readings.shape[1]
    noise_off, noise_shown, noise_on = noises
    span = on - off
    typical = float(np.median(noise_off + noise_on))
    lit = valid & (span > CLEAR * np.sqrt(np.maximum(noise_off + noise_on, typical)))
    if int(lit.sum()) < LEAST_PIXELS:
        raise CalibrationError(
            STEP,
            Reason.NO_LIGHT,
            f"{int(lit.sum())} pixels are lit well enough to recognise a mask",
            allowed=f"{LEAST_PIXELS} or more",
            remedy="light the scene, or leave the probe out with --no-probe",
        )
    foretold = (masks - leakage) / np.maximum(1 - leakage, 0.1)  # 0.1: a pixel that leaks more than 90 % is useless
    seen = (shown - off)[lit] / span[lit]
    rest = seen - foretold[index][lit]
    share = foretold[index][lit]
    noise = (noise_shown[lit] + (1 - share) ** 2 * noise_off[lit] + share**2 * noise_on[lit]) / np.square(span[lit])
    shift, errors = _shift(foretold[index], lit, rest, noise)
    alike = [_correlation(seen, mask[lit]) for mask in foretold]
    return Probe(
        index,
        float(np.sqrt(max(np.square(rest).mean() - noise.mean(), 0.0))),
        alike[index],
        shift,
        errors,
        int(lit.sum()),
        int(np.argmax(alike)) if max(alike) >= ALIKE else None,
        float(off[lit].mean()),
        float(on[lit].mean()),
    )


def _take(bench: Bench, index: int) -> Stack:
    """Take the frames, at an exposure at which no pixel is clipped."""
    shut, unshut = (bench.flat_pattern(is_open=is_open) for is_open in (False, True))
    patterns = np.stack([bench.deep(shut), bench.capture.masks[index], bench.deep(unshut)])
    shortest_s = max(SHORTEST_S, bench.exposure_limits_s[0])
    exposure_s = max(min(bench.capture.mask_s, bench.exposure_limits_s[1]) - GUARD_S, shortest_s)
    while True:
        stack = bench.grab(patterns, frames=FRAMES, exposure_s=exposure_s, bit_depth=bench.capture.bit_depth)
        bright = float(np.quantile(stack.readings[2], 0.99))
        if bright < ROOM * bench.top_dn or exposure_s <= shortest_s:
            return stack
        exposure_s = max(exposure_s / 2, shortest_s)


def _shift(foretold: F64, lit: Bool, rest: F64, noise: F64) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the mask's displacement, right and down, and its standard errors.

    It is the first moment of the filter that turns the mask into what was seen: slopes show half of it, if
    elements are as sharp as a pixel. Of a mask that was between pixels before, or blurred, the filter is an alternating
    series without end; cut after one, two and three pixels it errs to either side, and means of means are taken, as by
    Euler's summation of alternating series.
    """
    sides = [foretold - np.roll(foretold, 1, axis) for axis in (1, 0)]
    spread = np.cov([side[lit] for side in sides])
    if np.linalg.det(spread) <= 1e-6 * np.trace(spread) ** 2:  # 1e-6: in a mask without structure no shift is visible
        return (0.0, 0.0), (float(np.inf), float(np.inf))
    one, two, three = (_first_moment(foretold, lit, rest, float(noise.mean()), reach) for reach in (1, 2, 3))
    right, down = (one[0] + 2 * two[0] + three[0]) / 4
    of_right, of_down = np.hypot(three[1], np.abs(one[0] - three[0]) / 4)
    return (float(right), float(down)), (float(of_right), float(of_down))


def _first_moment(foretold: F64, lit: Bool, rest: F64, noise: float, reach: int) -> tuple[F64, F64]:
    """Return by how much a filter of that reach, px, moves a mask right and down, by least squares, and its errors."""
    high, wide = foretold.shape
    padded = np.pad(foretold, reach, mode="edge")
    steps = np.argwhere(np.ones((2 * reach + 1, 2 * reach + 1))) - reach
    steps = steps[steps.any(axis=1)]
    moved = (padded[reach - down :, reach - right :][:high, :wide] for down, right in steps)
    parts = np.stack([(image - foretold)[lit] for image in moved], axis=1)
    inverse = np.linalg.pinv(parts.T @ parts, rcond=1e-6, hermitian=True)  # 1e-6: a smooth mask's neighbours are alike
    weights = inverse @ (parts.T @ rest)
    left = float(np.square(rest - parts @ weights).mean()) + noise
    along = steps.T[::-1].astype(float)
    return along @ weights, np.sqrt(np.diag(along @ inverse @ along.T) * left)


def _correlation(a: F64, b: F64) -> float:
    spread = float(a.std() * b.std())
    return float(np.mean((a - a.mean()) * (b - b.mean()))) / spread if spread > 0 else 0.0
