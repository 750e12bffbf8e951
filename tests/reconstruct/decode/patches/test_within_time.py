"""The patch decode that keeps to a time, by a clock that the test advances."""

from itertools import pairwise

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, gap_tv
from gs2ci.reconstruct.decode.patches import within_time
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.decode.patches.denoiser import SimilarPatches
from gs2ci.reconstruct.decode.patches.within_time import decode_until

BRIEF = PatchSettings(iterations=40, first_sigma=0.1, last_sigma=0.02)
BEGINS = GapTvSettings(iterations=5)


class Clock:
    """Stands still but for the steps, each of which takes what it is told."""

    def __init__(self, monkeypatch, costs):
        self.now_s, self.sigmas = 100.0, []

        class Watched(SimilarPatches):
            def __call__(patches, views, sigma):  # noqa: N805
                self.now_s += costs(len(self.sigmas), patches.seeks(len(self.sigmas)))
                self.sigmas.append(sigma)
                return super().__call__(views, sigma)

        monkeypatch.setattr(within_time, "SimilarPatches", Watched)

    def __call__(self):
        return self.now_s


@pytest.fixture
def unwatched(monkeypatch):
    """Hide no pixels: the views do not change the levels."""
    monkeypatch.setattr(within_time, "HELDOUT_SHARE", 0.0)


@pytest.fixture
def decoded(make_shot, monkeypatch):
    def decode(seconds, costs, settings=BRIEF, begins=BEGINS):
        clock = Clock(monkeypatch, costs)
        return decode_until(make_shot(slide=0.4), 100.0 + seconds, settings, clock=clock, begins=begins), clock

    return decode


def even(_, seeks):
    return 2.0 if seeks else 1.0


@pytest.mark.usefixtures("unwatched")
@pytest.mark.parametrize("seconds", [5, 9, 20, 31.5])
def test_it_ends_in_time_at_the_last_level_having_used_what_there_was(decoded, seconds):
    found, clock = decoded(seconds, even)
    assert 0 < found.steps == len(clock.sigmas)
    assert seconds - 5 < clock.now_s - 100 <= seconds
    assert clock.sigmas[0] == BRIEF.first_sigma
    assert clock.sigmas[-1] == pytest.approx(BRIEF.last_sigma)
    assert all(after < before for before, after in pairwise(clock.sigmas))


@pytest.mark.usefixtures("unwatched")
def test_a_machine_that_slows_down_makes_fewer_steps_and_ends_in_time_all_the_same(decoded):
    steady, _ = decoded(40, even)
    slowed, clock = decoded(40, lambda step, seeks: even(step, seeks) * (3 if step > 8 else 1))
    assert clock.now_s - 100 <= 40 + 3  # one step may begin at the old pace
    assert slowed.steps < steady.steps
    assert clock.sigmas[-1] == pytest.approx(BRIEF.last_sigma, rel=0.2)


@pytest.mark.parametrize("seconds", [30, 1e6])
def test_it_goes_down_to_a_lower_level_where_the_views_err_less(decoded, seconds):
    found, clock = decoded(seconds, even)
    assert found.steps == len(clock.sigmas)
    assert 0.66 * BRIEF.last_sigma < clock.sigmas[-1] < 0.9 * BRIEF.last_sigma
    assert all(after <= before for before, after in pairwise(clock.sigmas))


@pytest.mark.usefixtures("unwatched")
def test_no_more_steps_are_made_than_there_is_a_use_for(decoded):
    found, clock = decoded(1e6, even)
    assert found.steps == BRIEF.iterations
    np.testing.assert_allclose(clock.sigmas, BRIEF.sigmas, rtol=1e-6)


def test_one_step_is_made_where_there_is_any_time_and_none_where_there_is_none(decoded, make_shot):
    found, clock = decoded(0.5, even)
    assert (found.steps, clock.sigmas) == (1, [BRIEF.first_sigma])
    found, _ = decoded(0, even)
    assert found.steps == 0
    np.testing.assert_array_equal(found.views, gap_tv(make_shot(slide=0.4), BEGINS))


def test_the_steps_of_a_short_time_come_closer_to_the_truth_than_gap_tv(decoded, make_shot):
    found, _ = decoded(20, even, None, None)
    truth = make_shot(slide=0.4).truth.views
    assert found.settings.lattice.step_px == found.settings.lattice.patch_px
    by_patches, by_tv = (
        np.mean(psnr_per_view(views, truth)) for views in (found.views, gap_tv(make_shot(slide=0.4), GapTvSettings()))
    )
    assert by_patches > by_tv + 0.5


def test_senseless_settings_are_refused(make_shot):
    with pytest.raises(InputError, match="iterations = 0 in PatchSettings"):
        decode_until(make_shot(), 1e9, PatchSettings(iterations=0))
