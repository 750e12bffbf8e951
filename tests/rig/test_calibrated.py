"""A capture that uses a calibration bundle, and one that must not."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from gs2ci.core.storage import read_shot
from gs2ci.rig.calibrated import Calibrated
from gs2ci.rig.calibrating import bench_of, operator_of
from gs2ci_calibration import fitting
from gs2ci_calibration.bundle import Bundle, read_bundle, write_bundle
from gs2ci_calibration.drift import changes_since
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.fitting import needed
from gs2ci_calibration.procedures import PROCEDURES
from gs2ci_calibration.refusals import CalibrationError, Reason

RIG = """
name = "tiny"
[modulator]
kind = "scpi"
[sensor]
kind = "v4l2"
height = 32
width = 48
format = "Y12"
black_level_dn = 64.0
[capture]
masks = 3
mask_s = 0.02
density = 0.4
shots = 1
[calibration]
frames = 8
[optics]
full_scale_dn = 740.0
[world]
scene = "planes"
height = 32
width = 48
[world.effects.dsnu]
sigma_e = 20.0
[world.effects.prnu]
spread = 0.05
[world.effects.finite_contrast]
contrast = 50.0
[world.effects.misregistration]
right_px = 0.3
down_px = -0.2
"""


def test_a_rig_without_a_bundle_takes_nominal_masks(loaded):
    assert loaded(None) is None


def test_capture_writes_calibrated_masks_and_per_pixel_dark_and_flat(rig, tmp_path, capsys, calibrate, gs2ci):
    bundle = calibrate(tmp_path / "bench.cal.h5", "dark-flat", "sensor")
    rig.write_text(RIG.replace("[calibration]", '[calibration]\nbundle = "bench.cal.h5"'))
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5") == 0
    assert "masks from" in capsys.readouterr().out
    shot = read_shot(tmp_path / "shot.h5")
    masks = bundle.sections["masks"].array("masks")
    assert shot.masks == pytest.approx(masks, abs=1e-6)
    with h5py.File("shot.h5") as file:
        kept = {name: file[name][()] for name in ("calib/dark", "calib/flat")}
        assert any(b'"calibration"' in event for event in file["events"])
        reading = file["meas"][0].astype(float)
    assert kept["calib/flat"] == pytest.approx(bundle.sections["dark-flat"].array("response"))
    corrected = (reading - kept["calib/dark"]) / (740.0 * kept["calib/flat"])
    assert shot.measurement[..., 0] == pytest.approx(corrected, rel=1e-5)
    assert shot.saturated is not None


@pytest.mark.parametrize("dsnu_dn", [0.0, 3.0, 12.0])
def test_full_pixels_are_told_whatever_their_own_offsets(dsnu_dn):
    sensor = {
        "saturation_dn": Estimate(4027.0, 0.1, "DN"),
        "read_noise_e": Estimate(2.9, 0.01, "e"),
        "gain_e_per_dn": Estimate(2.7, 0.01, "e/DN"),
    }
    bundle = Bundle().with_section(Section("sensor", sensor))
    if dsnu_dn:
        bundle = bundle.with_section(Section("dark-flat", {"dsnu_dn": Estimate(dsnu_dn, 0.1, "DN")}))
    limit = Calibrated(bundle, ()).saturation_dn
    rng = np.random.default_rng(1)
    full = 4027.0 + dsnu_dn * rng.standard_normal(200_000) + 2.9 / 2.7 * rng.standard_normal(200_000)
    assert np.mean(full >= limit) > 0.9998
    assert limit > 4027.0 - 5 * np.hypot(dsnu_dn, 2.9 / 2.7)


LENS = np.array([-0.15, 0.02, 1e-3, -1e-3, 0.0])


def test_capture_writes_the_lens_that_was_measured_with_its_camera_matrix(rig, tmp_path, calibrate, gs2ci):
    path = tmp_path / "bench.cal.h5"
    bundle = calibrate(path)
    matrix = np.array([[40.0, 0, 24.5], [0, 41, 15.5], [0, 0, 1]])
    estimates = {"intrinsics": Estimate(matrix, np.zeros((3, 3)), "px"), "distortion": Estimate(LENS, 0.01, "1")}
    write_bundle(path, bundle.with_section(Section("camera", estimates)))
    rig.write_text(RIG.replace("[calibration]", '[calibration]\nbundle = "bench.cal.h5"'))
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5") == 0
    shot = read_shot(tmp_path / "shot.h5")
    assert np.array_equal(shot.intrinsics, matrix)
    assert np.array_equal(shot.distortion, LENS)


def test_a_simulated_bench_without_a_bundle_tells_its_own_lens(rig, tmp_path, gs2ci):
    rig.write_text(RIG + "[world.effects.lens_distortion]\nk1 = -0.1\n")
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5") == 0
    assert read_shot(tmp_path / "shot.h5").distortion.tolist() == [-0.1, 0, 0, 0, 0]
    rig.write_text(RIG)
    assert gs2ci("capture", "--rig", rig, "-o", "straight.h5") == 0
    assert read_shot(tmp_path / "straight.h5").distortion is None


def test_calibrated_pixels_explain_the_measurement_better_than_nominal_ones(rig, tmp_path, calibrate, gs2ci):
    calibrate(tmp_path / "bench.cal.h5", "dark-flat")
    residuals = {}
    for name, options in (("nominal", ()), ("calibrated", ("--calibration", "bench.cal.h5"))):
        assert gs2ci("capture", "--rig", rig, "-o", f"{name}.h5", *options) == 0
        shot = read_shot(tmp_path / f"{name}.h5")
        coded = (shot.weights[:, None, None, None] * shot.masks[..., None] * shot.truth.views).sum(axis=0)
        scale = (shot.measurement * coded).sum() / np.square(coded).sum()
        residuals[name] = np.sqrt(np.square(shot.measurement - scale * coded).mean()) / coded.std()
    assert residuals["calibrated"] < 0.25 * residuals["nominal"]


def test_a_modulator_that_moved_since_is_noticed_by_the_probe(rig, tmp_path, calibrate, loaded):
    bundle = tmp_path / "bench.cal.h5"
    calibrate(bundle)
    seen = loaded(bundle).probe
    assert seen.difference < 0.02
    assert np.abs(seen.shift_px).max() < 0.05
    rig.write_text(RIG.replace("right_px = 0.3", "right_px = 0.55"))
    with pytest.raises(CalibrationError, match=r"moved by \+0\.2[2-8] ") as refused:
        loaded(bundle)
    assert refused.value.reason is Reason.DOES_NOT_FIT
    assert "gs2ci calibrate update" in str(refused.value)
    assert loaded(bundle, probe=False).probe is None


def test_a_modulator_that_moved_is_noticed_though_the_first_mask_is_open_everywhere(rig, tmp_path, calibrate, loaded):
    """As the first of Hadamard's masks: it shows neither the place nor the polarity of the others."""
    codes = np.random.default_rng(0).random((3, 32, 48)) < 0.4
    codes[0] = True
    np.save(tmp_path / "codes.npy", codes)
    mine = RIG.replace("[capture]", '[capture]\npattern_file = "codes.npy"')
    rig.write_text(mine)
    bundle = tmp_path / "bench.cal.h5"
    calibrate(bundle)
    assert loaded(bundle).probe.mask == 1
    rig.write_text(mine.replace("right_px = 0.3", "right_px = 0.55"))
    with pytest.raises(CalibrationError, match=r"mask 1 differs .* moved by \+0\.2[3-7] "):
        loaded(bundle)


