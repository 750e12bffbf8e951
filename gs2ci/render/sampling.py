"""Positions of an image's pixels on a pinhole's canvas, for a lens that distorts.

A Gaussian can be evaluated anywhere on the screen, so that a lens needs no resampling: each pixel is blended at the
position where its light would have fallen without the lens. Here: these positions, and the pinhole's canvas that
contains them all. Not here: the lens (`gs2ci.core.lens`).
"""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError


@dataclass(frozen=True, eq=False)
class CanvasSampling:
    """Positions on a pinhole's canvas, one for each pixel of an image.

    The canvas is a larger or smaller frame of the same pinhole camera: its pixel (0, 0) is the camera's pixel `origin`.

    Args:
        places: On the canvas as (x, y) in px, [H, W, 2] float64; pixel centres lie at +0.5.
        origin: Column and row of the canvas's first pixel in the camera's frame; may be negative.
        canvas: Height and width of the canvas, px.
    """

    places: F64
    origin: tuple[int, int]
    canvas: tuple[int, int]

    @classmethod
    def around(cls, places: F64, border: int = 0) -> Self:
        """Make a canvas around positions in the camera's frame, [H, W, 2] px, with a border of pixels on each side.

        Raises:
            InputError: Not [H, W, 2], or not finite.
        """
        if places.ndim != 3 or places.shape[2] != 2 or not places.size or not np.isfinite(places).all():
            raise InputError(f"positions of pixels of shape {list(places.shape)}", allowed="finite numbers, [H, W, 2]")
        low = np.floor(places.min(axis=(0, 1))).astype(int) - border
        # A whole number belongs to the pixel that starts there.
        size = np.floor(places.max(axis=(0, 1))).astype(int) + 1 + border - low
        return cls(places - low, (int(low[0]), int(low[1])), (int(size[1]), int(size[0])))

    @property
    def size(self) -> tuple[int, int]:
        """Get height and width of the image, px."""
        return int(self.places.shape[0]), int(self.places.shape[1])

    def intrinsics_of_canvas(self, intrinsics: Tensor) -> Tensor:
        """Return the camera matrix, [3, 3], in the pixels of the canvas."""
        moved = intrinsics.clone()
        moved[:2, 2] -= torch.tensor(self.origin, dtype=intrinsics.dtype)
        return moved


def on_canvas(intrinsics: Tensor, sampling: CanvasSampling | None) -> Tensor:
    """Return the camera matrix, [3, 3], in the pixels of what is rendered: the canvas if there is a sampling."""
    return intrinsics if sampling is None else sampling.intrinsics_of_canvas(intrinsics)


def check_sampling(sampling: CanvasSampling | None, size: tuple[Any, ...]) -> None:
    """Check that a sampling, if given, is for an image of this size.

    Raises:
        InputError: It is for an image of another size.
    """
    if sampling is not None and sampling.size != tuple(size):
        raise InputError(f"positions of {sampling.size} pixels for an image of {tuple(size)}", allowed="equal sizes")
