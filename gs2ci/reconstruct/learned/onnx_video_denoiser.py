"""Video denoisers from ONNX files, run by ONNX Runtime on the CPU: several frames in, the middle one out.

Here: the supported signature, and frames beyond both ends. Not here: how such a file is made (`fastdvdnet` exports
one), denoisers of single images and colours (`onnx_denoiser`).

A model takes `[N, F, C, H, W]` float32: F frames in the order of exposure, F fixed and odd, C = 1 or 3, full scale 1;
and sigma, `[]` or `[N]`. It returns the middle frame, `[N, C, H, W]`.
"""

from pathlib import Path
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.decode.denoisers import Denoiser
from gs2ci.reconstruct.learned.onnx_denoiser import OnnxDenoiser, OnnxDenoising
from gs2ci.reconstruct.learned.onnx_models import fixed_side, open_model

_RANK: Final = 5


class OnnxVideoDenoiser(OnnxDenoising):
    """A video denoiser in an ONNX file; see `OnnxModel`. Each view is denoised with those before and after it.

    Beyond the first and the last view the stack is mirrored.
    """

    kind = "a video denoiser"
    called = "frames [N, F, 1 or 3, H, W] float32 with F fixed and odd and open sides, then sigma: [] or [N] float32"
    missing = "`gs2ci models export-fastdvdnet WEIGHTS -o FILE` makes one"
    of = "frames"
    makes = "the middle frame"

    def is_one(self) -> bool:
        """Tell by inputs and outputs whether the file is of this kind."""
        if self.ranks not in ([_RANK, 0], [_RANK, 1]):
            return False
        images, count, channels, *sides = (fixed_side(side) for side in self.inputs[0].shape)
        odd = count is not None and count % 2 == 1
        return odd and channels in (1, 3) and images in (None, 1) and not any(sides)

    def denoised(self, views: F32, sigma: float) -> F32:
        """Denoise a stack, [N, C, H, W], of as many colours as the model takes."""
        height, width = views.shape[2:]
        padded, count = self.padded(views, self.inputs[0]), self.inputs[0].shape[1]
        places = np.pad(np.arange(len(views)), count // 2, mode="symmetric" if len(views) == 1 else "reflect")
        level = np.full((1,) * len(self.inputs[1].shape), sigma, np.float32)
        # One middle frame at a time: the working memory of a network is hundreds of times its frames.
        answers = [
            self.answer((padded[places[i : i + count]][None], level), padded[:1].shape, f" at sigma {sigma:.4g}")
            for i in range(len(views))
        ]
        return np.ascontiguousarray(np.concatenate(answers)[:, :, :height, :width])


def open_denoiser(path: Path) -> Denoiser:
    """Open a denoiser of images or of video, by the rank of its input.

    Raises:
        InputError: As for the two.
    """
    inputs = open_model(Path(path), OnnxDenoiser.missing).get_inputs()
    video = bool(inputs) and len(inputs[0].shape) == _RANK
    return OnnxVideoDenoiser(path) if video else OnnxDenoiser(path)
