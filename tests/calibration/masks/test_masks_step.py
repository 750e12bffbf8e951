from dataclasses import replace

import numpy as np
import pytest

from gs2ci_calibration.bundle import Bundle, read_bundle, write_bundle
from gs2ci_calibration.fitting import codes_sha256
from gs2ci_calibration.masks.masks_step import measure_masks
from gs2ci_calibration.masks.registration_step import measure_registration
from gs2ci_calibration.refusals import CalibrationError, Reason


@pytest.fixture(scope="module")
def registered(bench_of_truth, dark_known):
    """Return a good bench's bundle after registration; benches with the same truth share it."""
    bench = bench_of_truth()
    return dark_known(bench).with_section(measure_registration(bench, dark_known(bench)))


def fast(bench):
    return replace(bench, fast=True)


def refusal(bench, known):
    with pytest.raises(CalibrationError) as caught:
        measure_masks(bench, known)
    assert caught.value.step == "masks"
    return caught.value


def error_rms(section, bench):
    return float(np.sqrt(np.mean(np.square(section.array("masks") - bench.world.masks(bench.capture.masks)))))


def swapped(first, second):
    """Show two masks in each other's place, as far as a run shows any."""

    def shuffle(patterns):
        order = list(range(len(patterns)))
        if len(patterns) > 6:
            order[first], order[second] = order[second], order[first]
        return patterns[order]

    return shuffle


def test_more_frames_are_planned_when_the_accuracy_demands_them(bench_of_truth, registered):
    dim = {"electrons_per_dn": 0.5, "full_well_e": 1500.0}
    bench = bench_of_truth(options={"mask_frames": 2}, **dim)
    section = measure_masks(bench, registered)
    assert section.facts["frames"] > 4
    assert section.facts["rms_standard_error"] < 0.0105
    assert error_rms(section, bench) < 0.0105


def test_an_accuracy_out_of_reach_is_refused_with_the_frames_it_would_take(bench_of_truth, registered):
    bench = bench_of_truth(options={"mask_accuracy": 2e-4})
    found = refusal(bench, registered)
    assert found.reason is Reason.TOO_FEW_FRAMES
    assert "frames of each mask would be needed" in str(found)


@pytest.mark.parametrize("way", ["measured", "predicted"])
def test_two_masks_in_each_others_place_are_refused_by_image(bench_of_truth, registered, way):
    bench = bench_of_truth(shuffle=swapped(3, 4))
    found = refusal(bench if way == "measured" else fast(bench), registered)
    assert found.reason is Reason.WRONG_ORDER
    assert "instead of mask 1, mask 2 is shown" in str(found)


def test_masks_that_come_one_place_late_are_refused(bench_of_truth, registered):
    bench = bench_of_truth(shuffle=lambda patterns: np.roll(patterns, 1, axis=0) if len(patterns) > 2 else patterns)
    assert refusal(bench, registered).reason is Reason.WRONG_ORDER


def test_masks_inverted_between_good_references_are_refused(bench_of_truth, registered):
    def invert(patterns):
        plain = patterns.reshape(len(patterns), -1).std(axis=1) == 0
        return np.where(plain[:, None, None], patterns, 1 - patterns)

    assert refusal(bench_of_truth(shuffle=invert), registered).reason is Reason.WRONG_POLARITY


def test_a_modulator_turned_upside_down_since_registration_is_refused(bench_of_truth, registered):
    found = refusal(bench_of_truth(quarter_turns=2), registered)
    assert found.reason is Reason.FLIPPED
    assert "upside down" in str(found)


def test_a_bench_that_moved_since_registration_is_refused_with_the_shift(bench_of_truth, registered):
    found = refusal(bench_of_truth(right_px=3.0, down_px=-2.0), registered)
    assert found.reason is Reason.DOES_NOT_FIT
    assert "3 px to the right and -2 px down" in str(found)


