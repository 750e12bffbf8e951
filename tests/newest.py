"""`python -m tests.newest`: a part of the tests on the newest Python that this machine has, with the newest releases.

Without constraints and without torch, whose wheels take gigabytes: files, commands' refusals, the drivers and their
twins. Where there is no newer Python than the one that runs this, it says so.
"""

import os
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PARTS = (
    *(f"tests/core/{name}" for name in ("storage", "foreign", "test_whole_file.py")),
    *(f"tests/drivers/{name}" for name in ("v4l2", "links")),
    "tests/contracts",
)


def pythons() -> Iterator[Path]:
    """Find Pythons: on the path, and those of pyenv, of which the path may hold only shims."""
    folders = [Path(folder) for folder in os.environ.get("PATH", "").split(os.pathsep)]
    folders += Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")).glob("versions/*/bin")
    for folder in folders:
        yield from (path for path in folder.glob("python3.*") if re.fullmatch(r"python3\.\d+", path.name))


def version_of(python: Path) -> tuple[int, ...]:
    """Ask a Python for its version; (0,) if it does not run, as a shim of a version that is not chosen."""
    told = "import sys; print(*sys.version_info[:2])"
    done = subprocess.run([python, "-c", told], capture_output=True, text=True, check=False)
    return tuple(map(int, done.stdout.split())) if done.returncode == 0 else (0,)


def newest() -> Path | None:
    """Return the newest Python, None if none is newer than this one."""
    found = {version_of(path): path for path in sorted(set(pythons()))}
    version = max(found, default=(0,))
    return found[version] if version > sys.version_info[:2] else None


def main() -> int:
    """Install the newest releases into an environment of its own and run the part; returns pytest's status."""
    python = newest()
    if python is None:
        print("no newer Python is installed")
        return 0
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = [*project["dependencies"], *project["optional-dependencies"]["calibrate"]]
    needed += ["hypothesis", "pytest", "scikit-image"]
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([python, "-m", "venv", folder], check=True)
        own = str(Path(folder) / "bin" / "python")
        install = [own, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*install, *needed], check=True)
        parts = [str(ROOT / part) for part in PARTS]
        return subprocess.run([own, "-m", "pytest", "-q", *parts], cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
