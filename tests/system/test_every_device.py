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
ALP = 'kind = "alp"'
ZABER = 'kind = "zaber"'
RIGS, NAMES = [(SCPI, KINESIS), (ALP, ZABER), (ALP, KINESIS)], ["kinesis", "alp", "alp and kinesis"]


@pytest.mark.parametrize(("modulator", "stage"), RIGS, ids=NAMES)
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


@pytest.mark.parametrize(("modulator", "stage"), RIGS, ids=NAMES)
def test_the_doctor_finds_nothing_wrong(tmp_path, gs2ci, modulator, stage, capsys):
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.format(modulator=modulator, stage=stage))
    assert gs2ci("doctor", "--rig", rig) == 0
    assert "BAD" not in capsys.readouterr().out


def test_a_burst_has_the_pauses_that_an_alp_device_can_keep(tmp_path, gs2ci):
    rig = tmp_path / "rig.toml"
    text = RIG.format(modulator=ALP, stage=ZABER).replace('axis = "x"\nfrom_mm = 24.95\nto_mm = 25.15\n', "")
    rig.write_text(text.replace("masks = 4", "masks = 4\nshots = 6\nburst = 3\ndark_s = 0.001"))
    assert gs2ci("capture", "--rig", rig, "-o", tmp_path / "shot.h5") == 0
    shots = [read_shot(tmp_path / "shot.h5", index).measurement for index in range(6)]
    assert all(np.abs(one - shots[0]).mean() < 0.1 * shots[0].mean() for one in shots[1:])
