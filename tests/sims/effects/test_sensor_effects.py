"""Effects of sensor and readout against their closed forms."""

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import UNAVOIDABLE
from gs2ci_sims.effects.bayer_filter import BayerFilter
from gs2ci_sims.effects.charges import Blooming, DarkCurrent, FullWell, Persistence
from gs2ci_sims.effects.noises import Dsnu, HotPixels, Prnu, ReadNoise, RowNoise, ShotNoise
from gs2ci_sims.effects.readout import BlackLevel, GainNonlinearity, Quantisation
from gs2ci_sims.exposure import read_out
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.rig import ModulatorFigures, RigFigures, Timing
from gs2ci_sims.sensor import SensorFigures

RIG = RigFigures(
    modulator=ModulatorFigures(masks=4), timing=Timing(0.2, 0.05), sensor=SensorFigures(full_well_e=10_000.0)
)
EXPOSURE_S = 0.95


def rng(seed=0):
    return np.random.default_rng(seed)


def flat(electrons, size=(400, 500)):
    return np.full((*size, 1), float(electrons))


def test_the_exposure_counts_the_gaps_between_the_masks():
    assert RIG.exposure_s == pytest.approx(EXPOSURE_S)


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_a_bayer_filter_keeps_the_colour_that_its_pattern_names(pattern):
    photons = np.broadcast_to(np.array([1.0, 2.0, 3.0]), (5, 7, 3))
    mosaic = BayerFilter(pattern).apply(photons, RIG, rng())
    assert mosaic.shape == (5, 7, 1)
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        colour = "RGB".index(pattern[2 * row + column])
        assert (mosaic[row::2, column::2] == colour + 1).all()
    assert BayerFilter(pattern).bound(None, RIG) == UNAVOIDABLE


def test_prnu_makes_a_spread_that_grows_linearly_with_the_signal():
    for electrons in (100.0, 5000.0):
        response = Prnu(0.02).apply(flat(electrons), RIG, rng())
        assert response.std() == pytest.approx(0.02 * electrons, rel=0.01)
        assert response.mean() == pytest.approx(electrons, rel=5 * 0.02 / 447)
    assert not Prnu(0.02).apply(flat(0), RIG, rng()).any()


def test_no_pixel_responds_negatively_however_wide_the_spread():
    assert Prnu(0.5).apply(flat(100), RIG, rng()).min() == 0.0


def test_dsnu_has_its_standard_deviation_whatever_the_signal():
    for electrons in (0.0, 5000.0):
        assert (Dsnu(3.0).apply(flat(electrons), RIG, rng()) - electrons).std() == pytest.approx(3.0, rel=0.01)


@pytest.mark.parametrize("effect", [Prnu(0.02), Dsnu(3.0), HotPixels(0.01, 1e3)], ids=lambda effect: effect.name)
def test_a_fixed_pattern_is_the_devices_and_not_the_exposures(effect):
    one, again = (EffectChain([effect], seed, RIG).through(effect.stage, flat(50)) for seed in (1, 2))
    other = EffectChain([effect], 1, RigFigures(device_seed=7)).through(effect.stage, flat(50))
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("effect", [ReadNoise(3.0), RowNoise(3.0), ShotNoise()], ids=lambda effect: effect.name)
def test_a_noise_is_new_in_every_exposure(effect):
    one, other = (EffectChain([effect], seed, RIG).through(effect.stage, flat(50)) for seed in (1, 2))
    assert not np.array_equal(one, other)


def test_dark_current_collects_current_times_exposure_and_doubles_with_the_temperature():
    cool, warm = DarkCurrent(10.0), DarkCurrent(10.0, temperature_c=41.0, doubling_k=8.0)
    assert (cool.apply(flat(5), RIG, rng()) - 5).max() == pytest.approx(10 * EXPOSURE_S)
    assert warm.collected_e(EXPOSURE_S) == pytest.approx(4 * cool.collected_e(EXPOSURE_S))


def test_the_variance_of_a_dark_frame_is_read_noise_and_dark_charge():
    chain = EffectChain([DarkCurrent(40.0), ShotNoise(), ReadNoise(2.0)], 3, RIG)
    dark = (read_out(np.zeros((600, 600, 1)), chain) - RIG.sensor.black_level_dn) / RIG.dn_per_e
    assert dark.mean() == pytest.approx(40 * EXPOSURE_S, rel=0.005)
    assert dark.var() == pytest.approx(2.0**2 + 40 * EXPOSURE_S, rel=0.01)


def test_hot_pixels_are_as_many_and_as_hot_as_stated():
    excess = HotPixels(0.02, 1000.0).apply(flat(0, (1000, 1000)), RIG, rng())
    hot = excess[excess > 0]
    assert hot.size / excess.size == pytest.approx(0.02, abs=5 * np.sqrt(0.02 / excess.size))
    assert hot.mean() == pytest.approx(1000 * EXPOSURE_S, rel=0.04)
    assert np.mean(hot > 2000 * EXPOSURE_S) == pytest.approx(np.exp(-2), rel=0.08)


def test_persistence_decays_exponentially_with_the_gap():
    shares = [Persistence(0.03, 0.5, gap, 8000.0).released_share(EXPOSURE_S) for gap in (0.0, 0.5, 1.0)]
    assert shares[1] / shares[0] == pytest.approx(np.exp(-1))
    assert shares[2] / shares[0] == pytest.approx(np.exp(-2))


