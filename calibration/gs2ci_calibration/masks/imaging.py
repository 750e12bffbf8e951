"""How a modulator is imaged onto the sensor: the place each pixel sees, the average over its box, the relay's blur.

Here: the map from sensor to modulator, and the prediction of a pattern's image. Not here: fitting either
(`registration`, `predicted`), light, contrast.

Coordinates are columns and rows in pixels with centres at +0.5, of the sensor (x, y) and of the modulator (u, v).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

from gs2ci.core.arrays import F64
from gs2ci_calibration.masks.imaging_kernels import sample_boxes

# The discrete Gaussian is truncated here, in standard deviations: less than 1e-6 of it lies beyond.
REACH: Final = 5.0


def monomials(x: F64, y: F64, degree: int) -> F64:
    """Return all products x^p y^q with p + q up to `degree`, on a last axis, the lowest degrees first."""
    terms = [x ** (d - q) * y**q for d in range(degree + 1) for q in range(d + 1)]
    return np.stack([np.broadcast_to(term, np.shape(x)) for term in terms], axis=-1)


@dataclass(frozen=True)
class PixelMap:
    """The place on the modulator that each sensor pixel sees: a polynomial; with degree 1, an affine map.

    Args:
        size: The sensor's height and width.
        coefficients: Coefficients of u and v for each of `monomials`, [K, 2] modulator pixels. The arguments of the
            monomials are the sensor's coordinates from its middle, in units of half its longer side.
    """

    size: tuple[int, int]
    coefficients: F64

    @property
    def degree(self) -> int:
        """Get the polynomial's degree."""
        return round((float(np.sqrt(8 * len(self.coefficients) + 1)) - 3) / 2)

    @property
    def unit_px(self) -> float:
        """Get half the sensor's longer side."""
        return 0.5 * max(self.size)

    def basis(self, x: F64, y: F64) -> F64:
        """Return the monomials of sensor coordinates, [..., K]."""
        height, width = self.size
        return monomials((x - 0.5 * width) / self.unit_px, (y - 0.5 * height) / self.unit_px, self.degree)

    def at(self, x: F64, y: F64) -> tuple[F64, F64]:
        """Return the modulator's coordinates (u, v) at sensor coordinates."""
        both = self.basis(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)) @ self.coefficients
        return both[..., 0], both[..., 1]

    def everywhere(self) -> tuple[F64, F64]:
        """Return the modulator's coordinates at each pixel's middle, u and v [H, W]."""
        y, x = np.mgrid[: self.size[0], : self.size[1]] + 0.5
        return self.at(x, y)

    @property
    def modulator_from_sensor(self) -> F64:
        """Get the affine map, [2, 3]: for a higher degree, the tangent at the sensor's middle."""
        linear = self.coefficients[1:3].T / self.unit_px
        middle = 0.5 * np.array([self.size[1], self.size[0]])
        return np.column_stack([linear, self.coefficients[0] - linear @ middle])

    @property
    def sensor_from_modulator(self) -> F64:
        """Get the inverse affine map, [2, 3]."""
        forth = self.modulator_from_sensor
        inverse = np.linalg.inv(forth[:, :2])
        return np.column_stack([inverse, -inverse @ forth[:, 2]])

    @property
    def ratio(self) -> tuple[float, float]:
        """Get how many modulator pixels lie along one sensor pixel's width and height."""
        linear = self.modulator_from_sensor[:, :2]
        return float(np.hypot(*linear[:, 0])), float(np.hypot(*linear[:, 1]))

    @property
    def footprint(self) -> tuple[float, float]:
        """Get width and height, on the modulator, of the box with the second moments of a pixel's parallelogram."""
        linear = self.modulator_from_sensor[:, :2]
        return float(np.hypot(*linear[0])), float(np.hypot(*linear[1]))

    def raised(self, degree: int) -> "PixelMap":
        """Return the same map as a polynomial of a higher degree."""
        more = np.zeros(((degree + 1) * (degree + 2) // 2, 2))
        more[: len(self.coefficients)] = self.coefficients
        return PixelMap(self.size, more)

    def turned(self, *, transpose: bool, flip_x: bool, flip_y: bool) -> "PixelMap":
        """Return the map of the modulator's image in another orientation, about the sensor's middle."""
        turned = np.empty_like(self.coefficients)
        terms = [(d - q, q) for d in range(self.degree + 1) for q in range(d + 1)]
        for k, (p, q) in enumerate(terms):
            sign = (-1.0) ** (p * flip_x + q * flip_y)
            turned[terms.index((q, p)) if transpose else k] = sign * self.coefficients[k]
        return PixelMap(self.size, turned)


@lru_cache(maxsize=64)
def _gaussian(variance: float) -> F64:
    radius = int(np.ceil(REACH * np.sqrt(variance))) + 1
    kernel = ive(np.arange(-radius, radius + 1), variance)
    return kernel / kernel.sum()


def blurred(image: F64, variance_px2: float) -> F64:
    """Convolve an image [H, W] with the discrete Gaussian of a variance, mirrored beyond the border.

    The kernel is Lindeberg's e^-t I_n(t), whose derivative by the variance is exactly half the five-point Laplacian
    (IEEE PAMI 12 (1990) 234).
    """
    if variance_px2 <= 0:
        return image
    kernel = _gaussian(float(variance_px2))
    return cv2.sepFilter2D(image, cv2.CV_64F, kernel, kernel, borderType=cv2.BORDER_REFLECT)


def convolved(image: F64, kernel: F64) -> F64:
    """Convolve an image [H, W] with a measured kernel [2r + 1, 2r + 1], mirrored beyond the border."""
    return cv2.filter2D(image, cv2.CV_64F, kernel[::-1, ::-1].copy(), borderType=cv2.BORDER_REFLECT)


def sharp(pattern: NDArray[Any], pixels: PixelMap) -> tuple[F64, F64, F64]:
    """Return the ideal relay's image of a pattern [Hm, Wm] in [0, 1], and its derivatives by u and v."""
    u, v = pixels.everywhere()
    return sample_boxes(np.ascontiguousarray(pattern, dtype=np.float32), u, v, *pixels.footprint)
