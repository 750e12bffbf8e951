"""Masks predicted instead of measured: from the map, the relay's measured kernel and the contrast map.

Here: the kernel's fit, the prediction, and its error. Not here: the map (`registration`), masks measured one by one
(`measured`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci_calibration.estimates import Section
from gs2ci_calibration.masks.imaging import PixelMap, convolved, sharp
from gs2ci_calibration.refusals import CalibrationError, Reason

RADIUS: Final = (2, 5)
"""Smallest and largest radius of the kernel: three standard deviations of the blur, and one pixel more."""
PIXELS_USED: Final = 60_000
"""Number of pixels to which a kernel of at most 121 taps is fitted; more would only take longer."""


@dataclass(frozen=True)
class Kernel:
    """The relay's point spread, as a kernel on the sensor's grid.

    Args:
        taps: [2r + 1, 2r + 1], with the sum 1, so that an open modulator appears open.
        standard_error: Standard error of each.
        residual_rms: Rms residual of the images, noise included.
    """

    taps: F64
    standard_error: F64
    residual_rms: float


def fit_kernel(
    pixels: PixelMap,
    variance_px2: float,
    patterns: Sequence[NDArray[Any]] | NDArray[Any],
    shares: Sequence[F64],
    valid: Bool,
) -> Kernel:
    """Fit the kernel to images of known patterns by least squares.

    Args:
        pixels: The map from sensor to modulator.
        variance_px2: Variance of the blur, which determines the kernel's size.
        patterns: The patterns shown, each [Hm, Wm] in [0, 1]; with detail as fine as a sensor pixel.
        shares: The image of each, between off (0) and on (1), [H, W].
        valid: Pixels that can be trusted, [H, W].

    Raises:
        CalibrationError: The taps cannot be determined from the patterns.
    """
    radius = int(np.clip(np.ceil(3 * np.sqrt(max(variance_px2, 0.0))) + 1, *RADIUS))
    taps = [(i, j) for i in range(-radius, radius + 1) for j in range(-radius, radius + 1) if (i, j) != (0, 0)]
    design, right = _shifted(pixels, taps, patterns, shares, _inner(valid, radius, len(patterns)))
    normal = design.T @ design
    if len(right) < 4 * len(taps) or np.linalg.cond(normal) > 1e10:
        raise CalibrationError(
            "registration",
            Reason.NOT_REGISTERED,
            f"{len(right)} pixels with texture do not determine the {len(taps)} taps of the relay's blur",
            allowed="fine random patterns all over the sensor",
            remedy="light the whole field and focus the relay",
        )
    inverse = np.linalg.inv(normal)
    found = inverse @ (design.T @ right)
    left = right - design @ found
    square = float(left @ left) / (len(right) - len(taps))
    middle = len(taps) // 2
    error = np.sqrt(square * np.append(np.diag(inverse), inverse.sum()))
    shape = (2 * radius + 1, 2 * radius + 1)
    return Kernel(
        np.insert(found, middle, 1 - found.sum()).reshape(shape),
        np.insert(error[:-1], middle, error[-1]).reshape(shape),
        float(np.sqrt(square)),
    )


def _inner(valid: Bool, radius: int, images: int) -> NDArray[np.intp]:
    """Choose pixels: valid ones away from the border, beyond which nothing is known."""
    inner = np.zeros_like(valid)
    inner[radius:-radius, radius:-radius] = valid[radius:-radius, radius:-radius]
    places = np.flatnonzero(inner)
    if len(places) * images > PIXELS_USED:
        places = np.random.default_rng(0).permutation(places)[: PIXELS_USED // images]
    return places


def _shifted(
    pixels: PixelMap,
    taps: Sequence[tuple[int, int]],
    patterns: Sequence[NDArray[Any]] | NDArray[Any],
    shares: Sequence[F64],
    places: NDArray[np.intp],
) -> tuple[F64, F64]:
    """Return the least squares problem: shifted minus unshifted ideal images [P, T], and the target values [P]."""
    columns, rest = [], []
    for pattern, share in zip(patterns, shares, strict=True):
        ideal = sharp(pattern, pixels)[0]
        plain = ideal.ravel()[places]
        # A convolution: the tap (i, j) brings the light of the pixel i rows up and j columns to the left.
        columns.append(np.column_stack([np.roll(ideal, tap, (0, 1)).ravel()[places] - plain for tap in taps]))
        rest.append(share.ravel()[places] - plain)
    return np.concatenate(columns), np.concatenate(rest)


@dataclass(frozen=True)
class Relay:
    """How the modulator is imaged onto the sensor.

    Args:
        pixels: The map from sensor to modulator.
        taps: The relay's kernel, [2r + 1, 2r + 1].
    """

    pixels: PixelMap
    taps: F64

    def shares(self, patterns: NDArray[Any], top: int = 1) -> F32:
        """Return the images of patterns [N, Hm, Wm] between off (0) and on (1), [N, H, W]."""
        seen = [convolved(sharp(pattern / np.float32(top), self.pixels)[0], self.taps) for pattern in patterns]
        return np.clip(np.reshape(seen, (-1, *self.pixels.size)), 0.0, 1.0).astype(np.float32)

    def turned(self, *, transpose: bool, flip_x: bool, flip_y: bool) -> "Relay":
        """Return the relay for a modulator in another orientation."""
        taps = self.taps[:: -1 if flip_y else 1, :: -1 if flip_x else 1]
        return Relay(
            self.pixels.turned(transpose=transpose, flip_x=flip_x, flip_y=flip_y), taps.T if transpose else taps
        )


def relay_of(registration: Section, size: tuple[int, int], step: str) -> Relay:
    """Return the relay that a bundle's registration describes.

    Raises:
        CalibrationError: It was measured at another size of the sensor (`Reason.DOES_NOT_FIT`).
    """
    measured = tuple(int(side) for side in registration.facts["size"])
    if measured != size:
        raise CalibrationError(
            step,
            Reason.DOES_NOT_FIT,
            f"the registration is of a sensor of {measured[0]} x {measured[1]}, this one takes {size[0]} x {size[1]}",
            remedy="run `gs2ci calibrate registration` again",
        )
    coefficients = np.asarray(registration.array("modulator_from_sensor"), dtype=np.float64)
    return Relay(PixelMap(size, coefficients), np.asarray(registration.array("psf_kernel"), dtype=np.float64))


def transmissions(shares: NDArray[np.floating], leakage: F64) -> F32:
    """Return transmissions, closed mirrors' leakage included, [N, H, W], from images between off (0) and on (1)."""
    return np.asarray(leakage + (1 - leakage) * shares, dtype=np.float32)


def model_error(
    seen: NDArray[np.floating], variance: NDArray[np.floating], foreseen: NDArray[np.floating]
) -> tuple[float, float]:
    """Return the predictions' rms error beyond the noise of the measurements, and its standard error.

    Args:
        seen: The measured values, [...].
        variance: Variance of each, [...].
        foreseen: The predicted values, [...].
    """
    square = np.square(seen - foreseen, dtype=np.float64)
    excess = float(np.mean(square - variance))
    error = float(np.std(square - variance) / np.sqrt(max(square.size, 1)))
    rms = float(np.sqrt(max(excess, error)))
    return rms, error / (2 * rms) if rms > 0 else 0.0
