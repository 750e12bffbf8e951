"""How a case becomes a measurement."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from gs2ci.bench.cases import Case, recoded
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot, Truth

SMALL = Case("small", scene="boxes", size=(32, 48), views=4)


@pytest.fixture
def known():
    draws = np.random.default_rng(0)
    views = draws.random((6, 16, 20, 3), dtype=np.float32)
    masks = (draws.random((6, 16, 20)) < 0.5).astype(np.float32)
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, 0, 3] = np.arange(6)
    return Shot(
        measurement=np.einsum("nhw,nhwc->hwc", masks, views),
        masks=masks,
        weights=np.full(6, 0.5, np.float32),
        truth=Truth(views, poses),
    )


@pytest.fixture
def file(known, tmp_path):
    path = tmp_path / "known.npz"
    np.savez(path, meas=known.measurement, masks=known.masks, truth=known.truth.views)
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


def test_a_file_is_taken_as_it_is(file, known):
    shot = Case("known", file=file).shot(3)
    assert np.allclose(shot.measurement, known.measurement, atol=1e-6)
    assert np.array_equal(shot.masks, known.masks)


def test_a_file_is_coded_anew_when_asked_for(file, known):
    shot = Case("known", file=file, views=3, open_share=0.2).shot(0)
    assert shot.views == 3
    assert np.array_equal(shot.truth.views, known.truth.views[[0, 2, 5]])
    assert np.allclose(shot.measurement, np.einsum("nhw,nhwc->hwc", shot.masks, shot.truth.views), atol=1e-6)


def test_recoding_keeps_first_and_last_view_and_their_poses_and_resets_the_weights(known):
    shot = recoded(known, 2, None, 0.0, np.random.default_rng(0))
    assert np.array_equal(shot.masks, known.masks[[0, 5]])
    assert shot.truth.world_to_camera[:, 0, 3].tolist() == [0, 5]
    assert shot.weights.tolist() == [1, 1]


def test_noise_is_added_to_the_sum(known):
    plain = recoded(known, 6, None, 0.0, np.random.default_rng(0)).measurement
    noisy = recoded(known, 6, None, 0.1, np.random.default_rng(0)).measurement
    assert np.std(noisy - plain) == pytest.approx(0.1, rel=0.1)


def test_a_shot_without_truth_cannot_be_coded_anew(known):
    with pytest.raises(InputError, match="no true views"):
        recoded(replace(known, truth=Truth()), 2, None, 0.0, np.random.default_rng(0))


@pytest.mark.parametrize(("views", "noise"), [(0, 0.0), (7, 0.0), (2, -1.0), (2, np.nan)])
def test_more_views_than_there_are_or_impossible_noise_are_refused(known, views, noise):
    with pytest.raises(InputError, match="1 to 6 views"):
        recoded(known, views, None, noise, np.random.default_rng(0))


@pytest.mark.parametrize("case", [Case("none"), Case("both", file="a.npz", scene="boxes")])
def test_a_case_names_exactly_one_source(case):
    with pytest.raises(InputError, match="names file"):
        case.shot(0)
