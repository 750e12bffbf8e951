"""What the wheel holds: the Python files of the four packages, all of them and nothing else."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {
    "gs2ci": ROOT / "gs2ci",
    "gs2ci_drivers": ROOT / "drivers" / "gs2ci_drivers",
    "gs2ci_calibration": ROOT / "calibration" / "gs2ci_calibration",
    "gs2ci_sims": ROOT / "sims" / "gs2ci_sims",
}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Build the wheel from a copy of the sources, so that nothing is left in the checkout."""
    sources, target = tmp_path_factory.mktemp("sources"), tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, sources)
    for folder in PACKAGES.values():
        to = sources / folder.relative_to(ROOT)
        shutil.copytree(folder, to, ignore=shutil.ignore_patterns("__pycache__"))
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(target)]
    built = subprocess.run(command, cwd=sources, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    (path,) = target.glob("*.whl")
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def expected():
    files = set()
    for name, folder in PACKAGES.items():
        for path in folder.rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts:
                files.add(f"{name}/{path.relative_to(folder).as_posix()}")
    return files


def test_the_wheel_holds_exactly_the_files_of_the_four_packages(wheel):
    packaged = {name for name in wheel if ".dist-info/" not in name}
    assert packaged == expected()
    assert {name.split("/")[0] for name in packaged} == set(PACKAGES)


def test_every_package_says_that_it_is_typed(wheel):
    for name in PACKAGES:
        assert f"{name}/py.typed" in wheel


def test_the_wheel_brings_the_command_its_licence_and_what_it_needs(wheel):
    information = {name.split(".dist-info/")[1]: text.decode() for name, text in wheel.items() if ".dist-info/" in name}
    assert "gs2ci = gs2ci.cli:main" in information["entry_points.txt"]
    assert "Apache License" in information["licenses/LICENSE"]
    for requirement in ("numpy", "torch", "numba", "tyro"):
        assert f"Requires-Dist: {requirement}" in information["METADATA"]
