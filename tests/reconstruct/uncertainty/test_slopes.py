import numpy as np
import torch

from gs2ci.reconstruct.uncertainty.slopes import slopes


def test_slopes_are_differences_per_pixel_down_and_across():
    rows, columns = np.mgrid[:4, :5].astype(np.float64)
    down, across = slopes(torch.from_numpy(3 * rows + 2 * columns)[None])
    assert np.allclose(down, 3)
    assert np.allclose(across, 2)


def test_along_a_side_of_one_pixel_nothing_changes():
    down, across = slopes(torch.arange(5.0)[None])
    assert not down.any()
    assert np.allclose(across, 1)
