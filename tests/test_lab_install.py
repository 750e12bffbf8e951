"""What `pip install gs2ci` alone can do: a computer at a bench, without torch and all else that an extra brings."""

import ast
import json
import os
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import gs2ci
from gs2ci import __version__, cli
from gs2ci.batch import cluster
from gs2ci.core.errors import Gs2ciError
from gs2ci.core.extras import EXTRAS, missing_extra
from gs2ci.evaluate import viewer
from gs2ci.evaluate.exports import depth_files
from gs2ci.reconstruct.learned import ffdnet
from gs2ci.reconstruct.learned.weight_file import Convolution
from gs2ci.render.backend import load_backend
from gs2ci_drivers.links.alp_library import AlpLibrary
from gs2ci_drivers.links.gentl import GenTlPort
from gs2ci_drivers.links.sdl_screen import SdlScreen
from gs2ci_sims.scenes.meshes import mesh_from_file

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# All that `gs2ci[calibrate]` does without, and what `gs2ci` alone does.
MISSING = sorted({module for extra, modules in EXTRAS.items() if extra != "calibrate" for module in modules})
LEAST = [*MISSING, *EXTRAS["calibrate"], "llvmlite"]

# In a process of its own: modules of the extras cannot be found.
HIDDEN = """
import sys
MISSING = {missing}
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in MISSING:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Absent())
"""
# The scene's light, which torch renders, is off.
DARK = """
import gs2ci.rig.simulated as simulated
from gs2ci_sims.world import Darkness
lit = simulated.build_bench
simulated.build_bench = lambda table, light=None: lit(table, light or Darkness())
"""
TYPED = """
from gs2ci import cli
for line in {lines}:
    sys.argv = ["gs2ci", *line]
    status = cli.main()
    print("status", status, *line[:1], flush=True)
heavy = sorted(name for name in MISSING if name in sys.modules)
print("heavy", heavy)
"""
# All of a bench without twins: its modules, its rig file, the patterns of a file, and an image for the modulator.
BENCH = """
import importlib, pkgutil
from pathlib import Path
import numpy as np
import gs2ci_drivers
import gs2ci.rig.calibrated, gs2ci.rig.discovery, gs2ci.rig.doctor, gs2ci.rig.patterns, gs2ci.rig.recording
from gs2ci.rig.opening import load_rig
from gs2ci.core.foreign.opening import load_single
from gs2ci_drivers.dlpc900 import erle

for found in pkgutil.walk_packages(gs2ci_drivers.__path__, "gs2ci_drivers."):
    importlib.import_module(found.name)
assert load_rig(Path({rig!r})).bench is None
np.savez("masks.npz", masks=np.eye(8))
words = load_single(Path("masks.npz")).values.astype(np.uint32)
assert erle.encode(words).hex().startswith("0100000107000000")
"""


def run_hiding(modules, code, folder, **given):
    code = (HIDDEN + code).format(missing=modules, **given)
    path = os.pathsep.join([str(ROOT / name) for name in (".", "drivers", "calibration", "sims")])
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done


def test_a_bench_is_captured_and_files_are_handled_and_the_rest_says_what_to_install(tmp_path):
    rig = ROOT / "docs" / "rigs" / "simulated.toml"
    lines = [
        ["capture", "--rig", str(rig), "-o", "shot.h5"],
        ["devices", "--rig", str(rig)],
        ["recover", "nothing.h5"],
        ["plugins"],
        ["reconstruct", "shot.h5"],
        ["demo", "-o", "demo"],
    ]
    done = run_hiding(MISSING, DARK + TYPED, tmp_path, lines=json.dumps(lines))
    said = [line for line in done.stdout.splitlines() if line.startswith(("status", "heavy"))]
    assert said == [
        "status 0 capture",
        "status 0 devices",
        "status 2 recover",
        "status 0 plugins",
        "status 2 reconstruct",
        "status 2 demo",
        "heavy []",
    ]
    assert (tmp_path / "shot.h5").is_file()
    assert done.stderr.count("pip install 'gs2ci[reconstruct]'") == 2


def test_a_bench_that_calibrates_elsewhere_needs_nothing_that_compiles(tmp_path):
    rigs = ROOT / "docs" / "rigs"
    np.savez(tmp_path / "exposure.npz", meas=np.ones((8, 8)), masks=np.ones((4, 8, 8)))
    lines = [
        ["plugins"],
        ["recover", "nothing.h5"],
        ["import", "exposure.npz", "-o", "shot.h5"],
        ["calibrate", "all", "--rig", str(rigs / "real.toml"), "-o", "bench.cal.h5"],
        ["live", "--rig", str(rigs / "real.toml")],
        ["capture", "--rig", str(rigs / "simulated.toml"), "-o", "shot.h5"],
        ["demo", "-o", "demo"],
    ]
    done = run_hiding(LEAST, BENCH + TYPED, tmp_path, lines=json.dumps(lines), rig=str(rigs / "real.toml"))
    assert [line for line in done.stdout.splitlines() if line.startswith(("status", "heavy"))] == [
        "status 0 plugins",
        *(f"status 2 {line[0]}" for line in lines[1:]),
        "heavy []",
    ]
    said = done.stderr.split("error: ")[1:]
    assert len(said) == len(lines) - 1
    assert ["gs2ci[calibrate]" in each for each in said] == [False, True, True, True, True, True], done.stderr
    assert all("gs2ci[reconstruct]" in each for each in said[1:])


