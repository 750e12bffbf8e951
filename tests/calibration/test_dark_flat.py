from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from gs2ci.rig.config import RigTable
from gs2ci_calibration import dark_flat
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.dark_flat import Darks, estimate_dark, estimate_response
from gs2ci_calibration.refusals import CalibrationError, Reason
from tests.bench_truth import opened

TOP_DN = 4095


def refused(reason, action, *arguments):
    with pytest.raises(CalibrationError) as error:
        action(*arguments)
    assert error.value.reason is reason, str(error.value)
    return str(error.value)


def test_standard_errors_of_maps_and_spreads_are_true_over_many_sensors(make_sensor):
    hits = {"dsnu": [], "prnu": [], "noise": []}
    shares = {"offset": [], "current": [], "response": []}
    for seed in range(60):
        sensor = make_sensor(seed)
        found = estimate_dark(sensor.darks(), TOP_DN)
        flat = estimate_response(sensor.frames(16, 0.1), 0.1, found)
        for name, (value, error), true in (
            ("dsnu", found.dsnu_dn, sensor.dsnu_dn),
            ("prnu", flat.prnu, sensor.prnu),
            ("noise", found.noise_rms_dn, sensor.noise_dn[0]),
        ):
            hits[name].append(abs(value - true) <= 2 * error)
        response = sensor.response / sensor.response.mean()
        for name, value, error, true in (
            ("offset", found.dark.offset_dn, found.offset_error_dn, sensor.offset_dn),
            ("current", found.dark.current_dn_per_s, found.current_error_dn_per_s, 8.0),
            ("response", flat.response, flat.error, response),
        ):
            shares[name].append(np.mean(np.abs(value - true) <= 2 * error))
    for name, found in hits.items():
        assert sum(found) >= binom.ppf(0.001, len(found), 0.95), name
    for name, found in shares.items():
        assert 0.94 < np.mean(found) < 0.975, name


@pytest.mark.parametrize(("frames", "noise_e"), [(4, 2.5), (4, 7.5), (8, 7.5), (32, 7.5)])
def test_spreads_are_unbiased_however_few_the_frames_and_many_the_pixels(make_sensor, frames, noise_e):
    """With a hundred thousand pixels a bias of a few per cent of the noise is many standard errors."""
    sensor = make_sensor(frames, shape=(256, 384), read_noise_e=noise_e, dsnu_dn=0.6, prnu=0.005)
    found = estimate_dark(sensor.darks(frames), TOP_DN)
    flat = estimate_response(sensor.frames(frames, 0.1), 0.1, found)
    offset, response = sensor.offset_dn.std(), sensor.response.std() / sensor.response.mean()
    for (value, error), true in ((found.dsnu_dn, offset), (flat.prnu, response)):
        assert abs(value - true) < 3.5 * error
        assert error < 0.02 * true


def test_the_colours_of_a_mosaic_are_no_prnu(make_sensor):
    sensor = make_sensor(5, shape=(64, 96), light_e_per_s=80_000.0)
    found = estimate_dark(sensor.darks(), TOP_DN)
    colours = np.array([[0.5, 1.0], [1.0, 0.4]])[np.indices(sensor.shape)[0] % 2, np.indices(sensor.shape)[1] % 2]
    flat = replace(sensor, light_e_per_s=sensor.light_e_per_s * colours).frames(16, 0.05)
    value, error = estimate_response(flat, 0.05, found, mosaic=True).prnu
    assert abs(value - sensor.prnu) < 4 * error
    assert estimate_response(flat, 0.05, found).prnu[0] > 0.2


def test_a_lamp_of_one_colour_makes_the_other_pixels_of_a_mosaic_neither_dead_nor_uneven(make_sensor):
    sensor = make_sensor(6, shape=(64, 96), light_e_per_s=80_000.0)
    found = estimate_dark(sensor.darks(), TOP_DN)
    colours = np.array([[1.0, 0.2], [0.2, 0.06]])[np.indices(sensor.shape)[0] % 2, np.indices(sensor.shape)[1] % 2]
    flat = replace(sensor, light_e_per_s=sensor.light_e_per_s * colours).frames(16, 0.1)
    flat[:, 5, 4] = 64.0 + np.arange(16) % 2
    response = estimate_response(flat, 0.1, found, mosaic=True)
    assert np.argwhere(response.dead).tolist() == [[5, 4]]
    darker = colours * np.where(np.arange(96) < 20, 0.2, 1.0)
    flat = replace(sensor, light_e_per_s=sensor.light_e_per_s * darker).frames(16, 0.1)
    with pytest.raises(CalibrationError, match="of their colour's mean"):
        estimate_response(flat, 0.1, found, mosaic=True)


