"""Groups of similar patches denoised on a device are those of the CPU's kernels."""

import cv2
import numpy as np
import pytest
import torch

from gs2ci.reconstruct.decode.patches import denoiser
from gs2ci.reconstruct.decode.patches.denoiser import SimilarPatches, denoise_groups_on_device
from gs2ci.reconstruct.decode.patches.flow import Flow
from gs2ci.reconstruct.decode.patches.low_rank import denoise_groups
from gs2ci.reconstruct.decode.patches.matching import Lattice, find_groups
from gs2ci.render import places

PATCH, SIGMA, HOST = (6, 6), 0.05, torch.device("cpu")


@pytest.fixture
def device():
    """Let the host be a device."""
    places.count_host_as_device(yes=True)
    yield
    places.count_host_as_device(yes=False)


def noisy(views=4, size=(20, 26), seed=0):
    """Return views of one blurred picture, with noise."""
    draws = np.random.default_rng(seed)
    picture = 0.5 + 3 * cv2.GaussianBlur(draws.normal(size=size).astype(np.float32), (0, 0), 2)
    return (picture + draws.normal(0, SIGMA, (views, *size))).astype(np.float32)


def groups_of(views, per_group):
    return find_groups(views, Flow.between(views), Lattice(per_group=per_group, step_px=6), 0)


@pytest.mark.parametrize("per_group", [32, 12, 1])
@pytest.mark.parametrize("colours", ["different", "equal", "one alone", "grey"])
def test_they_are_those_of_the_kernel(per_group, colours):
    views = noisy()
    groups = groups_of(views, per_group)
    others = {"different": [2 * views - 1, noisy(seed=1)], "equal": [views, views], "one alone": [0 * views, 0 * views]}
    planes = np.stack([views, *others.get(colours, [])])
    there = denoise_groups_on_device(planes, groups, PATCH, SIGMA, 0 * planes, HOST)
    here = denoise_groups(planes, groups, PATCH, SIGMA, 0 * planes)
    np.testing.assert_allclose(there, here, atol=1e-4)
    assert per_group == 1 or np.abs(here - planes).max() > 100 * 1e-4


def test_pixels_without_a_patch_take_what_is_given():
    views = noisy()
    groups, instead = groups_of(views, 32)[:2], np.full_like(views, 7)
    found = denoise_groups_on_device(views[None], groups, PATCH, SIGMA, instead[None], HOST)[0]
    np.testing.assert_array_equal(found == 7, denoise_groups(views[None], groups, PATCH, SIGMA, instead[None])[0] == 7)
    assert (found == 7).any()


def test_flat_groups_and_equal_patches_stay_as_they_are():
    views = np.full((2, 14, 14), 0.25, np.float32)
    views[1] = np.linspace(0, 1, 14)
    groups = np.array([[[0, 2, 2]] * 30, [[1, 4, 4]] * 30], np.int32)
    found = denoise_groups_on_device(views[None], groups, PATCH, SIGMA, views[None], HOST)[0]
    np.testing.assert_allclose(found, views, atol=1e-6)


def test_bits_are_the_same_in_any_order_of_groups():
    views = noisy()
    groups = groups_of(views, 32)
    for planes in (views[None], np.stack([views, noisy(seed=1)])):
        one, other = (
            denoise_groups_on_device(planes, each, PATCH, SIGMA, 0 * planes, HOST) for each in (groups, groups[::-1])
        )
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("strange", [np.nan, np.inf])
def test_what_is_not_finite_does_not_become_a_number(strange):
    views = noisy()
    groups = groups_of(views, 16)
    views[2, 3, 4] = strange
    assert np.isnan(denoise_groups_on_device(views[None], groups, PATCH, SIGMA, views[None], HOST)).all()


def test_the_denoiser_takes_them_there(device, monkeypatch):
    views = np.stack([noisy(seed=seed) for seed in range(3)], axis=1)

    def steps():
        denoise = SimilarPatches(views, Lattice(per_group=16, step_px=6), 2)
        first = denoise(views, SIGMA)
        return denoise(first, 0.5 * SIGMA)

    there = steps()
    places.count_host_as_device(yes=False)
    np.testing.assert_allclose(there, steps(), atol=1e-4)
    places.count_host_as_device(yes=True)
    monkeypatch.setattr(denoiser, "denoise_groups", None)
    steps()


@pytest.mark.parametrize(("per_group", "size"), [(64, (20, 26)), (33, (20, 26)), (16, (2, 9))])
def test_large_groups_and_patches_of_few_pixels_stay_on_the_host(device, per_group, size):
    views = noisy(size=size)[:, None]
    there = SimilarPatches(views, Lattice(per_group=per_group), 2)(views, SIGMA)
    places.count_host_as_device(yes=False)
    np.testing.assert_array_equal(there, SimilarPatches(views, Lattice(per_group=per_group), 2)(views, SIGMA))
