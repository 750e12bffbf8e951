"""Denoisers of plug-and-play decoders: what a `Denoiser` is, and total variation, which needs no weights.

Not here: learned denoisers (`learned.onnx_denoiser`), groups of similar patches (`patches`), the decoders (`pnp`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydantic import PositiveInt

from gs2ci.core.arrays import F32
from gs2ci.core.bounds import BoundedRecord
from gs2ci.core.config import NotNegative, Positive
from gs2ci.reconstruct.decode.kernels import denoise_coupled, denoise_planes

Denoiser = Callable[[F32, float], F32]
"""Removes white noise of a standard deviation, full scale 1, from a stack, [N, C, H, W] float32 with C = 1 or 3, full
scale 1, not clamped, which it may overwrite; the result has the same shape."""


def clamped(denoise: Denoiser) -> Denoiser:
    """Return a denoiser whose results are kept between black and white.

    A step towards the measurement from views outside that range explains it by light that no scene sends.
    """

    def within(views: F32, sigma: float) -> F32:
        denoised = denoise(views, sigma)
        return np.clip(denoised, 0, 1, out=denoised)

    return within


@dataclass(frozen=True)
class TotalVariation(BoundedRecord):
    """The minimiser of ½‖u − x‖² + λ TV(u), each colour apart, by a few steps of Chambolle's dual method.

    Args:
        weight_per_sigma: λ in units of sigma. On photographs 0.7 is within 0.2 dB of the best for any sigma between
            12/255 and 50/255.
        inner: Steps.
        coupling: Weight of a difference between consecutive views relative to one between neighbouring pixels; 0
            denoises each view by itself. If the camera stands still and little moves, 0.3 to 0.6 gain as much as 1 dB;
            if every pixel moves, they lose as much.
    """

    weight_per_sigma: Positive = 0.7
    inner: PositiveInt = 10
    coupling: NotNegative = 0.0

    def __call__(self, views: F32, sigma: float) -> F32:
        """Denoise in place; arguments as for `Denoiser`."""
        weight = self.weight_per_sigma * sigma
        if self.coupling:
            for c in range(views.shape[1]):
                plane = np.ascontiguousarray(views[:, c])
                denoise_coupled(plane, weight, self.coupling, self.inner)
                views[:, c] = plane
            return views
        views = np.ascontiguousarray(views)  # a reshape of another layout would copy, and the result would be lost
        denoise_planes(views.reshape(-1, *views.shape[2:]), weight, self.inner)
        return views
