"""The data term of a fit in torch, for predictions on a device: the arithmetic of `ssim.py` and `objective.DataTerm`.

Nothing is read back: the loss is a tensor []. Sums have an order of their own; convolutions are computed in full
float32 (TF32 would keep three digits) by algorithms that give the same bits from run to run. Never run on a GPU so far.
Here: these two. Not here: why they are computed so (`ssim.py`), the term's weights (`objective.py`).
"""

import torch
from torch import Tensor

from gs2ci.core.arrays import F32, Bool
from gs2ci.reconstruct.fit.losses.objective import LossWeights
from gs2ci.reconstruct.fit.losses.ssim import C1, C2, window_taps


class SimilarityOnDevice:
    """See `ssim.SimilarityTo`; the target's statistics are computed in float64, once.

    Args:
        target: [H, W, C], on the device.
        window_px: The window's side.
    """

    def __init__(self, target: Tensor, window_px: int) -> None:
        taps = torch.from_numpy(window_taps(window_px))
        self._taps = torch.cat([taps.flip(0)[:-1], taps]).to(target.device)
        exact = target.double()
        middle = exact.mean(dim=(0, 1))
        mean, mean_square = self._filtered(exact), self._filtered(exact * exact)
        self._target = target.float()
        self._mean, self._centred_mean = mean.float(), (mean - middle).float()
        self._variance = (mean_square - mean * mean).float()
        self._centred = (exact - middle).float()

    def _filtered(self, image: Tensor) -> Tensor:
        """Filter [H, W, K]; pixels outside the image count as zero."""
        taps = self._taps.to(image.dtype)
        reach = len(taps) // 2
        planes = image.permute(2, 0, 1)[:, None]
        with torch.backends.cudnn.flags(enabled=True, benchmark=False, deterministic=True, allow_tf32=False):
            down = torch.nn.functional.conv2d(planes, taps[None, None, :, None], padding=(reach, 0))
            across = torch.nn.functional.conv2d(down, taps[None, None, None, :], padding=(0, reach))
        return across[:, 0].permute(1, 2, 0)

    def _compared(self, error: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return 1 − similarity, [H, W, C], and the similarity's derivatives by filtered e, e² and eb."""
        fe, ee, eb = self._filtered(torch.cat([error, error * error, error * self._centred], dim=2)).chunk(3, dim=2)
        ma = self._mean + fe
        difference = (ee - fe * fe).clamp(min=0.0)
        bottom = 2 * self._variance + 2 * (eb - fe * self._centred_mean) + difference + C2
        per_bottom = 1 / bottom.clamp(min=0.5 * C2)
        unlike = difference * per_bottom
        per_means = 1 / (ma * ma + self._mean * self._mean + C1)
        darker = fe * fe * per_means
        luminance, structure = 1 - darker, 1 - unlike
        slope = luminance * per_bottom
        by_luminance = 2 * (darker * ma - fe) * per_means
        by_e = structure * by_luminance + 2 * slope * (fe - unlike * (self._centred_mean + fe))
        return darker + unlike - darker * unlike, by_e, -slope * structure, 2 * slope * unlike

    def dissimilarity(self, image: Tensor) -> Tensor:
        """See `ssim.SimilarityTo.dissimilarity`."""
        return self._compared(image - self._target)[0].mean(dim=2)

    def of_error(self, error: Tensor) -> tuple[Tensor, Tensor]:
        """See `ssim.SimilarityTo.of_error`; the gradient is the caller's."""
        apart, *derivatives = self._compared(error)
        by_e, by_ee, by_eb = self._filtered(torch.cat(derivatives, dim=2)).chunk(3, dim=2)
        gradient = (by_e + 2 * error * by_ee + self._centred * by_eb) / error.numel()
        return 1 - apart.mean(dtype=torch.float64), gradient


class DataTermOnDevice:
    """See `objective.DataTerm`; arguments likewise, and the device."""

    def __init__(
        self,
        measurement: F32,
        fitted: Bool,
        saturated: Bool | None,
        weights: LossWeights,
        exposure: float,
        device: torch.device,
    ) -> None:
        def there(array: F32 | Bool) -> Tensor:
            return torch.from_numpy(array).to(device)

        self._fitted = there(fitted[..., None]).float()
        self._per_exposure = 1 / exposure
        self._target = there(measurement) * (self._per_exposure * self._fitted)
        self._saturated = None if saturated is None or not saturated.any() else there(saturated[..., None])
        self._similarity_weight = weights.similarity
        self._similarity = SimilarityOnDevice(self._target, weights.window_px)
        self._per_value = 1.0 / max(1.0, float(fitted.sum()) * measurement.shape[2])

    def value_and_gradient(self, predicted: Tensor) -> tuple[Tensor, Tensor]:
        """See `losses.DataTerm.value_and_gradient`."""
        error, counted = self._error(predicted)
        similarity, by_similarity = self._similarity.of_error(error)
        weight = self._similarity_weight
        gradient = (1 - weight) * self._per_value * error.sign() - weight * counted * by_similarity
        l1 = error.abs().sum(dtype=torch.float64) * self._per_value
        return (1 - weight) * l1 + weight * (1 - similarity), gradient * self._per_exposure

    def _error(self, predicted: Tensor) -> tuple[Tensor, Tensor]:
        """See `losses.DataTerm._error`."""
        counted = self._fitted
        predicted = predicted * self._per_exposure
        if self._saturated is not None:
            counted = counted * ~(self._saturated & (predicted > self._target))
        return (predicted - self._target) * counted, counted

    def dissimilarity(self, predicted: Tensor) -> Tensor:
        """See `losses.DataTerm.dissimilarity`."""
        error, counted = self._error(predicted)
        return self._similarity.dissimilarity(self._target + error) * counted.any(dim=2)
