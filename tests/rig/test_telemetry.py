"""Poses from what the stage reports: by the calibration where it measured the axes, else as the rig file says."""

import numpy as np
import pytest

import gs2ci
from gs2ci.core.storage import read_shot
from gs2ci.core.summed import in_one_frame
from gs2ci.rig.calibrated import Calibrated
from gs2ci.rig.config import RigTable
from gs2ci.rig.telemetry import carriage_of
from gs2ci_calibration.bundle import Bundle, read_bundle, write_bundle
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.geometry import stage as steps
from gs2ci_drivers.plan import Travel

pytestmark = pytest.mark.slow

# The rig file takes the x axis for square to the camera's; it truly runs 5 degrees off, 2 % too far and 0.5 % too fast.
TRUE_X = (0.996195, 0.070000, 0.052000)
RIG = f"""
[modulator]
kind = "dlpc900"
trigger_out_2_bit = "disables"
[sensor]
kind = "v4l2"
height = 160
width = 200
format = "Y12"
black_level_dn = 64.0
[stage]
kind = "zaber"
[stage.mount]
[capture]
masks = 3
mask_s = 0.04
axis = "x"
from_mm = 74.0
to_mm = 76.0
[calibration]
board_views = 7
[optics]
full_scale_e_per_s = 200000.0
[world]
scene = "planes"
height = 160
width = 200
scene_units_per_mm = 0.02
[world.mount]
x = [{TRUE_X[0]}, {TRUE_X[1]}, {TRUE_X[2]}]
[world.mechanics.x]
scale = 1.02
speed_error = 0.005
backlash_mm = 0.1
"""
LATE_S, LONGER_S = 1e-3, 2e-4
LATE = RIG.replace(
    "[world.mount]",
    f"camera_readout_s = 2e-4\ntrigger_latency_s = {LATE_S}\ntrigger_exposure_offset_s = {LONGER_S}\n[world.mount]",
)
BACKWARDS = LATE.replace("from_mm = 74.0\nto_mm = 76.0", "from_mm = 76.0\nto_mm = 74.0")
TRAVEL = Travel("x", 10.0, 14.0)


def path_of(poses):
    """How far the camera came with each mask, in its own frame, [N − 1, 3]; the shot only says it up to a shift."""
    return -(poses[1:, :3, 3] - poses[:1, :3, 3])


def timed(bundle):
    """Add what the step `timing` would measure to a bundle."""
    estimates = {"latency_s": Estimate(LATE_S, 2e-6, "s"), "exposure_offset_s": Estimate(LONGER_S, 2e-6, "s")}
    write_bundle(bundle, read_bundle(bundle).with_section(Section("timing", estimates)))


def ahead_mm(shot):
    """How far the poses are ahead of the true ones along the axis, mm, the mean over the masks; up to a constant."""
    found, true = (poses[:, :3, 3] for poses in (shot.telemetry_world_to_camera, shot.truth.world_to_camera))
    return float(((true - found) @ np.array(TRUE_X)).mean()) / 0.02


def test_a_captures_telemetry_is_as_true_as_the_calibration_of_the_stage(rig, tmp_path, calibrate, gs2ci, monkeypatch):
    monkeypatch.setattr(steps, "TARGETS", 4)
    monkeypatch.setattr(steps, "SWEEP_PICTURES", 6)
    # Whether the masks were where the bundle has them takes long, and tests/commands/test_calibrate_update.py asks it.
    monkeypatch.setattr("gs2ci.commands.capture._say_where_masks_were", lambda *_: None)
    section = calibrate(tmp_path / "bench.cal.h5", "camera", "stage").sections["stage"]
    timed(tmp_path / "bench.cal.h5")
    rig.write_text(LATE)
    errors, shots = {}, {}
    for name, options in (("nominal", ()), ("calibrated", ("--calibration", "bench.cal.h5"))):
        assert gs2ci("capture", "--rig", rig, "-o", f"{name}.h5", *options) == 0
        shots[name] = read_shot(tmp_path / f"{name}.h5")
        found, true = (
            path_of(poses) for poses in (shots[name].telemetry_world_to_camera, shots[name].truth.world_to_camera)
        )
        errors[name] = float(np.linalg.norm(found[-1] - true[-1]) / np.linalg.norm(true[-1]))
    # Of the way gone: direction (both components), scale and speed as the bundle states them.
    stated = np.linalg.norm(
        [
            *np.broadcast_to(section.estimates["direction_x"].standard_error, 3),
            section.estimates["scale_x"].error,
            section.estimates["velocity_error_x"].error,
        ]
    )
    assert errors["calibrated"] < 2 * stated < 0.004
    assert errors["nominal"] > 0.08
    assert shots["nominal"].provenance["telemetry"]["axes_from"] == "[stage.mount]"
    told = shots["calibrated"].provenance["telemetry"]
    assert told["axes_from"] == "calibration"
    assert told["measured_utc"] == section.measured_utc
    assert told["scale_x"] == pytest.approx(1.02, rel=1e-3)

    # Forwards and backwards, what is behind the counted position lies to either side of it.
    rig.write_text(BACKWARDS)
    for name, options in (("nominal", ()), ("calibrated", ("--calibration", "bench.cal.h5"))):
        assert gs2ci("capture", "--rig", rig, "-o", f"{name}-back.h5", *options) == 0
    apart_mm = {
        name: abs(ahead_mm(shots[name]) - ahead_mm(read_shot(tmp_path / f"{name}-back.h5"))) / 2 for name in shots
    }
    assert apart_mm["calibrated"] < told["ahead_error_mm"] < 0.02
    assert apart_mm["nominal"] > 0.02


