"""A prior in an ONNX file: an image-to-image network, such as an export of Difix.

Here: the signature. Not here: the network; the prompt and the diffusion timestep are fixed when it is exported.

A model takes images, [B, 3, H, W] float32 in [−1, 1], and, if its encoder draws at random, a seed: one integer, [] or
[1]. It returns images of the same shape and range. Open sides are padded to multiples of 8 and cropped again.
"""

from pathlib import Path

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.learned.onnx_models import OnnxModel, fixed_side
from gs2ci.reconstruct.paper.priors2d.base import Question, check_targets


class OnnxPrior(OnnxModel):
    """An image-to-image network in an ONNX file; see `OnnxModel`.

    Args:
        path: The file.
        seed: For its encoder, if it takes one; view i gets seed + i.
    """

    kind = "a prior on images"
    called = "images [B, 3, H, W] float32 in [-1, 1], then, if at all, a seed: [] or [1] int64"
    missing = "export one, or take --prior none"
    makes = "images of the same size"
    scaled = "check that the model was exported for values in [-1, 1], and in float32"

    def __init__(self, path: Path, seed: int = 0) -> None:
        super().__init__(path)
        self._seed = seed

    def is_one(self) -> bool:
        """Tell by inputs and outputs whether the file is of this kind."""
        if [(one.type, len(one.shape)) for one in self.inputs[:1]] != [("tensor(float)", 4)] or len(self.inputs) > 2:
            return False
        image, *seeds = self.inputs
        seeded = all(one.type == "tensor(int64)" and one.shape in ([], [1]) for one in seeds)
        return seeded and fixed_side(image.shape[0]) in (None, 1) and fixed_side(image.shape[1]) in (None, 3)

    @property
    def name(self) -> str:
        """Get its name in reports: that of the file."""
        return self.path.name

    def __call__(self, question: Question) -> F32:
        """Run the network on each pseudo-view by itself; arguments as for `ImagePrior`."""
        images = question.pseudo.images
        if not len(images):
            return images
        return check_targets(self.name, np.stack([self._improved(image, i) for i, image in enumerate(images)]), images)

    def _improved(self, image: F32, index: int) -> F32:
        height, width = image.shape[:2]
        scaled = self.padded(np.clip(image, 0, 1).transpose(2, 0, 1)[None] * 2 - 1, self.inputs[0])
        seeds = [np.full(tuple(one.shape), self._seed + index, np.int64) for one in self.inputs[1:]]
        answer = self.answer((scaled, *seeds), scaled.shape)
        return ((answer[0, :, :height, :width].transpose(1, 2, 0) + 1) / 2).astype(np.float32)
