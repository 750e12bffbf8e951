import itertools

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.measurement.coding import cfa_channels
from gs2ci.reconstruct.paper.proxies.amdi import WINDOW_SIZES, admissible, mask_decoded_views, window_sizes


def brute_force(masks, measured, sizes):
    """The supplement's equations 5 to 8 as they stand, in float64, one pixel and one window at a time."""
    n, height, width = masks.shape
    kappa_all = np.linalg.cond(np.einsum("nhw,mhw->nm", masks, masks))
    views = np.zeros((n, height, width, measured.shape[2]))
    windows = np.zeros((height, width), int)
    for r in range(height):
        for c in range(width):
            for size in sizes:
                half = size // 2
                box = np.s_[max(r - half, 0) : r + half + 1, max(c - half, 0) : c + half + 1]
                m, y = masks[:, *box].reshape(n, -1), measured[box].reshape(-1, measured.shape[2])
                gram = m @ m.T
                eigenvalues = np.linalg.eigvalsh(gram)
                if (
                    np.linalg.matrix_rank(gram, hermitian=True) == n
                    and eigenvalues[0] >= 1 - 1e-9
                    and np.linalg.cond(gram) <= 2 * kappa_all * (1 + 1e-9)
                ):
                    break
            windows[r, c] = size
            views[:, r, c] = np.linalg.solve(gram + 1e-3 * np.trace(gram) / n * np.eye(n), m @ y)
    return views, windows


@pytest.mark.parametrize("case", ["binary", "grey", "weighted", "colour", "dense", "single view"])
def test_views_and_windows_are_those_of_the_equations(make_shot, random_masks, case):
    n = 1 if case == "single view" else 4
    masks = random_masks(n, (21, 26), 0.75 if case == "dense" else 0.5, grey=case == "grey")
    channels = 3 if case == "colour" else 1
    views = np.random.default_rng(1).random((n, 21, 26, channels))
    weights = [1, 0.5, 0.8, 0.3] if case == "weighted" else np.ones(n)
    shot = make_shot(masks, views, channels=channels, weights=weights)
    found = mask_decoded_views(shot)
    transmissions = shot.masks.astype(float) * shot.weights.astype(float)[:, None, None]
    expected, windows = brute_force(transmissions, shot.measurement.astype(float), window_sizes((21, 26)))
    assert np.array_equal(found.windows[..., 0], windows)
    assert len(np.unique(windows)) > 1 or n == 1
    assert np.abs(found.views - expected).max() < 1e-6


def test_large_sums_before_a_small_window_do_not_drown_it(make_shot, random_masks):
    masks = random_masks(3, (150, 12), grey=True)
    views = np.random.default_rng(1).random((3, 150, 12, 1))
    views[:, :100] *= 1e4
    shot = make_shot(masks, views)
    expected, _ = brute_force(shot.masks.astype(float), shot.measurement.astype(float), window_sizes((150, 12)))
    assert np.abs(mask_decoded_views(shot).views - expected)[:, 140:].max() < 1e-6


def test_constant_views_come_back_to_within_the_ridge(make_shot, random_masks):
    shot = make_shot(random_masks(8, (60, 70)), channels=3)
    truth = np.linspace(0.2, 0.9, 24).reshape(8, 1, 1, 3)
    assert np.abs(mask_decoded_views(shot).views - truth).max() < 0.01


def test_pixels_that_no_mask_opens_are_decoded_from_around_them(make_shot, random_masks):
    masks = random_masks(4, (40, 40))
    masks[:, 10:20, 10:20] = 0
    found = mask_decoded_views(make_shot(masks))
    assert np.abs(found.views - np.linspace(0.2, 0.9, 4).reshape(4, 1, 1, 1)).max() < 0.01
    assert found.windows[15, 15, 0] > np.median(found.windows)


def test_saturated_pixels_do_not_count(make_shot, random_masks):
    masks = random_masks(4, (30, 30))
    saturated = np.random.default_rng(3).random((30, 30)) < 0.1
    clean = make_shot(masks, saturated=saturated)
    spoilt = clean.measurement.copy()
    spoilt[saturated] = 99
    again = make_shot(masks, measurement=spoilt, saturated=saturated)
    assert np.array_equal(mask_decoded_views(again).views, mask_decoded_views(clean).views)


