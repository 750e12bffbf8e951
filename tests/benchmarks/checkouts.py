"""Cost and quality of this checkout's reconstructions compared with another's: the same measurements, in turns.

    GS2CI_AGAINST=bb9e2cb python -m tests.benchmarks checkouts

`GS2CI_AGAINST` names a commit of this repository (made a temporary work tree) or the folder of another checkout. Each
side is one process on one thread, and compiles its kernels before the timing. Then both reconstruct every case with
every seed, as this checkout's simulator exposes it; the side that begins alternates from case to case. It prints
processor seconds (which other load hardly changes, unlike the wall clock), PSNR, nATE and depth: the median error of
the disparity between neighbouring views, px, and the share of pixels more than 0.25 px off.

| variable | what it sets | default |
|---|---|---|
| `GS2CI_CASES` | scenes of the simulator, and files in `GS2CI_DATA` without their ending | the library's four |
| `GS2CI_SEEDS` | how many seeds | 3 |
| `GS2CI_PRESET` | the preset of both; `one,other` where they differ, this checkout's first | standard |
| `GS2CI_FITS` | how many fits are averaged, likewise | the preset's |
| `GS2CI_MOTION` | the setting `motion` of a checkout that has it, as `off` against one that has not | the preset's |
| `GS2CI_SIZE` | height and width, px; the middle of a file, the rest cut away; `all` of it | 96x128 |

Not here: what happens on one side (`checkout_side.py`).
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

import numpy as np

from gs2ci.core.storage import write_shots
from tests.benchmarks.checkout_side import Asked, Found
from tests.processes import ONE_THREAD
from tests.tables.cases import Case

ROOT: Final = Path(__file__).parents[2]
SIDE: Final = Path(__file__).with_name("checkout_side.py")
SCENES: Final = ("boxes", "thicket", "motorcycle", "corridor")
PACKAGES: Final = ("", "drivers", "calibration", "sims")


class Side:
    """A process that reconstructs by one checkout, one measurement after the other."""

    def __init__(self, folder: Path) -> None:
        paths = os.pathsep.join(str(folder / name) for name in PACKAGES)
        # -P keeps this folder, where a file is called as a module of Python's own, off the path.
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(SIDE)],
            cwd=folder,
            env={**os.environ, **ONE_THREAD, "PYTHONPATH": paths},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ask(self, asked: Asked) -> Found:
        """Reconstruct, and return what came out."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps(asked), file=self._process.stdin, flush=True)
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit("a side ended before it answered; its words are above")
        found: Found = json.loads(line)
        return found

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()


def run() -> None:
    """Ask both sides in turns, and print a line for each pair and what they come to."""
    presets = os.environ.get("GS2CI_PRESET", "standard").split(",")
    counts = [int(count) if count else None for count in os.environ.get("GS2CI_FITS", "").split(",")]
    seeds = range(int(os.environ.get("GS2CI_SEEDS", "3")))
    with ExitStack() as stack:
        folder_of_shots = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        other = stack.enter_context(checkout(os.environ.get("GS2CI_AGAINST", "bb9e2cb")))
        sides = []
        for folder, preset, fits in ((ROOT, presets[0], counts[0]), (other, presets[-1], counts[-1])):
            side = Side(folder)
            stack.callback(side.close)
            side.ask(asked(write(folder_of_shots, "boxes", 0, "48x64"), "boxes", 0, "draft"))
            sides.append((side, preset, fits))
        pairs = []
        print(f"{'':18} seed   seconds: this other ratio   PSNR: this  other   nATE        depth, px    far off")
        for number, (name, seed) in enumerate((name, seed) for name in names() for seed in seeds):
            order = (0, 1) if number % 2 == 0 else (1, 0)
            file = write(folder_of_shots, name, seed, os.environ.get("GS2CI_SIZE", "96x128"))
            found = {k: sides[k][0].ask(asked(file, name, seed, *sides[k][1:])) for k in order}
            pairs.append((found[0], found[1]))
            print(line(name, seed, *pairs[-1]), flush=True)
    for text in summary(pairs):
        print(text)


@contextmanager
def checkout(which: str) -> Iterator[Path]:
    """Give the folder of another checkout, made for the time being where a commit is named."""
    if Path(which).is_dir():
        yield Path(which).resolve()
        return
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "other"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(folder), which], check=True)
        try:
            yield folder
        finally:
            subprocess.run([*git, "remove", "--force", str(folder)], check=True)


def names() -> list[str]:
    return os.environ.get("GS2CI_CASES", " ".join(SCENES)).split()


def write(folder: Path, name: str, seed: int, size: str) -> Path:
    """Write a measurement, whose masks and noise the seed draws, as an exposure file; return its path."""
    known = name in (*SCENES, "ball", "textureless")
    file = "" if known else str(Path(os.environ.get("GS2CI_DATA", "")) / f"{name}.npz")
    height, width = (None, None) if size == "all" else (int(side) for side in size.split("x"))
    middle = None if height is None or width is None else (height, width)
    shot = Case(name, file=file, scene=name if known else "", size=middle).shot(seed)
    return write_shots(folder / f"{name.replace('/', '_')}-{seed}-{size}.h5", [shot])


def asked(file: Path, name: str, seed: int, preset: str, fits: int | None = None) -> Asked:
    whole = os.environ.get("GS2CI_SIZE") == "all"
    between = name.endswith("antinous") and whole
    return {"file": str(file), "between": between, "seed": seed, "preset": preset, "fits": fits}


def line(name: str, seed: int, this: Found, other: Found) -> str:
    """Return a pair as a line of the table."""
    figures = [
        f"{this['seconds']:6.1f} {other['seconds']:6.1f} {this['seconds'] / other['seconds']:5.2f}",
        f"{this['psnr_db']:6.2f} {other['psnr_db']:6.2f}",
        *(" ".join(_figure(side[key]) for side in (this, other)) for key in ("nate", "median_px", "far_off")),
    ]
    return f"{name:18} {seed:4}   " + "   ".join(figures)


def _figure(value: float | None) -> str:
    return "    –" if value is None else f"{value:.3f}"


def summary(pairs: list[tuple[Found, Found]]) -> Iterator[str]:
    """Say what pairs come to: the ratio of times, and how far the others differ, with its standard error."""
    logs = np.log([this["seconds"] / other["seconds"] for this, other in pairs])
    yield f"time, geometric mean of the ratios: {np.exp(logs.mean()):.3f} ({np.exp(-logs.mean()):.2f} times as fast)"
    for key, what in (("psnr_db", "PSNR, dB"), ("nate", "nATE"), ("median_px", "depth, px"), ("far_off", "far off")):
        both = [(this[key], other[key]) for this, other in pairs]
        gained = [one - two for one, two in both if one is not None and two is not None]
        if gained:
            error = np.std(gained, ddof=1) / len(gained) ** 0.5 if len(gained) > 1 else float("nan")
            yield f"{what}, this less other: {np.mean(gained):+.3f} ± {error:.3f} ({len(gained)} pairs)"
