"""The tape measure on the command line."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

from gs2ci.commands import measure
from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code, finding
from gs2ci.core.records import Shot
from gs2ci.core.run_figures import VERDICTS
from gs2ci.core.run_records import RunResult
from gs2ci.evaluate.run_folder import write_run
from gs2ci.render.gaussians import Gaussians

pytestmark = pytest.mark.usefixtures("undrawn")

SIZE = (12, 16)


@pytest.fixture
def folder(tmp_path):
    """A run before a wall at a depth of 2."""
    grey = np.full((2, *SIZE, 3), 0.5, np.float32)
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 0.1
    wall = np.full((2, *SIZE), 2, np.float32)
    result = RunResult(
        views=grey, scene_views=grey, depth=wall, world_to_camera=poses,
        intrinsics=np.array([[20.0, 0, 8], [0, 20, 6], [0, 0, 1]]), decode=grey, predicted_measurement=2 * grey[0],
        curve=(), stopped=finding(Code.FIT_STALLED, best=1),
        seconds=dict.fromkeys(("total", "decode", "geometry", "fit"), 1.0),
        gaussians=1, notes=(), settings={}, seed=0, verdict="refined", heldout_rms=dict.fromkeys(VERDICTS),
        depth_spread=0.01 * wall, depth_confidence=0.4 * wall,
    )  # fmt: skip
    one = torch.zeros(1, 3)
    scene = Gaussians(one + torch.tensor([0, 0, 1.0]), one, torch.tensor([[1.0, 0, 0, 0]]), torch.zeros(1), one)
    shot = Shot(2 * grey[0], np.ones((2, *SIZE), np.float32), np.ones(2, np.float32))
    return write_run(tmp_path / "run", shot, replace(result), scene)


def test_a_length_is_printed_with_its_error_and_both_points(folder, capsys):
    assert measure.run(folder, "3,6", "13,6") == pytest.approx(1.0, rel=1e-6)
    said = capsys.readouterr().out
    assert "1 ± " in said
    assert "scene units (view 2)" in said
    assert said.count("confidence 0.80") == 2
    assert measure.run(folder, "3,6", "13,6", view=1) == pytest.approx(1.0, rel=1e-6)
    assert "(view 1)" in capsys.readouterr().out
    assert (folder / "points.ply").read_bytes().startswith(b"ply\n")


def test_what_the_report_says_against_depth_is_repeated(folder, capsys):
    assert measured_json(folder, capsys)["doubts"] == []
    report = json.loads((folder / "report.json").read_text())
    notes = (
        finding(Code.DEPTH_ORDER_OPEN, errors=0.5),
        finding(Code.FOCAL_ESTIMATED, focal_px=20.0, spread=0.1, view_angle_deg=49.0),
    )
    report["notes"] = [asdict(note) for note in notes]
    (folder / "report.json").write_text(json.dumps(report))
    measure.run(folder, "3,6", "13,6")
    said = " ".join(capsys.readouterr().out.split())
    assert "Near and far may be exchanged" in said
    assert "focal length" not in said
    (doubt,) = measured_json(folder, capsys)["doubts"]
    assert doubt == notes[0].advice


def measured_json(folder, capsys):
    measure.run(folder, "3,6", "13,6", json=True)
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("text", ["3", "3,4,5", "a,b", "1.5,2"])
def test_what_is_no_pixel_is_refused(folder, text):
    with pytest.raises(InputError, match="COLUMN,ROW"):
        measure.run(folder, text, "1,1")
