"""The least time of an iteration of a fit on two cards, from what it launches: a model, not a measurement.

    python -m tests.benchmarks gpu_model

One iteration of the coarse stage (coded rendering, loss, its gradient, steps of Gaussians and poses; before there are
surfaces) is made with the renderer `warp` and the counterparts of the fit's kernels, the CPU standing in for the
device. Each launch is counted with the bytes of the arrays that it is given, each once; of Warp's kernels those that
make the lists run, so that the lists have their true lengths, and the others are only counted. Operations are counted
for the two kernels that have most of them: each pixel of a block with each Gaussian of its list, as if none ended
early. A card cannot need less than the bytes at its memory's rate, nor than the operations at its arithmetic's. Apart
from it is measured what an iteration costs Python once its graphs are captured, with nothing computed.
"""

import os
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from gs2ci.core.records import Shot
from gs2ci.reconstruct.fit.coarse.exposure import FittedExposure
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.state import FitState
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.settings import Settings
from gs2ci.render import places
from gs2ci.render.backend import load_backend
from gs2ci.render.interface import Backend
from tests.benchmarks.gpu_parts import SIZES
from tests.benchmarks.scenes import fitted_like, random_masks, small_motion

# Memory, GB/s, and arithmetic in float32, TFLOP/s: the makers' data sheets.
CARDS = {"H100 SXM": (3350.0, 67.0), "RTX 4090": (1008.0, 82.6)}
# Operations of a pixel with a Gaussian: exponent, exponential, weight and colour; in the gradient also the derivative
# and the pixel's part in two products of matrices.
BLEND_OPERATIONS, GRADIENT_OPERATIONS = 26, 78
BLOCK = 32
SERVED = Settings().raster.relist_every
"""Iterations that lists serve, over which figures are means."""
_LISTING = ("project", "emit", "find_ranges")
# What only looks at memory in another way.
_VIEWS = (
    *("view", "_unsafe_view", "reshape", "alias", "detach", "slice", "select", "permute", "transpose", "t", "expand"),
    *("unsqueeze", "squeeze", "split", "split_with_sizes", "unbind", "as_strided", "_local_scalar_dense", "lift_fresh"),
)


@dataclass
class Counted:
    """What an iteration launches: by name how often, and all bytes; and the entries of the lists."""

    launches: Counter[str] = field(default_factory=Counter)
    bytes: int = 0
    entries: int = 0

    def add(self, name: str, size: int) -> None:
        self.launches[name] += 1
        self.bytes += size


class _Torch(TorchDispatchMode):
    """Counts torch's operations."""

    def __init__(self, counted: Counted) -> None:
        super().__init__()
        self._counted = counted

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = function(*args, **(kwargs or {}))
        name = function.overloadpacket.__name__
        if name not in _VIEWS:
            tensors = [one for one in torch.utils._pytree.tree_leaves((args, result)) if isinstance(one, torch.Tensor)]
            self._counted.add(f"torch {name}", sum(one.numel() * one.element_size() for one in tensors))
        return result


