"""A capture that uses a calibration bundle, and one that must not."""

import sys
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import h5py
import numpy as np
import pytest

from gs2ci import cli
from gs2ci.core.storage import read_calibration, read_shot
from gs2ci.rig.calibrated import load
from gs2ci.rig.calibrating import bench_of, operator_of, provenance_of
from gs2ci.rig.opening import load_rig
from gs2ci.rig.truth import truth_of
from gs2ci_calibration.bundle import Bundle, read_bundle, write_bundle
from gs2ci_calibration.drift import changes_since
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.fitting import codes_sha256
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


@pytest.fixture
def rig_file(tmp_path, monkeypatch):
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    monkeypatch.chdir(tmp_path)
    return path


def masks_section(bench, truth):
    """Return the section `masks` that a perfect calibration would write."""
    shut = bench.flat_pattern(is_open=False)[None]
    unshut = bench.flat_pattern(is_open=True)[None]
    masks, (off,), (on,) = (truth.masks(patterns) for patterns in (bench.capture.masks, shut, unshut))
    return Section(
        "masks",
        {
            "masks": Estimate((masks / on).astype(np.float32), np.float32(0.001), "1"),
            "contrast": Estimate(off / on, np.float32(0.001), "1"),
            "weights": Estimate(np.ones(len(masks)), 1e-4, "1"),
        },
        arrays={"patterns_sha256": codes_sha256(bench.codes)},
        facts={"mask_s": bench.capture.mask_s},
    )


def calibrate(rig_file, out, *steps):
    rig = load_rig(rig_file)
    devices = rig.open()
    try:
        bench = bench_of(rig, devices, operator_of(rig, print))
        bundle = Bundle(provenance_of(rig, devices))
        for step in steps:
            bundle = bundle.with_section(PROCEDURES[step](bench, bundle))
        bundle = bundle.with_section(masks_section(bench, truth_of(rig.bench, 12)))
        write_bundle(out, bundle)
    finally:
        devices.close()
    return read_bundle(out)


def loaded(rig_file, bundle, **options):
    rig = load_rig(rig_file)
    devices = rig.open()
    try:
        return load(rig, devices, bundle, **options)
    finally:
        devices.close()


def gs2ci(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["gs2ci", *map(str, arguments)])
    return cli.main()


def test_a_rig_without_a_bundle_takes_nominal_masks(rig_file):
    assert loaded(rig_file, None) is None


def test_capture_writes_calibrated_masks_and_per_pixel_dark_and_flat(rig_file, tmp_path, monkeypatch, capsys):
    bundle = calibrate(rig_file, tmp_path / "bench.cal.h5", "dark-flat", "sensor")
    rig_file.write_text(RIG.replace("[calibration]", '[calibration]\nbundle = "bench.cal.h5"'))
    assert gs2ci(monkeypatch, "capture", "--rig", rig_file, "-o", "shot.h5") == 0
    assert "masks from" in capsys.readouterr().out
    shot, kept = read_shot(tmp_path / "shot.h5"), read_calibration(tmp_path / "shot.h5")
    masks = bundle.sections["masks"].array("masks")
    assert shot.masks == pytest.approx(masks, abs=1e-6)
    assert kept["calib/flat"] == pytest.approx(bundle.sections["dark-flat"].array("response"))
    with h5py.File("shot.h5") as file:
        assert any(b'"calibration"' in event for event in file["events"])
        reading = file["meas"][0].astype(float)
    corrected = (reading - kept["calib/dark"]) / (740.0 * kept["calib/flat"])
    assert shot.measurement[..., 0] == pytest.approx(corrected, rel=1e-5)
    assert shot.saturated is not None


def test_calibrated_pixels_explain_the_measurement_better_than_nominal_ones(rig_file, tmp_path, monkeypatch):
    calibrate(rig_file, tmp_path / "bench.cal.h5", "dark-flat")
    residuals = {}
    for name, options in (("nominal", ()), ("calibrated", ("--calibration", "bench.cal.h5"))):
        assert gs2ci(monkeypatch, "capture", "--rig", rig_file, "-o", f"{name}.h5", *options) == 0
        shot = read_shot(tmp_path / f"{name}.h5")
        coded = (shot.weights[:, None, None, None] * shot.masks[..., None] * shot.truth.views).sum(axis=0)
        scale = (shot.measurement * coded).sum() / np.square(coded).sum()
        residuals[name] = np.sqrt(np.square(shot.measurement - scale * coded).mean()) / coded.std()
    assert residuals["calibrated"] < 0.25 * residuals["nominal"]


def test_a_modulator_that_moved_since_is_noticed_by_the_probe(rig_file, tmp_path):
    bundle = tmp_path / "bench.cal.h5"
    calibrate(rig_file, bundle)
    seen = loaded(rig_file, bundle).probe
    assert seen.difference < 0.02
    assert np.abs(seen.shift_px).max() < 0.05
    rig_file.write_text(RIG.replace("right_px = 0.3", "right_px = 0.55"))
    with pytest.raises(CalibrationError, match=r"moved by \+0\.[12]") as refused:
        loaded(rig_file, bundle)
    assert refused.value.reason is Reason.DOES_NOT_FIT
    assert loaded(rig_file, bundle, probe=False).probe is None


