"""Denoisers from ONNX files, run by ONNX Runtime on the CPU.

Here: the supported signatures, and an error for every way in which a file or its output can be wrong. Not here: how
such a file is made (`ffdnet` exports one). ONNX Runtime is imported when a model is loaded.

A model takes a noisy image, [N, C, H, W] float32 with C = 1 or 3 and full scale 1, and, unless it is blind, sigma:
as a number, as [N] or [1], as [N, 1, 1, 1], or as a map of the image's height and width. It returns the denoised
image. Axes may be dynamic or fixed.
"""

from pathlib import Path
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError, NumericsError
from gs2ci.reconstruct.learned.onnx_models import SIDE_MULTIPLE, fixed_side, open_model, run_model, signature

_CALLED: Final = (
    "an image [N, 1 or 3, H, W] float32, then, if at all, sigma: [], [N], [N, 1, 1, 1] or [N, 1, H, W] float32"
)


class OnnxDenoiser:
    """A denoiser in an ONNX file.

    Args:
        path: The file.

    Attributes:
        channels: Number of colours that it denoises at once; None if it leaves them open.

    Raises:
        InputError: No such file, a file that ONNX Runtime refuses (damaged, of an unknown operator set), or inputs and
            outputs other than those of a denoiser.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._session = open_model(self.path, "`gs2ci models export-ffdnet WEIGHTS -o FILE` makes one")
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        if len(inputs) not in (1, 2) or len(outputs) < 1 or any(one.type != "tensor(float)" for one in inputs):
            raise self._refusal()
        self._image, self._sigma = inputs[0], inputs[1] if len(inputs) == 2 else None
        if len(self._image.shape) != 4 or (self._sigma is not None and len(self._sigma.shape) not in (0, 1, 4)):
            raise self._refusal()
        channels = fixed_side(self._image.shape[1])
        if channels not in (None, 1, 3):
            raise self._refusal()
        self.channels = channels

    def __call__(self, views: F32, sigma: float) -> F32:
        """Denoise a stack, [N, C, H, W].

        A grey model gets the colours of an image one by one. A colour model gets a grey image three times, and √3 sigma
        for the reason that `onnx_video_denoiser` gives: noise of sigma in each of three channels would leave sigma / √3
        in their mean, which is all that it can tell of a grey image.

        Raises:
            InputError: The model's image size is fixed and differs.
            NumericsError: The model failed on this image, changed its shape, or returned NaN or infinity.
        """
        n, c, height, width = views.shape
        if self.channels == 1:
            images = views.reshape(n * c, 1, height, width)
        elif self.channels == 3 and c == 1:
            images, sigma = np.repeat(views, 3, axis=1), 3**0.5 * sigma
        else:
            images = views
        denoised = self._denoise(images, sigma)
        if self.channels == 3 and c == 1:
            denoised = denoised.mean(axis=1, keepdims=True)
        return denoised.reshape(views.shape)

    def _denoise(self, images: F32, sigma: float) -> F32:
        height, width = images.shape[2:]
        padded = self._padded(images)
        batch = fixed_side(self._image.shape[0]) or 1
        # One image at a time unless the model requires more: its working memory is hundreds of times its image.
        denoised = []
        for first in range(0, len(padded), batch):
            part = padded[first : first + batch]
            missing = batch - len(part)
            full = np.concatenate([part, np.repeat(part[-1:], missing, axis=0)]) if missing else part
            denoised.append(self._run(np.ascontiguousarray(full), sigma)[: len(part)])
        return np.ascontiguousarray(np.concatenate(denoised)[:, :, :height, :width])

    def _padded(self, images: F32) -> F32:
        sides = [fixed_side(side) for side in self._image.shape[2:]]
        wanted = [
            side or -(-had // SIDE_MULTIPLE) * SIDE_MULTIPLE for side, had in zip(sides, images.shape[2:], strict=True)
        ]
        for side, had in zip(sides, images.shape[2:], strict=True):
            if side is not None and side != had:
                raise InputError(
                    f"{self.path.name} takes images of {wanted[0]} x {wanted[1]} pixels, not of {images.shape[2]} x "
                    f"{images.shape[3]}",
                    remedy="export the model with dynamic height and width",
                )
        rows, columns = wanted[0] - images.shape[2], wanted[1] - images.shape[3]
        return (
            np.pad(images, ((0, 0), (0, 0), (0, rows), (0, columns)), mode="symmetric") if rows or columns else images
        )

    def _run(self, images: F32, sigma: float) -> F32:
        feed = {self._image.name: images}
        if self._sigma is not None:
            feed[self._sigma.name] = self._sigma_like(images, sigma)
        remedy = "check the model with its own images; export it with dynamic axes"
        denoised = run_model(self._session, self.path.name, feed, remedy)[self._session.get_outputs()[0].name]
        if denoised.shape != images.shape:
            raise NumericsError(
                f"{self.path.name} made {list(denoised.shape)} of images {list(images.shape)}",
                allowed="the denoised images, of the same shape",
            )
        if not np.isfinite(denoised).all():
            raise NumericsError(
                f"{self.path.name} returned numbers that are not finite at sigma {sigma:.4g}",
                remedy="check that the model takes images and sigma with full scale 1",
            )
        return denoised.astype(np.float32, copy=False)

    def _sigma_like(self, images: F32, sigma: float) -> F32:
        shape = self._sigma.shape if self._sigma is not None else []
        n, _, height, width = images.shape
        # An axis that is open or of length one: sigma per image; open sides or those of the image: a map.
        if len(shape) < 4:
            return np.full((fixed_side(shape[0]) or n,) if shape else (), sigma, np.float32)
        sides = [1 if fixed_side(s) == 1 else whole for s, whole in zip(shape[2:], (height, width), strict=True)]
        return np.full((fixed_side(shape[0]) or n, fixed_side(shape[1]) or 1, *sides), sigma, np.float32)

    def _refusal(self) -> InputError:
        return InputError(
            f"{self.path} is not a denoiser: it takes {signature(self._session)}",
            allowed=_CALLED,
            remedy="wrap the network so that it has this signature, and export it again",
        )
