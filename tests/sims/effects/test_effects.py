"""Effects against their closed forms."""

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Bound
from gs2ci_sims.effects.charges import FullWell
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.noises import ReadNoise, ShotNoise
from gs2ci_sims.effects.readout import Quantisation
from gs2ci_sims.moments import one_per_interval
from gs2ci_sims.rig import Optics, RigFigures

RIG = RigFigures()


def rng(seed=0):
    return np.random.default_rng(seed)


def test_shot_noise_has_variance_equal_to_mean():
    for mean in (0.5, 20.0, 5000.0):
        counted = ShotNoise().apply(np.full((500, 500, 1), mean), RIG, rng())
        assert counted.mean() == pytest.approx(mean, rel=5 * mean**-0.5 / 500)
        assert counted.var() == pytest.approx(mean, rel=0.015)


def test_shot_noise_of_no_light_is_none():
    assert not ShotNoise().apply(np.zeros((9, 9, 3)), RIG, rng()).any()


def test_shot_noise_stays_finite_and_of_the_right_size_beyond_the_poisson_sampler():
    mean = 1e18
    counted = ShotNoise().apply(np.full((300, 300, 1), mean), RIG, rng())
    assert np.std(counted - mean) == pytest.approx(mean**0.5, rel=0.02)


def test_the_normal_law_takes_over_from_poissons_without_a_step():
    below, above = (ShotNoise().apply(np.full((300, 300, 1), mean), RIG, rng()) for mean in (0.99e10, 1.01e10))
    assert below.std() / 0.99e10**0.5 == pytest.approx(above.std() / 1.01e10**0.5, rel=0.02)


def test_full_well_clips_at_the_capacity_and_leaves_the_rest():
    charge = np.array([0.0, 99.0, 100.0, 101.0, 1e9])
    assert FullWell(100.0).apply(charge, RIG, rng()).tolist() == [0.0, 99.0, 100.0, 100.0, 100.0]


def test_read_noise_has_its_standard_deviation_and_no_mean():
    added = ReadNoise(2.9).apply(np.zeros((600, 600, 1)), RIG, rng())
    assert added.std() == pytest.approx(2.9, rel=0.01)
    assert abs(added.mean()) < 5 * 2.9 / 600


def test_quantisation_adds_a_twelfth_of_a_step_squared():
    smooth = rng().uniform(100, 200, 400_000)
    error = Quantisation(12).apply(smooth, RIG, rng()) - smooth
    assert error.var() == pytest.approx(1 / 12, rel=0.01)
    assert abs(error).max() <= 0.5


def test_quantisation_keeps_to_the_range_of_the_converter():
    assert Quantisation(8).apply(np.array([-3.0, 0.4, 254.6, 300.0]), RIG, rng()).tolist() == [0, 0, 255, 255]


def test_motion_blur_puts_its_views_into_the_panels_it_is_given_or_else_into_each_interval():
    nominal = one_per_interval(np.array([[0.0, 1.0], [1.0, 2.0]]))
    assert MotionBlur(3).apply(nominal, RIG, rng()).times_s.shape == (6,)
    assert MotionBlur(2, (0.0, 2.0)).apply(nominal, RIG, rng()).times_s.shape == (2,)


def test_motion_blur_of_one_view_is_the_middle_of_the_interval():
    nominal = one_per_interval(np.array([[0.25, 0.75]]))
    assert MotionBlur(1).apply(nominal, RIG, rng()).times_s.tolist() == nominal.times_s.tolist() == [0.5]


@pytest.mark.parametrize(
    "make",
    [
        lambda: MotionBlur(0),
        lambda: FullWell(0.0),
        lambda: FullWell(float("nan")),
        lambda: ReadNoise(-1.0),
        lambda: ReadNoise(float("inf")),
        lambda: Quantisation(0),
        lambda: Quantisation(33),
    ],
)
def test_figures_out_of_range_are_refused_when_the_effect_is_made(make):
    with pytest.raises(InputError, match="allowed"):
        make()


@pytest.mark.parametrize(("rms_dn", "peak_dn"), [(-1, 1), (1, -1), (np.nan, 1), (1, np.nan)])
def test_a_bound_that_bounds_nothing_is_refused(rms_dn, peak_dn):
    with pytest.raises(InputError, match="0 or more, or infinite"):
        Bound(rms_dn, peak_dn)


@pytest.mark.parametrize(
    "lens", [{"f_number": 0}, {"f_number": np.inf}, {"wavelength_nm": -1}, {"wavelength_nm": np.nan}]
)
def test_a_lens_that_cannot_be_is_refused(lens):
    with pytest.raises(InputError, match="in Optics"):
        Optics(**lens)