def test_check_tells_where_the_modulators_picture_has_gone(rig, tmp_path, calibrate, connected):
    bundle = calibrate(tmp_path / "bench.cal.h5", "dark-flat")

    def changes():
        with connected() as (opened, devices):
            bench = bench_of(opened, devices, operator_of(opened, print))
            return {one.what: one for one in changes_since(bench, bundle)}

    found = changes()
    assert {"one mask, rms over pixels", "modulator moved right", "modulator moved down"} <= set(found)
    assert not any(one.too_far for one in found.values())
    rig.write_text(RIG.replace("down_px = -0.2", "down_px = 0.2"))
    found = changes()
    assert found["modulator moved down"].too_far
    assert found["modulator moved down"].value == pytest.approx(0.4, abs=0.06)
    assert found["modulator moved down"].step == "registration"
    assert found["one mask, rms over pixels"].too_far
    assert not found["modulator moved right"].too_far


def test_an_inverted_modulator_and_another_mask_are_told_apart(tmp_path, calibrate, loaded):
    bundle = tmp_path / "bench.cal.h5"
    section = calibrate(bundle).sections["masks"]
    masks, leakage = section.array("masks"), section.array("contrast")

    def rewrite(changed):
        estimates = {**section.estimates, "masks": Estimate(changed, np.float32(0.001), "1")}
        write_bundle(bundle, replace(read_bundle(bundle).with_section(replace(section, estimates=estimates))))

    rewrite(masks[[1, 0, 2]])
    with pytest.raises(CalibrationError, match="the picture of mask 0 resembles mask 1") as refused:
        loaded(bundle)
    assert refused.value.reason is Reason.WRONG_ORDER
    rewrite(1 + leakage - masks)
    with pytest.raises(CalibrationError, match="appears inverted") as refused:
        loaded(bundle)
    assert refused.value.reason is Reason.WRONG_POLARITY


