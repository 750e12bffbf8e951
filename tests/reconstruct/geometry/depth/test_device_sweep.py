"""The loops of a plane sweep for a device do what the CPU's kernels do."""

import numpy as np
import pytest
import torch

pytest.importorskip("warp", reason="Warp is not installed")
from scipy.ndimage import gaussian_filter

from gs2ci.reconstruct.geometry.depth import device_sweep
from gs2ci.reconstruct.geometry.depth.device_sweep import best_planes_on_device
from gs2ci.reconstruct.geometry.depth.kernels import best_plane, matching_cost, smoothed
from gs2ci.reconstruct.geometry.depth.sweep import plane_homographies
from tests.reconstruct.fit.reading_back import reads
from tests.render.se3 import exp

HEIGHT, WIDTH, FOCAL_PX = 24, 40, 24.0
MATRIX = np.array([[FOCAL_PX, 0, WIDTH / 2], [0, FOCAL_PX, HEIGHT / 2], [0, 0, 1]])
PLANES = np.linspace(0, 5.5, 12)


def near_and_far(views):
    """Features of a reference view and others, which move by 1, 2, ... px: the right half at 4, the left at 1."""
    random = np.random.default_rng(views)
    reference = gaussian_filter(random.random((HEIGHT, WIDTH, 8)), (1, 1, 0)).astype(np.float32)
    shown = [reference]
    for view in range(1, views + 1):
        moved = gaussian_filter(random.random((HEIGHT, WIDTH, 8)), (1, 1, 0)).astype(np.float32)
        for inverse, columns in ((1, range(WIDTH // 2)), (4, range(WIDTH // 2, WIDTH))):
            for column in columns:
                if column + view * inverse < WIDTH:
                    moved[:, column + view * inverse] = reference[:, column]
        shown.append(moved)
    return np.stack(shown)


@pytest.mark.parametrize(("window", "best", "views"), [(1, 1, 1), (5, 2, 3), (7, 3, 4)])
@pytest.mark.parametrize("forward", [0.0, -0.4])
@pytest.mark.parametrize("at_once", [1, 10**9])
def test_planes_are_those_of_the_kernels(window, best, views, forward, at_once, monkeypatch):
    monkeypatch.setattr(device_sweep, "AT_ONCE", at_once)
    features = near_and_far(views)
    twists = torch.zeros(views, 6, dtype=torch.float64)
    twists[:, 0] = torch.arange(1, views + 1) / FOCAL_PX
    twists[-1, 2] = forward  # near planes then lie behind the last view
    homographies = plane_homographies(exp(twists).numpy(), MATRIX, PLANES)
    cost = matching_cost(features, range(len(features)), homographies, best, window)
    here = best_plane(torch.from_numpy(smoothed(cost))).numpy()
    with reads() as count:
        there = best_planes_on_device(torch.from_numpy(features), homographies, best, window)
    assert count.calls == {"cpu": 1, "numpy": 1}
    # Where two planes cost the same, rounding decides.
    assert np.mean(np.abs(there - here) < 1e-2) > 0.98
    if not forward:
        assert np.median(there[:, 6:14]) == pytest.approx(2, abs=0.3)
        assert np.median(there[:, 22:26]) == pytest.approx(8, abs=0.3)
