"""The measurement model of snapshot compressive imaging: y = Σᵢ wᵢ Mᵢ ⊙ Xᵢ, seen through a colour filter array.

Here: the linear map from N views to one coded image, the readings of a white scene and those above them, how pixels are
left out, and the geometry of colour filter arrays. Not here: any inversion (`gs2ci.reconstruct.decode`), noise
(`gs2ci_sims`).
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F64, Bool, Size
from gs2ci.core.errors import InputError
from gs2ci.core.records import CFA_PATTERNS, CfaPattern, Shot

_CHANNEL: Final = {"R": 0, "G": 1, "B": 2}
# Noise of the dark level alone makes half of the closed pixels positive, but not by this share of a view's full scale.
EXCESS: Final = 0.05
# A scene may be dark; one whose brightest point is darker than this uses less than three bits of an eight-bit sensor.
DARK: Final = 0.02
# If a larger share of readings is beyond white, they are not outliers: the unit or the masks are wrong.
MOST_OUTLIERS: Final = 0.1


def cfa_channels(pattern: CfaPattern, size: Size) -> Tensor:
    """Get which of R, G, B each pixel of a mosaic sees.

    Args:
        pattern: The 2x2 cell, read row by row from the top left pixel.
        size: Height and width in pixels.

    Returns:
        Channel indices, [H, W] int64.

    Raises:
        InputError: The pattern is not a Bayer pattern.
    """
    if pattern not in CFA_PATTERNS:
        raise InputError(f"colour filter array {pattern!r}", allowed=", ".join(CFA_PATTERNS))
    cell = np.array([_CHANNEL[letter] for letter in pattern], dtype=np.int64).reshape(2, 2)
    height, width = size
    return torch.from_numpy(np.tile(cell, (-(-height // 2), -(-width // 2)))[:height, :width].copy())


def select(image: Tensor, channels: Tensor) -> Tensor:
    """Sample a colour image by a colour filter array.

    Args:
        image: [..., H, W, 3].
        channels: Channel index of each pixel, [H, W] int64.

    Returns:
        The mosaic, [..., H, W, 1].
    """
    index = channels.to(image.device)[..., None].expand(*image.shape[:-1], 1)
    return torch.gather(image, -1, index)


def white_reading(shot: Shot) -> F64:
    """Return the reading of each pixel for a white scene, [H, W], in full scales of one view."""
    return np.tensordot(shot.weights.astype(np.float64), shot.masks, axes=1)


def beyond_white(shot: Shot) -> Bool:
    """Find the pixels, [H, W], that read clearly more light than a white scene would send through their masks.

    Hot pixels, lamps and glints do; if they are many, the masks or the unit are wrong.
    """
    most = (1 + EXCESS) * white_reading(shot)[..., None] + EXCESS
    return np.any(shot.measurement > most, axis=2)


def without_pixels(shot: Shot, pixels: Bool) -> Shot:
    """Close every mask over some pixels, [H, W], and clear their readings, so that no stage uses them."""
    measurement = np.where(pixels[..., None], np.float32(0), shot.measurement)
    return replace(shot, masks=shot.masks * ~pixels, measurement=measurement)


@dataclass(frozen=True)
class Coding:
    """The linear map Φ from N views to one coded measurement (paper, eq. 1).

    Args:
        transmissions: wᵢ Mᵢ, [N, H, W], float32 or float64; the map computes in this precision.
        channels: Channel index of each pixel of a mosaic, [H, W] int64; None if every pixel sees all channels.
    """

    transmissions: Tensor
    channels: Tensor | None = None

    @classmethod
    def of(cls, shot: Shot, dtype: torch.dtype = torch.float32) -> "Coding":
        """Take the map from a shot's masks, weights and colour filter array."""
        masks = torch.from_numpy(shot.masks).to(dtype)
        weights = torch.from_numpy(shot.weights).to(dtype)
        channels = None if shot.cfa is None else cfa_channels(shot.cfa, shot.size)
        return cls(weights[:, None, None] * masks, channels)

    def forward(self, views: Tensor) -> Tensor:
        """Sum masked views into one coded image.

        Args:
            views: [N, H, W, C], full scale 1; C must be 3 with a colour filter array.

        Returns:
            Coded measurement, [H, W, C], or [H, W, 1] with a colour filter array.

        Raises:
            InputError: The views do not fit the masks or the colour filter array.

        Linear in `views`.
        """
        self._check("views", views, self.transmissions.shape)
        # View by view, since memory may not hold the products of all views of a large shot.
        coded = views.new_zeros(views.shape[1:], dtype=torch.promote_types(views.dtype, self.transmissions.dtype))
        for transmission, view in zip(self.transmissions, views, strict=True):
            coded.addcmul_(transmission[..., None], view)
        return coded if self.channels is None else select(coded, self.channels)

    def _check(self, what: str, array: Tensor, leading: torch.Size) -> None:
        allowed_last = (1, 3) if self.channels is None else (3,) if what == "views" else (1,)
        if array.shape[:-1] != leading or array.shape[-1] not in allowed_last:
            raise InputError(
                f"{what} of shape {list(array.shape)} behind masks of shape {list(self.transmissions.shape)}",
                allowed=f"{[*leading]} followed by {' or '.join(map(str, allowed_last))}",
            )
