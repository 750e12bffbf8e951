"""A relay to predict masks through. Nothing here is a test."""

import numpy as np

from gs2ci_calibration.masks.imaging import PixelMap, blurred
from gs2ci_calibration.masks.predicted import RADIUS, Relay


def gaussian_relay(pixels: PixelMap, variance_px2: float) -> Relay:
    """Return a relay whose blur is a Gaussian."""
    radius = int(np.clip(np.ceil(3 * np.sqrt(max(variance_px2, 0.0))) + 1, *RADIUS))
    point = np.zeros((2 * radius + 1, 2 * radius + 1))
    point[radius, radius] = 1.0
    return Relay(pixels, blurred(point, variance_px2))