@pytest.mark.parametrize("turned", ["quarter_turns = 2", "mirrored = true"])
def test_a_turned_modulator_is_not_said_to_show_another_mask(rig, tmp_path, calibrate, loaded, turned):
    bundle = tmp_path / "bench.cal.h5"
    calibrate(bundle)
    rig.write_text(RIG.replace("[world]", f"[world]\n{turned}"))
    with pytest.raises(
        CalibrationError, match=r"mask 0 resembles none of the bundle's masks, .*turned, mirrored"
    ) as refused:
        loaded(bundle)
    assert refused.value.reason is Reason.DOES_NOT_FIT


def test_a_capture_without_the_probe_says_that_its_masks_are_turned(rig, tmp_path, calibrate, gs2ci, capsys):
    calibrate(tmp_path / "bench.cal.h5")
    rig.write_text(RIG.replace("[world]", "[world]\nquarter_turns = 2"))
    command = ("capture", "--rig", rig, "--calibration", "bench.cal.h5", "--no-probe")
    assert gs2ci(*command, "-o", "shot.h5") == 0
    out = capsys.readouterr().out
    assert "WARNING: shot 1: compared with the bundle, the masks are turned by 180 degrees" in out
    assert "masks within" not in out


def test_the_probe_wants_light(rig, tmp_path, calibrate, loaded):
    bundle = tmp_path / "bench.cal.h5"
    calibrate(bundle)
    rig.write_text(RIG.replace("[optics]", "[optics]\nfull_scale_e_per_s = 200.0"))
    with pytest.raises(CalibrationError, match="--no-probe"):
        loaded(bundle)


@pytest.mark.parametrize(
    ("before", "after", "sentence"),
    [
        ("density = 0.4", "density = 0.5", "of other patterns"),
        ("masks = 3", "masks = 4", "its masks are"),
        ("mask_s = 0.02", "mask_s = 0.03", "are shown for 20 ms"),
        ('format = "Y12"', 'format = "Y10"', "readings end at 4095 DN"),
        ("black_level_dn = 64.0", "black_level_dn = 64.0\ngain_db = 3.0", "at a gain of None dB"),
        ('kind = "scpi"', 'kind = "dlpc900"', "its modulator is"),
    ],
)
def test_a_bundle_of_another_set_up_is_refused(rig, tmp_path, before, after, sentence, calibrate, loaded):
    bundle = tmp_path / "bench.cal.h5"
    calibrate(bundle, *(["dark-flat"] if "readings" in sentence or "gain" in sentence else []))
    rig.write_text(RIG.replace(before, after))
    with pytest.raises(CalibrationError, match=sentence) as refused:
        loaded(bundle, probe=False)
    assert refused.value.reason is Reason.DOES_NOT_FIT