def table(form="Y12"):
    return RigTable.model_validate(
        {
            "modulator": {"kind": "dlpc900", "trigger_out_2_bit": "disables"},
            "sensor": {"kind": "v4l2", "format": form, "black_level_dn": 64.0},
            "capture": {"masks": 4, "density": 0.5, "mask_s": 0.004},
            "registration": {"superpixel": 2},
            "optics": {"full_scale_e_per_s": 2e6},
            "calibration": {"frames": 8},
            "world": {"scene": "planes", "height": 48, "width": 64},
        }
    )


def test_the_middle_exposure_is_well_above_the_shortest_where_that_is_long(monkeypatch):
    monkeypatch.setattr(dark_flat, "limits_s", lambda bench: (0.3, 0.9))
    with opened(table()) as (bench, _):
        assert dark_flat._take_darks(bench).exposures_s == pytest.approx((0.3, 0.6, 0.9), rel=1e-3)


@pytest.mark.parametrize(("form", "mosaic"), [("Y12", False), ("RG12", True)])
def test_the_sensors_format_says_whether_it_is_a_mosaic(monkeypatch, form, mosaic):
    asked, taken = [], []
    estimate, estimate_darks = dark_flat.estimate_response, dark_flat.estimate_dark

    def seen(*arguments, **options):
        asked.append(options["mosaic"])
        return estimate(*arguments, **options)

    def seen_darks(darks, *arguments):
        taken.append(darks)
        return estimate_darks(darks, *arguments)

    monkeypatch.setattr(dark_flat, "estimate_response", seen)
    monkeypatch.setattr(dark_flat, "estimate_dark", seen_darks)
    with opened(table(form)) as (bench, _):
        section = dark_flat.measure(bench, Bundle())
    assert asked == [mosaic]
    # A quarter of the frames tells what only has to be seen; the flat field fills half of the range.
    assert [len(taken[0].short), len(taken[0].middle), len(taken[0].long), len(taken[0].unshut)] == [8, 2, 8, 2]
    filled_dn = float(section.estimates["flat_dn_per_s"].value) * section.facts["flat_exposure_s"]
    assert 0.4 < filled_dn / TOP_DN < 0.6


def test_standard_errors_of_each_pixels_noise_are_true_however_few_the_frames(make_sensor):
    for frames in (6, 16):
        sensor = make_sensor(frames, shape=(64, 96))
        found = estimate_dark(sensor.darks(frames), TOP_DN)
        misses = (found.noise_dn - sensor.noise_dn[0]) / found.noise_error_dn
        assert np.sqrt(np.mean(np.square(misses))) == pytest.approx(1.0, abs=0.15), frames


def test_the_rate_at_which_pixels_fill_is_known_to_its_standard_error(make_sensor):
    misses = []
    for seed in range(20):
        sensor = make_sensor(seed)
        flat = estimate_response(sensor.frames(16, 0.1), 0.1, estimate_dark(sensor.darks(), TOP_DN))
        rate, error = flat.rate_dn_per_s
        misses.append((rate - sensor.light_e_per_s * sensor.response.mean() / sensor.gain_e_per_dn) / error)
        assert error < 1e-3 * rate
    assert np.sqrt(np.mean(np.square(misses))) < 1.5


def test_what_few_pixels_gain_by_chance_is_no_light(make_sensor):
    darks = make_sensor(17, shape=(8, 8)).darks(4)
    noise = darks.long.std(axis=0, ddof=1).mean()
    estimate_dark(replace(darks, unshut=darks.long + np.float32(0.4 * noise)), TOP_DN)
    refused(Reason.NOT_DARK, estimate_dark, replace(darks, unshut=darks.long + np.float32(noise)), TOP_DN)


def test_a_pixel_whose_well_is_full_below_the_largest_reading_is_read_in_the_middle_exposure():
    times, rng = (0.2, 0.3, 1.2), np.random.default_rng(0)
    charge = np.full((16, 24), 20.0)
    charge[4, 7] = 3000.0  # DN a second, of which 2600 fill the well

    def frames(exposure_s):
        read = np.minimum(charge * exposure_s, 2600.0) + 2.0 * rng.standard_normal((16, *charge.shape))
        return np.rint(64.0 + read).astype(np.float32)

    darks = Darks(*(frames(each) for each in times), frames(times[2]), times)
    dark = estimate_dark(darks, TOP_DN).dark
    assert dark.current_dn_per_s[4, 7] == pytest.approx(3000.0, rel=0.01)
    assert np.argwhere(dark.hot).tolist() == [[4, 7]]


def test_hot_pixels_are_found_and_others_are_not(make_sensor):
    sensor = make_sensor(3)
    current = np.full(sensor.shape, 20.0)
    hot = np.zeros(sensor.shape, bool)
    hot[2, 5] = hot[9, 1] = hot[15, 23] = True
    current[hot] = (400.0, 3000.0, 60_000.0)
    found = estimate_dark(sensor.darks(current_e_per_s=current), TOP_DN)
    assert np.array_equal(found.dark.hot, hot)
    # The hottest overflows in the long exposure and is read in the middle one.
    assert found.dark.current_dn_per_s[15, 23] == pytest.approx(24_000, rel=0.02)


