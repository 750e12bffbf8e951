"""How unlike two images look: the unweighted term of the pseudo-view loss (paper, eq. 10, D_per).

Here: the interface, and the substitute that needs no weights: 1 − SSIM, averaged over three scales. It is not LPIPS,
and no report calls it so. Not here: learned distances (`learned/lpips.py`), the loss around them (`fine.py`).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import torch
from torch import Tensor

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.fit.losses.ssim import SimilarityTo
from gs2ci.reconstruct.learned.lpips import Lpips
from gs2ci.reconstruct.learned.onnx_models import find_model, known_model

_FILE: Final = "lpips:"


class PerceptualDistance(Protocol):
    """A differentiable distance between an image and a fixed target."""

    @property
    def name(self) -> str:
        """Get its name in reports."""

    def __call__(self, image: Tensor, target: Tensor) -> Tensor:
        """Return the distance of images [H, W, 3], full scale 1, as a scalar; the gradient reaches `image` only."""


@dataclass(frozen=True)
class StructuralDissimilarity:
    """1 − SSIM, averaged over an image and its halvings: the substitute if no learned distance is available.

    Over three sizes, the full one included; fewer if a side would fall below one pixel.
    """

    name: str = "structural dissimilarity"

    def __call__(self, image: Tensor, target: Tensor) -> Tensor:
        """Compare; arguments as for `PerceptualDistance`."""
        distances = []
        for _ in range(3):
            distances.append(_Dissimilarity.apply(image, target))  # type: ignore[no-untyped-call]
            if min(image.shape[:2]) < 2:
                break
            image, target = _halved(image), _halved(target)
        return torch.stack(distances).mean()


def load_distance(name: str) -> PerceptualDistance:
    """Load a perceptual distance.

    Args:
        name: "structure", which needs no weights; "lpips", the model added under that name; "lpips:FILE"; or
            "lpips-or-structure", the former if it has been added.

    Raises:
        InputError: No such name, or the model file cannot be used.
        StorageError: The list of added models cannot be read.
    """
    if name == "lpips-or-structure":
        name = "structure" if known_model("lpips") is None else "lpips"
    if name == "structure":
        return StructuralDissimilarity()
    if name == "lpips":
        return Lpips(find_model("lpips"))
    if name.startswith(_FILE):
        return Lpips(Path(name.removeprefix(_FILE)))
    raise InputError(f"perceptual distance {name!r}", allowed="structure, lpips, lpips:FILE or lpips-or-structure")


def _halved(image: Tensor) -> Tensor:
    return torch.nn.functional.avg_pool2d(image.permute(2, 0, 1), 2).permute(1, 2, 0)


class _Dissimilarity(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, image: Tensor, target: Tensor) -> Tensor:
        fixed = target.detach().contiguous().numpy()
        similarity, gradient = SimilarityTo(fixed)(image.detach().contiguous().numpy())
        ctx.gradient = torch.from_numpy(gradient)
        return image.new_tensor(1 - similarity)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        return -ctx.gradient * upstream, None