def test_each_colour_of_a_mosaic_is_decoded_from_its_own_pixels(make_shot, random_masks):
    masks = random_masks(4, (40, 44))
    colours = cfa_channels("RGGB", (40, 44)).numpy()
    measured = masks.sum(axis=0) * np.array([0.3, 0.9, 0.6])[colours]
    shot = make_shot(masks, measurement=measured[..., None].astype(np.float32), cfa="RGGB")
    found = mask_decoded_views(shot)
    assert found.views.shape == (4, 40, 44, 3)
    assert np.abs(found.views - [0.3, 0.9, 0.6]).max() < 0.01
    assert found.windows[..., 0].mean() > found.windows[..., 1].mean()


def test_the_result_is_the_same_for_any_number_of_threads(make_shot, random_masks):
    shot = make_shot(random_masks(4, (64, 64), grey=True))
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        alone = mask_decoded_views(shot)
        torch.set_num_threads(3)
        together = mask_decoded_views(shot)
    finally:
        torch.set_num_threads(before)
    assert np.array_equal(alone.views, together.views)


@pytest.mark.parametrize("kind", ["two equal", "all open", "one closed", "sum of two", "fewer pixels than views"])
def test_masks_that_do_not_tell_views_apart_are_refused(make_shot, random_masks, kind):
    masks = random_masks(4, (30, 30))
    if kind == "two equal":
        masks[2] = masks[1]
    elif kind == "all open":
        masks[:] = 1
    elif kind == "one closed":
        masks[3] = 0
    elif kind == "sum of two":
        masks[1] *= 1 - masks[0]
        masks[2] = masks[0] + masks[1]
    else:
        masks = masks[:, :1, :3]
    with pytest.raises(InputError, match="do not distinguish their views"):
        mask_decoded_views(make_shot(masks))


def test_nearly_equal_masks_are_refused_by_their_smallest_eigenvalue(make_shot, random_masks):
    masks = random_masks(3, (30, 30), grey=True)
    masks[2] = np.clip(masks[1] + 1e-3 * masks[0], 0, 1)
    with pytest.raises(InputError, match="eigenvalues"):
        mask_decoded_views(make_shot(masks))


def test_masks_that_differ_in_a_few_pixels_grow_the_window_and_stay_finite(make_shot, random_masks):
    masks = random_masks(3, (40, 40))
    masks[2] = masks[1]
    masks[2, 0, :6] = 1 - masks[1, 0, :6]
    found = mask_decoded_views(make_shot(masks))
    assert np.isfinite(found.views).all()
    # What the ridge leaves undecided lies between the two views; that of the other mask is not touched by it.
    assert np.abs(found.views[0] - 0.2).max() < 0.02
    assert found.windows.max() > 41


def test_a_single_fully_open_mask_averages_its_smallest_window(make_shot):
    found = mask_decoded_views(make_shot(np.ones((1, 12, 12))))
    assert (found.windows == 3).all()
    assert np.abs(found.views - 0.2).max() < 1e-3


def test_admission_agrees_with_eigenvalues_on_and_around_the_bounds():
    rng = np.random.default_rng(0)
    grams = []
    for smallest, largest in ((1, 10), (0.999, 5), (1.001, 5), (2, 20.01), (2, 19.99), (2, 20), (1e-17, 1), (0, 4)):
        basis, _ = np.linalg.qr(rng.standard_normal((5, 5)))
        gram = basis @ np.diag([smallest, *np.linspace(smallest, largest, 3), largest]) @ basis.T
        grams.append((gram + gram.T) / 2)
    expected = [True, False, True, False, True, True, False, False]
    assert admissible(np.array(grams), 10.0).tolist() == expected


def test_no_matrices_are_no_work():
    assert admissible(np.empty((0, 4, 4)), 10.0).shape == (0,)


@pytest.mark.parametrize("size", [(1, 1), (4, 9), (256, 256), (1080, 1920)])
def test_windows_are_odd_grow_and_end_with_the_whole_image(size):
    sizes = window_sizes(size)
    assert all(s % 2 for s in sizes)
    assert all(a < b for a, b in itertools.pairwise(sizes))
    assert sizes[-1] == max(2 * max(size) - 1, 3)
    papers = [s for s in WINDOW_SIZES if s < sizes[-1]]
    assert list(sizes[: len(papers)]) == papers