def test_a_relay_that_lost_its_focus_since_is_refused(bench_of_truth, registered):
    found = refusal(bench_of_truth(sigma_px=4.0), registered)
    assert found.reason is Reason.MISPREDICTED


def test_predictions_that_are_too_far_off_are_refused_and_measured_masks_are_not(bench_of_truth, registered):
    bench = bench_of_truth(right_px=0.3)
    assert refusal(fast(bench), registered).reason is Reason.MISPREDICTED
    assert error_rms(measure_masks(bench, registered), bench) < 0.01


def test_a_flickering_lamp_is_refused(bench_of_truth, registered):
    assert refusal(bench_of_truth(flicker=0.05), registered).reason is Reason.LAMP_FLICKERS


def test_a_lamp_that_drifts_away_is_refused_and_one_that_drifts_a_little_is_followed(bench_of_truth, registered):
    assert refusal(bench_of_truth(drift_per_s=-0.5), registered).reason is Reason.LAMP_DRIFTS
    bench = bench_of_truth(drift_per_s=0.05)
    section = measure_masks(bench, registered)
    assert section.facts["lamp_drift"] > 0.02
    assert error_rms(section, bench) < 0.01


def test_a_dead_row_is_refused_by_its_number(bench_of_truth, registered):
    found = refusal(bench_of_truth(dead_rows=(17,)), registered)
    assert found.reason is Reason.DEAD_PIXELS
    assert "rows 17" in str(found)


def test_on_and_off_alike_are_refused(bench_of_truth, registered):
    assert refusal(bench_of_truth(contrast=1.02), registered).reason is Reason.LOW_CONTRAST


def test_masks_need_a_registration_of_the_same_sensor(bench_of_truth, dark_known, registered):
    bench = bench_of_truth()
    assert refusal(bench, dark_known(bench)).reason is Reason.NEEDS
    other = bench_of_truth(size=(64, 50))
    known = dark_known(other).with_section(registered.sections["registration"])
    assert refusal(other, known).reason is Reason.DOES_NOT_FIT


def test_dark_frames_that_are_too_bad_are_refused(bench_of_truth, dark_known, registered):
    bench = bench_of_truth()
    known = dark_known(bench, error_dn=80.0).with_section(registered.sections["registration"])
    found = refusal(bench, known)
    assert found.reason is Reason.TOO_FEW_FRAMES
    assert "dark" in str(found)


def test_grey_masks_are_measured_and_predicted(bench_of_truth, registered):
    bench = bench_of_truth(bit_depth=3)
    levels = np.random.default_rng(5).integers(0, 8, bench.codes.shape).astype(np.uint16)
    bench = replace(bench, codes=levels, capture=replace(bench.capture, masks=bench.lay_out(levels)))
    for one, limit in ((bench, 0.01), (fast(bench), 0.02)):
        section = measure_masks(one, registered)
        truth = bench.world.masks(bench.capture.masks, 7)
        assert np.sqrt(np.mean(np.square(section.array("masks") - truth))) < limit


def test_the_section_survives_the_bundle_and_names_the_codes(bench_of_truth, registered, tmp_path):
    bench = bench_of_truth()
    section = measure_masks(bench, registered)
    write_bundle(tmp_path / "bench.cal.h5", Bundle().with_section(section))
    again = read_bundle(tmp_path / "bench.cal.h5").sections["masks"]
    assert np.array_equal(again.array("masks"), section.array("masks"))
    assert np.array_equal(again.array("patterns_sha256"), codes_sha256(bench.codes))
    assert not np.array_equal(codes_sha256(bench.codes[::-1]), codes_sha256(bench.codes))
    assert again.array("contrast").shape == bench.size
    assert again.facts["mode"] == "measured"


def test_the_same_seed_gives_the_same_masks(bench_of_truth, registered):
    one, two = (measure_masks(bench_of_truth(), registered) for _ in range(2))
    assert np.array_equal(one.array("masks"), two.array("masks"))
