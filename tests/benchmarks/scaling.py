"""Growth of cost and memory with pixels, views, Gaussians, open share and compression ratio; and the machine's limits.

An iteration of the fit is one forward and backward pass of the rasteriser with poses; one thing grows at a time.
Printed for each: the fastest of several rounds (other load only ever adds time), how many pairs of pixel and Gaussian
were blended, the rasteriser's memory, and the exponent p of cost ∝ size^p that fits best. Then a step of GAP-TV and a
plane sweep. Above all, what this machine can do at most, measured on the same number of threads: fused multiply-adds
on 16 lanes from registers, and bytes through a triad that no cache holds; each cost is said in shares of these.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numba
import numpy as np
import torch
from torch import Tensor

from gs2ci.core.kernels import f32_1, i64, in_parts, kernel
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, gap_tv
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings, sweep
from gs2ci.render.conventions import TERMINATION_TRANSMITTANCE
from gs2ci.render.cpu.backend import CpuBackend
from gs2ci.render.cpu.passes import Inputs, camera_fields, render_cells
from gs2ci.render.cpu.workspace import Workspace
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.simd.vector import LANES, broadcast, fused, store
from tests.benchmarks.scenes import fitted_like, random_masks, small_motion
from tests.tables.works import least_seconds

ROUNDS = 5
ACCUMULATORS = 8
FMA_STEPS = 2_000_000
TRIAD_FLOATS = 24_000_000
# Parameters, their gradients and Adam's two moments are each read and written at least once per iteration: 14 floats.
LEAST_BYTES_PER_GAUSSIAN = 14 * 4 * 7


@dataclass(frozen=True)
class Size:
    """What an iteration works on."""

    height: int = 192
    width: int = 256
    views: int = 8
    gaussians: int = 12_000
    open_share: float = 0.25


@dataclass(frozen=True)
class Cost:
    """Of one iteration."""

    seconds: float
    pairs: int
    mib: float
    gaussians: int


@dataclass(frozen=True)
class Limits:
    """What the machine can do in a second, all threads together."""

    fmas: float
    bytes: float


@kernel(i64, i64, i64, f32_1)
def _fma_chains(from_task, to_task, steps, out):
    for task in range(from_task, to_task):
        a = broadcast(np.float32(0.999))
        b = broadcast(np.float32(1e-3))
        # As many chains as hide the latency of one; more would not fit into the registers of AVX2.
        c0, c1, c2, c3, c4, c5, c6, c7 = a, b, a, b, a, b, a, b
        for _ in range(steps):
            c0, c1, c2, c3 = fused(c0, a, b), fused(c1, a, b), fused(c2, a, b), fused(c3, a, b)
            c4, c5, c6, c7 = fused(c4, a, b), fused(c5, a, b), fused(c6, a, b), fused(c7, a, b)
        store(out, task * LANES, c0 + c1 + c2 + c3 + c4 + c5 + c6 + c7)


@kernel(i64, i64, f32_1, f32_1, f32_1)
def _triad(start, end, a, b, c):
    for i in range(start, end):
        a[i] = b[i] + np.float32(0.5) * c[i]


def measured_limits() -> Limits:
    threads = numba.get_num_threads()
    out = np.zeros(threads * LANES, np.float32)
    fma_s = fastest(lambda: in_parts(_fma_chains, threads, FMA_STEPS, out))
    a, b, c = (np.ones(TRIAD_FLOATS, np.float32) for _ in range(3))
    triad_s = fastest(lambda: in_parts(_triad, TRIAD_FLOATS, a, b, c))
    # The line that is written is read first.
    return Limits(threads * FMA_STEPS * ACCUMULATORS * LANES / fma_s, 4 * 4 * TRIAD_FLOATS / triad_s)


def fastest(work: Callable[[], object], rounds: int = ROUNDS) -> float:
    work()  # compiles, and makes room
    return least_seconds(work, rounds)


def iteration_cost(size: Size) -> Cost:
    shape = (size.height, size.width)
    scene, intrinsics = fitted_like(size.gaussians, shape)
    poses, masks = small_motion(size.views), random_masks(size.views, shape, size.open_share)
    target = masks.sum(0)[..., None] * 0.5
    backend = CpuBackend()
    coding = backend.code(masks)
    seconds = fastest(lambda: _iterate(backend, scene, poses, intrinsics, coding, target))
    workspace = Workspace()
    inputs = Inputs(
        *(t.numpy() for t in scene.parameters().values()),
        poses.numpy(),
        camera_fields(intrinsics.double().numpy(), *shape),
    )
    kept = render_cells(inputs, coding.layout, TERMINATION_TRANSMITTANCE, workspace).lists.entries
    return Cost(seconds, int(kept.sum()) * LANES, workspace.nbytes / 2**20, size.gaussians)


def _iterate(
    backend: CpuBackend, scene: Gaussians, poses: Tensor, intrinsics: Tensor, coding: object, target: Tensor
) -> None:
    scene = scene.map(lambda t: t.clone().requires_grad_())
    coded = backend.coded(scene, poses.clone().requires_grad_(), intrinsics, coding)
    (coded - target).square().mean().backward()


def exponent(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """Fit p of cost ∝ size^p."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])