@pytest.mark.parametrize(("margin_s", "weights"), [(0.008, None), (0.0, [1, 0.9, 0.8])])
def test_weights_that_were_measured_with_other_times_give_way_to_the_plan(
    rig, tmp_path, margin_s, weights, calibrate, loaded
):
    path = tmp_path / "bench.cal.h5"
    masks = calibrate(path).sections["masks"]
    measured = {**masks.estimates, "weights": Estimate(np.array([1, 0.9, 0.8]), np.full(3, 0.01), "1")}
    facts = {**masks.facts, "weights": "measured", "dark_s": 0.0, "margin_s": 0.0}
    write_bundle(path, read_bundle(path).with_section(replace(masks, estimates=measured, facts=facts)))
    rig.write_text(RIG.replace("mask_s = 0.02", f"mask_s = 0.02\nmargin_s = {margin_s}"))
    found = loaded(path, probe=False)
    assert found.weights == pytest.approx(weights) if weights else found.weights is None
    assert any("those planned are used" in note for note in found.notes) == (weights is None)


@pytest.mark.parametrize(
    ("name", "facts", "sentence"),
    [
        ("camera", {"height": 64, "width": 48}, "its section camera is of 64 x 48 pixels, the capture of 32 x 48"),
        (
            "camera",
            {"region": [8, None]},
            "camera is of the region at row 8, column in the middle, the capture",
        ),
        ("masks", {"region": [None, 4]}, "masks is of the region at row in the middle, column 4, the capture at"),
        ("registration", {"size": [32, 64]}, "its section registration is of 32 x 64 pixels"),
        ("sensor", {"gain_db": 6.0}, "its section sensor was taken at a gain of 6.0 dB, not None"),
        ("sensor", {"top_dn": 1023}, "its section sensor: readings end at 1023 DN, those of the capture at 4095"),
    ],
)
def test_every_section_must_be_of_the_sensor_as_it_is_set_up(tmp_path, name, facts, sentence, calibrate, loaded):
    path = tmp_path / "bench.cal.h5"
    bundle = calibrate(path)
    section = bundle.sections.get(name, Section(name, {}))
    write_bundle(path, bundle.with_section(replace(section, facts=section.facts)))
    assert loaded(path, probe=False).notes == ()
    write_bundle(path, bundle.with_section(replace(section, facts={**section.facts, **facts})))
    with pytest.raises(CalibrationError, match=sentence) as refused:
        loaded(path, probe=False)
    assert refused.value.reason is Reason.DOES_NOT_FIT


def test_steps_refuse_sections_measured_with_the_sensor_set_up_otherwise(rig, tmp_path, calibrate, connected):
    bundle = calibrate(tmp_path / "bench.cal.h5", "dark-flat")
    camera = Section("camera", {}, facts={"height": 32, "width": 48})
    for after, sentence in (
        ("height = 30", "its section dark-flat is of 32 x 48 pixels, the capture of 30 x 48"),
        ("height = 32\ngain_db = 6.0", "its section dark-flat was taken at a gain of None dB, not 6.0"),
    ):
        rig.write_text(RIG.replace("height = 32", after, 1))
        with connected() as (opened, devices):
            bench = bench_of(opened, devices, operator_of(opened, print))
            for step in ("sensor", "timing", "registration"):
                with pytest.raises(CalibrationError, match=sentence) as refused:
                    PROCEDURES[step](bench, bundle)
                assert refused.value.reason is Reason.DOES_NOT_FIT
            if bench.size == (32, 48):  # the camera depends on the region, not on the gain
                assert needed(bundle.with_section(camera), "camera", bench, "stage") is camera
            else:
                with pytest.raises(CalibrationError, match="its section camera is of 32 x 48 pixels"):
                    needed(bundle.with_section(camera), "camera", bench, "stage")


