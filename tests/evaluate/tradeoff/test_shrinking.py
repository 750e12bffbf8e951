from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.tradeoff.shrinking import enlarged, shrunk
from gs2ci.reconstruct.measurement.coding import Coding

CAMERA = np.array([[80.0, 0, 21], [0, 84, 11], [0, 0, 1]])


def shot(size=(22, 42), cfa=None, channels=3):
    rng = np.random.default_rng(1)
    masks = (rng.random((3, *size)) < 0.5).astype(np.float32)
    measurement = rng.random((*size, 1 if cfa else channels)).astype(np.float32)
    return Shot(
        measurement, masks, np.ones(3, np.float32), cfa=cfa, intrinsics=CAMERA, saturated=np.zeros(size, bool)
    ).check()


def test_the_coded_sum_of_flat_views_stays_exact():
    torch = pytest.importorskip("torch")
    given = shot()
    flat = torch.full((3, *given.size, 3), 0.4)
    small = shrunk(replace(given, measurement=Coding.of(given).forward(flat).numpy()), 2)
    again = Coding.of(small).forward(torch.full((3, *small.size, 3), 0.4)).numpy()
    np.testing.assert_allclose(again, small.measurement, atol=1e-6)


def test_closed_pixels_with_their_measurement_count_for_nothing():
    given = shot()
    kept = np.random.default_rng(3).random(given.size) < 0.7
    views = np.full((3, *given.size, 3), 0.25, np.float32)
    masks = given.masks * kept
    measured = np.einsum("nhw,nhwc->hwc", masks, views)
    small = shrunk(replace(given, masks=masks, measurement=measured), 2)
    np.testing.assert_allclose(small.measurement, 0.25 * small.masks.sum(0)[..., None].repeat(3, 2), atol=1e-6)


def test_a_mosaic_keeps_its_pattern_because_each_phase_is_averaged_by_itself():
    given = shot(size=(24, 40), cfa="RGGB")
    phases = np.zeros((24, 40, 1), np.float32)
    for value, (row, column) in enumerate([(0, 0), (0, 1), (1, 0), (1, 1)]):
        phases[row::2, column::2] = value
    small = shrunk(replace(given, measurement=phases), 2)
    assert small.size == (12, 20)
    assert small.cfa == "RGGB"
    np.testing.assert_array_equal(small.measurement, phases[:12, :20])


def test_the_camera_shrinks_and_incomplete_blocks_are_left_out():
    small = shrunk(shot(size=(23, 43)), 2)
    assert small.size == (11, 21)
    np.testing.assert_allclose(small.intrinsics, [[40, 0, 10.5], [0, 42, 5.5], [0, 0, 1]])


def test_one_saturated_sample_makes_its_block_saturated():
    given = shot()
    given.saturated[5, 8] = True
    assert np.argwhere(shrunk(given, 2).saturated).tolist() == [[2, 4]]


def test_poses_stay_known_and_true_views_do_not():
    given = replace(shot(), truth=Truth(np.zeros((3, 22, 42, 3), np.float32), np.tile(np.eye(4), (3, 1, 1))))
    assert shrunk(given, 2).truth.views is None
    assert shrunk(given, 2).truth.world_to_camera is given.truth.world_to_camera


@pytest.mark.parametrize("channels", [1, 3])
def test_smooth_views_come_back_at_full_size(channels):
    y, x = np.mgrid[:25, :43] + 0.5
    wave = (0.5 + 0.3 * np.sin(x / 9) * np.cos(y / 7)).astype(np.float32)
    small = np.stack([wave[:24, :42].reshape(12, 2, 21, 2).mean(axis=(1, 3))] * 2)[..., None].repeat(channels, 3)
    large = enlarged(small, 2, (25, 43))
    assert large.shape == (2, 25, 43, channels)
    assert large.dtype == np.float32
    np.testing.assert_allclose(large[0, 4:20, 4:38, 0], wave[4:20, 4:38], atol=5e-3)


@pytest.mark.parametrize(("factor", "cfa"), [(0, None), (30, None), (12, "GBRG")])
def test_a_factor_that_leaves_nothing_is_refused(factor, cfa):
    with pytest.raises(InputError, match="resolution"):
        shrunk(shot(cfa=cfa), factor)
