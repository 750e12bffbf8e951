"""The coarse-stage objective: 0.9 ℓ1 + 0.1 (1 − SSIM) on the measurement + 0.01 × mean opacity (paper, eq. 7).

Here: the data term with held-out and saturated pixels, the opacity term, and the size term that 3DGS-MCMC adds. Not
here: the rendering that makes the prediction (`gs2ci.render`).
"""

from dataclasses import dataclass
from typing import Annotated, Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import AfterValidator, Field
from torch import Tensor

from gs2ci.core.arrays import F32, Bool
from gs2ci.core.bounds import LARGEST_WINDOW_PX, Bounded, odd
from gs2ci.reconstruct.fit.kernels.calling import call
from gs2ci.reconstruct.fit.kernels.gaussian_kernels import add_opacity_gradient, add_size_gradient
from gs2ci.reconstruct.fit.losses.ssim import LEAST_WINDOW, WINDOW, SimilarityTo
from gs2ci.render.gaussians import Gaussians


@dataclass(frozen=True)
class LossWeights(Bounded):
    """The weights of the objective, and its window.

    Args:
        similarity: Share of (1 − SSIM) in the data term; the rest is ℓ1 (paper: 0.1).
        window_px: Side of SSIM's window.
        opacity: Weight of the mean opacity (paper: 0.01).
        size: Weight of the mean standard deviation, in scene units (Kheradmand et al. 2024: 0.01; paper: none).
    """

    similarity: float = 0.1
    window_px: Annotated[int, Field(ge=LEAST_WINDOW, le=LARGEST_WINDOW_PX), AfterValidator(odd)] = WINDOW
    opacity: float = 0.01
    size: float = 0.0


class Term(Protocol):
    """What an iteration asks of a data term: of arrays on the host, of tensors on a device."""

    def value_and_gradient(self, predicted: Any) -> tuple[Any, Any]:
        """Return the loss of a prediction [H, W, C] and its gradient."""

    def dissimilarity(self, predicted: Any) -> Any:
        """Return 1 − SSIM at each pixel of a prediction [H, W, C], [H, W]; zero at pixels that do not count."""


class DataTerm:
    """(1 − λ) ℓ1 + λ (1 − SSIM) between a predicted measurement and the measured one.

    Pixels outside `fitted` are set to zero in both, so that they neither count nor influence their neighbours.
    Saturated pixels are lower bounds: a prediction above them is not an error.

    Args:
        measurement: [H, W, C] float32.
        fitted: Pixels that the loss may see, [H, W] bool.
        saturated: Clipped pixels, [H, W] bool, or None.
        weights: λ and the window, as `similarity` and `window_px`.
        exposure: The reading of a white pixel under one open mask, by which both are divided: terms that do not come
            from readings, and SSIM's constants, must not weigh more where exposures are short.
    """

    def __init__(
        self, measurement: F32, fitted: Bool, saturated: Bool | None, weights: LossWeights, exposure: float = 1.0
    ) -> None:
        self.shape = measurement.shape
        # Of every channel, since NumPy spreads a last axis of one number over three at a tenth of the speed.
        self.fitted = np.repeat(fitted[..., None].astype(np.float32), measurement.shape[2], axis=2)
        self.per_exposure = np.float32(1 / exposure)
        self.target = measurement * (self.per_exposure * self.fitted)
        self.saturated = None if saturated is None or not saturated.any() else saturated[..., None]
        self.similarity_weight = weights.similarity
        self.similarity = SimilarityTo(self.target, weights.window_px)
        # This mean is over the pixels that count. That of the similarity is over all, and those that do not count are
        # alike in both pictures there: the larger their share, the less the similarity weighs beside this term.
        self.per_value = 1.0 / max(1.0, float(self.fitted.sum(dtype=np.float64)))

    def value_and_gradient(self, predicted: F32) -> tuple[float, F32]:
        """Return the loss of a prediction [H, W, C] and its gradient."""
        error, counted = self._error(predicted)
        similarity, similarity_gradient = self.similarity.of_error(error)
        weight = self.similarity_weight
        similarity_gradient *= counted
        similarity_gradient *= np.float32(weight)
        gradient = np.sign(error)
        gradient *= np.float32((1 - weight) * self.per_value)
        gradient -= similarity_gradient
        gradient *= self.per_exposure
        l1 = float(np.abs(error, out=error).sum(dtype=np.float64)) * self.per_value
        return (1 - weight) * l1 + weight * (1 - similarity), gradient

    def _error(self, predicted: F32) -> tuple[F32, NDArray[Any]]:
        """Return the error of a prediction at the pixels that count, and which pixels count, [H, W, 1 or C]."""
        counted = self.fitted
        predicted = predicted * self.per_exposure
        if self.saturated is not None:
            counted = counted * ~(self.saturated & (predicted > self.target))
        error = predicted - self.target
        error *= counted
        return error, counted

    def dissimilarity(self, predicted: F32) -> F32:
        """Return 1 − SSIM at each pixel of a prediction [H, W, C], [H, W]; zero at pixels that do not count."""
        error, counted = self._error(predicted)
        return self.similarity.dissimilarity(self.target + error) * counted.any(axis=2)


def add_regularisers(scene: Gaussians, weights: LossWeights) -> float | Tensor:
    """Return the weighted mean opacity and mean size of a scene, and add their gradient to the scene's.

    A number, or a tensor [] of a scene on a device.
    """
    found: float | Tensor = weights.opacity * call(
        add_opacity_gradient, *_values(scene.opacity_logits, weights.opacity)
    )
    if weights.size:
        found += weights.size * call(add_size_gradient, *_values(scene.log_scales, weights.size))
    return found


def _values(tensor: Tensor, weight: float) -> tuple[Tensor, float, Tensor]:
    """Return a parameter, a weight and the parameter's gradient as the kernels take them."""
    if tensor.grad is None:
        tensor.grad = torch.zeros_like(tensor)
    return tensor.detach().view(-1), weight, tensor.grad.view(-1)
