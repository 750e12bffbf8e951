"""Video denoisers from ONNX files, run by ONNX Runtime on the CPU: several frames in, the middle one out.

Here: the supported signature, frames beyond both ends, and an error for every way in which a file or its output can be
wrong. Not here: how such a file is made (`fastdvdnet` exports one), denoisers of single images (`onnx_denoiser`).

A model takes `[N, F, C, H, W]` float32: F frames in the order of exposure, F fixed and odd, C = 1 or 3, full scale 1;
and sigma, `[]` or `[N]`. It returns the middle frame, `[N, C, H, W]`.
"""

from pathlib import Path
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError, NumericsError
from gs2ci.reconstruct.decode.denoisers import Denoiser
from gs2ci.reconstruct.learned.onnx_denoiser import OnnxDenoiser
from gs2ci.reconstruct.learned.onnx_models import SIDE_MULTIPLE, fixed_side, open_model, run_model, signature

_RANK: Final = 5
_CALLED: Final = (
    "frames [N, F, 1 or 3, H, W] float32 with F fixed and odd and open sides, then sigma: [] or [N] float32"
)


class OnnxVideoDenoiser:
    """A video denoiser in an ONNX file.

    Args:
        path: The file.

    Raises:
        InputError: No such file, a file that ONNX Runtime refuses, or inputs other than those of a video denoiser.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._session = open_model(self.path, "`gs2ci models export-fastdvdnet WEIGHTS -o FILE` makes one")
        inputs = self._session.get_inputs()
        if len(inputs) != 2 or any(one.type != "tensor(float)" for one in inputs):
            raise self._refusal()
        frames, sigma = inputs
        if len(frames.shape) != _RANK or len(sigma.shape) > 1:
            raise self._refusal()
        images, count, channels, *sides = (fixed_side(side) for side in frames.shape)
        if count is None or count % 2 == 0 or channels not in (1, 3) or images not in (None, 1) or any(sides):
            raise self._refusal()
        self._frames, self._sigma, self._count, self._channels = frames, sigma, count, channels

    def __call__(self, views: F32, sigma: float) -> F32:
        """Denoise a stack, [N, C, H, W], each view with those before and after it; arguments as for `Denoiser`.

        Beyond the first and the last view the stack is mirrored. A grey model gets the colours one by one. A colour
        model gets a grey image three times, and √3 sigma, since the same noise in three channels has √3 times the norm
        of independent noise per channel. On a photograph 9.5/255 remained of noise of 25/255, and 14.6/255 without the
        factor.

        Raises:
            NumericsError: The model failed on these frames, changed their shape, or returned NaN or infinity.
        """
        channels = views.shape[1]
        if self._channels == channels:
            return self._denoise(views, sigma)
        if self._channels == 1:
            return np.concatenate([self._denoise(views[:, c : c + 1], sigma) for c in range(channels)], axis=1)
        return self._denoise(np.repeat(views, 3, axis=1), 3**0.5 * sigma).mean(axis=1, keepdims=True)

    def _denoise(self, views: F32, sigma: float) -> F32:
        height, width = views.shape[2:]
        rows, columns = (-(-side // SIDE_MULTIPLE) * SIDE_MULTIPLE - side for side in (height, width))
        padded = np.pad(views, ((0, 0), (0, 0), (0, rows), (0, columns)), mode="symmetric")
        # One middle frame at a time: the working memory of a network is hundreds of times its frames.
        level = np.full((1,) if len(self._sigma.shape) else (), sigma, np.float32)
        answers = [self._run(padded[self._around(i, len(views))][None], level) for i in range(len(views))]
        return np.ascontiguousarray(np.concatenate(answers)[:, :, :height, :width])

    def _around(self, middle: int, count: int) -> list[int]:
        reach = self._count // 2
        places = np.pad(np.arange(count), reach, mode="symmetric" if count == 1 else "reflect")
        return [int(place) for place in places[middle : middle + self._count]]

    def _run(self, frames: F32, level: F32) -> F32:
        feed = {self._frames.name: np.ascontiguousarray(frames, np.float32), self._sigma.name: level}
        remedy = "check the model with its own frames; export it with dynamic height and width"
        first = self._session.get_outputs()[0].name
        denoised = np.asarray(run_model(self._session, self.path.name, feed, remedy)[first])
        wanted = (1, *frames.shape[2:])
        if denoised.shape != wanted:
            raise NumericsError(
                f"{self.path.name} made {list(denoised.shape)} of frames {list(frames.shape)}",
                allowed=f"the middle frame, {list(wanted)}",
            )
        if not np.isfinite(denoised).all():
            raise NumericsError(
                f"{self.path.name} returned numbers that are not finite at sigma {float(level.mean()):.4g}",
                remedy="check that the model takes frames and sigma with full scale 1",
            )
        return denoised.astype(np.float32, copy=False)

    def _refusal(self) -> InputError:
        return InputError(
            f"{self.path} is not a video denoiser: it takes {signature(self._session)}",
            allowed=_CALLED,
            remedy="wrap the network so that it has this signature, and export it again",
        )


def open_denoiser(path: Path) -> Denoiser:
    """Open a denoiser of images or of video, by the rank of its input.

    Raises:
        InputError: As for the two.
    """
    session = open_model(Path(path), "`gs2ci models export-ffdnet WEIGHTS -o FILE` makes one")
    inputs = session.get_inputs()
    video = bool(inputs) and len(inputs[0].shape) == _RANK
    return OnnxVideoDenoiser(path) if video else OnnxDenoiser(path)