def test_dead_pixels_are_flagged_and_have_a_response_that_can_be_divided_by(make_sensor):
    sensor = make_sensor(4)
    found = estimate_dark(sensor.darks(), TOP_DN)
    flat = sensor.frames(16, 0.1)
    flat[:, 3, 3] = 64.0
    flat[:, 8, 2] = np.arange(16) % 2 + 30.0  # dark above signal
    response = estimate_response(flat, 0.1, found)
    assert np.argwhere(response.dead).tolist() == [[3, 3], [8, 2]]
    assert response.response[3, 3] == 1.0
    assert np.isfinite(response.error).all()


def test_a_dead_row_is_refused_by_its_number(make_sensor):
    sensor = make_sensor(5)
    found = estimate_dark(sensor.darks(), TOP_DN)
    flat = sensor.frames(16, 0.1)
    flat[:, 7] = sensor.frames(16, 0.1, lit=False)[:, 7]
    assert "row 7" in refused(Reason.DEAD_PIXELS, estimate_response, flat, 0.1, found)
    flat = sensor.frames(16, 0.1)
    flat[:, :, 11] = sensor.frames(16, 0.1, lit=False)[:, :, 11]
    assert "column 11" in refused(Reason.DEAD_PIXELS, estimate_response, flat, 0.1, found)


def test_a_single_frame_is_refused(make_sensor):
    sensor = make_sensor(6)
    darks = sensor.darks()
    assert "1 frame" in refused(Reason.TOO_FEW_FRAMES, estimate_dark, replace(darks, short=darks.short[:1]), TOP_DN)
    found = estimate_dark(darks, TOP_DN)
    refused(Reason.TOO_FEW_FRAMES, estimate_response, sensor.frames(1, 0.1), 0.1, found)


def test_frames_without_variance_are_refused(make_sensor):
    sensor = make_sensor(7)
    darks = sensor.darks()
    still = np.repeat(darks.short[:1], 16, axis=0)
    refused(Reason.NO_VARIANCE, estimate_dark, replace(darks, short=still), TOP_DN)


def test_frames_that_are_not_numbers_are_refused(make_sensor):
    darks = make_sensor(8).darks()
    darks.long[3, 2, 1] = np.nan
    refused(Reason.DEAD_PIXELS, estimate_dark, darks, TOP_DN)


def test_dark_above_signal_is_refused_as_no_light(make_sensor):
    sensor = make_sensor(9)
    found = estimate_dark(sensor.darks(), TOP_DN)
    refused(Reason.NO_LIGHT, estimate_response, sensor.frames(16, 0.1, lit=False) - 5, 0.1, found)


def test_light_in_the_dark_frames_is_refused(make_sensor):
    sensor = make_sensor(10)
    darks = sensor.darks()
    refused(Reason.NOT_DARK, estimate_dark, replace(darks, unshut=darks.unshut + 2), TOP_DN)
    refused(Reason.NOT_DARK, estimate_dark, sensor.darks(current_e_per_s=6000.0), TOP_DN)


def test_a_black_level_that_cuts_noise_off_is_refused(make_sensor):
    refused(Reason.CLIPPED_AT_BLACK, estimate_dark, make_sensor(11, black_dn=0.0).darks(), TOP_DN)


def test_a_sensor_full_of_hot_pixels_is_refused(make_sensor):
    sensor = make_sensor(12)
    current = np.where(np.random.default_rng(0).random(sensor.shape) < 0.1, 2000.0, 20.0)
    refused(Reason.DEAD_PIXELS, estimate_dark, sensor.darks(current_e_per_s=current), TOP_DN)


def test_a_flickering_lamp_is_refused_and_a_steady_one_is_not(make_sensor):
    sensor = make_sensor(13)
    found = estimate_dark(sensor.darks(), TOP_DN)
    assert estimate_response(sensor.frames(16, 0.1), 0.1, found).flicker < 0.003
    shaky = make_sensor(13, flicker=0.02)
    assert "%" in refused(Reason.LAMP_FLICKERS, estimate_response, shaky.frames(16, 0.1), 0.1, found)


def test_flicker_within_bounds_does_not_reach_the_response(make_sensor):
    steady, shaky = make_sensor(14), make_sensor(14, flicker=0.004)
    found = estimate_dark(steady.darks(), TOP_DN)
    response = estimate_response(shaky.frames(16, 0.1), 0.1, found)
    true = shaky.response / shaky.response.mean()
    assert np.mean(np.abs(response.response - true) <= 2 * response.error) > 0.92


def test_an_uneven_field_is_refused(make_sensor):
    sensor = make_sensor(15)
    found = estimate_dark(sensor.darks(), TOP_DN)
    slope = np.linspace(0.15, 1.85, sensor.shape[1])
    flat = sensor.offset_dn + (sensor.frames(16, 0.1) - sensor.offset_dn) * slope
    refused(Reason.UNEVEN, estimate_response, flat.astype(np.float32), 0.1, found)
