"""`make wheel`: build sdist and wheel, install the wheel into empty environments away from the checkout, and use it.

    python -m tests.wheel [-o dist] [--quick]

The wheel is built from the unpacked sdist, so that the sdist is known to be complete. Two environments: what a bench's
computer installs (`pip install gs2ci`, where every module of the rig and the drivers is imported, and with
`[calibrate]`, where a simulated bench is captured without torch); and `gs2ci[reconstruct]`, where the
kernels are compiled, every one, and the demo runs small. With --quick the second one borrows the packages of this
environment, so that no gigabyte is fetched, and imports every module instead: kernels are compiled by `make install`.
"""

import argparse
import ast
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import time
import venv
from collections.abc import Iterable, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CONSTRAINTS = ROOT / "constraints.txt"
# Every command's help, in one process: its start takes longer than the help.
HELP = """
import sys
from contextlib import redirect_stdout
from io import StringIO
from gs2ci import cli

for command in cli.COMMANDS:
    sys.argv = ["gs2ci", command, "--help"]
    with redirect_stdout(StringIO()) as told:
        try:
            status = cli.main()
        except SystemExit as end:
            status = end.code
    assert not status and "usage" in told.getvalue(), f"{command}: {status}, {told.getvalue()}"
"""
# What a bench's computer needs to capture: nothing that is compiled, or compiles.
BARE = """
import importlib, importlib.util, pkgutil
import numpy as np
import gs2ci_drivers
import gs2ci.rig.calibrated, gs2ci.rig.discovery, gs2ci.rig.doctor, gs2ci.rig.patterns, gs2ci.rig.recording
for name in ("torch", "numba", "scipy", "cv2"):
    assert importlib.util.find_spec(name) is None, f"{name} is installed: this is not the least"
for found in pkgutil.walk_packages(gs2ci_drivers.__path__, "gs2ci_drivers."):
    if not found.name.startswith("gs2ci_drivers.testing"):  # for tests of other people's drivers
        importlib.import_module(found.name)
from gs2ci_drivers.dlpc900 import erle
assert len(erle.encode(np.zeros((1080, 1920), np.uint32))) < 8000
"""
ALL = """
import importlib, pkgutil
import gs2ci, gs2ci_drivers, gs2ci_calibration, gs2ci_sims
for package in (gs2ci, gs2ci_drivers, gs2ci_calibration, gs2ci_sims):
    for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        try:
            found.name.endswith("__main__") or importlib.import_module(found.name)
        except ModuleNotFoundError as missing:
            if str(missing.name).startswith("gs2ci"):  # else an extra that is not installed
                raise
"""
# What it does that calibrates: the light of the simulated scene, which torch renders, is off.
LAB = """
import importlib.util, sys
import gs2ci, gs2ci_drivers, gs2ci_calibration, gs2ci_sims
assert importlib.util.find_spec("torch") is None, "torch is installed: this is no bench's computer"
import gs2ci.rig.simulated as simulated
from gs2ci_sims.world import Darkness
lit = simulated.build_bench
simulated.build_bench = lambda table, light=None: lit(table, Darkness())
from gs2ci import cli
sys.argv = ["gs2ci", "capture", "--rig", "simulated.toml", "-o", "shot.h5"]
sys.exit(cli.main())
"""


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.wheel")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "dist")
    parser.add_argument("--quick", action="store_true")
    chosen = parser.parse_args(arguments)
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        wheel = build(Path(folder), chosen.output)
        lab(wheel, Path(folder) / "lab")
        whole(wheel, Path(folder) / "whole", borrowed=chosen.quick)
    print(f"{wheel.name} is fit to be published; {time.monotonic() - began_s:.0f} s")
    return 0


def build(folder: Path, output: Path) -> Path:
    """Build the sdist from the checkout and the wheel from the sdist; return the wheel."""
    output.mkdir(parents=True, exist_ok=True)
    for old in (*output.glob("gs2ci-*.whl"), *output.glob("gs2ci-*.tar.gz")):
        old.unlink()
    say("sdist and wheel")
    run([sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(output)], ROOT)
    (sdist,) = output.glob("gs2ci-*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder / "sdist", filter="data")
    (sources,) = (folder / "sdist").iterdir()
    for name in ("README.md", "LICENSE", "CITATION.cff", "tests/conftest.py", "docs/rigs/simulated.toml", "Makefile"):
        assert (sources / name).is_file(), f"{name} is not in the sdist"
    run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(output)], sources)
    (wheel,) = output.glob("gs2ci-*.whl")
    return wheel