def test_what_each_extra_brings_is_what_the_error_names():
    distributions = packages_distributions()
    for extra, modules in EXTRAS.items():
        required = {line.partition(">")[0] for line in PROJECT["optional-dependencies"][extra]}
        for module in modules:
            named = distributions.get(module)
            # dask comes with distributed; what is not installed here has the module's name.
            assert named is None or module == "dask" or required & {name.lower() for name in named}, module


def test_nothing_of_an_extra_is_needed_by_default():
    required = {line.partition(">")[0] for line in PROJECT["dependencies"]}
    extra = {line.partition(">")[0] for line in PROJECT["optional-dependencies"]["reconstruct"]}
    assert not required & extra
    imported = set()
    for folder in ("gs2ci/core", "gs2ci/rig", "drivers", "calibration"):
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.Import):
                    imported |= {(alias.name.partition(".")[0], path.name) for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.module:
                    imported.add((node.module.partition(".")[0], path.name))
    assert [(module, name) for module, name in sorted(imported) if module in MISSING] == []


def _list_cameras(folder):
    GenTlPort("cam0").list_cameras(str(folder / "producer.cti"))


def _load_alp(folder):
    AlpLibrary("dmd", "4.3", folder)


def _render_on_a_device(folder):
    load_backend("warp")


def _draw(folder):
    SdlScreen("slm").list_outputs()


def _serve(folder):
    scene = SimpleNamespace()
    viewer.serve(scene, host="127.0.0.1", port=0)


def _read_a_mesh(folder):
    mesh_from_file(folder / "scene.glb")


def _write_a_model(folder):
    layer = Convolution(torch.zeros(4, 5, 3, 3), torch.zeros(4))
    ffdnet.export_ffdnet(ffdnet.FfdNet((layer,)), folder / "model.onnx")


def _write_depth(folder):
    depth_files.write_depth_exr(folder, np.ones((1, 2, 3), np.float32))


def _join_a_cluster(folder):
    with cluster.connected("tcp://127.0.0.1:1"):
        pass


def _hand_to_bluesky(folder):
    shutil.copy(ROOT / "docs" / "rigs" / "simulated.toml", folder)
    with gs2ci.open_rig(folder / "simulated.toml") as rig:
        gs2ci.ophyd_bench(rig, folder)


# What asks for each extra; `reconstruct` and `calibrate` have processes of their own above.
ASKED = {
    "gpu": _render_on_a_device,
    "genicam": _list_cameras,
    "video": _draw,
    "alp": _load_alp,
    "view": _serve,
    "mesh": _read_a_mesh,
    "export": _write_a_model,
    "exr": _write_depth,
    "cluster": _join_a_cluster,
    "ophyd": _hand_to_bluesky,
}


def test_every_extra_is_asked_for_somewhere():
    assert {*ASKED, "calibrate", "reconstruct"} == set(EXTRAS)


@pytest.mark.parametrize("extra", ASKED)
def test_what_needs_an_extra_that_is_not_there_says_which_to_install(extra, tmp_path, monkeypatch):
    for name in list(sys.modules):
        if name.partition(".")[0] in EXTRAS[extra] or name.startswith(("gs2ci.api.ophyd.", "gs2ci.render.warp.")):
            monkeypatch.delitem(sys.modules, name)
    for module in EXTRAS[extra]:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(Gs2ciError) as caught:
        ASKED[extra](tmp_path)
    assert f"pip install 'gs2ci[{extra}]'" in str(caught.value)


def test_a_missing_module_of_nobody_is_an_error_of_ours():
    assert missing_extra(ModuleNotFoundError("x", name="nowhere")) is None
    assert "gs2ci[view]" in missing_extra(ModuleNotFoundError("x", name="viser.extras")).remedy


def test_a_module_of_ours_that_is_missing_is_not_hidden(monkeypatch, gs2ci):
    monkeypatch.setitem(cli.COMMANDS, "plugins", ("gs2ci.commands.nothing", ""))
    with pytest.raises(ModuleNotFoundError):
        gs2ci("plugins")


def test_the_version_stands_in_one_place():
    assert PROJECT["dynamic"] == ["version"]
    assert "version" not in PROJECT
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text()
