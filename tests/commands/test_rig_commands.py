"""The bench's commands as a user types them, on a small simulated rig with the procedural scene."""

import json
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from gs2ci.core.storage import count_shots, read_shot, sealing, writer
from gs2ci.core.storage.guarded_file import GuardedFile
from gs2ci.rig import discovery, until
from gs2ci.rig.opening import Rig

RIG = """
name = "tiny"
trace = true
[modulator]
kind = "dlpc900"
trigger_out_2_bit = "disables"
[sensor]
kind = "v4l2"
height = 40
width = 60
format = "RG12"
black_level_dn = 64.0
[stage]
kind = "zaber"
[stage.mount]
[capture]
masks = 3
mask_s = 0.03
shots = 2
axis = "x"
from_mm = 74.0
to_mm = 75.0
[world]
scene = "planes"
height = 40
width = 60
"""


def test_capture_writes_a_shot_file_with_truth_telemetry_and_traces(rig, capsys, gs2ci):
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5") == 0
    said = capsys.readouterr().out
    assert "stage travel" in said
    assert said.endswith("2 shots in shot.h5\nnext: gs2ci reconstruct shot.h5 --together -o run/\n")
    shot = read_shot(rig.with_name("shot.h5"), 1)
    assert shot.cfa == "RGGB"
    assert shot.truth.views.shape == (3, 40, 60, 3)
    assert shot.telemetry_world_to_camera.shape == (3, 4, 4)
    with h5py.File("shot.h5") as file:
        assert file["frames/trigger_index"][:].tolist() == [0, 1]
        assert b'"plan"' in file["events"][1]
    assert {path.name for path in rig.parent.glob("*.wire")} == {
        f"shot.h5.{device}.wire" for device in ("modulator", "sensor", "stage")
    }


def test_a_shot_states_whether_its_camera_moved_under_the_masks_and_whether_its_unit_is_known(rig, gs2ci):
    assert gs2ci("capture", "--rig", rig, "-o", "swept.h5") == 0
    still = "\n".join(line for line in RIG.splitlines() if not line.startswith(("axis", "from_mm", "to_mm")))
    rig.write_text(still)
    assert gs2ci("capture", "--rig", rig, "-o", "still.h5") == 0
    stated = [read_shot(rig.with_name(name)).provenance["within_mask"] for name in ("swept.h5", "still.h5")]
    assert stated == ["moving", "still"]
    rig.write_text(still.replace("[world]", "[optics]\nfull_scale_dn = 700.0\n[world]"))
    assert gs2ci("capture", "--rig", rig, "-o", "known.h5") == 0
    units = [read_shot(rig.with_name(name)).provenance["unit_stated"] for name in ("still.h5", "known.h5")]
    assert units == [False, True]


def test_the_measurement_explains_itself_by_the_true_views_and_masks(rig, gs2ci):
    rig.write_text(RIG.replace("[world]", '[world]\nnoise = false\ndevices = "ideal"').replace('"RG12"', '"Y12"'))
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5") == 0
    shot = read_shot(rig.with_name("shot.h5"))
    coded = (shot.weights[:, None, None, None] * shot.masks[..., None] * shot.truth.views).sum(axis=0)
    lit = (coded > 0.1) & ~shot.saturated[..., None]
    ratio = shot.measurement[lit] / coded[lit]
    assert ratio.std() / ratio.mean() < 0.02


def test_the_loser_of_two_captures_is_not_told_to_recover_the_winners_file(rig, capsys, gs2ci, monkeypatch):
    partial = rig.with_name("shot.h5.partial")
    winner = GuardedFile(partial)  # as another process holds it
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5") == 2
    said = capsys.readouterr().err
    assert "another capture is writing it" in said
    assert "recover" not in said
    for module in (sealing, writer):  # or the other one came in between
        monkeypatch.setattr(module, "check_target", lambda path, **how: None)
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5") == 2
    assert "recover" not in capsys.readouterr().err
    winner.close()
    assert partial.stat().st_size == 0  # and it still has its file


def test_a_dry_run_prints_the_plan_and_writes_and_moves_nothing(rig, capsys, gs2ci):
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5", "--dry-run") == 0
    assert "upload" in capsys.readouterr().out
    assert [path.name for path in rig.parent.iterdir()] == ["rig.toml"]


