"""A smooth field beyond the affine is found where the measurement tells it, and nowhere else."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci.reconstruct.registration.coarse import Peak, Tile, find_tiles, fine_pattern
from gs2ci.reconstruct.registration.fine import MisfitEstimate, Problem, _jacobian
from gs2ci.reconstruct.registration.local_scene import Seen
from gs2ci.reconstruct.registration.misfit import Misfit
from gs2ci.reconstruct.registration.parameters import FIELD, LOW
from gs2ci.reconstruct.registration.placement import Placement
from gs2ci.reconstruct.registration.proposals import _by_tiles, _let_in, _predicts_better, bent_px, find_field
from gs2ci.reconstruct.registration.register import register
from gs2ci.reconstruct.registration.widening import MaskSum
from tests.reconstruct.registration.warps import bent, blurred, warped


def displacement(placement, size):
    """How far what is seen at each pixel was moved, by the definition of a placement, [2, H, W]."""
    middle = ((np.array(size) - 1) / 2)[:, None, None]
    seen = np.mgrid[: size[0], : size[1]] - middle
    left = np.moveaxis(seen, 0, -1) - placement.field_px(np.moveaxis(seen, 0, -1)) - placement.shift_px
    return seen - np.moveaxis(left @ np.linalg.inv(placement.matrix).T, -1, 0)


# A keystone's third order, which is no part of the field, is 0.05 px in the corners of so small a picture.
@pytest.mark.parametrize(
    ("radial_px", "keystone_px", "to_px"),
    [(1.5, 0.0, 0.03), (-1.5, 0.0, 0.035), (3.0, 0.0, 0.03), (0.0, 1.5, 0.1), (1.5, 1.0, 0.15)],
)
def test_a_field_is_found(bench, radial_px, keystone_px, to_px):
    were, true = bent(bench.masks, radial_px=radial_px, keystone_px=keystone_px)
    found = register(bench.shoot(were=were))
    off = displacement(found.misfit, bench.masks.shape[1:]) - true
    assert np.linalg.norm(off, axis=0).max() < to_px
    assert np.abs(found.shot.masks - were)[:, 3:-3, 3:-3].mean() < 0.01
    assert set(found.errors) & set(FIELD)
    assert found.summary().largest_displacement_px > 1


def test_a_field_is_found_along_with_the_blur_that_hides_it(bench):
    """The best affine leaves what looks like blur, and masks with a wrong blur are moved to the wrong places."""
    were, true = bent(bench.masks, radial_px=1.5)
    found = register(bench.shoot(were=blurred(were, 0.6)))
    off = displacement(found.misfit, bench.masks.shape[1:]) - true
    assert np.linalg.norm(off, axis=0).max() < 0.06
    assert found.misfit.blur_px2 == pytest.approx(0.36, abs=0.05)


def test_tiles_that_are_whole_pixels_off_show_where_to_begin(bench):
    were, true = bent(bench.masks, keystone_px=2.2)
    found = register(bench.shoot(were=were))
    off = displacement(found.misfit, bench.masks.shape[1:]) - true
    assert np.linalg.norm(off, axis=0).max() < 0.15


@pytest.mark.parametrize("radial_px", [0.5, 1.0])
def test_a_field_that_only_tiles_lead_to_is_found_without_terms_that_are_not_there(radial_px):
    """Beyond half an element no step from a straight picture leads there, so the tiles' field is the start."""
    rng = np.random.default_rng(0)
    size, masks = (320, 320), (rng.random((8, 320, 320)) < 0.5).astype(float)
    scene = gaussian_filter(rng.random(size), 3)
    scene = 0.2 + 0.7 * (scene - scene.min()) / np.ptp(scene)
    were = Placement(radial_px=radial_px).sample(masks)
    reading = (were * scene).sum(axis=0) + rng.normal(0, 0.05, size)
    problem = Problem(Seen(reading[None], np.ones((1, *size)), 1.5), MaskSum(masks, np.ones(8)), float(reading.mean()))
    pattern = fine_pattern(reading, 1.0, relative=True)
    tiles = find_tiles(pattern, fine_pattern(masks.sum(axis=0), 1.0), np.zeros(2), 8, 1.0, 32)
    found, _ = find_field(problem, Misfit(), tiles)
    assert found.misfit.radial_px == pytest.approx(radial_px, abs=0.002)
    left_out = [name for name in FIELD if name not in found.errors]
    assert [getattr(found.misfit, name) for name in left_out] == [0.0] * len(left_out)


