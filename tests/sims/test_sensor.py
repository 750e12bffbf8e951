"""The sensor as a whole against the EMVA 1288 model: photon transfer, saturation."""

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.charges import FullWell
from gs2ci_sims.effects.noises import Dsnu, RowNoise
from gs2ci_sims.effects.readout import BlackLevel, GainNonlinearity, Quantisation
from gs2ci_sims.exposure import read_out
from gs2ci_sims.light_path import EffectChain, sensor_effects
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.sensor import SensorFigures
from tests.exposing import saturation_dn

SENSOR = SensorFigures()
SATURATION_DN = saturation_dn(EffectChain(sensor_effects(SENSOR), 0))


def readings(photons, seed=0, sensor=SENSOR):
    chain = EffectChain(sensor_effects(sensor), seed, RigFigures(sensor=sensor))
    return read_out(np.full((400, 400, 1), float(photons)), chain)


def test_the_photon_transfer_curve_has_the_system_gain_as_slope_and_the_dark_noise_as_intercept():
    levels = np.linspace(0, 0.8, 9) * SENSOR.full_well_e / SENSOR.quantum_efficiency
    frames = [readings(level, seed) for seed, level in enumerate(levels)]
    mean = np.array([frame.mean() for frame in frames])
    variance = np.array([frame.var() for frame in frames])
    gain = 1 / SENSOR.electrons_per_dn
    dark_variance = (gain * SENSOR.read_noise_e) ** 2 + 1 / 12
    slope = np.polyfit(mean, variance, 1)[0]
    assert slope == pytest.approx(gain, rel=0.01)
    assert variance[0] == pytest.approx(dark_variance, rel=0.02)


def test_the_mean_reading_is_linear_in_photons_with_the_quantum_efficiency_as_slope():
    dark, light = readings(0).mean(), readings(8000).mean()
    assert dark == pytest.approx(SENSOR.black_level_dn, abs=0.02)
    assert (light - dark) * SENSOR.electrons_per_dn / 8000 == pytest.approx(SENSOR.quantum_efficiency, rel=1e-3)


@pytest.mark.parametrize("photons", [1e5, 1e9, 1e15])
def test_an_overexposed_pixel_reads_at_least_its_saturation_level_and_stays_in_range(photons):
    frame = readings(photons)
    assert np.mean(frame >= SATURATION_DN) > 0.9999
    assert frame.max() <= 2**SENSOR.bits - 1


@pytest.mark.parametrize(
    "added",
    [
        [],
        [BlackLevel(-20.0)],
        [BlackLevel(15.0)],
        [Dsnu(20.0)],
        [RowNoise(10.0)],
        [Dsnu(20.0), RowNoise(10.0), BlackLevel(-5.0)],
        [GainNonlinearity(-0.2), FullWell(8000.0)],
    ],
    ids=lambda added: "-".join(effect.name for effect in added) or "alone",
)
def test_full_pixels_are_told_whatever_is_added_behind_the_well(added):
    given = {effect.name for effect in added}
    chain = EffectChain([*(one for one in sensor_effects(SENSOR) if one.name not in given), *added], 3)
    full, bright = (
        read_out(np.full((400, 400, 1), share * SENSOR.full_well_e / SENSOR.quantum_efficiency), chain)
        for share in (2.0, 0.7)
    )
    assert np.mean(full >= saturation_dn(chain)) > 0.9995
    assert not (bright >= saturation_dn(chain)).any()


@pytest.mark.parametrize("well_e", 8000.0 + 2.7 * np.arange(-0.5, 0.5, 0.1))
def test_full_pixels_without_noise_are_told_wherever_their_reading_is_rounded_to(well_e):
    sensor = SensorFigures(full_well_e=well_e, read_noise_e=0.0)
    chain = EffectChain([FullWell(well_e), Quantisation(12)], 0, RigFigures(sensor=sensor))
    assert (read_out(np.full((2, 2, 1), 1e6), chain) >= saturation_dn(chain)).all()


@pytest.mark.parametrize(("bits", "marked"), [(10, True), (16, False)])
def test_a_converter_of_another_depth_than_the_data_sheets_tells_what_it_clips(bits, marked):
    chain = EffectChain([FullWell(1e6), Quantisation(bits)], 0)
    photons = 2000 * SENSOR.electrons_per_dn / SENSOR.quantum_efficiency  # 2064 DN
    reading = read_out(np.full((2, 2, 1), photons), chain)
    assert (reading >= saturation_dn(chain)).all() == marked
    assert (reading == 1023).all() == marked


def test_a_pixel_well_below_the_full_well_is_not_called_saturated():
    assert not (readings(0.9 * SENSOR.full_well_e / SENSOR.quantum_efficiency) >= SATURATION_DN).any()


def test_a_converter_too_short_for_the_well_saturates_first():
    short = SensorFigures(electrons_per_dn=1.0)
    assert saturation_dn(EffectChain(sensor_effects(short), 0, RigFigures(sensor=short))) == 4095
    assert (readings(1e6, sensor=short) == 4095).all()


@pytest.mark.parametrize(
    "figures",
    [
        {"full_well_e": 0.0},
        {"read_noise_e": -1.0},
        {"bits": 0},
        {"electrons_per_dn": 0.0},
        {"electrons_per_dn": float("inf")},
        {"quantum_efficiency": 0.0},
        {"quantum_efficiency": 1.1},
        {"black_level_dn": -1.0},
        {"black_level_dn": 4095.0},
    ],
)
def test_a_data_sheet_out_of_range_is_refused(figures):
    with pytest.raises(InputError, match="allowed"):
        SensorFigures(**figures)