def test_a_plan_that_breaks_limits_is_printed_and_refused(rig, capsys, gs2ci):
    rig.write_text(RIG.replace("mask_s = 0.03", "mask_s = 0.00001"))
    assert gs2ci("capture", "--rig", rig, "--dry-run") == 2
    captured = capsys.readouterr()
    assert "NO" in captured.out
    assert "time per mask" in captured.err


def test_a_bundle_that_cannot_be_read_is_told_before_any_device_is_opened(rig, capsys, gs2ci, monkeypatch):
    monkeypatch.setattr(Rig, "open", lambda *_: pytest.fail("a device was opened"))
    for words in (("capture", "--calibration", "no.h5"), ("capture", "--calibration", rig), ("calibrate", "sensor")):
        out = "shot.h5" if words[0] == "capture" else "damaged.h5"
        rig.with_name("damaged.h5").write_bytes(b"no HDF5")
        assert gs2ci(*words, "--rig", rig, "-o", out) == 2
        assert (words[-1] if words[-1] == "no.h5" else "HDF5") in capsys.readouterr().err
        assert {path.name for path in rig.parent.iterdir()} <= {rig.name, "damaged.h5"}


def test_another_number_of_shots_can_be_asked_for(rig, capsys, gs2ci):
    assert gs2ci("capture", "--rig", rig, "-o", "one.h5", "--shots", "1") == 0
    assert "1 shot in one.h5" in capsys.readouterr().out
    assert gs2ci("capture", "--rig", rig, "--shots", "0") == 2


def accurate(errors):
    """Stand in for reconstructions: views of an accuracy that depends on the number of exposures."""
    counts = []

    def solve(shots):
        counts.append([shot.measurement.shape for shot in shots])
        return SimpleNamespace(
            notes=(), depth=None, uncertainty=SimpleNamespace(views=np.full((3, 40, 60), errors[len(shots) - 1]))
        )

    solve.counts = counts
    return solve


def test_a_capture_takes_exposures_until_their_standard_errors_are_small_enough(rig, capsys, gs2ci, monkeypatch):
    solve = accurate([0.1, 0.05, 0.01])
    monkeypatch.setattr(until, "solve_together", solve)
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5", "--until", "35dB", "--no-probe") == 0
    said = capsys.readouterr()
    assert "3 exposures together: 40.0 dB, asked for 35.0 dB" in said.out + said.err
    assert "lost" not in said.out
    assert [len(shapes) for shapes in solve.counts] == [1, 2, 3]
    assert {shape for shapes in solve.counts for shape in shapes} == {(40, 60, 1)}
    assert count_shots(Path("shot.h5")) == 3
    assert read_shot(Path("shot.h5"), 2).truth.views.shape == (3, 40, 60, 3)
    log = [json.loads(line) for line in Path("shot.h5.session.jsonl").read_text().splitlines()]
    events = [line["event"] for line in log if line["event"] in ("shot", "judged", "end")]
    assert events == ["shot", "judged"] * 3 + ["end"]


def test_no_more_exposures_are_taken_than_allowed(rig, capsys, gs2ci, monkeypatch):
    monkeypatch.setattr(until, "solve_together", accurate([0.1] * 4))
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5", "--until", "35dB", "--shots", "2", "--no-probe") == 0
    said = capsys.readouterr()
    assert "no more are taken than --shots allows" in said.out + said.err
    assert count_shots(Path("shot.h5")) == 2


def test_a_time_ends_a_capture_by_the_clock_of_the_bench(rig, capsys, gs2ci):
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5", "--until", "1s", "--no-probe", "--shots", "30") == 0
    assert 1 <= count_shots(Path("shot.h5")) < 30


def test_a_capture_whose_exposures_cannot_be_judged_is_refused_before_anything_moves(rig, capsys, gs2ci):
    rig.write_text(RIG.replace("[capture]", '[capture]\nmode = "per-mask"').replace('axis = "x"', 'axis = ""'))
    assert gs2ci("capture", "--rig", rig, "--until", "35dB") == 2
    assert "per-mask" in capsys.readouterr().err
    assert gs2ci("capture", "--rig", rig, "--until", "soon") == 2
    assert "35dB" in capsys.readouterr().err
    assert not Path("shot.h5").exists()
    assert not Path("shot.h5.partial").exists()


def test_a_capture_that_fails_while_it_is_judged_keeps_what_was_taken(rig, capsys, gs2ci, monkeypatch):
    def fails(shots):
        raise KeyboardInterrupt

    monkeypatch.setattr(until, "solve_together", fails)
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5", "--until", "35dB", "--no-probe") != 0
    assert "gs2ci recover" in capsys.readouterr().err
    assert gs2ci("recover", "shot.h5.partial", "-o", "saved.h5") == 0
    assert count_shots(Path("saved.h5")) == 1


