"""What is written by hand although a library has it: what the library would do instead.

MAT files of version 5 whose bytes were damaged: how often scipy's reader and ours end the process. Gray-code stripes:
OpenCV's patterns against ours. FFDNet as ONNX: the graph that torch's exporter traces against ours.
Decision: `docs/decisions`, "Formats and graphs written by hand".
"""

import io
import multiprocessing
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import onnx
import onnxruntime
import scipy.io
import torch

from gs2ci.core.errors import Gs2ciError
from gs2ci.core.foreign.mat5 import read_mat5
from gs2ci.reconstruct.learned.ffdnet import Convolution, FfdNet, export_ffdnet
from gs2ci_calibration.masks.gray_code import GrayCode

TRIALS, FILES, CHANGED_BYTES = 5, 400, 3


def run() -> None:
    """Print all three comparisons."""
    with tempfile.TemporaryDirectory() as folder:
        _damaged_mat(Path(folder))
        _ffdnet(Path(folder))
    _gray_code()


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


def _ffdnet(folder: Path) -> None:
    torch.manual_seed(0)
    shapes = ((8, 5), (8, 8), (4, 8))
    network = FfdNet(tuple(Convolution(torch.randn(o, i, 3, 3) / 10, torch.randn(o) / 10) for o, i in shapes))
    traced, names = io.BytesIO(), {"noisy": {0: "n", 2: "h", 3: "w"}, "sigma": {0: "n"}, "denoised": {0: "n"}}
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        torch.onnx.export(
            _Module(network),
            (torch.rand(2, 1, 16, 24), torch.rand(2)),
            traced,
            input_names=["noisy", "sigma"],
            output_names=["denoised"],
            dynamic_axes=names,
            dynamo=False,
        )
    graphs = {"torch.onnx": traced.getvalue(), "export_ffdnet": export_ffdnet(network, folder / "a.onnx").read_bytes()}
    given = {"noisy": np.ones((3, 1, 40, 64), np.float32), "sigma": np.full(3, 0.1, np.float32)}
    onnxruntime.set_default_logger_severity(4)
    for name, graph in graphs.items():
        try:
            onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"]).run(None, given)
            outcome = "runs"
        except onnxruntime.capi.onnxruntime_pybind11_state.InvalidArgument as error:
            outcome = f"fails ({str(error).splitlines()[0][-60:]})"
        nodes = len(onnx.load_from_string(graph).graph.node)
        print(f"FFDNet, {name}: {nodes} nodes; on another number of images it {outcome}")
    print("torch.onnx warns:", *sorted({str(one.message)[:70] for one in said}), sep="\n    ")


class _Module(torch.nn.Module):
    def __init__(self, network: FfdNet) -> None:
        super().__init__()
        self._network = network

    def forward(self, noisy: torch.Tensor, sigma: torch.Tensor) -> torch.Tensor:
        return self._network(noisy, sigma)


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