def sweeps(base: Size) -> dict[str, dict[float, Size]]:
    """Return what grows, with its values."""
    sides = (0.5, 0.71, 1.0, 1.41, 2.0)
    return {
        "pixels": {
            (s := replace(base, height=round(base.height * k), width=round(base.width * k))).height * s.width: s
            for k in sides
        },
        "views": {n: replace(base, views=n) for n in (2, 4, 8, 16, 32)},
        "Gaussians": {n: replace(base, gaussians=n) for n in (3_000, 6_000, 12_000, 24_000, 48_000)},
        "open share": {share: replace(base, open_share=share) for share in (0.05, 0.1, 0.25, 0.5, 1.0)},
        # The measurement's light stays the same: one mask in N is open at a pixel.
        "compression": {n: replace(base, views=n, open_share=1 / n) for n in (2, 4, 8, 16, 32)},
    }


def coded_shot(size: Size) -> Shot:
    rng = np.random.default_rng(0)
    masks = (rng.random((size.views, size.height, size.width)) < size.open_share).astype(np.float32)
    measurement = np.repeat(0.5 * masks.sum(0)[..., None], 3, axis=2).astype(np.float32)
    return Shot(measurement, masks, np.ones(size.views, np.float32)).check()


def sweep_seconds(size: Size, planes: int = 24) -> float:
    views = np.random.default_rng(0).random((size.views, size.height, size.width, 3)).astype(np.float32)
    poses = small_motion(size.views).double().numpy()
    focal = 1.1 * size.width
    camera = np.array([[focal, 0, size.width / 2], [0, focal, size.height / 2], [0, 0, 1.0]])
    settings = SweepSettings(planes=planes, most_pixels=10**9)
    return fastest(lambda: sweep(views, poses, camera, size.views // 2, (0.1, 0.5), settings), 2)


def run() -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(1)  # as in a reconstruction
    try:
        limits = measured_limits()
        print(
            f"{numba.get_num_threads()} threads: {limits.fmas / 1e9:.0f} G fused multiply-adds/s, "
            f"{limits.bytes / 1e9:.1f} GB/s"
        )
        for name, sizes in sweeps(Size()).items():
            _print_iterations(name, sizes, limits)
        _print_stages(Size())
    finally:
        torch.set_num_threads(before)


def _print_iterations(name: str, sizes: dict[float, Size], limits: Limits) -> None:
    costs = {value: iteration_cost(size) for value, size in sizes.items()}
    print(
        f"\niteration against {name}\n{name:>12} {'ms':>9} {'M pairs':>9} {'FMA each':>9} {'bandwidth':>9} {'MiB':>7}"
    )
    for value, cost in costs.items():
        # What a pair costs, in multiply-adds that the machine could have done meanwhile.
        fmas = cost.seconds * limits.fmas / max(cost.pairs, 1)
        moved = cost.gaussians * LEAST_BYTES_PER_GAUSSIAN / limits.bytes / cost.seconds
        print(f"{value:12g} {1e3 * cost.seconds:9.2f} {cost.pairs / 1e6:9.2f} {fmas:9.0f} {moved:9.1%} {cost.mib:7.1f}")
    values = list(costs)
    print(
        f"exponents: time {exponent(values, [c.seconds for c in costs.values()]):.2f}, "
        f"pairs {exponent(values, [c.pairs for c in costs.values()]):.2f}, "
        f"memory {exponent(values, [c.mib for c in costs.values()]):.2f}"
    )


def _print_stages(base: Size) -> None:
    settings = GapTvSettings(iterations=4)
    stages: dict[str, Callable[[Size], float]] = {
        "GAP-TV, a step": lambda size: fastest(lambda: gap_tv(coded_shot(size), settings), 2) / settings.iterations,
        "sweep, 24 planes": sweep_seconds,
    }
    print(f"\n{'':18} {'against':>10} {'ms':>30} {'exponent':>9}")
    for stage, cost in stages.items():
        for name in ("pixels", "views"):
            sizes = sweeps(base)[name]
            seconds = [cost(size) for size in sizes.values()]
            listed = " ".join(f"{1e3 * s:.1f}" for s in seconds)
            print(f"{stage:18} {name:>10} {listed:>30} {exponent(list(sizes), seconds):9.2f}")