def table(stage=None, **world):
    """A rig whose poses are in mm, with a stage or without."""
    tables = {"modulator": {"kind": "scpi"}, "sensor": {"kind": "v4l2", "height": 32, "width": 48}}
    tables |= {"world": {"height": 32, "width": 48, "scene_units_per_mm": 1.0, **world}}
    return RigTable.model_validate(tables | ({"stage": {"kind": "zaber", **stage}} if stage is not None else {}))


def measured(axis="x", direction=(0.6, 0.8, 0.0), scale=1.5, **more):
    """A bundle that measured one axis."""
    estimates = {
        f"direction_{axis}": Estimate(np.array(direction), np.full(3, 1e-4), "1"),
        f"scale_{axis}": Estimate(scale, 1e-4, "mm/mm"),
        **{f"{name}_{axis}": Estimate(value, 1e-4, "1") for name, value in more.items()},
    }
    return Calibrated(Bundle().with_section(Section("stage", estimates)), ())


def test_the_pose_is_the_identity_in_the_middle_of_the_travel():
    carriage = carriage_of(table({"mount": {}}), TRAVEL, None)
    poses = carriage.world_to_camera(np.array([[10.0], [12.0], [14.0]]), ("x",))
    assert poses[1] == pytest.approx(np.eye(4))
    assert poses[:, :3, 3] == pytest.approx(np.array([[2.0, 0, 0], [0, 0, 0], [-2.0, 0, 0]]))


def test_captures_say_where_the_stage_had_the_camera_in_the_middle_of_their_travel():
    real = carriage_of(table({"mount": {}, "port": "/dev/ttyUSB0"}), TRAVEL, measured("y", (0.0, 1.0, 0.0), 2.0))
    assert real.origin(np.array([[10.0, 3.0], [14.0, 3.0]]), ("x", "y")) == pytest.approx([12.0, 6.0, 0.0])
    # An axis whose direction nobody stated.
    assert real.origin(np.array([[10.0, 3.0]]), ("x", "focus")) == pytest.approx([12.0, 0.0, 0.0])


def test_a_simulated_scene_stands_before_the_middle_of_each_travel_unless_its_place_is_stated():
    stage = np.array([[10.0, 3.0]])
    around_each = carriage_of(table({"mount": {}}, scene_units_per_mm=0.1), TRAVEL, None)
    assert around_each.origin(stage, ("x", "y")) == pytest.approx([0.0, 0.0, 0.0])
    stated = carriage_of(table({"mount": {}}, scene_units_per_mm=0.1, rest_mm=9.0), TRAVEL, None)
    assert stated.origin(stage, ("x", "y")) == pytest.approx([0.3, 0.0, 0.0])


def test_captures_along_neighbouring_travels_lie_where_they_were(tmp_path):
    shots = []
    for from_mm in (74.0, 77.0):
        rig = tmp_path / f"{from_mm:.0f}.toml"
        text = RIG[: RIG.index("[world.mount]")].replace("160", "24").replace("200\n", "32\n")
        text = text.replace("[stage.mount]", "[stage.mount]\nz = [0.0, 0.0, 1.0]").replace(
            "[world]", "[world]\nrest_mm = 75.0"
        )
        rig.write_text(text.replace("74.0", f"{from_mm}").replace("76.0", f"{from_mm + 2}"))
        with gs2ci.open_rig(rig) as opened:
            shots.append(read_shot(opened.record(tmp_path / f"{from_mm:.0f}.h5")))
    assert [one.provenance["telemetry"]["origin"] for one in shots] == [[0.0, 0.0, 0.0], [0.06, 0.0, 0.0]]
    found, true = (
        np.stack([one[:, 0, 3] for one in poses])
        for poses in (
            [one.telemetry_world_to_camera for one in in_one_frame(shots)],
            [one.truth.world_to_camera for one in shots],
        )
    )
    assert found == pytest.approx(true - true[0].mean() + found[0].mean(), abs=2e-3)


