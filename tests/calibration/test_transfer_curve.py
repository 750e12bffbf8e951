from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from gs2ci_calibration.refusals import CalibrationError, Reason
from gs2ci_calibration.transfer_curve import Full, estimate

TOP_DN = 4095


def measured(sensor, **options):
    return estimate(sensor.sweep(**options), sensor.full, sensor.dark, sensor.noise_dn, TOP_DN)


def refused(reason, *arguments):
    with pytest.raises(CalibrationError) as error:
        estimate(*arguments)
    assert error.value.reason is reason, str(error.value)
    return str(error.value)


def test_standard_errors_are_true_over_many_sensors_bent_or_not(make_sensor):
    hits = {"gain_e_per_dn": [], "read_noise_e": [], "full_well_e": [], "linearity_error": []}
    errors = []
    for seed in range(100):
        departure = (-0.02, 0.0, 0.01, 0.04)[seed % 4]
        sensor = make_sensor(seed, departure=departure)
        found = measured(sensor)
        for name, true in (
            ("gain_e_per_dn", 2.5),
            ("read_noise_e", 4.0),
            ("full_well_e", 9000.0),
            ("linearity_error", departure),
        ):
            value, error = getattr(found, name)
            hits[name].append(abs(value - true) <= 2 * error)
        errors.append(found.gain_e_per_dn[0] / 2.5 - 1)
    for name, found in hits.items():
        assert sum(found) >= binom.ppf(0.001, len(found), 0.95), name
        assert sum(found) <= 99, name
    assert abs(np.mean(errors)) < 4 * np.std(errors) / 10


def test_a_response_that_bends_would_mislead_a_straight_curve(make_sensor):
    sensor = make_sensor(1, departure=0.04, shape=(48, 64))
    found = measured(sensor, frames=8)
    assert found.gain_e_per_dn[0] == pytest.approx(2.5, rel=0.02)
    clear = found.signal_dn < 0.8 * 3600
    slope = np.polyfit(found.signal_dn[clear], found.variance_dn2[clear], 1)[0]
    assert abs(slope * 2.5 - 1) > 0.1


def test_the_converter_may_end_before_the_well(make_sensor):
    sensor = make_sensor(2, gain_e_per_dn=1.5)
    full = Full(sensor.full.reading_dn, 4031 * 1.5 / 40_000)
    sweep = sensor.sweep()
    sweep = replace(sweep, exposures_s=sweep.exposures_s, stacks=sweep.stacks)
    found = estimate(sweep, full, sensor.dark, sensor.noise_dn, TOP_DN)
    assert found.limited_by == "converter"
    assert found.full_well_e[0] == pytest.approx(4031 * 1.5, rel=0.05)
    assert measured(make_sensor(2)).limited_by == "well"


def test_readings_are_linear_up_to_saturation_and_no_further(make_sensor):
    found = measured(make_sensor(3))
    assert 0.85 * 3664 < found.linear_to_dn[0] <= 3700
    assert found.saturation_dn[0] == pytest.approx(64 + 3600, abs=1.0)


def test_flicker_is_no_noise_of_the_pixels(make_sensor):
    shaky = measured(make_sensor(4, flicker=0.004, shape=(32, 48)))
    assert shaky.gain_e_per_dn[0] == pytest.approx(2.5, rel=0.02)
    assert shaky.flicker == pytest.approx(0.004, rel=0.4)
    sensor = make_sensor(5, flicker=0.02)
    refused(Reason.LAMP_FLICKERS, sensor.sweep(), sensor.full, sensor.dark, sensor.noise_dn, TOP_DN)


@pytest.mark.parametrize("flicker", [0.0, 0.002, 0.004])
def test_flicker_of_a_lamp_is_no_noise_of_pixels_that_see_it_in_unequal_colours(make_sensor, flicker):
    sensor = make_sensor(8, shape=(96, 128), flicker=flicker)
    colours = np.array([[0.5, 1.0], [1.0, 0.4]])[np.indices(sensor.shape)[0] % 2, np.indices(sensor.shape)[1] % 2]
    lit = replace(sensor, light_e_per_s=sensor.light_e_per_s * colours)
    # The exposures are those at which the brighter colour fills.
    sweep = replace(sensor.sweep(), stacks=tuple(lit.frames(8, time_s) for time_s in sensor.sweep().exposures_s))
    found = estimate(sweep, sensor.full, sensor.dark, sensor.noise_dn, TOP_DN)
    value, error = found.gain_e_per_dn
    assert error < 0.01 * 2.5
    assert abs(value - 2.5) < 3 * error


def test_a_drifting_lamp_is_refused(make_sensor):
    sensor = make_sensor(6)
    sweep = sensor.sweep()
    fading = [
        (sensor.offset_dn + (stack - sensor.offset_dn) * (1 - 0.005 * i)).astype(np.float32)
        for i, stack in enumerate(sweep.stacks)
    ]
    refused(Reason.LAMP_DRIFTS, replace(sweep, stacks=tuple(fading)), sensor.full, sensor.dark, sensor.noise_dn, TOP_DN)


def test_readings_that_follow_no_line_are_refused(make_sensor):
    sensor = make_sensor(7)
    sweep = sensor.sweep()
    wrong = sweep.exposures_s * (1 + 0.05 * np.tile([1, -1], 12))
    sentence = refused(
        Reason.NOT_LINEAR, replace(sweep, exposures_s=wrong), sensor.full, sensor.dark, sensor.noise_dn, TOP_DN
    )
    assert "parabola" in sentence


def test_a_single_frame_per_level_is_refused(make_sensor):
    sensor = make_sensor(8)
    refused(Reason.TOO_FEW_FRAMES, sensor.sweep(frames=1), sensor.full, sensor.dark, sensor.noise_dn, TOP_DN)


def test_frames_without_variance_are_refused(make_sensor):
    sensor = make_sensor(9)
    still = replace(sensor.sweep(), stacks=tuple(np.repeat(s[:1], 4, axis=0) for s in sensor.sweep().stacks))
    refused(Reason.NO_VARIANCE, still, sensor.full, sensor.dark, sensor.noise_dn, TOP_DN)


def test_noise_that_does_not_grow_with_the_light_is_refused(make_sensor):
    sensor = make_sensor(10)
    rng = np.random.default_rng(0)
    stacks = tuple(
        (stack.mean(axis=0) + 1.6 * rng.standard_normal(stack.shape)).astype(np.float32)
        for stack in sensor.sweep(frames=16).stacks
    )
    sentence = refused(
        Reason.NO_VARIANCE,
        replace(sensor.sweep(), stacks=stacks),
        sensor.full,
        sensor.dark,
        (1.6, 0.002),
        TOP_DN,
    )
    assert "photons" in sentence


def test_dark_noise_of_rounding_alone_is_refused(make_sensor):
    sensor = make_sensor(11)
    sentence = refused(
        Reason.NO_VARIANCE, sensor.sweep(), sensor.full, sensor.dark, (float(np.sqrt(1 / 12)), 0.002), TOP_DN
    )
    assert "rounding" in sentence


def test_a_sweep_above_saturation_is_refused(make_sensor):
    sensor = make_sensor(12, light_e_per_s=4e6)
    sweep = make_sensor(12).sweep()
    stacks = tuple(sensor.frames(4, t) for t in sweep.exposures_s)
    refused(Reason.SATURATED, replace(sweep, stacks=stacks), sensor.full, sensor.dark, sensor.noise_dn, TOP_DN)