def test_a_capture_that_fails_before_its_first_shot_leaves_nothing_in_the_way(rig, capsys, gs2ci):
    rig.write_text(RIG.replace("[world]", '[world]\nfaults = ["stage: zaber.stall"]'))
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5") == 2
    said = capsys.readouterr().err
    assert "stalled" in said
    assert "safe" not in said
    rig.write_text(RIG)
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5") == 0


def test_a_capture_that_fails_later_says_how_to_save_what_was_taken(rig, capsys, gs2ci):
    rig.write_text(RIG.replace("[world]", '[world]\nfaults = ["sensor: v4l2.frame_corrupt after 1"]'))
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5") == 2
    assert "gs2ci recover shot.h5.partial" in capsys.readouterr().err
    assert gs2ci("recover", "shot.h5.partial") == 0
    said = capsys.readouterr().out.splitlines()
    assert "1 finished row of shot.h5.partial saved in shot.recovered.h5" in said
    assert said[-1] == "next: gs2ci reconstruct shot.recovered.h5 -o run/"


def test_recover_takes_the_name_from_the_interrupted_file(rig, capsys, gs2ci):
    assert gs2ci("capture", "--rig", rig, "-o", "shot.h5") == 0
    rig.with_name("shot.h5").rename(rig.with_name("late.h5.partial"))
    assert gs2ci("recover", "late.h5.partial") == 0
    assert "2 finished rows of late.h5.partial saved in late.recovered.h5" in capsys.readouterr().out


def test_an_unknown_fault_in_the_rig_file_names_the_nearest(rig, capsys, gs2ci):
    rig.write_text(RIG.replace("[world]", '[world]\nfaults = ["stage: zaber.stal"]'))
    assert gs2ci("capture", "--rig", rig) == 2
    assert "did you mean 'zaber.stall'" in capsys.readouterr().err


def test_devices_says_what_each_can_do_and_homes_only_when_asked(rig, capsys, gs2ci):
    assert gs2ci("devices", "--rig", rig) == 0
    said = capsys.readouterr().out
    for words in ("DLP6500", "RG12 40 x 60", "axis x", "at 75.0000 mm", "at rest"):
        assert words in said
    assert "homed" not in said
    assert gs2ci("devices", "--rig", rig, "--home") == 0
    assert "homed: x 0.0000 mm" in capsys.readouterr().out


def test_what_cannot_be_homed_is_told(rig, capsys, gs2ci):
    assert gs2ci("devices", "--home") == 2
    assert "gs2ci devices --rig RIG.toml --home" in capsys.readouterr().err
    rest = "\n".join(line for line in RIG.splitlines() if not line.startswith(("axis", "from_mm", "to_mm")))
    rig.write_text(rest.replace('[stage]\nkind = "zaber"\n[stage.mount]\n', ""))
    assert gs2ci("devices", "--rig", rig, "--home") == 2
    assert "names no stage" in capsys.readouterr().err


def test_devices_without_a_rig_looks_at_this_computer(rig, monkeypatch, capsys, gs2ci):
    monkeypatch.setattr(discovery, "find_devices", lambda: [("sensor", "/dev/video3", "a camera")])
    assert gs2ci("devices") == 0
    said = capsys.readouterr().out
    assert "port = '/dev/video3'  a camera" in said
    assert "compute    --device cpu  the default" in said
    monkeypatch.setattr(discovery, "find_devices", list)
    assert gs2ci("devices") == 0
    assert "gs2ci doctor" in capsys.readouterr().out


def test_doctor_ends_well_on_a_healthy_bench_and_badly_on_a_sick_one(rig, capsys, gs2ci):
    assert gs2ci("doctor", "--rig", rig) == 0
    said = capsys.readouterr().out
    assert said.index("trigger loop") < said.index("time stamps:") < said.index("know about")
    assert said.endswith("nothing was found that would keep this bench from working\n")
    rig.write_text(RIG.replace("[world]", '[world]\nfaults = ["sensor: v4l2.trigger_missed"]'))
    assert gs2ci("doctor", "--rig", rig) == 2
    captured = capsys.readouterr()
    assert "BAD" in captured.out
    assert "1 finding would keep this bench from working: trigger pulses" in captured.err