def test_check_tells_where_the_modulators_picture_has_gone(rig_file, tmp_path):
    bundle = calibrate(rig_file, tmp_path / "bench.cal.h5", "dark-flat")

    def changes():
        rig = load_rig(rig_file)
        devices = rig.open()
        try:
            return {one.what: one for one in changes_since(bench_of(rig, devices, operator_of(rig, print)), bundle)}
        finally:
            devices.close()

    found = changes()
    assert {"one mask, rms over pixels", "modulator moved right", "modulator moved down"} <= set(found)
    assert not any(one.too_far for one in found.values())
    rig_file.write_text(RIG.replace("down_px = -0.2", "down_px = 0.2"))
    found = changes()
    assert found["modulator moved down"].too_far
    assert found["modulator moved down"].step == "registration"
    assert found["one mask, rms over pixels"].too_far
    assert not found["modulator moved right"].too_far


def test_an_inverted_modulator_and_another_mask_are_told_apart(rig_file, tmp_path):
    bundle = tmp_path / "bench.cal.h5"
    section = calibrate(rig_file, bundle).sections["masks"]
    masks, leakage = section.array("masks"), section.array("contrast")

    def rewrite(changed):
        estimates = {**section.estimates, "masks": Estimate(changed, np.float32(0.001), "1")}
        write_bundle(bundle, replace(read_bundle(bundle).with_section(replace(section, estimates=estimates))))

    rewrite(masks[[1, 0, 2]])
    with pytest.raises(CalibrationError, match="what should be mask 0 resembles mask 1") as refused:
        loaded(rig_file, bundle)
    assert refused.value.reason is Reason.WRONG_ORDER
    rewrite(1 + leakage - masks)
    with pytest.raises(CalibrationError, match="appears inverted") as refused:
        loaded(rig_file, bundle)
    assert refused.value.reason is Reason.WRONG_POLARITY


def test_the_probe_wants_light(rig_file, tmp_path):
    bundle = tmp_path / "bench.cal.h5"
    calibrate(rig_file, bundle)
    rig_file.write_text(RIG.replace("[optics]", "[optics]\nfull_scale_e_per_s = 200.0"))
    with pytest.raises(CalibrationError, match="--no-probe"):
        loaded(rig_file, bundle)


@pytest.mark.parametrize(
    ("before", "after", "sentence"),
    [
        ("density = 0.4", "density = 0.5", "of other patterns"),
        ("masks = 3", "masks = 4", "its masks are"),
        ("mask_s = 0.02", "mask_s = 0.03", "on show for 20 ms"),
        ('format = "Y12"', 'format = "Y10"', "readings end at 4095 DN"),
        ("black_level_dn = 64.0", "black_level_dn = 64.0\ngain_db = 3.0", "at a gain of None dB"),
        ('kind = "scpi"', 'kind = "dlpc900"', "its modulator is"),
    ],
)
def test_a_bundle_of_another_set_up_is_refused(rig_file, tmp_path, before, after, sentence):
    bundle = tmp_path / "bench.cal.h5"
    calibrate(rig_file, bundle, *(["dark-flat"] if "readings" in sentence or "gain" in sentence else []))
    rig_file.write_text(RIG.replace(before, after))
    with pytest.raises(CalibrationError, match=sentence) as refused:
        loaded(rig_file, bundle, probe=False)
    assert refused.value.reason is Reason.DOES_NOT_FIT


def test_a_bundle_that_is_too_old_or_undated_is_refused(rig_file, tmp_path):
    path = tmp_path / "bench.cal.h5"
    bundle = calibrate(rig_file, path)
    for measured, sentence in (
        ((datetime.now(UTC) - timedelta(days=40)).isoformat(), "40 days old, allowed are 30"),
        ("yesterday", "has no date"),
    ):
        write_bundle(path, bundle.with_section(replace(bundle.sections["masks"], measured_utc=measured)))
        with pytest.raises(CalibrationError, match=sentence):
            loaded(rig_file, path, probe=False)


def test_a_bundle_without_masks_cannot_be_captured_with(rig_file, tmp_path):
    path = tmp_path / "bench.cal.h5"
    bundle = calibrate(rig_file, path)
    write_bundle(path, replace(bundle, sections={}))
    with pytest.raises(CalibrationError, match="run `gs2ci calibrate masks` first"):
        loaded(rig_file, path)


def test_a_changed_rig_file_is_told_and_not_refused(rig_file, tmp_path):
    path = tmp_path / "bench.cal.h5"
    calibrate(rig_file, path)
    rig_file.write_text(RIG + "\n# a comment\n")
    assert loaded(rig_file, path, probe=False).notes == ("the rig file has changed since the calibration",)
