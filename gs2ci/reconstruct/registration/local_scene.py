"""A locally constant scene, fitted around every pixel: it predicts a measurement from the sum of the masks.

For such a scene y(p) = X(p) · S(p) with the masks' sum S. X is the least-squares level of the pixels around p without p
itself, so that the prediction error at every pixel is a held-out one, and all pixels can judge masks without any
decode. Texture and parallax act as noise; masks do not depend on the scene, so that this noise does not bias.

Here: that prediction. Not here: the parameters varied to improve it (`fine`).
"""

from dataclasses import dataclass
from typing import Final, Self

import cv2
import numpy as np

from gs2ci.core.arrays import F64, Bool
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import cfa_channels

# Standard deviation of the windows, in mask elements.
_WINDOW_ELEMENTS: Final = 1.5
# A prediction counts if the weight of a pixel's neighbours is at least this share of the pixel's own weight.
_LEAST_NEIGHBOURS: Final = 0.5
TINY: Final = 1e-12


def blurred(image: F64, sigma_px: float) -> F64:
    """Blur a picture, [H, W], mirrored at its border."""
    return cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT)


@dataclass(frozen=True)
class Seen:
    """The readings of a measurement that are used.

    Args:
        planes: Readings by colour, [K, H, W]: one plane for mono and for RGB (its mean), three behind a mosaic.
        counts: Which pixels of each plane are readings, [K, H, W], 1 or 0.
        window_px: Standard deviation of the window within which the scene is assumed to be constant.
    """

    planes: F64
    counts: F64
    window_px: float

    @classmethod
    def of(cls, shot: Shot, element_px: float = 1.0) -> Self:
        """Take the readings that are not clipped, of masks with elements of this width, at least a pixel."""
        counted: Bool = np.ones(shot.size, bool) if shot.saturated is None else ~shot.saturated
        image = shot.measurement.mean(axis=2, dtype=np.float64)
        window_px = _WINDOW_ELEMENTS * element_px
        if shot.cfa is None:
            return cls(image[None], counted[None].astype(np.float64), window_px)
        channels = cfa_channels(shot.cfa, shot.size).numpy()
        colours = np.stack([channels == k for k in range(3)])
        # Each colour has a quarter or half of the pixels.
        return cls(np.repeat(image[None], 3, axis=0), (colours & counted).astype(np.float64), 1.7 * window_px)

    def without(self, pixels: Bool) -> "Seen":
        """Return the same without some pixels, [H, W]."""
        return Seen(self.planes, self.counts * ~pixels, self.window_px)

    def blur(self, image: F64) -> F64:
        """Blur one picture, [H, W], by the window."""
        return blurred(image, self.window_px)

    @property
    def centre_weight(self) -> float:
        """Get the weight of the window's central pixel."""
        spike = np.zeros((1, 1 + 2 * int(np.ceil(5 * self.window_px))))
        spike[0, spike.shape[1] // 2] = 1.0
        return float(cv2.GaussianBlur(spike.T, (0, 0), self.window_px).max()) ** 2

    def level(self, total: F64) -> F64:
        """Return the level of the scene around each pixel, [K, H, W], with its own reading."""
        return np.stack(
            [
                self.blur(counts * plane * total) / np.maximum(self.blur(counts * total * total), TINY)
                for plane, counts in zip(self.planes, self.counts, strict=True)
            ]
        )

    def errors(self, total: F64, black: float = 0.0) -> F64:
        """Predict each reading from those around it, and return reading − prediction, [H, W]; 0 without a prediction.

        Args:
            total: The reading of a white scene, [H, W].
            black: The reading without light.
        """
        left = np.zeros(total.shape)
        centre = self.centre_weight
        for plane, counts in zip(self.planes, self.counts, strict=True):
            power = counts * total * total
            around = self.blur(power)
            level = self.blur(counts * (plane - black) * total) / np.maximum(around, TINY)
            # Leave-one-out in closed form: a pixel's part in its own level is its share of the window's power.
            own = centre * power / np.maximum(around, TINY)
            lever = np.minimum(own, 1 / (1 + _LEAST_NEIGHBOURS))
            left += counts * (plane - black - level * total) / (1 - lever)
        return left
