"""A prior in an ONNX file: an image-to-image network, such as an export of Difix.

Here: the signature, and an error for every way in which a file or its output can be wrong. Not here: the network; the
prompt and the diffusion timestep are fixed when it is exported.

A model takes images, [B, 3, H, W] float32 in [−1, 1], and, if its encoder draws at random, a seed: one integer, [] or
[1]. It returns images of the same shape and range. Open sides are padded to multiples of 8 and cropped again.
"""

from pathlib import Path
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci.reconstruct.learned.onnx_models import SIDE_MULTIPLE, fixed_side, open_model, run_model, signature
from gs2ci.reconstruct.paper.priors2d.base import Question, check_targets

_CALLED: Final = "images [B, 3, H, W] float32 in [-1, 1], then, if at all, a seed: [] or [1] int64"


class OnnxPrior:
    """An image-to-image network.

    Args:
        path: The file.
        seed: For its encoder, if it takes one; view i gets seed + i.

    Raises:
        InputError: No such file, a file that ONNX Runtime refuses, or inputs other than those of such a network.
    """

    def __init__(self, path: Path, seed: int = 0) -> None:
        self.path = Path(path)
        self._seed_value = seed
        self._session = open_model(self.path, "export one, or take --prior consistent")
        inputs = self._session.get_inputs()
        if len(inputs) not in (1, 2) or inputs[0].type != "tensor(float)" or len(inputs[0].shape) != 4:
            raise self._refusal()
        if fixed_side(inputs[0].shape[0]) not in (None, 1) or fixed_side(inputs[0].shape[1]) not in (None, 3):
            raise self._refusal()
        if len(inputs) == 2 and (inputs[1].type != "tensor(int64)" or inputs[1].shape not in ([], [1])):
            raise self._refusal()
        self._image, self._seed = inputs[0], inputs[1] if len(inputs) == 2 else None

    @property
    def name(self) -> str:
        """Get its name in reports: that of the file."""
        return self.path.name

    def __call__(self, question: Question) -> F32:
        """Run the network on each pseudo-view by itself; arguments as for `ImagePrior`."""
        images = question.pseudo.images
        if not len(images):
            return images
        return check_targets(self.name, np.stack([self._answer(image, i) for i, image in enumerate(images)]), images)

    def _answer(self, image: F32, index: int) -> F32:
        height, width = image.shape[:2]
        scaled = np.clip(image, 0, 1).transpose(2, 0, 1)[None] * 2 - 1
        feed = {self._image.name: np.ascontiguousarray(self._padded(scaled), np.float32)}
        if self._seed is not None:
            feed[self._seed.name] = np.full(tuple(self._seed.shape), self._seed_value + index, np.int64)
        remedy = "check the model with its own images; export it with dynamic height and width"
        first = self._session.get_outputs()[0].name
        answer = np.asarray(run_model(self._session, self.name, feed, remedy)[first])
        # A wrong shape is returned unchanged; `check_targets` refuses it with the prior's name.
        if answer.shape != feed[self._image.name].shape:
            return answer
        restored: F32 = ((answer[0, :, :height, :width].transpose(1, 2, 0) + 1) / 2).astype(np.float32)
        return restored

    def _padded(self, images: F32) -> F32:
        had = images.shape[2:]
        sides = [fixed_side(side) for side in self._image.shape[2:]]
        if any(side is not None and side < size for side, size in zip(sides, had, strict=True)):
            raise InputError(
                f"{self.name} takes images of {sides[0]} x {sides[1]} pixels, not of {had[0]} x {had[1]}",
                remedy="export the model with dynamic height and width",
            )
        wanted = [side or -(-size // SIDE_MULTIPLE) * SIDE_MULTIPLE for side, size in zip(sides, had, strict=True)]
        rows, columns = wanted[0] - had[0], wanted[1] - had[1]
        return np.pad(images, ((0, 0), (0, 0), (0, rows), (0, columns)), mode="symmetric")

    def _refusal(self) -> InputError:
        return InputError(
            f"{self.path} is not a prior on images: it takes {signature(self._session)}",
            allowed=_CALLED,
            remedy="wrap the network so that it has this signature, and export it again",
        )
