"""Denoisers from ONNX files, run by ONNX Runtime on the CPU.

Here: the supported signatures of denoisers of single images, and how models of one and of three colours are given views
of the other kind. Not here: how such a file is made (`ffdnet` exports one), video denoisers (`onnx_video_denoiser`).

A model takes a noisy image, [N, C, H, W] float32 with C = 1 or 3 and full scale 1, and, unless it is blind, sigma:
as a number, as [N] or [1], as [N, 1, 1, 1], or as a map of the image's height and width. It returns the denoised
image. Axes may be dynamic or fixed.
"""

from abc import abstractmethod

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.learned.onnx_models import OnnxModel, fixed_side


class OnnxDenoising(OnnxModel):
    """A denoiser in an ONNX file, of images or of video."""

    scaled = "check that the model takes images and sigma with full scale 1"

    @property
    def channels(self) -> int | None:
        """Get the number of colours that it denoises at once; None if it leaves them open."""
        return fixed_side(self.inputs[0].shape[-3])

    def __call__(self, views: F32, sigma: float) -> F32:
        """Denoise a stack, [N, C, H, W]; arguments as for `Denoiser`.

        A grey model gets the colours one by one. A colour model gets a grey image three times, and √3 sigma, since the
        same noise in three channels has √3 times the norm of independent noise per channel: noise of sigma in each
        would leave sigma / √3 in their mean, which is all that it can tell of a grey image. FastDVDnet left 9.5/255 of
        noise of 25/255 on a photograph, and 14.6/255 without the factor.

        Raises:
            InputError: The model's image size is fixed and smaller.
            NumericsError: The model failed on these views, changed their shape, or returned NaN or infinity.
        """
        colours = views.shape[1]
        if self.channels in (None, colours):
            return self.denoised(views, sigma)
        if self.channels == 1:
            return np.concatenate([self.denoised(views[:, c : c + 1], sigma) for c in range(colours)], axis=1)
        return self.denoised(np.repeat(views, 3, axis=1), 3**0.5 * sigma).mean(axis=1, keepdims=True)

    @abstractmethod
    def denoised(self, views: F32, sigma: float) -> F32:
        """Denoise a stack, [N, C, H, W], of as many colours as the model takes."""


class OnnxDenoiser(OnnxDenoising):
    """A denoiser of single images in an ONNX file; see `OnnxModel`."""

    kind = "a denoiser"
    called = "an image [N, 1 or 3, H, W] float32, then, if at all, sigma: [], [N], [N, 1, 1, 1] or [N, 1, H, W] float32"
    missing = "`gs2ci models export-ffdnet WEIGHTS -o FILE` makes one"
    makes = "the denoised images, of the same shape"

    def is_one(self) -> bool:
        """Tell by inputs and outputs whether the file is of this kind."""
        return self.ranks in ([4], [4, 0], [4, 1], [4, 4]) and self.channels in (None, 1, 3)

    def denoised(self, views: F32, sigma: float) -> F32:
        """Denoise a stack, [N, C, H, W], of as many colours as the model takes."""
        height, width = views.shape[2:]
        padded = self.padded(views, self.inputs[0])
        batch = fixed_side(self.inputs[0].shape[0]) or 1
        # One image at a time unless the model requires more: its working memory is hundreds of times its image.
        denoised = []
        for first in range(0, len(padded), batch):
            part = padded[first : first + batch]
            full = np.concatenate([part, np.repeat(part[-1:], batch - len(part), axis=0)])
            fed = (full, *(self._sigma_like(one.shape, full, sigma) for one in self.inputs[1:]))
            denoised.append(self.answer(fed, full.shape, f" at sigma {sigma:.4g}")[: len(part)])
        return np.ascontiguousarray(np.concatenate(denoised)[:, :, :height, :width])

    def _sigma_like(self, shape: list[int | str], images: F32, sigma: float) -> F32:
        n, _, height, width = images.shape
        # An axis that is open or of length one: sigma per image; open sides or those of the image: a map.
        if len(shape) < 4:
            return np.full((fixed_side(shape[0]) or n,) if shape else (), sigma, np.float32)
        sides = [1 if fixed_side(s) == 1 else whole for s, whole in zip(shape[2:], (height, width), strict=True)]
        return np.full((fixed_side(shape[0]) or n, fixed_side(shape[1]) or 1, *sides), sigma, np.float32)