def test_a_field_that_the_pattern_does_not_tell_is_left_alone(bench):
    were, _ = bent(bench.masks, radial_px=1.5)
    rng = np.random.default_rng(3)
    noisy = bench.shoot(were=were, noise=3.0)
    found = register(noisy)
    assert not found.misfit.field.any()
    even = np.concatenate([bench.masks[:3], 1 - bench.masks[:3]])
    found = register(bench.shoot(were=bent(even, radial_px=1.5)[0], stated=even, seed=int(rng.integers(9))))
    assert not found.misfit.field.any()


@pytest.mark.parametrize("seed", [6, 7, 9])
def test_terms_that_masks_of_whole_rows_hardly_show_do_not_leave_the_range_of_numbers(bench, seed):
    """Unshortened, their first step moved corners by thousands of pixels, where the field's polynomials overflowed."""
    small = replace(bench, views=bench.views[:, :41, :36])
    rows = (np.random.default_rng(seed).random((6, 41, 1)) < 0.4).astype(np.float32).repeat(36, axis=2)
    shot = small.shoot(were=rows, stated=rows, noise=0)
    clipped = np.minimum(shot.measurement, np.quantile(shot.measurement, 0.8))
    found = register(replace(shot, measurement=clipped))
    assert np.isfinite(list(found.misfit.values().values())).all()


def test_the_way_of_an_element_and_what_a_pixel_sees_undo_each_other():
    placement = Placement(0.4, -1.2, 0.5, 0.004, -0.002, 0.003, 1.1, 0.3, -0.6, 0.2, 0.5, -0.4, 0.7)
    places = np.random.default_rng(4).uniform(-90, 90, (20, 2))
    there = places + placement.moved_px(places)
    back = np.linalg.inv(placement.matrix) @ (there - placement.field_px(there) - placement.shift_px).T
    assert pytest.approx(places, abs=1e-6) == back.T


def test_the_kernel_reads_where_the_definition_says():
    placement = Placement(0.4, -1.2, 0.5, 0.004, -0.002, 0.003, 1.1, 0.3, -0.6, 0.2, 0.5, -0.4, 0.7)
    size = (40, 52)
    places = np.mgrid[: size[0], : size[1]].astype(float)
    read = np.stack([placement.sample(one[None])[0] for one in places])  # of a ramp, the place that was read
    inner = np.s_[:, 6:-6, 6:-6]
    assert (places - read)[inner] == pytest.approx(displacement(placement, size)[inner], abs=1e-9)


def test_a_shot_without_a_field_gets_none(bench):
    for were in (bench.masks, warped(bench.masks, down_px=0.6, right_px=-0.3, turn_deg=0.4, scale=1.004)):
        found = register(bench.shoot(were=were))
        assert not found.misfit.field.any()
        assert set(LOW) <= set(found.tried)
        for name in LOW:
            value, error = found.tried[name]
            assert abs(value) < 5 * error


def tiles_of(placement, size, count=(4, 4)):
    """Tiles in a grid, each displaced as a placement displaces its middle."""
    rows, columns = (np.linspace(0, n - 1, k) for n, k in zip(size, count, strict=True))
    middle = (np.array(size) - 1) / 2
    found = []
    for row in rows:
        for column in columns:
            down, right = placement.moved_px(np.array([(row, column)]) - middle)[0]
            found.append(Tile((row, column), Peak(float(down), float(right), 9.0, 20.0)))
    return found


