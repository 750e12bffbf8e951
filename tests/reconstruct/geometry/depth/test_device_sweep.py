"""The loops of a plane sweep for a device do what the CPU's kernels do."""

import numpy as np
import pytest
import torch

from gs2ci.reconstruct.geometry.depth.device_sweep import best_planes_on_device
from gs2ci.reconstruct.geometry.depth.kernels import best_plane, matching_cost, sum_along_rows
from gs2ci.reconstruct.geometry.depth.sweep import plane_homographies
from gs2ci.render.se3 import exp
from tests.reconstruct.fit.reading_back import reads

SIZE = (20, 26)


def planes_of(features, homographies, best, window):
    cost = matching_cost(features[0], features[1:], homographies, best, window)
    return best_plane(cost, sum_along_rows(cost)), cost


@pytest.mark.parametrize(("window", "best", "views"), [(1, 1, 1), (5, 2, 3), (7, 3, 4)])
def test_planes_are_those_of_the_kernels(window, best, views):
    random = np.random.default_rng(views)
    features = random.random((1 + views, *SIZE, 8)).astype(np.float32) * 0.3
    # Some planes send pixels outside the views, and some behind them.
    twists = torch.tensor(random.normal(0, 0.08, (views, 6)))
    twists[0, 2] = -0.6
    matrix = np.array([[24.0, 0, 13], [0, 24, 10], [0, 0, 1]])
    homographies = plane_homographies(exp(twists).numpy(), matrix, np.linspace(0.2, 2.5, 12))
    here, cost = planes_of(features, homographies, best, window)
    with reads() as count:
        there = best_planes_on_device(features, homographies, best, window, torch.device("cpu"))
    assert count.calls == {"cpu": 1, "numpy": 1}
    # Where two planes cost the same, rounding decides.
    apart = np.abs(there - here)
    assert np.mean(apart < 1e-2) > 0.98
    index = np.rint(there).astype(int)
    assert cost.shape == (*SIZE, 12)
    assert np.all((there >= 0) & (there <= 11))
    assert index.std() > 0
