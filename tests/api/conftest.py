"""A folder with a small one of everything that the examples in docstrings name."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.records import Shot
from gs2ci.core.storage import write_shots
from gs2ci.evaluate.run_folder import write_run
from tests.evaluate.conftest import make_run, scene

__all__ = ["make_run", "scene"]

RIG = """
name = "small bench"
[modulator]
kind = "dlpc900"
trigger_out_2_bit = "disables"
[sensor]
kind = "v4l2"
height = 24
width = 32
format = "{pixels}"
black_level_dn = 64.0
[stage]
kind = "zaber"
[stage.mount]
[capture]
masks = 4
{capture}
[world]
scene = "planes"
height = 24
width = 32
{world}
"""
"""A bench of 24 x 32 pixels; left open are the sensor's format, and more of [capture] and [world]."""
SWEEP = 'mask_s = 0.03\naxis = "x"\nfrom_mm = 74.0\nto_mm = 75.0'


@pytest.fixture(scope="session")
def filled(tmp_path_factory, make_run, scene):
    """measurement.npz, shot.h5, interrupted.h5.partial, run/ and rig.toml, all of 4 views of 24 × 32 px."""
    folder = tmp_path_factory.mktemp("examples")
    shot, result = make_run(count=4, size=(24, 32))
    surely = np.full(result.depth.shape, 0.02, np.float32)
    result = replace(result, depth_spread=surely, depth_confidence=1 - surely)
    np.savez(folder / "measurement.npz", meas=shot.measurement, mask=shot.masks, orig=shot.truth.views)
    named = Shot(shot.measurement, shot.masks, truth=shot.truth, name="measurement")
    write_shots(folder / "shot.h5", [named])
    shutil.copy(folder / "shot.h5", folder / "interrupted.h5.partial")
    write_run(folder / "run", named, result, scene)
    (folder / "rig.toml").write_text(RIG.format(pixels="RG12", capture=SWEEP, world=""))
    return folder


@pytest.fixture
def examples(filled, tmp_path, monkeypatch):
    """A copy of that folder to work in."""
    folder = tmp_path / "examples"
    shutil.copytree(filled, folder)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("GS2CI_HOME", str(folder / "home"))
    return folder
