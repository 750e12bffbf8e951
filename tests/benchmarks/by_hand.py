"""Own code for which a library has a function: a comparison with the library.

MAT files of version 5 whose bytes were damaged: how often scipy's reader and ours end the process. Gray-code stripes:
OpenCV's patterns against ours. A chart of a page: matplotlib's SVG against ours. And the other way round: the golden
section that was written by hand against scipy's search, for the focal length.
Decision: docs/decisions/libraries.md.
"""

import io
import multiprocessing
import re
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import cv2
import matplotlib
import numpy as np
import scipy.io
import scipy.optimize
from matplotlib.figure import Figure

from gs2ci.core.errors import Gs2ciError
from gs2ci.core.foreign.mat5 import read_mat5
from gs2ci.evaluate.pages.charts import Chart, Line, chart_svg
from gs2ci.reconstruct.geometry.path import focal
from gs2ci.reconstruct.geometry.path.motion import MotionSettings
from gs2ci_calibration.masks.gray_code import GrayCode
from tests.reconstruct.conftest import bent_path, make_tracks

TRIALS, FILES, CHANGED_BYTES = 5, 400, 3


def run() -> None:
    """Print all comparisons."""
    with tempfile.TemporaryDirectory() as folder:
        _damaged_mat(Path(folder))
    _gray_code()
    _chart()
    _focal()


def _damaged_mat(folder: Path) -> None:
    rng = np.random.default_rng(0)
    arrays = {"meas": rng.random((24, 32)), "mask": rng.random((24, 32, 4)) > 0.5, "note": "a text"}
    scipy.io.savemat(folder / "whole.mat", arrays)
    whole = np.frombuffer((folder / "whole.mat").read_bytes(), np.uint8)
    for name, read in (("scipy.io.loadmat", _by_scipy), ("read_mat5", _by_ours)):
        deaths = [_death(read, whole, folder / f"{trial}.mat", trial) for trial in range(TRIALS)]
        died = [death for death in deaths if death is not None]
        print(f"damaged .mat, {name}: the process died in {len(died)} of {TRIALS} trials of {FILES} files, at {died}")


def _death(read: Callable[[Path], None], whole: np.ndarray, path: Path, seed: int) -> int | None:
    """Read damaged files in a process of its own; return how many it had read when it died, None if it did not."""
    count = multiprocessing.get_context("fork").Value("i", 0)
    process = multiprocessing.get_context("fork").Process(target=_read_all, args=(read, whole, path, seed, count))
    process.start()
    process.join()
    return count.value if process.exitcode else None


def _read_all(read: Callable[[Path], None], whole: np.ndarray, path: Path, seed: int, count: object) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(FILES):
        damaged = whole.copy()
        damaged[rng.integers(128, len(whole), CHANGED_BYTES)] = rng.integers(0, 256, CHANGED_BYTES)
        path.write_bytes(damaged.tobytes())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read(path)
        count.value += 1  # type: ignore[attr-defined]


def _by_scipy(path: Path) -> None:
    try:
        scipy.io.loadmat(path)
    except Exception:
        return


def _by_ours(path: Path) -> None:
    try:
        found = read_mat5(path)
        for key in found.entries:
            found.load(key)
    except Gs2ciError:
        return


def _gray_code() -> None:
    height, width = 48, 64
    ours = GrayCode((height, width), finest=1).patterns()
    _, theirs = cv2.structured_light.GrayCodePattern.create(width, height).generate()
    stripes = np.array(theirs[::2]) // 255
    bits = len(ours) // 2
    same = np.array_equal(np.concatenate([stripes[bits:], stripes[:bits]]), ours)
    coarse = len(GrayCode((height, width)).patterns())
    print(f"Gray code, {height} x {width}: OpenCV {len(theirs)} patterns, each with its inverse, finest stripe 1 px")
    print(f"    ours: {len(ours)} with stripes of 1 px, which are {'the same' if same else 'others'}; {coarse} of 8 px")


def _chart() -> None:
    """Draw one chart of two courses and their points both ways."""
    steps = np.arange(40)
    courses = {"accent": np.exp(-steps / 15), "truth": np.exp(-steps / 10)}
    lines = [Line(name, steps.tolist(), values.tolist(), name) for name, values in courses.items()]

    def ours() -> str:
        return str(chart_svg(Chart(lines, "iteration", "loss", "a loss that falls"), 640, 300))

    def theirs() -> str:
        figure = Figure(figsize=(6.4, 3.0))
        axes = figure.subplots()
        for values in courses.values():
            axes.plot(steps, values, ".-")
        axes.set(xlabel="iteration", ylabel="loss")
        drawn = io.StringIO()
        with matplotlib.rc_context({"svg.fonttype": "none"}):
            figure.savefig(drawn, format="svg")
        return drawn.getvalue()

    for name, draw in (("matplotlib", theirs), ("chart_svg", ours)):
        draw()
        began = time.process_time()
        for _ in range(20):
            svg = draw()
        spent = (time.process_time() - began) / 20
        fixed, said = len(re.findall(r"#[0-9a-f]{6}", svg)), svg.count("<title>")
        print(f"chart, {name}: {len(svg)} bytes, {1e3 * spent:.1f} ms, {fixed} fixed colours, {said} points say theirs")


def _focal() -> None:
    """Find focal lengths with both searches; print errors, the costs reached, and how often each tried."""
    by_scipy = focal.minimize_scalar
    for true_px in (180.0, 300.0, 480.0):
        for seed in (0, 1):
            poses = bent_path(6, np.random.default_rng(2 + seed), length=0.25, turn=0.05)
            scene = make_tracks(seed=seed, views=6, points=150, focal=true_px, poses=poses, noise_px=0.2)
            said = []
            for name, search in (("golden section", _golden_section), ("scipy", by_scipy)):
                searches = []

                def kept(*arguments, search=search, searches=searches, **options):  # type: ignore[no-untyped-def]
                    searches.append(search(*arguments, **options))
                    return searches[-1]

                focal.minimize_scalar = kept
                found = focal.estimate_focal(scene.tracks, (240, 320), focal.FocalSettings(), MotionSettings())
                error = abs(found.intrinsics[0, 0] - true_px)
                said.append(f"{name} {error:.2f} px off, cost {searches[0].fun:.4f}, {searches[0].nfev} tried")
            focal.minimize_scalar = by_scipy
            print(f"focal length {true_px:.0f} px, seed {seed}: {'; '.join(said)}")


def _golden_section(
    function: Callable[[float], float], bounds: tuple[float, float], **_: object
) -> scipy.optimize.OptimizeResult:
    """Narrow a bracket around a minimum in six steps, as gs2ci did."""
    low, high = bounds
    shrink = (np.sqrt(5) - 1) / 2
    a, b = high - shrink * (high - low), low + shrink * (high - low)
    at_a, at_b = function(a), function(b)
    for _step in range(6):
        if at_a < at_b:
            high, b, at_b = b, a, at_a
            a = high - shrink * (high - low)
            at_a = function(a)
        else:
            low, a, at_a = a, b, at_b
            b = low + shrink * (high - low)
            at_b = function(b)
    return scipy.optimize.OptimizeResult(x=a if at_a < at_b else b, fun=min(at_a, at_b), nfev=8)