def test_a_bundle_that_is_too_old_or_undated_is_refused(tmp_path, calibrate, loaded):
    path = tmp_path / "bench.cal.h5"
    bundle = calibrate(path)
    for measured, sentence in (
        ((datetime.now(UTC) - timedelta(days=40)).isoformat(), "40 days old, allowed are 30"),
        ("yesterday", "has no date"),
    ):
        write_bundle(path, bundle.with_section(replace(bundle.sections["masks"], measured_utc=measured)))
        with pytest.raises(CalibrationError, match=sentence):
            loaded(path, probe=False)


def test_a_bundle_without_masks_cannot_be_captured_with(tmp_path, calibrate, loaded):
    path = tmp_path / "bench.cal.h5"
    bundle = calibrate(path)
    write_bundle(path, replace(bundle, sections={}))
    with pytest.raises(CalibrationError, match="run `gs2ci calibrate masks` first"):
        loaded(path)


def test_a_changed_rig_file_is_told_and_not_refused(rig, tmp_path, calibrate, loaded):
    path = tmp_path / "bench.cal.h5"
    calibrate(path)
    rig.write_text(RIG.replace('name = "', 'name = "another '))
    assert loaded(path, probe=False).notes == ("the rig file has changed since the calibration",)


def test_a_comment_and_the_name_of_the_bundle_change_nothing_in_a_rig(rig, tmp_path, calibrate, loaded):
    path = tmp_path / "bench.cal.h5"
    calibrate(path)
    rig.write_text(RIG.replace("[calibration]", '# of today\n[calibration]\nbundle = "bench.cal.h5"'))
    assert loaded(path, probe=False).notes == ()


def test_a_rig_file_of_another_time_that_is_no_toml_has_changed(tmp_path, calibrate, loaded):
    path = tmp_path / "bench.cal.h5"
    bundle = calibrate(path)
    other = {name: replace(section, rig="= [") for name, section in bundle.sections.items()}
    write_bundle(path, replace(bundle, sections=other))
    assert loaded(path, probe=False).notes == ("the rig file has changed since the calibration",)


def test_a_change_since_some_of_the_steps_is_told_after_the_others_were_measured_again(tmp_path, calibrate, loaded):
    path = tmp_path / "bench.cal.h5"
    bundle = calibrate(path, "dark-flat")
    dark = replace(bundle.sections["dark-flat"], rig="name = 'before'")
    write_bundle(path, bundle.with_section(dark))
    assert loaded(path, probe=False).notes == ("the rig file has changed since the measurement of dark-flat",)


def test_a_rig_file_that_several_sections_share_is_parsed_once(tmp_path, calibrate, loaded, monkeypatch):
    path = tmp_path / "bench.cal.h5"
    calibrate(path)
    assert len(calibrate(path, "dark-flat").sections) > 1
    parsed, parse = [], fitting.tomllib.loads
    monkeypatch.setattr(fitting, "tomllib", SimpleNamespace(**vars(fitting.tomllib)))
    monkeypatch.setattr(fitting.tomllib, "loads", lambda text: parsed.append(text) or parse(text))
    assert loaded(path, probe=False).notes == ()
    assert len(parsed) == 1


def test_another_temperature_than_that_of_the_dark_frames_is_told(rig, tmp_path, calibrate, loaded):
    path = tmp_path / "bench.cal.h5"
    bundle = calibrate(path, "dark-flat")
    rig.write_text(RIG.replace("[calibration]", "[calibration]\ntemperature_c = 31.0"))
    provenance = replace(bundle.provenance, temperature_c=31.0)  # as after a later step
    for celsius, told in ((20.0, True), (28.0, False), (None, False)):
        dark = replace(bundle.sections["dark-flat"], temperature_c=celsius)
        write_bundle(path, replace(bundle.with_section(dark), provenance=provenance))
        (changed, *more) = loaded(path, probe=False).notes
        assert "the rig file has changed" in changed
        assert bool(more) == told
        assert not told or "the sensor was at 20 °C and is at 31 °C" in more[0]
