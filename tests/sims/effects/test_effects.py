"""Each effect against its closed form, and the laws that all of them obey."""

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Stage
from gs2ci_sims.effects.bayer_filter import BayerFilter
from gs2ci_sims.effects.black_level import BlackLevel
from gs2ci_sims.effects.blooming import Blooming
from gs2ci_sims.effects.dark_current import DarkCurrent
from gs2ci_sims.effects.dsnu import Dsnu
from gs2ci_sims.effects.full_well import FullWell
from gs2ci_sims.effects.gain_nonlinearity import GainNonlinearity
from gs2ci_sims.effects.hot_pixels import HotPixels
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.persistence import Persistence
from gs2ci_sims.effects.prnu import Prnu
from gs2ci_sims.effects.quantisation import Quantisation
from gs2ci_sims.effects.read_noise import ReadNoise
from gs2ci_sims.effects.rolling_shutter import RollingShutter
from gs2ci_sims.effects.row_noise import RowNoise
from gs2ci_sims.effects.shot_noise import ShotNoise
from gs2ci_sims.light_path import LIGHT_PATH
from gs2ci_sims.moments import one_per_interval
from gs2ci_sims.rig import Rig

RIG = Rig()

ONE_OF_EACH = [
    BayerFilter(),
    Prnu(0.02),
    DarkCurrent(10.0),
    HotPixels(0.1, 100.0),
    Persistence(0.1, 1.0, 0.1, 1e4),
    ShotNoise(),
    Blooming(0.5),
    FullWell(100.0),
    GainNonlinearity(0.02),
    Dsnu(1.0),
    ReadNoise(2.0),
    RowNoise(1.0),
    BlackLevel(3.0),
    Quantisation(8),
]


def rng(seed=0):
    return np.random.default_rng(seed)


def test_every_effect_on_charge_and_readings_is_tested_here():
    ours = [kind for kind in LIGHT_PATH if kind.stage in (Stage.CHARGE, Stage.READOUT)]
    assert [type(effect) for effect in ONE_OF_EACH] == ours


@pytest.mark.parametrize(
    "effect", [e for e in ONE_OF_EACH if not isinstance(e, MotionBlur | RollingShutter)], ids=lambda e: e.name
)
def test_an_effect_never_changes_its_argument_and_repeats_itself_from_the_same_seed(effect):
    signal = np.sort(rng().uniform(0, 300, (7, 2, 3)))
    before = signal.copy()
    first, second = effect.apply(signal, RIG, rng(1)), effect.apply(signal, RIG, rng(1))
    assert np.array_equal(signal, before)
    assert np.array_equal(first, second)
    assert np.isfinite(first).all()


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
