"""What other machines need and lack: a Linux on ARM has no pycolmap, and goes without."""

import os
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci.core import colmap
from gs2ci.core.errors import GeometryError, InputError
from gs2ci.core.foreign import camera_files
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.geometry.path import bundle
from gs2ci.reconstruct.geometry.sources import mapper
from gs2ci.reconstruct.hypotheses import matches
from tests import platforms

ARM = platforms.Target("aarch64", "3.11", ("reconstruct",))
HERE = platforms.Target("x86_64", "3.11", ("reconstruct",))
IMPORTED = """
import platform, sys
platform.machine = lambda: "{machine}"
sys.modules["pycolmap"] = None
import gs2ci.reconstruct.pipeline, gs2ci.evaluate.run_folder, gs2ci.api.exports
from gs2ci.core.colmap import pycolmap
from gs2ci.core.errors import GeometryError
try:
    pycolmap.Reconstruction()
except GeometryError as error:
    print(error)
"""


def test_pycolmap_is_needed_where_it_can_be_had():
    here, arm = platforms.needed(HERE), platforms.needed(ARM)
    assert here.keys() - arm.keys() >= {"pycolmap"}
    assert arm.keys() <= here.keys()
    assert {"torch", "numba", "llvmlite", "jinja2", "h5py"} <= arm.keys()
    assert arm["numpy"] == "numpy>=2.0"


@pytest.mark.parametrize(("code", "said"), [(0, ""), (1, "ERROR: No matching distribution found for pycolmap")])
def test_what_pip_lacks_is_told(monkeypatch, code, said):
    asked = []

    def answer(command, **_):
        asked.extend(command)
        return SimpleNamespace(returncode=code, stderr=f"WARNING: slow\n{said}\n")

    monkeypatch.setattr(platforms.subprocess, "run", answer)
    assert platforms.lacking(ARM) == said
    assert {"--python-version=3.11", "--platform=manylinux_2_28_aarch64", "--dry-run", "torch>=2.6"} <= set(asked)
    assert not any("pycolmap" in word for word in asked)


@pytest.mark.parametrize("machine", ["aarch64", "x86_64"])
def test_all_is_imported_without_pycolmap_on_arm_and_elsewhere_it_is_missing(machine):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    words = [sys.executable, "-c", IMPORTED.format(machine=machine)]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    if machine == "aarch64":
        assert "pycolmap (Reconstruction), of which there is none for aarch64" in done.stdout, done.stderr
    else:
        assert "ModuleNotFoundError" in done.stderr


@pytest.fixture
def arm(monkeypatch):
    """Take pycolmap away from all that uses it."""
    absent = colmap._Absent()
    for module in (bundle, colmap, mapper):
        monkeypatch.setattr(module, "pycolmap", absent)


@pytest.mark.usefixtures("arm")
def test_a_model_of_colmap_is_refused_with_the_reason(tmp_path):
    with pytest.raises(InputError, match="of which there is none for") as caught:
        camera_files.read_cameras(tmp_path, 3, (10, 10))
    assert caught.value.allowed == "a transforms.json"


@pytest.mark.usefixtures("arm")
def test_a_scene_of_matched_features_is_refused_with_the_reason():
    places = [np.zeros((3, 2), np.float32)] * 2
    with pytest.raises(GeometryError, match="needs pycolmap"):
        mapper.grown_scene(places, {}, np.eye(3), (10, 10))


def refuse(*_, **__):
    raise GeometryError("this needs pycolmap")


def test_a_look_at_views_far_apart_gives_up_where_matches_fail(monkeypatch):
    monkeypatch.setattr(matches, "wide_motion", refuse)
    monkeypatch.setattr(matches.Request, "of", lambda *_: None)
    first = SimpleNamespace(holdout=SimpleNamespace(seen=None), decoded=None, geometry=None)
    laps, settings = [], SimpleNamespace(geometry=None)
    assert matches.look_far_apart(first, None, settings, Silent(), laps.append, np.eye(4)[None]) is None
    assert laps == ["geometry"]