def test_a_real_stage_is_in_millimetres_whatever_the_world_that_its_rig_was_tried_in():
    carriage = carriage_of(table({"mount": {}, "port": "/dev/ttyUSB0"}, scene_units_per_mm=0.01), TRAVEL, None)
    poses = carriage.world_to_camera(np.array([[10.0], [12.0]]), ("x",))
    assert poses[0, :3, 3] == pytest.approx([2.0, 0, 0])


def test_the_unit_of_a_simulated_scene_holds_for_measured_axes_too():
    carriage = carriage_of(table({"mount": {}}, scene_units_per_mm=0.1), TRAVEL, measured())
    poses = carriage.world_to_camera(np.array([[13.0]]), ("x",))
    assert poses[0, :3, 3] == pytest.approx([-0.09, -0.12, 0])


def test_an_axis_that_was_not_measured_is_taken_from_the_rig_file_and_it_says_so():
    stated = table({"mount": {"error_mm": 0.2, "turn_error_deg": 0.05}}, scene_units_per_mm=0.1)
    provenance = carriage_of(stated, TRAVEL, None).provenance
    assert provenance["position_error"] == pytest.approx(0.02)
    assert provenance["turn_error_deg"] == 0.05
    assert provenance["unit_mm"] == pytest.approx(10.0)
    carriage = carriage_of(table({"mount": {"x": [0.0, 0.0, 1.0]}}), TRAVEL, measured("y", (0.0, 1.0, 0.0), 3.0))
    assert carriage.provenance == {"axes_from": "[stage.mount]", "unit_mm": 1.0}
    poses = carriage.world_to_camera(np.array([[13.0, 5.0], [13.0, 6.0]]), ("x", "y"))
    assert poses[:, :3, 3] == pytest.approx(np.array([[0, 0, -1.0], [0, -3.0, -1.0]]))


def test_a_sweep_that_runs_too_fast_goes_further_than_is_counted():
    for error, gone_mm in ((0.0, 3.0), (0.02, 3.06)):
        carriage = carriage_of(table({}), TRAVEL, measured(velocity_error=error))
        poses = carriage.world_to_camera(np.array([[12.0], [14.0]]), ("x",))
        assert np.linalg.norm(poses[1, :3, 3] - poses[0, :3, 3]) == pytest.approx(gone_mm)
    assert carriage_of(table({}), TRAVEL, measured()).provenance["velocity_error_x"] == 0.0


def test_without_a_word_on_the_swept_axis_there_are_no_poses():
    assert carriage_of(table(), TRAVEL, None) is None
    assert carriage_of(table({"mount": {}}), None, None) is None
    assert carriage_of(table({}), TRAVEL, None) is None
    assert carriage_of(table({}), TRAVEL, measured("y")) is None
    assert carriage_of(table({}), TRAVEL, Calibrated(Bundle(), ())) is None
    assert carriage_of(table({}), TRAVEL, measured()) is not None


def test_a_position_that_was_counted_late_lies_ahead_and_one_with_play_behind():
    found = measured(scale=1.0, direction=(1.0, 0.0, 0.0), sweep_lag_s=2e-3, backlash_mm=0.1)
    for travel, ahead_mm in ((TRAVEL, 0.02 - 0.05), (Travel("x", 14.0, 10.0), 0.05 - 0.02)):
        carriage = carriage_of(table({}), travel, found, 10.0)
        poses = carriage.world_to_camera(np.array([[12.0]]), ("x",))
        assert -poses[0, 0, 3] == pytest.approx(ahead_mm)
        assert carriage.provenance["ahead_mm"] == pytest.approx(ahead_mm)
        assert carriage.provenance["ahead_error_mm"] == pytest.approx(np.hypot(10.0 * 1e-4, 0.5e-4), abs=1e-6)
    assert carriage_of(table({"mount": {}}), TRAVEL, None, 10.0).ahead_mm == 0.0
