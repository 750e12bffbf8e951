"""`gs2ci capture` on the simulated bench, with each of the devices that no other system test uses."""

import numpy as np
import pytest

from gs2ci.core.storage import read_shot

RIG = """
[modulator]
{modulator}
[sensor]
kind = "v4l2"
format = "Y12"
[stage]
{stage}
[stage.mount]
x = [1.0, 0.0, 0.0]
[capture]
masks = 4
mask_s = 0.05
axis = "x"
from_mm = 24.95
to_mm = 25.15
[world]
scene = "planes"
height = 32
width = 48
"""
SCPI = 'kind = "scpi"'
KINESIS = 'kind = "kinesis"'


@pytest.mark.parametrize(("modulator", "stage"), [(SCPI, KINESIS)], ids=["kinesis"])
def test_a_capture_has_the_masks_and_the_poses_of_the_devices(tmp_path, gs2ci, modulator, stage):
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.format(modulator=modulator, stage=stage))
    assert gs2ci("capture", "--rig", rig, "--dry-run") == 0
    assert gs2ci("capture", "--rig", rig, "-o", tmp_path / "shot.h5") == 0
    shot = read_shot(tmp_path / "shot.h5")
    assert shot.masks.shape == (4, 32, 48)
    assert shot.measurement.max() > 0.1
    true, told = shot.truth.world_to_camera, shot.telemetry_world_to_camera
    moved = np.linalg.norm(true[-1, :3, 3] - true[0, :3, 3])
    assert moved > 0
    # Less than a twentieth of the path: the time of a query on the line, at the speed of the sweep.
    assert np.abs(told - true).max() < 0.05 * moved


@pytest.mark.parametrize(("modulator", "stage"), [(SCPI, KINESIS)], ids=["kinesis"])
def test_the_doctor_finds_nothing_wrong(tmp_path, gs2ci, modulator, stage, capsys):
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.format(modulator=modulator, stage=stage))
    assert gs2ci("doctor", "--rig", rig) == 0
    assert "BAD" not in capsys.readouterr().out