def test_consecutive_exposures_release_together_all_that_was_caught():
    shares = [Persistence(0.03, 0.5, k * EXPOSURE_S, 1.0).released_share(EXPOSURE_S) for k in range(40)]
    assert sum(shares) == pytest.approx(0.03)


def test_persistence_shows_the_earlier_image():
    earlier = np.arange(12.0).reshape(2, 2, 3)
    effect = Persistence(0.1, 0.5, 0.2, earlier)
    added = effect.apply(np.ones((2, 2, 3)), RIG, rng()) - 1
    np.testing.assert_allclose(added, effect.released_share(EXPOSURE_S) * earlier)


def test_persistence_of_an_image_of_another_size_is_refused():
    with pytest.raises(InputError, match="signal's shape"):
        Persistence(0.1, 0.5, 0.2, np.ones((3, 3, 1))).apply(np.ones((2, 2, 1)), RIG, rng())


def test_blooming_fills_the_column_evenly_up_and_down_and_keeps_all_charge():
    charge = flat(1000.0, (21, 3))
    charge[10, 1] = 10_000 + 2 * 3.5 * 9000
    spilled = Blooming(1.0).apply(charge, RIG, rng())
    assert spilled.sum() == pytest.approx(charge.sum())
    assert np.array_equal(spilled[:, [0, 2]], charge[:, [0, 2]])
    assert spilled[7:14, 1, 0] == pytest.approx(np.full(7, 10_000.0))
    assert spilled[[6, 14], 1, 0] == pytest.approx(np.full(2, 1000 + 0.5 * 9000))
    assert spilled[:6, 1, 0] == pytest.approx(np.full(6, 1000.0))


def test_what_blooms_over_the_border_is_gone_and_no_receiver_holds_more_than_the_well():
    charge = flat(0.0, (5, 1))
    charge[0] = 1e6
    spilled = Blooming(1.0).apply(charge, RIG, rng())
    assert (spilled == 10_000).all()


def test_a_drain_takes_the_rest_and_an_image_below_the_well_does_not_bloom():
    charge = flat(0.0, (101, 1))
    charge[50] = 12_000.0
    assert Blooming(0.25).apply(charge, RIG, rng()).sum() == pytest.approx(12_000)
    assert FullWell(10_000.0).apply(Blooming(0.25).apply(charge, RIG, rng()), RIG, rng()).sum() == pytest.approx(10_500)
    calm = rng().uniform(0, 9999, (20, 20, 3))
    assert np.array_equal(Blooming(1.0).apply(calm, RIG, rng()), calm)


@pytest.mark.parametrize("departure", [0.03, -0.2])
def test_a_bent_response_departs_most_at_half_the_well_and_nowhere_at_its_ends(departure):
    charge = np.linspace(0, 10_000, 1001)
    change = GainNonlinearity(departure).apply(charge, RIG, rng()) - charge
    assert change[500] == pytest.approx(departure * 10_000)
    assert np.abs(change).argmax() == 500
    assert change[[0, -1]] == pytest.approx([0.0, 0.0])
    assert (np.diff(charge + change) > 0).all()


def test_the_slope_of_a_bent_response_at_no_light_is_one_plus_four_departures():
    small = np.array([0.0, 1e-3])
    assert np.diff(GainNonlinearity(0.05).apply(small, RIG, rng()))[0] / 1e-3 == pytest.approx(1.2, rel=1e-6)


def test_row_noise_is_one_number_per_row_with_its_standard_deviation():
    noise = RowNoise(2.0).apply(flat(0, (40_000, 3)), RIG, rng())
    assert (noise == noise[:, :1]).all()
    assert noise[:, 0].std() == pytest.approx(2.0, rel=0.02)
    assert np.corrcoef(noise[:-1, 0, 0], noise[1:, 0, 0])[0, 1] == pytest.approx(0.0, abs=0.03)


def test_a_black_level_that_drifted_down_clips_at_zero_when_it_is_converted():
    chain = EffectChain([BlackLevel(-70.0), Quantisation(12)], 0, RIG)
    assert read_out(np.zeros((2, 2, 1)), chain).tolist() == np.zeros((2, 2, 1)).tolist()
    bright = read_out(np.full((2, 2, 1), 2.7 * 100 / 0.64), chain)
    assert (bright == 64 + 100 - 70).all()


@pytest.mark.parametrize(
    "make",
    [
        lambda: BayerFilter("RGBW"),
        lambda: Prnu(-0.1),
        lambda: Prnu(0.6),
        lambda: Dsnu(-1.0),
        lambda: Dsnu(float("nan")),
        lambda: DarkCurrent(-1.0),
        lambda: DarkCurrent(1.0, temperature_c=300.0),
        lambda: DarkCurrent(1.0, doubling_k=0.0),
        lambda: HotPixels(1.5, 1.0),
        lambda: HotPixels(0.5, float("inf")),
        lambda: Persistence(1.5, 1.0, 0.0, 1.0),
        lambda: Persistence(0.5, 0.0, 0.0, 1.0),
        lambda: Persistence(0.5, 1.0, -1.0, 1.0),
        lambda: Persistence(0.5, 1.0, 0.0, -1.0),
        lambda: Blooming(1.5),
        lambda: GainNonlinearity(0.25),
        lambda: RowNoise(-1.0),
        lambda: BlackLevel(float("inf")),
    ],
)
def test_figures_out_of_range_are_refused_when_the_effect_is_made(make):
    with pytest.raises(InputError, match="allowed"):
        make()