@contextmanager
def counting(counted: Counted) -> Iterator[None]:
    """Count what is launched, a graph as one launch; of Warp's kernels only those of the lists run."""
    import warp as wp  # noqa: PLC0415  an extra

    def size(arrays: Any) -> int:
        return sum(a.size * wp.types.type_size_in_bytes(a.dtype) for a in arrays if isinstance(a, wp.array))

    plain = {name: getattr(wp, name) for name in ("launch", "launch_tiled", "zeros")}
    scan, sort = wp.utils.array_scan, wp.utils.radix_sort_pairs

    def launch(kernel: Any, dim: Any, inputs: Any, outputs: Any = (), **rest: Any) -> Any:
        if rest.get("record_cmd"):  # it counts when it is made
            return plain["launch"](kernel, dim=dim, inputs=inputs, outputs=list(outputs), **rest)
        counted.add(f"warp {kernel.key}", size([*inputs, *outputs]))
        if kernel.key in _LISTING:
            plain["launch"](kernel, dim=dim, inputs=inputs, outputs=outputs, **rest)
        return None

    def launch_tiled(kernel: Any, dim: Any, inputs: Any, outputs: Any = (), **rest: Any) -> Any:
        if rest.get("record_cmd"):
            return plain["launch_tiled"](kernel, dim=dim, inputs=inputs, outputs=list(outputs), **rest)
        counted.add(f"warp {kernel.key}", size([*inputs, *outputs]))
        return None

    def launched(kept: Any, stream: Any = None) -> None:
        counted.add(f"warp {kept.kernel.key}", size(kept.fwd_args))

    def replayed(graph: Any, stream: Any = None) -> None:
        counted.add("warp graph", 0)

    def zeros(*args: Any, **kwargs: Any) -> Any:
        made = plain["zeros"](*args, **kwargs)
        counted.add("warp zeros", size([made]))
        return made

    def scanned(counts: Any, starts: Any, **kwargs: Any) -> None:
        counted.add("warp scan", size([counts, starts]))
        scan(counts, starts, **kwargs)

    def sorted_pairs(keys: Any, rows: Any, total: int, begin: int, end: int) -> None:
        # Eight bits in a pass; each pass reads and writes keys and values, and reads the keys once more.
        passes = -(-(end - begin) // 8)
        counted.entries = total
        counted.launches["warp sort"] += passes
        counted.bytes += passes * total * 32
        sort(keys, rows, total, begin, end)

    with ExitStack() as stack:
        for owner, name, new in (
            *((wp, "launch", launch), (wp, "launch_tiled", launch_tiled), (wp, "zeros", zeros)),
            *((wp.utils, "array_scan", scanned), (wp.utils, "radix_sort_pairs", sorted_pairs)),
            *((wp.Launch, "launch", launched), (wp, "capture_launch", replayed)),
        ):
            stack.enter_context(patch.object(owner, name, new))
        stack.enter_context(_Torch(counted))
        yield


def state(count: int, size: tuple[int, int], views: int, backend: Backend | None = None) -> FitState:
    """Return a fit of a random measurement, before its first iteration."""
    scene, intrinsics = fitted_like(count, size)
    matrix, path = intrinsics.double().numpy(), small_motion(views).double().numpy()
    masks = random_masks(views, size, 0.25).numpy()
    shot = Shot(np.random.default_rng(0).random((*size, 3), np.float32), masks, np.ones(views, np.float32))
    geometry = Geometry(
        world_to_camera=path,
        intrinsics=matrix,
        focal_source="file",
        inverse_depth=np.ones(size, np.float32),
        reference=views // 2,
        tracks=100,
        reprojection_rms_px=0.1,
        parallax_px=2.0,
        verdict="full",
        notes=(),
    )
    renderer = ShotRenderer(shot, matrix, backend or load_backend("warp", Settings().raster))
    settings = replace(CoarseSettings(), surfaces=None, mask_moments_from=0.0)
    exposure = FittedExposure(Holdout(shot, np.zeros(size, bool)), renderer, geometry)
    return FitState([exposure], scene, settings, seed=0)


def iteration(fit: FitState) -> None:
    """Make one iteration; nothing that it computes counts."""
    fit.is_finite(fit.backward(0.5, 1))
    fit.step(0.5, 1.0)


def run() -> None:
    """Print the model."""
    sizes = [(500, (48, 64), 4)] if os.environ.get("GS2CI_SMALL") else SIZES
    places.count_host_as_device(yes=True)
    try:
        print(
            "| Gaussians | size | views | launches | MB | entries | GFLOP | "
            + " | ".join(f"{card}: memory, arithmetic ms" for card in CARDS)
            + " |\n|---:|---|---:|---:|---:|---:|---:|"
            + "---:|" * len(CARDS)
        )
        for count, size, views in sizes:
            counted = _counted(state(count, size, views))
            operations = counted.entries * BLOCK * (BLEND_OPERATIONS + GRADIENT_OPERATIONS)
            cells = " | ".join(
                f"{counted.bytes / SERVED / rate / 1e6:.2f}, {operations / flops / 1e9:.2f}"
                for rate, flops in CARDS.values()
            )
            figures = (
                f"{sum(counted.launches.values()) / SERVED:.0f} | {counted.bytes / SERVED / 1e6:.0f} | "
                f"{counted.entries} | {operations / 1e9:.1f}"
            )
            print(f"| {count} | {size[0]} × {size[1]} | {views} | {figures} | {cells} |", flush=True)
        print(f"\nlaunches of {SERVED}:", ", ".join(f"{n} {name}" for name, n in counted.launches.most_common()))
        host_ms, calls = _host()
        print(f"\nan iteration costs Python {host_ms:.2f} ms (processor time), for {calls:.1f} calls to the device")
    finally:
        places.count_host_as_device(yes=False)


def _counted(fit: FitState) -> Counted:
    """Count as many iterations as lists serve, after the first, in which memory is made ready.

    No graph is captured: whether launches come from Python or from a graph, the card makes them.
    """
    from gs2ci.render import recording  # noqa: PLC0415  an extra

    counted = Counted()
    with counting(Counted()):
        iteration(fit)
    with patch.object(recording, "_may_capture", lambda _: False), counting(counted):
        for _ in range(SERVED):
            iteration(fit)
    return counted


def _host() -> tuple[float, float]:
    """Return what an iteration costs Python, ms, and how many calls to the device it makes, graphs being captured.

    The scene is so small, and its launches are left out, that Python is what takes the time; the least of several
    rounds of as many iterations as lists serve.
    """
    fit = state(20, (16, 16), 2)
    for _ in range(3 * SERVED):
        iteration(fit)
    calls, times = Counted(), []
    with _nothing_computed():
        for _ in range(12):
            began = time.process_time()
            for _ in range(SERVED):
                iteration(fit)
            times.append((time.process_time() - began) / SERVED)
    with counting(calls):
        for _ in range(SERVED):
            iteration(fit)
    return 1e3 * min(times), sum(calls.launches.values()) / SERVED


@contextmanager
def _nothing_computed() -> Iterator[None]:
    """Let Warp launch nothing on the host, whatever it is told."""
    import warp as wp  # noqa: PLC0415  an extra
    from warp._src import context  # noqa: PLC0415  what a launch comes down to on the host

    with ExitStack() as stack:
        for owner, name in (
            *((context, "invoke"), (context, "invoke_cpu_blocks"), (wp, "capture_launch")),
            (wp.utils, "radix_sort_pairs"),
        ):
            stack.enter_context(patch.object(owner, name, lambda *_, **__: None))
        yield
