"""The search for similar patches against its plain statement, and where the lattice looks."""

import numba
import numpy as np
import pytest
from skimage import data

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.decode.patches.flow import Flow
from gs2ci.reconstruct.decode.patches.matching import Lattice, find_groups, match_patches


def search_reference(views, at, corner, around, first, patch, reach, each):
    """Compare with every patch of each window, float64; a window that leaves the picture is moved into it."""
    height, width = patch
    reference = views[at, corner[0] : corner[0] + height, corner[1] : corner[1] + width].astype(np.float64)
    found = []
    for k, middle in enumerate(around):
        starts = []
        for place, side, length in zip(middle, views.shape[1:], patch, strict=True):
            wide = min(2 * reach + 1, side - length + 1)
            low = min(max(place - reach, 0), side - length + 1 - wide)
            starts.append(range(low, low + wide))
        places = [(r, c) for r in starts[0] for c in starts[1]]
        unlike = [((views[first + k, r : r + height, c : c + width] - reference) ** 2).sum() for r, c in places]
        found += [(first + k, *places[i]) for i in np.argsort(unlike, kind="stable")[:each]]
    return np.array(found)


@pytest.mark.parametrize(("size", "patch", "each"), [((20, 23), (5, 5), 4), ((4, 30), (4, 6), 3), ((6, 6), (6, 6), 1)])
def test_the_search_agrees_with_its_reference(size, patch, each):
    rng = np.random.default_rng(0)
    views = rng.random((4, *size)).astype(np.float32)
    corners = np.stack([rng.integers(0, side - p + 1, 6) for side, p in zip(size, patch, strict=True)], 1)
    around = rng.integers(-5, max(size) + 5, (6, 3, 2))
    found = match_patches(views, 2, corners.astype(np.int32), around.astype(np.int32), 1, patch, 2, each)
    for g in range(6):
        np.testing.assert_array_equal(found[g], search_reference(views, 2, corners[g], around[g], 1, patch, 2, each))


def test_groups_follow_a_photograph_that_slides_farther_than_the_search_reaches():
    photograph = (data.camera() / 255).astype(np.float32)
    views = np.stack([photograph[120:200, 150 + 6 * i : 246 + 6 * i] for i in range(4)])
    lattice = Lattice(reach_px=2, per_group=4, views=4)
    groups = find_groups(views, Flow.between(views), lattice, 0)
    assert groups.shape[1:] == (4, 3)
    inside = (groups[:, 0, 2] > 30) & (groups[:, 0, 0] == 0)
    slid = groups[inside, 1:, 2] - groups[inside, :1, 2]
    assert inside.sum() > 100
    assert np.mean(np.abs(slid + 6 * np.arange(1, 4)) <= 2) > 0.7


@pytest.mark.parametrize("views", [1, 2, 3, 4, 9])
@pytest.mark.parametrize("size", [(1, 1), (3, 17), (20, 22)])
def test_the_phases_together_refer_to_every_pixel_of_every_view(views, size):
    lattice = Lattice()
    covered = np.zeros((views, *size), int)
    for phase in range(lattice.parts(views)):
        height, width = lattice.patch(size)
        for at in lattice.references(phase, views):
            for row, column in lattice.corners(phase, size):
                covered[at, row : row + height, column : column + width] += 1
    assert covered.min() > 0


def test_a_window_of_views_holds_its_reference_and_stays_inside():
    lattice = Lattice(views=8)
    for views in (1, 5, 8, 30):
        for at in range(views):
            first, count = lattice.window(at, views)
            assert count == min(8, views)
            assert 0 <= first <= at < first + count <= views


def test_groups_are_the_same_for_any_number_of_threads():
    views = np.random.default_rng(0).random((5, 24, 26)).astype(np.float32)
    before, found = numba.get_num_threads(), []
    try:
        for threads in (1, min(2, before)):
            numba.set_num_threads(threads)
            found.append(find_groups(views, Flow.between(views), Lattice(), 1))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize(
    ("name", "value"), [("step_px", 0), ("reach_px", -1), ("per_group", 0), ("views", 0), ("phases", 0), ("phases", 5)]
)
def test_senseless_lattices_are_refused(name, value):
    with pytest.raises(InputError, match=f"{name} = {value} in Lattice"):
        Lattice(**{name: value}).check()


@pytest.mark.parametrize("wrong", [{"patch_px": 0}, {"step_px": 7}])
def test_patches_with_gaps_between_them_are_refused(wrong):
    with pytest.raises(InputError, match="allowed: step_px <= patch_px"):
        Lattice(**wrong).check()
