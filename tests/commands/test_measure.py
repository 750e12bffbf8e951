"""The tape measure on the command line."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.commands import measure
from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code, finding
from gs2ci.core.records import Shot
from gs2ci.core.run_records import VERDICTS, RunResult
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


@pytest.mark.parametrize("text", ["3", "3,4,5", "a,b", "1.5,2"])
def test_what_is_no_pixel_is_refused(folder, text):
    with pytest.raises(InputError, match="COLUMN,ROW"):
        measure.run(folder, text, "1,1")
