"""Gaussians on a line, and evidence about them."""

from collections.abc import Callable, Iterable

import numpy as np
import pytest
import torch

from gs2ci.reconstruct.fit.density.base import GaussianStatistics
from gs2ci.render.gaussians import Gaussians

SMALL = 0.001


def _line(count: int, opacity: float | torch.Tensor = 0.5, size: float = SMALL) -> Gaussians:
    """Gaussians a unit apart on a line."""
    opacity = torch.as_tensor(opacity, dtype=torch.float32).expand(count)
    means = torch.zeros(count, 3)
    means[:, 0] = torch.arange(count)
    return Gaussians(
        means=means,
        log_scales=torch.full((count, 3), float(np.log(size))),
        quaternions=torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
        opacity_logits=torch.logit(opacity).clone(),
        colours=torch.arange(count * 3, dtype=torch.float32).reshape(count, 3),
    )


def _evidence(
    count: int,
    *,
    moved: Iterable[int] = (),
    wide: Iterable[int] = (),
    wrong: Iterable[int] = (),
    cap: int = 10**6,
    iteration: int = 100,
) -> GaussianStatistics:
    """Gradients on those `moved`, a large radius for the `wide`, errors on the `wrong`, the later the larger."""

    def ranked(chosen: Iterable[int], least: float) -> torch.Tensor:
        column = torch.zeros(count)
        for rank, index in enumerate(chosen):
            column[index] = least + rank
        return column

    return GaussianStatistics(ranked(moved, 1.0), ranked(wide, 0.5), lambda: ranked(wrong, 1.0), 1.0, cap, iteration)


@pytest.fixture
def line() -> Callable[..., Gaussians]:
    return _line


@pytest.fixture
def evidence() -> Callable[..., GaussianStatistics]:
    return _evidence
