from dataclasses import replace

import numpy as np
import pytest

from gs2ci_calibration.masks import registration_step
from gs2ci_calibration.masks.registration_step import measure_registration
from gs2ci_calibration.refusals import CalibrationError, Reason


def refusal(bench, known):
    with pytest.raises(CalibrationError) as caught:
        measure_registration(bench, known)
    assert caught.value.step == "registration"
    return caught.value


def test_an_image_upside_down_is_refused_with_the_way_round_it_lies(bench_of_truth, dark_known):
    bench = bench_of_truth(quarter_turns=2)
    found = refusal(bench, dark_known(bench))
    assert found.reason is Reason.FLIPPED
    assert "upside down" in str(found)
    assert "upright" in str(found)


def test_an_image_upside_down_is_taken_when_the_rig_file_says_so(bench_of_truth, dark_known):
    bench = bench_of_truth(quarter_turns=2, options={"orientation": "upside down"})
    section = measure_registration(bench, dark_known(bench))
    assert section.facts["orientation"] == "upside down"
    truth = bench.world.registration.sensor_from_modulator(*bench.size)
    assert np.abs(section.array("sensor_from_modulator") - truth)[:, :2].max() < 1e-3


def test_a_bent_image_is_followed_by_a_polynomial(bench_of_truth, dark_known):
    bench = bench_of_truth(size=(96, 120), bend=0.06, right_px=1.3, options={"mask_frames": 8})
    section = measure_registration(bench, dark_known(bench))
    y, x = np.mgrid[:96, :120] + 0.5
    truth = np.stack(bench.world.looks_at(x, y))
    relay = registration_step.PixelMap(bench.size, section.array("modulator_from_sensor"))
    off_px = np.sqrt(np.square(np.stack(relay.at(x, y)) - truth).sum(axis=0).mean()) / 2
    assert section.facts["degree"] == 3
    assert off_px < 0.02
    assert any("bends" in note for note in section.notes)


def test_a_wrong_pixel_ratio_is_refused(bench_of_truth, dark_known):
    bench = bench_of_truth(magnification=1.05)
    found = refusal(bench, dark_known(bench))
    assert found.reason is Reason.NOT_REGISTERED
    assert "1.905" in str(found)


def test_patterns_that_come_one_place_late_are_refused_as_a_wrong_order(bench_of_truth, dark_known):
    bench = bench_of_truth(shuffle=lambda patterns: np.roll(patterns, 1, axis=0) if len(patterns) > 2 else patterns)
    assert refusal(bench, dark_known(bench)).reason is Reason.WRONG_ORDER


def test_an_inverted_modulator_is_refused(bench_of_truth, dark_known):
    bench = bench_of_truth(invert=True, contrast=8.0)
    assert refusal(bench, dark_known(bench)).reason in {Reason.WRONG_POLARITY, Reason.LOW_CONTRAST}


def test_a_lens_cap_is_refused(bench_of_truth, dark_known):
    bench = bench_of_truth(lit=False)
    assert refusal(bench, dark_known(bench)).reason is Reason.NO_LIGHT


def test_a_light_that_saturates_at_the_shortest_exposure_is_refused(bench_of_truth, dark_known):
    bench = bench_of_truth(electrons_per_s=1e9)
    assert refusal(bench, dark_known(bench)).reason is Reason.SATURATED


def test_registration_needs_dark_frames(bench_of_truth, dark_known):
    bench = bench_of_truth()
    known = replace(dark_known(bench), sections={})
    assert refusal(bench, known).reason is Reason.NEEDS


def test_a_relay_far_out_of_focus_is_refused(bench_of_truth, dark_known):
    bench = bench_of_truth(sigma_px=9.0)
    assert refusal(bench, dark_known(bench)).reason is Reason.NOT_REGISTERED


def test_a_map_that_is_not_known_well_enough_is_refused(bench_of_truth, dark_known, monkeypatch):
    monkeypatch.setattr(registration_step, "ACCURACY_PX", 1e-6)
    bench = bench_of_truth()
    found = refusal(bench, dark_known(bench))
    assert found.reason is Reason.NOT_REGISTERED
    assert "known to" in str(found)


def test_a_map_whose_error_is_no_number_is_refused(bench_of_truth, dark_known, monkeypatch):
    monkeypatch.setattr(registration_step.Registration, "rms_se_px", float("nan"))
    bench = bench_of_truth()
    assert "known to nan px" in str(refusal(bench, dark_known(bench)))


def test_a_modulator_with_little_memory_is_registered_in_several_runs(bench_of_truth, dark_known, monkeypatch):
    bench = bench_of_truth()
    monkeypatch.setattr(type(bench), "capacity", property(lambda self: 9))
    section = measure_registration(bench, dark_known(bench))
    assert section.facts["rms_se_px"] < 0.005
