"""How far blocks of a picture move, from the measurement alone; pictures are drawn, pans by resampling."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci.reconstruct.measurement.displacements import displacements
from tests.reconstruct.measurement.pans import AT_REST, EVENLY, SIZE, VIEWS, exposed, masks_of, mosaic, seen

ROUNDS = 3


def test_displacements_of_a_picture_at_rest_have_the_errors_that_they_state():
    found = displacements(exposed(AT_REST, masks_of("random")))
    assert (found.centres_px.min(axis=0).tolist(), found.centres_px.max(axis=0).tolist()) == ([8, 8], [136, 104])
    errors = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    assert np.sqrt(np.mean((found.px / errors) ** 2)) == pytest.approx(1, abs=0.35)


def test_displacements_follow_a_pan():
    found = displacements(exposed(seen(EVENLY[:, None] * (0.6, -0.3)), masks_of("random")))
    # The picture is sampled from displaced places: what it shows moves the other way. Gradients are smoothed, so that
    # fine detail seems to move farther.
    x, y, *to_and_fro = np.median(found.px, axis=0)
    assert -1.2 < x < -0.5
    assert 0.25 < y < 0.6
    assert np.abs(to_and_fro).max() < 0.1


@pytest.mark.parametrize("kind", ["random", "one pattern"])
@pytest.mark.parametrize("along", [(0.6, -0.3), (2.0, 1.0), (-3.0, 0.5)])
def test_in_rounds_they_are_those_of_the_pan(kind, along):
    found = displacements(exposed(seen(EVENLY[:, None] * along), masks_of(kind)), ROUNDS)
    x, y, *to_and_fro = np.median(found.px, axis=0)
    # Somewhat too far, as the docstring says, but all in the same direction.
    farther = -(x * along[0] + y * along[1]) / np.hypot(*along) ** 2
    assert 0.95 < farther < 1.4
    assert (x, y) == pytest.approx((-farther * along[0], -farther * along[1]), abs=0.1 + 0.08 * np.hypot(*along))
    assert np.abs(to_and_fro).max() < 0.15


def test_a_motion_to_and_fro_is_of_the_second_degree():
    time = np.linspace(-1, 1, VIEWS)
    found = displacements(exposed(seen((time**2)[:, None] * (1.0, 0.5)), masks_of("random")), ROUNDS)
    assert np.median(found.px, axis=0) == pytest.approx((0, 0, -1, -0.5), abs=0.2)
    assert found.over_time[1] == pytest.approx(time**2 - np.mean(time**2))


def test_fine_detail_does_not_seem_to_move_farther_after_rounds():
    """Half of the picture is smoother than the other."""
    fine = seen(EVENLY[:, None] * (2.0, 0.0))
    smooth = np.stack([gaussian_filter(view[..., 0], 2.0) for view in fine])[..., None]
    middle = SIZE[1] // 2
    both = np.concatenate([fine[:, :, :middle], smooth[:, :, middle:]], axis=2)
    shot = exposed(both, masks_of("random"), 0.002)

    def by_half(rounds):
        found = displacements(shot, rounds)
        left = found.centres_px[:, 0] < middle
        return np.median(found.px[left, 0]), np.median(found.px[~left, 0])

    once, thrice = by_half(0), by_half(ROUNDS)
    assert abs(once[0] - once[1]) > 2 * abs(thrice[0] - thrice[1])
    assert -2.6 < thrice[0] < -1.9


def test_a_mosaic_has_larger_blocks_and_displacements_in_pixels_of_the_sensor():
    shown = seen(EVENLY[:, None] * (2.0, -1.0)) * np.array([0.9, 0.6, 0.4], np.float32)
    light = exposed(shown, masks_of("random"), 0.001).measurement
    found = displacements(mosaic(light, masks_of("random")), ROUNDS)
    assert found.block_px == 32
    assert found.centres_px.min(axis=0).tolist() == [16, 16]
    assert np.median(found.px, axis=0)[:2] == pytest.approx((-2.5, 1.25), abs=0.6)


def test_rounds_read_no_closed_pixels_and_keep_numbers_finite():
    masks = masks_of("random")
    masks[:, 20:40, 30:90] = 0
    masks[:, :, ::7] = 0
    shot = exposed(seen(EVENLY[:, None] * (1.0, 0.5)), masks)
    spoilt = shot.measurement.copy()
    spoilt[:, ::7] = 7.0
    found, again = (displacements(one, ROUNDS) for one in (shot, replace(shot, measurement=spoilt)))
    assert np.array_equal(found.px, again.px)
    assert np.median(found.px, axis=0)[:2] == pytest.approx((-1, -0.5), abs=0.2)
    drowned = displacements(exposed(AT_REST, masks, 0.3), ROUNDS)
    assert drowned is None or np.isfinite(drowned.px).all()
    far = displacements(exposed(seen(EVENLY[:, None] * (30.0, 0.0)), masks_of("random")), ROUNDS)
    assert far is None or np.isfinite(far.px).all()


def test_where_nothing_is_to_be_seen_there_are_none():
    grey = np.full((VIEWS, *SIZE, 1), 0.5, np.float32)
    for rounds in (0, ROUNDS):
        assert displacements(exposed(AT_REST[:1], masks_of("random")[:1]), rounds) is None
        found = displacements(exposed(grey, masks_of("random"), 0.0), rounds)
        assert found is None or np.abs(found.px).max() < 1