def test_tiles_that_agree_give_the_field_and_one_that_does_not_is_dropped():
    size, true = (200, 240), Placement(down_px=1.0, radial_px=0.3)
    tiles = tiles_of(true, size)
    found = _by_tiles(tiles, Misfit(), size)
    assert found.radial_px == pytest.approx(0.3, abs=0.03)
    tiles[5] = replace(tiles[5], peak=replace(tiles[5].peak, right_px=8.0))
    assert _by_tiles(tiles, Misfit(), size).radial_px == pytest.approx(0.3, abs=0.03)


def test_few_tiles_and_tiles_that_lie_where_they_should_give_no_field():
    size, true = (200, 240), Placement(radial_px=0.3)
    assert _by_tiles(tiles_of(true, size, (3, 4)), Misfit(), size) is not None
    assert _by_tiles(tiles_of(true, size, (3, 4))[:11], Misfit(), size) is None
    assert _by_tiles(tiles_of(Placement(), size), Misfit(), size) is None


@pytest.mark.parametrize("at", [Placement(), Placement(4.0, -9.0, 2.0, 0.02, -0.01, 0.01, 0.5)])
def test_a_step_of_each_parameter_moves_what_is_seen_as_a_small_change_does(at):
    row, column = np.meshgrid(np.linspace(-40, 40, 5), np.linspace(-50, 50, 6), indexing="ij")
    places, small = np.stack([row, column], axis=-1), 1e-4
    steps = dict.fromkeys(("down_px", "right_px", "rotation_deg", "scale", "stretch", "shear", *FIELD), small)
    stated = at.stated_at(places)
    for name, by in zip(steps, at.derivatives(steps, places), strict=True):
        there, before = (stated + one.moved_px(stated) for one in (at.changed(name, small), at))
        np.testing.assert_allclose(by, there - before, atol=3e-2 * np.abs(by).max(), err_msg=name)


def test_terms_are_let_in_together_if_one_is_sure_and_masks_move_enough():
    problem, placement = Problem(None, MaskSum(np.zeros((1, 200, 240)), [1.0]), 1.0), Placement(radial_px=0.5)
    sure = MisfitEstimate(Misfit(radial_px=0.5), dict.fromkeys(LOW, 1e-4))
    assert "radial_px" in _let_in(problem, sure)
    assert _let_in(problem, replace(sure, misfit=Misfit(radial_px=0.02))) == ()
    assert _let_in(problem, replace(sure, errors=dict.fromkeys(LOW, 1.0))) == ()
    assert bent_px(Placement(scale=0.01), (40, 50)) == pytest.approx(0.0, abs=1e-9)
    assert bent_px(placement, (200, 240)) > 0.05


def test_derivatives_are_those_of_errors_that_grow_with_a_shift():
    down, right = np.random.default_rng(0).normal(size=(2, 20, 24))
    problem = SimpleNamespace(errors=lambda one: down * one.down_px + right * one.right_px)
    steps = {"down_px": 0.1, "right_px": 0.2}
    moves = dict(zip(steps, np.array([(0.1, 0.0), (0.0, 0.2)])[:, None, None], strict=True))
    found = _jacobian(problem, Misfit(), steps, moves)
    np.testing.assert_allclose(found, [0.1 * down, 0.2 * right], atol=1e-9)


def test_what_errs_surely_less_predicts_better():
    rng = np.random.default_rng(0)
    errors = {0.0: 0.05 * rng.normal(size=(20, 24)), 1.0: 0.03 * rng.normal(size=(20, 24))}
    problem = SimpleNamespace(size=(20, 24), errors=lambda one: errors[one.down_px])
    without, found = Misfit(), Misfit(down_px=1.0)
    assert _predicts_better(problem, without, found)
    assert not _predicts_better(problem, found, without)