def lab(wheel: Path, folder: Path) -> None:
    """Install what a bench's computer needs; ask every command for its help; install what calibrates, and capture."""
    say("pip install gs2ci, in an empty environment")
    python = environment(folder)
    pip(python, [str(wheel)])
    helped(python, folder)
    run([python, "-c", BARE], folder)
    pip(python, [f"gs2ci[calibrate] @ {wheel.as_uri()}"])
    shutil.copy(ROOT / "docs" / "rigs" / "simulated.toml", folder)
    run([python, "-c", LAB], folder)
    assert (folder / "shot.h5").is_file()
    refused = subprocess.run(
        [python, "-m", "gs2ci", "demo", "-o", "demo"],
        cwd=folder,
        env=clean(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert refused.returncode == 2, refused.stderr
    assert "pip install 'gs2ci[reconstruct]'" in refused.stderr, refused.stderr


def whole(wheel: Path, folder: Path, *, borrowed: bool) -> None:
    """Install everything; compile the kernels and run the demo small, or import all beside borrowed packages."""
    say(f"pip install gs2ci[reconstruct], {'beside the packages of this environment' if borrowed else 'all of it'}")
    python = environment(folder)
    if borrowed:
        pip(python, ["--no-deps", str(wheel)])
        site = run([python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], folder).strip()
        # A folder that a .pth file names is searched, its own .pth files are not read: the checkout stays away.
        (Path(site) / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    else:
        pip(python, [f"{wheel}[reconstruct]"])
    where = run([python, "-c", "import gs2ci; print(gs2ci.__file__)"], folder).strip()
    assert Path(where).is_relative_to(folder), f"{where} is not the wheel's"
    helped(python, folder)
    if borrowed:
        run([python, "-c", ALL], folder)
        return
    run([python, "-m", "gs2ci", "compile"], folder)
    missing = jitted(Path(where).parent.rglob("*.py")) - compiled(Path(where).parent)
    assert not missing, f"`gs2ci compile` left out {sorted(missing)}"
    small = ["--views", "4", "--height", "64", "--width", "96"]
    run([python, "-m", "gs2ci", "demo", "-o", "demo", *small], folder)
    for name in ("shot.h5", "run/report.html", "run/scene.ply"):
        assert (folder / "demo" / name).is_file(), name


def jitted(sources: Iterable[Path]) -> set[str]:
    """Name the functions of these files that Numba compiles, as file.function."""
    found = set()
    for path in sources:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                decorators = [ast.unparse(one).removeprefix("numba.") for one in node.decorator_list]
                if any(one.startswith(("njit", "kernel(")) for one in decorators):
                    found.add(f"{path.stem}.{node.name}")
    return found


def compiled(package: Path) -> set[str]:
    """Name the functions whose machine code lies on disk, as file.function (Numba's indices: file.function-line...)."""
    return {path.name.rpartition("-")[0] for path in package.rglob("*.nbi")}


def environment(folder: Path) -> str:
    """Make an empty environment; return its Python."""
    venv.create(folder / "venv", with_pip=True)
    return str(folder / "venv" / "bin" / "python")


def pip(python: str, wanted: Sequence[str]) -> None:
    """Install within the constraints."""
    command = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-c", str(CONSTRAINTS)]
    run([*command, *wanted], Path(python).parent)


def helped(python: str, folder: Path) -> None:
    """Ask every command for its help."""
    run([python, "-c", HELP], folder)
    version = run([python, "-m", "gs2ci", "--version"], folder)
    assert version.startswith("gs2ci "), version


def clean() -> dict[str, str]:
    """Return an environment in which nothing of the checkout is found."""
    return {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "GS2CI"))}


def run(command: Sequence[str], folder: Path) -> str:
    """Run a command away from the checkout; return what it printed."""
    done = subprocess.run(command, cwd=folder, env=clean(), capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(
            f"{' '.join(command)} ended with {done.returncode}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        )
    return done.stdout


def say(text: str) -> None:
    print(f"-- {text}", flush=True)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
