"""Denoisers of plug-and-play decoders: what a `Denoiser` is, and two that need no weights.

Here: total variation and non-local means. Not here: learned denoisers (`learned.onnx_denoiser`), the decoders (`pnp`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydantic import PositiveInt
from skimage.restoration import denoise_nl_means

from gs2ci.core.arrays import F32
from gs2ci.core.bounds import BoundedRecord
from gs2ci.core.config import NotNegative, Positive
from gs2ci.reconstruct.decode.kernels import denoise_coupled, denoise_planes
from gs2ci.reconstruct.threads import in_threads

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


@dataclass(frozen=True)
class NonLocalMeans(BoundedRecord):
    """Means over patches that look alike (Buades 2005, in scikit-image's fast form by Darbon 2008).

    Better than total variation on white noise; worse inside a decoder, where the residue of the masks is not white and
    matches other patches of residue (`python -m tests.benchmarks decoders`).

    Args:
        cutoff_per_sigma: How different patches may be, h in units of sigma. On photographs 0.7 is within 0.1 dB
            of the best for any sigma between 6/255 and 50/255.
        patch_px: Width of a patch.
        reach_px: How far patches are searched in each direction.
    """

    cutoff_per_sigma: Positive = 0.7
    patch_px: PositiveInt = 5
    reach_px: PositiveInt = 6

    def __call__(self, views: F32, sigma: float) -> F32:
        """Denoise view by view, colours together; arguments as for `Denoiser`."""

        def denoise(view: F32) -> F32:
            grey = len(view) == 1
            denoised: F32 = denoise_nl_means(
                view[0] if grey else view,
                patch_size=self.patch_px,
                patch_distance=self.reach_px,
                h=self.cutoff_per_sigma * sigma,
                sigma=sigma,
                fast_mode=True,
                channel_axis=None if grey else 0,
            )
            return denoised.reshape(view.shape)

        return np.stack(in_threads(denoise, views)).astype(np.float32, copy=False)
