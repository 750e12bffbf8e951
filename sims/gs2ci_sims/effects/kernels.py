"""Convolution kernels of optical effects, and what these and shifts change of cosines."""

from typing import Final

import cv2
import numpy as np
from scipy import sparse
from scipy.special import ive

from gs2ci.core.arrays import F64

# Sub-samples per pixel side when a disc is drawn: the error of its area is then below 0.1 %.
DISC_OVERSAMPLING: Final = 16


def gaussian_radius(sigma_px: float, reach: float) -> int:
    """Return the radius of a kernel truncated at reach sigma: one more, because narrow kernels decrease more slowly."""
    return int(np.ceil(reach * sigma_px)) + 1 if sigma_px > 0 else 0


def discrete_gaussian(sigma_px: float, reach: float) -> F64:
    """Return Lindeberg's discrete Gaussian, [2 r + 1] with r = `gaussian_radius`; its sum is 1.

    It is e^-t I_n(t) with t = sigma^2. Unlike for a sampled Gaussian, its variance is exactly t and its transfer
    function exactly exp(t (cos w - 1)), for any sigma (Lindeberg, IEEE PAMI 12 (1990) 234).
    """
    radius = gaussian_radius(sigma_px, reach)
    kernel = ive(np.arange(-radius, radius + 1), sigma_px**2)
    return kernel / kernel.sum()


def gaussian_tail(sigma_px: float, reach: float) -> float:
    """Return the share of the discrete Gaussian beyond its reach."""
    radius = gaussian_radius(sigma_px, reach)
    return float(max(0.0, 1.0 - ive(np.arange(-radius, radius + 1), sigma_px**2).sum()))


def blurred(image: F64, sigma_px: float, reach: float) -> F64:
    """Convolve an image [H, W] or [H, W, C] with the discrete Gaussian; beyond the border it is mirrored."""
    kernel = discrete_gaussian(sigma_px, reach)
    if kernel.size == 1:
        return image
    result = cv2.sepFilter2D(image, cv2.CV_64F, kernel, kernel, borderType=cv2.BORDER_REFLECT)
    return np.asarray(result).reshape(image.shape)


def blurred_inside(image: F64, sigma_px: float, reach: float, margin: int) -> F64:
    """Return what `blurred` makes of an image [H, W, C] without its margin, [H - 2 margin, W - 2 margin, C].

    Beside a margin of hundreds of pixels, a picture of a few is found in a small part of the time.
    """
    kernel = discrete_gaussian(sigma_px, reach)
    height, width, channels = image.shape
    down, across = (_mirrored_weights(kernel, length, margin) for length in (height, width))
    rows = (down @ image.reshape(height, -1)).reshape(-1, width, channels)
    columns = across @ rows.swapaxes(0, 1).reshape(width, -1)
    return columns.reshape(-1, len(rows), channels).swapaxes(0, 1)


def _mirrored_weights(kernel: F64, length: int, margin: int) -> sparse.csr_array:
    """Return the weights with which places within a margin gather a line that is mirrored at its ends."""
    places = np.pad(np.arange(length), kernel.size // 2, mode="symmetric")
    gathered = np.lib.stride_tricks.sliding_window_view(places, kernel.size)[margin : length - margin]
    inside = np.arange(len(gathered)).repeat(kernel.size)
    weights = np.tile(kernel, len(gathered)), (inside, gathered.ravel())
    return sparse.csr_array(sparse.coo_array(weights, shape=(len(gathered), length)))


def gaussian_loss(sigma_px: float, frequency: F64) -> F64:
    """Return an upper limit on the share of a cosine (cycles per pixel) that the discrete Gaussian removes.

    1 - exp(t (cos w_x + cos w_y - 2)) with cos w >= 1 - w^2 / 2.
    """
    return np.asarray(-np.expm1(-2 * np.square(np.pi * sigma_px * frequency)))


def shift_shares(frequency: F64, shift_px: float) -> F64:
    """Return by which share of its amplitude a shift of up to so many pixels changes a cosine (cycles per pixel)."""
    return 2 * np.sin(np.minimum(np.pi * frequency * shift_px, np.pi / 2))


def disc(diameter_px: float) -> F64:
    """Return a uniform disc integrated over pixels, [2 r + 1, 2 r + 1], with the sum 1; one pixel for less than one."""
    radius = int(np.ceil(0.5 * diameter_px - 0.5)) if diameter_px > 0 else 0
    if radius == 0:
        return np.ones((1, 1))
    side = (2 * radius + 1) * DISC_OVERSAMPLING
    place = (np.arange(side) + 0.5) / DISC_OVERSAMPLING - (radius + 0.5)
    inside = (np.square(place[:, None]) + np.square(place) <= np.square(0.5 * diameter_px)).astype(np.float64)
    blocks = inside.reshape(2 * radius + 1, DISC_OVERSAMPLING, 2 * radius + 1, DISC_OVERSAMPLING)
    kernel = blocks.mean(axis=(1, 3))
    return kernel / kernel.sum()
