"""The data term of a fit for predictions on a device, in one run of launches that is captured and replayed.

Nothing is read back: the loss is a tensor []. Sums have an order of their own, the same from run to run. Never run on a
GPU so far. Here: the arrays, and the order of the kernels. Not here: the kernels (`device_loss_kernels.py`), why they
compute so (`ssim.py`), the term's weights and the target's statistics, which are the host's (`objective.DataTerm`).
"""

from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from gs2ci.reconstruct.fit.kernels.device import kernels
from gs2ci.reconstruct.fit.losses import device_loss_kernels as loss_kernels
from gs2ci.reconstruct.fit.losses.objective import DataTerm
from gs2ci.render.recording import Launcher, Recording


class DataTermOnDevice:
    """See `objective.DataTerm`.

    Args:
        term: The same on the host.
        device: Where predictions lie.
    """

    def __init__(self, term: DataTerm, device: torch.device) -> None:
        def there(array: Any, kind: Any = np.float32) -> Tensor:
            return torch.from_numpy(np.array(array, dtype=kind).reshape(-1)).to(device)

        self._shape, self._channels = term.shape, term.shape[2]
        height, width, channels = term.shape
        self._row, self._height, self._size = width * channels, height, height * width * channels
        alike = term.similarity
        arrays = [there(one) for one in (term.target, *alike.of_target, alike.taps, term.fitted[..., 0])]
        saturated = np.zeros((height, width)) if term.saturated is None else term.saturated
        self._saturated = wp.from_torch(there(saturated, np.uint8))
        self._predicted, self._gradient, self._apart, self._counted = torch.empty(4, self._size, device=device)
        self._loss = torch.empty(1, dtype=torch.float64, device=device)
        self._target, *self._statistics, self._centred, self._taps, self._fitted = map(wp.from_torch, arrays)
        given = (self._predicted, self._gradient, self._apart, self._counted, self._loss)
        self._shared = [wp.from_torch(one) for one in given]
        place = str(self._target.device.alias)
        self._error = wp.empty(self._size, dtype=wp.float32, device=place)
        self._halfway, self._partial = (wp.empty(self._size, dtype=wp.vec3, device=place) for _ in range(2))
        self._sums = wp.empty(-(-self._size // int(kernels.CHUNK)), dtype=wp.vec2d, device=place)
        weight = term.similarity_weight
        self._weights = ((1 - weight) * term.per_value, weight / self._size)
        self._per_exposure = float(term.per_exposure)
        self._comparing, self._weighing = Recording(place, self._compare), Recording(place, self._weigh)

    def value_and_gradient(self, predicted: Tensor) -> tuple[Tensor, Tensor]:
        """See `objective.DataTerm.value_and_gradient`; the gradient lies in memory that the next call writes to."""
        self._predicted.copy_(predicted.reshape(-1))
        self._weighing.run()
        return self._loss[0].clone(), self._gradient.view(self._shape)

    def dissimilarity(self, predicted: Tensor) -> Tensor:
        """See `objective.DataTerm.dissimilarity`."""
        self._predicted.copy_(predicted.reshape(-1))
        self._comparing.run()
        counts = self._counted.view(self._shape).amax(dim=2)
        return self._apart.view(self._shape).mean(dim=2) * counts

    def _compare(self, launch: Launcher) -> None:
        predicted, _, apart, counted, _ = self._shared
        given = [predicted, self._target, self._fitted, self._saturated, self._channels, self._per_exposure]
        found = [self._error, counted, self._partial]
        launch(loss_kernels.find_error, self._size, [*given, self._centred], found)
        self._filter_columns(launch)
        along = [self._taps, self._row, self._channels]
        launch(loss_kernels.compare, self._size, [self._halfway, *self._statistics, *along], [apart, self._partial])

    def _filter_columns(self, launch: Launcher) -> None:
        given = [self._partial, self._taps, self._height, self._row]
        launch(loss_kernels.filter_columns, self._size, given, [self._halfway])

    def _weigh(self, launch: Launcher) -> None:
        self._compare(launch)
        self._filter_columns(launch)
        _, gradient, apart, counted, loss = self._shared
        size, (of_error, of_unlike) = self._size, self._weights
        along = [self._taps, self._row, self._channels]
        slopes = [of_error * self._per_exposure, of_unlike * self._per_exposure]
        launch(
            loss_kernels.find_gradient,
            size,
            [self._halfway, self._error, self._centred, counted, *along, *slopes],
            [gradient],
        )
        launch.blocks(loss_kernels.sum_errors, len(self._sums), int(kernels.SUMMED), [self._error, apart], [self._sums])
        launch.blocks(loss_kernels.find_loss, 1, int(kernels.SUMMED), [self._sums, of_error, of_unlike], [loss])
