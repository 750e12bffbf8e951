"""Shrinkage of groups and their sum against the plain statement in float64."""

import numba
import numpy as np
import pytest

from gs2ci.reconstruct.decode.patches.low_rank import denoise_groups, shrink_group, workspace


@numba.njit
def shrink(group, members, size, spread, sigma, work, lines, mean):
    shrink_group(group, members, size, spread, sigma, work, lines, mean)


def shrink_reference(group, sigma, planes=1):
    """Weighted shrinkage of the singular values of [M, D] less its mean row (Gu 2014); D are pixels of all planes."""
    mean, spread = group.mean(0), planes * len(group)
    left, singular, right = np.linalg.svd(group - mean, full_matrices=False)
    signal = np.sqrt(np.maximum(singular**2 - spread * sigma**2, 0))
    shrunk = np.maximum(0, singular - np.sqrt(spread) * sigma**2 / np.maximum(signal, 1e-150))
    return mean + left * shrunk @ right


def denoise_reference(planes, corners, patch, sigma, fallback):
    """Denoise [C, N, H, W]: all planes together where a group has fewer patches than a patch has pixels."""
    if len(planes) > 1 and corners.shape[1] >= patch[0] * patch[1]:
        each = [slice(c, c + 1) for c in range(len(planes))]
        return np.concatenate([denoise_reference(planes[c], corners, patch, sigma, fallback[c]) for c in each])
    total, number = np.zeros_like(planes), np.zeros_like(planes)
    for group in corners:
        cuts = [(slice(None), i, slice(r, r + patch[0]), slice(c, c + patch[1])) for i, r, c in group]
        shrunk = shrink_reference(np.stack([planes[cut].ravel() for cut in cuts]), sigma, len(planes))
        for cut, restored in zip(cuts, shrunk, strict=True):
            total[cut] += restored.reshape(-1, *patch)
            number[cut] += 1
    return np.where(number > 0, total / np.maximum(number, 1), fallback)


def shrunk(group, sigma, planes=1):
    members, size = group.shape
    flat, *work = workspace(members, size)
    rows = flat.reshape(max(members, size), -1)
    inside = rows[:, : min(members, size)]
    inside[:] = group.T if members < size else group
    shrink(flat, members, size, planes * members, np.float32(sigma), *work)
    assert (rows[:, min(members, size) :] == 0).all()
    return inside.T if members < size else inside


@pytest.mark.parametrize("shape", [(64, 36), (24, 36), (20, 36), (5, 1), (1, 9), (3, 4)])
@pytest.mark.parametrize("sigma", [0.003, 0.06, 3.0])
def test_shrinkage_agrees_with_its_reference(shape, sigma):
    rng = np.random.default_rng(0)
    group = rng.normal(size=(shape[0], 2)) @ rng.normal(size=(2, shape[1])) + 0.02 * rng.normal(size=shape) + 0.5
    # No singular value lies near the threshold, where the shrinkage is steep.
    # float32 knows the eigenvalues to about 1e-6 of the largest, which is some hundred here.
    np.testing.assert_allclose(shrunk(group, sigma), shrink_reference(group, sigma), atol=4e-4)


def test_equal_patches_stay_and_noise_goes():
    equal = np.tile(np.random.default_rng(0).random(16), (30, 1))
    np.testing.assert_allclose(shrunk(equal, 0.1), equal, atol=1e-6)
    noise = np.random.default_rng(0).normal(0, 0.1, (200, 16))
    assert shrunk(noise, 0.2).std() < 0.02


def some_groups(rng, views, patch, groups=7, members=9):
    corners = [
        rng.integers(0, side - length + 1, (groups, members))
        for side, length in zip(views.shape, (1, *patch), strict=True)
    ]
    return np.stack(corners, axis=-1).astype(np.int32)


@pytest.mark.parametrize("sigma", [0.003, 2.0])
@pytest.mark.parametrize(("size", "patch"), [((20, 22), (4, 4)), ((3, 30), (3, 5)), ((1, 1), (1, 1))])
def test_the_sum_of_groups_agrees_with_its_reference(size, patch, sigma):
    rng = np.random.default_rng(0)
    views, fallback = rng.random((2, 1, 3, *size)).astype(np.float32)
    corners = some_groups(rng, views[0], patch)
    expected = denoise_reference(views.astype(np.float64), corners, patch, sigma, fallback)
    np.testing.assert_allclose(denoise_groups(views, corners, patch, sigma, fallback), expected, atol=2e-5)


@pytest.mark.parametrize("colours", ["different", "equal", "one alone"])
@pytest.mark.parametrize(("patch", "members"), [((4, 4), 15), ((4, 4), 16), ((4, 5), 3), ((4, 5), 19), ((1, 1), 2)])
def test_colour_planes_agree_with_their_reference(patch, members, colours):
    rng = np.random.default_rng(1)
    planes = rng.random((3, 3, 14, 15)).astype(np.float32)
    if colours == "equal":
        planes[:] = planes[0]
    if colours == "one alone":
        planes[1:] = 0
    corners = some_groups(rng, planes[0], patch, members=members)
    expected = denoise_reference(planes.astype(np.float64), corners, patch, 0.1, planes)
    found = denoise_groups(planes, corners, patch, 0.1, planes)
    np.testing.assert_allclose(found, expected, atol=2e-5)
    if colours == "one alone":
        assert (found[1:] == 0).all()


def test_where_no_patch_lies_the_fallback_stands():
    planes, fallback = np.zeros((3, 1, 9, 9), np.float32), np.full((3, 1, 9, 9), 0.25, np.float32)
    for each in (1, 3):
        denoised = denoise_groups(planes[:each], np.zeros((1, 2, 3), np.int32), (4, 4), 0.1, fallback[:each])
        assert (denoised[:, 0, :4, :4] == 0).all()
        assert (denoised[:, 0, 4:] == 0.25).all()


def test_the_sum_is_the_same_for_any_number_of_threads():
    rng = np.random.default_rng(0)
    planes = rng.random((3, 4, 30, 31)).astype(np.float32)
    corners = some_groups(rng, planes[0], (6, 6), groups=60, members=20)
    before, found = numba.get_num_threads(), []
    try:
        for threads in (1, min(2, before)):
            numba.set_num_threads(threads)
            found.append(denoise_groups(planes, corners, (6, 6), 0.1, planes))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(*found)
