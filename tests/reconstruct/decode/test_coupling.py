import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.decode.gap_tv import COUPLINGS, GapTvSettings, choose_coupling


def test_views_that_stay_the_same_are_coupled_as_strongly_as_may_be(make_shot):
    assert choose_coupling(make_shot(), GapTvSettings(), seed=0).coupling == max(COUPLINGS)


def test_views_that_change_everywhere_are_left_apart(make_shot):
    assert choose_coupling(make_shot(slide=2.0), GapTvSettings(), seed=0).coupling == 0


def test_everything_else_is_kept_and_the_seed_decides_the_draw(make_shot):
    settings = GapTvSettings(iterations=7, weight=0.2, inner=3)
    chosen = choose_coupling(make_shot(), settings, seed=3)
    assert (chosen.iterations, chosen.weight, chosen.inner) == (7, 0.2, 3)
    assert choose_coupling(make_shot(), settings, seed=3) == chosen


def test_a_shot_without_a_pixel_to_hold_out_takes_the_first(make_shot):
    shot = make_shot(saturated=np.ones((32, 40), bool))
    assert choose_coupling(shot, GapTvSettings(), seed=0, candidates=(0.2, 0.5)).coupling == 0.2


def test_settings_that_make_no_sense_are_refused(make_shot):
    with pytest.raises(InputError, match=" in GapTvSettings"):
        choose_coupling(make_shot(), GapTvSettings(), seed=0, candidates=(-1.0,))
