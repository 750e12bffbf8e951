"""How a case becomes a measurement."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.records import Truth
from tests.tables.cases import Case, noisy, recoded, reweighted, staged, without_focal

SMALL = Case("small", scene="boxes", size=(32, 48), views=4)
TINY = Case("tiny", scene="planes", size=(24, 32), views=4)


@pytest.fixture
def file(random_shot, tmp_path):
    path = tmp_path / "known.npz"
    np.savez(path, meas=random_shot.measurement, masks=random_shot.masks, truth=random_shot.truth.views)
    return str(path)


def test_a_simulated_case_has_its_name_masks_and_truth():
    shot = SMALL.shot(0)
    assert (shot.name, shot.views, shot.size) == ("small", 4, (32, 48))
    assert shot.masks.mean() == pytest.approx(0.25, abs=0.05)
    assert shot.truth.views is not None


def test_the_seed_draws_masks_and_noise_and_nothing_else_does():
    assert np.array_equal(SMALL.shot(0).measurement, SMALL.shot(0).measurement)
    assert not np.array_equal(SMALL.shot(0).masks, SMALL.shot(1).masks)


def test_a_case_travels_as_plain_values():
    assert Case.of(asdict(SMALL)) == SMALL
    assert Case.of({**asdict(SMALL), "size": [32, 48]}) == SMALL


def test_a_file_is_taken_as_it_is(file, random_shot):
    shot = Case("known", file=file).shot(3)
    assert np.allclose(shot.measurement, random_shot.measurement, atol=1e-6)
    assert np.array_equal(shot.masks, random_shot.masks)


def test_all_but_the_middle_of_a_file_is_cut_away(file, random_shot):
    shot = Case("known", file=file, size=(8, 12)).shot(0)
    assert np.array_equal(shot.masks, random_shot.masks[:, 4:12, 4:16])
    assert np.array_equal(shot.truth.views, random_shot.truth.views[:, 4:12, 4:16])
    assert np.allclose(shot.measurement, random_shot.measurement[4:12, 4:16], atol=1e-6)


def test_a_file_is_coded_anew_when_asked_for(file, random_shot):
    shot = Case("known", file=file, views=3, open_share=0.2).shot(0)
    assert shot.views == 3
    assert np.array_equal(shot.truth.views, random_shot.truth.views[[0, 2, 5]])
    assert np.allclose(shot.measurement, np.einsum("nhw,nhwc->hwc", shot.masks, shot.truth.views), atol=1e-6)


def test_weights_that_are_off_tell_of_another_lamp_and_change_nothing_else(random_shot):
    told = reweighted(random_shot, 0.3, np.random.default_rng(0))
    factors = told.weights / random_shot.weights
    assert np.ptp(factors) > 0.2
    assert factors.min() > 0.5
    assert np.array_equal(told.measurement, random_shot.measurement)
    small = replace(SMALL, weights_off=0.3)
    assert np.array_equal(small.shot(0).measurement, SMALL.shot(0).measurement)
    assert np.array_equal(small.shot(0).weights, small.shot(0).weights)
    assert not np.array_equal(small.shot(0).weights, small.shot(1).weights)


@pytest.mark.parametrize("spread", [-0.1, 1.0, np.nan])
def test_weights_cannot_be_off_by_all_they_are(spread):
    with pytest.raises(InputError, match="weights off"):
        replace(TINY, weights_off=spread).shot(0)


def test_a_stage_tells_the_true_path_as_far_as_it_is_right():
    exact, off = replace(SMALL, stage_off=0.0).shot(0), replace(SMALL, stage_off=0.05).shot(0)
    assert SMALL.shot(0).telemetry_world_to_camera is None
    np.testing.assert_allclose(exact.telemetry_world_to_camera, exact.truth.world_to_camera, atol=1e-12)
    true, told = (np.linalg.inv(each) for each in (off.truth.world_to_camera, off.telemetry_world_to_camera))
    np.testing.assert_allclose(told[:, :3, :3], true[:, :3, :3], atol=1e-12)
    error = np.sqrt(np.mean(np.sum((told - true)[:, :3, 3] ** 2, axis=1)))
    extent = np.linalg.norm(np.ptp(true[:, :3, 3], axis=0))
    assert 0.02 < error / extent < 0.1


@pytest.mark.parametrize("share", [-0.1, 1.0, np.nan])
def test_a_stage_cannot_be_off_by_the_whole_path(share):
    with pytest.raises(InputError, match="stage off"):
        replace(TINY, stage_off=share).shot(0)


def test_a_shot_of_unknown_path_has_no_stage_to_tell_it(random_shot):
    with pytest.raises(InputError, match="no true poses for a stage"):
        staged(replace(random_shot, truth=Truth(random_shot.truth.views)), 0.0, np.random.default_rng(0))


def test_recoding_keeps_first_and_last_view_and_their_poses_and_resets_the_weights(random_shot):
    shot = recoded(random_shot, 2, None, 0.0, np.random.default_rng(0))
    assert np.array_equal(shot.masks, random_shot.masks[[0, 5]])
    assert shot.truth.world_to_camera[:, 0, 3].tolist() == [0, 5]
    assert shot.weights.tolist() == [1, 1]


def test_noise_is_added_to_the_sum(random_shot):
    plain = recoded(random_shot, 6, None, 0.0, np.random.default_rng(0)).measurement
    noisy = recoded(random_shot, 6, None, 0.1, np.random.default_rng(0)).measurement
    assert np.std(noisy - plain) == pytest.approx(0.1, rel=0.1)


def test_a_shot_without_truth_cannot_be_coded_anew(random_shot):
    with pytest.raises(InputError, match="no true views"):
        recoded(replace(random_shot, truth=Truth()), 2, None, 0.0, np.random.default_rng(0))


@pytest.mark.parametrize("views", [0, 7])
def test_more_views_than_there_are_or_none_are_refused(random_shot, views):
    with pytest.raises(InputError, match="1 to 6 views"):
        recoded(random_shot, views, None, 0.0, np.random.default_rng(0))


@pytest.mark.parametrize("noise", [-1.0, np.nan, np.inf, 1e13])
def test_impossible_noise_is_refused(random_shot, noise):
    with pytest.raises(InputError, match="noise of"):
        recoded(random_shot, 2, None, noise, np.random.default_rng(0))
    with pytest.raises(InputError, match="noise of"):
        noisy(random_shot, noise, np.random.default_rng(0))
    with pytest.raises(InputError, match="noise of"):
        replace(TINY, noise=noise).shot(0)


@pytest.mark.parametrize("switch", ["grey_masks", "focal_known", "stopped_down"])
@pytest.mark.parametrize("value", [None, 1, "no"])
def test_a_switch_that_is_neither_on_nor_off_is_refused(switch, value):
    with pytest.raises(InputError, match=f"{switch} = "):
        Case.of({**asdict(TINY), switch: value}).shot(0)


@pytest.mark.parametrize("views", [0, 7])
def test_a_file_is_not_taken_as_it_is_where_other_views_are_asked_for(file, views):
    with pytest.raises(InputError, match="1 to 6 views"):
        Case("known", file=file, views=views).shot(0)


def test_noise_comes_on_top_of_a_simulated_measurement_and_changes_nothing_else():
    plain, loud = TINY.shot(0), replace(TINY, noise=0.05).shot(0)
    added = (loud.measurement - plain.measurement)[~plain.saturated]
    assert added.std() == pytest.approx(0.05, rel=0.05)
    assert abs(added.mean()) < 0.005
    assert np.array_equal(loud.masks, plain.masks)
    assert np.array_equal(loud.truth.views, plain.truth.views)
    assert loud.provenance["added_noise"] == 0.05


def test_a_simulated_measurements_noise_is_the_seeds():
    one, again, other = (replace(TINY, noise=0.05).shot(seed).measurement for seed in (0, 0, 1))
    assert np.array_equal(one, again)
    added = one - TINY.shot(0).measurement
    # Nor is it that of the masks, whose generator begins with the same seed.
    assert not np.allclose(added, other - TINY.shot(1).measurement, atol=0.01)
    of_the_masks = 0.05 * np.random.default_rng(0).standard_normal(added.shape)
    assert abs(np.corrcoef(added.ravel(), of_the_masks.ravel())[0, 1]) < 0.1


def test_noise_leaves_clipped_readings_and_their_marks(random_shot):
    clipped = np.zeros(random_shot.size, np.bool_)
    clipped[3, 4:8] = True
    shot = noisy(replace(random_shot, saturated=clipped), 0.1, np.random.default_rng(0))
    assert np.array_equal(shot.measurement[clipped], random_shot.measurement[clipped])
    assert (shot.measurement[~clipped] != random_shot.measurement[~clipped]).all()
    assert np.array_equal(shot.saturated, clipped)


def test_a_simulated_cases_grey_masks_are_as_open_as_its_binary_ones():
    for share in (None, 0.5):
        shot = replace(TINY, grey_masks=True, open_share=share).shot(0)
        assert 0 <= shot.masks.min() < shot.masks.max() <= 1
        assert np.mean((shot.masks > 0) & (shot.masks < 1)) > 0.9
        assert shot.masks.mean() == pytest.approx(share or 0.25, abs=0.02)


def test_what_grey_masks_let_through_is_what_is_measured():
    shot = replace(TINY, grey_masks=True, full_scale_photons=4000.0).shot(0)
    coded = np.einsum("nhw,nhwc->hwc", shot.masks, shot.truth.views)
    # Motion within a mask's interval and photon noise are small against the scene.
    assert np.corrcoef(coded.ravel(), shot.measurement.ravel())[0, 1] > 0.98


def test_a_files_grey_masks_are_as_open_as_its_own_or_as_asked_for(file, random_shot):
    for share, expected in ((None, float(random_shot.masks.mean())), (0.3, 0.3)):
        shot = Case("known", file=file, open_share=share, grey_masks=True).shot(0)
        assert np.mean((shot.masks > 0) & (shot.masks < 1)) > 0.9
        assert shot.masks.mean() == pytest.approx(expected, abs=0.03)
        assert np.allclose(shot.measurement, np.einsum("nhw,nhwc->hwc", shot.masks, shot.truth.views), atol=1e-6)


def test_a_case_may_keep_its_focal_length_to_itself_and_changes_nothing_else():
    told, untold = TINY.shot(0), replace(TINY, focal_known=False).shot(0)
    assert told.intrinsics is not None
    assert untold.intrinsics is None
    assert np.array_equal(told.measurement, untold.measurement)


def test_a_shot_without_a_camera_matrix_has_none_to_leave_out(random_shot, file):
    with pytest.raises(InputError, match="no camera matrix"):
        without_focal(random_shot)
    with pytest.raises(InputError, match="no camera matrix"):
        Case("known", file=file, focal_known=False).shot(0)


def test_a_lens_that_is_stopped_down_keeps_many_views_from_clipping():
    bright = replace(TINY, views=32).shot(0)
    dim = replace(TINY, views=32, stopped_down=True).shot(0)
    assert bright.saturated.mean() > 0.2
    assert dim.saturated.mean() < 0.02
    # The unit stays the full scale of a view.
    within = ~bright.saturated & ~dim.saturated
    assert dim.measurement[within].mean() == pytest.approx(bright.measurement[within].mean(), rel=0.02)


def test_a_lens_is_not_opened_where_fewer_masks_are_open():
    assert np.array_equal(TINY.shot(0).measurement, replace(TINY, stopped_down=True).shot(0).measurement)


@pytest.mark.parametrize("case", [Case("none"), Case("both", file="a.npz", scene="boxes")])
def test_a_case_names_exactly_one_source(case):
    with pytest.raises(InputError, match="names file"):
        case.shot(0)
