"""The CPU rasteriser against a vectorised torch rasteriser: one coded measurement, forward and backward.

Both render the coded sum of 8 views of 256 x 256 from 20 000 Gaussians and differentiate a squared error with
respect to all parameters and poses, on one thread each, taking turns in one process. Printed: the fastest of
several rounds (other load only ever adds time), their ratio, and how far the two results lie apart.

Then the same while the Gaussians drift as in a fit, with lists made anew in every iteration or kept for several, taking
turns: the mean time of an iteration, relative to the former, and how far the coded sum of the last iteration before a
new listing lies from that of fresh lists.
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numba
import torch
from torch import Tensor

from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.settings import RasterSettings
from tests.benchmarks.scenes import fitted_like, random_masks, small_motion
from tests.benchmarks.torch_rasteriser import coded_sum

VIEWS, SIZE, GAUSSIANS = 8, (256, 256), 20_000
OPEN_SHARES = (0.25, 1.0)
ROUNDS_FAST, ROUNDS_SLOW = 12, 3
KEPT_FOR = (1, 2, 4, 8)
DRIFT_ROUNDS = 6
# Standard deviations of one iteration's steps: 0.03 px on the screen, and what Adam does to shape and opacity midway.
DRIFT_PX, DRIFT_LOG_SCALE, DRIFT_LOGIT = 0.03, 3e-3, 2e-2


def run() -> None:
    threads = torch.get_num_threads(), numba.get_num_threads()
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    try:
        for open_share in OPEN_SHARES:
            _compare(open_share)
            _compare_reuse(open_share)
    finally:
        torch.set_num_threads(threads[0])
        numba.set_num_threads(threads[1])


def _compare(open_share: float) -> None:
    scene, intrinsics = fitted_like(GAUSSIANS, SIZE)
    poses, masks = small_motion(VIEWS), random_masks(VIEWS, SIZE, open_share)
    target = masks.sum(0)[..., None] * 0.5
    backend = load_backend("cpu")
    coding = backend.code(masks)
    ways: dict[str, Callable[[Gaussians, Tensor], Tensor]] = {
        "gs2ci": lambda s, p: backend.coded(s, p, intrinsics, coding),
        "torch": lambda s, p: coded_sum(s, p, intrinsics, masks),
    }
    started = time.perf_counter()
    results = {name: _iterate(way, scene, poses, target)[1:] for name, way in ways.items()}
    warm_up = time.perf_counter() - started
    seconds = {name: float("inf") for name in ways}
    for round_ in range(ROUNDS_FAST):
        for name, way in ways.items():
            if name == "gs2ci" or round_ < ROUNDS_SLOW:
                seconds[name] = min(seconds[name], _iterate(way, scene, poses, target)[0])
    print(
        f"{GAUSSIANS} Gaussians, {VIEWS} views {SIZE[1]}x{SIZE[0]}, {open_share:.0%} of pixels open, "
        f"forward + backward with poses, one thread (warm-up {warm_up:.1f} s):\n"
        f"  gs2ci {seconds['gs2ci'] * 1e3:7.1f} ms   torch {seconds['torch'] * 1e3:7.0f} ms   "
        f"ratio {seconds['torch'] / seconds['gs2ci']:.1f}x"
    )
    differences = [
        f"{name} {float((fast - slow).norm() / slow.norm()):.0e}"
        for name, fast, slow in zip(("coded sum", "d means", "d poses"), *results.values(), strict=True)
    ]
    print(f"  apart by (relative): {', '.join(differences)}")


def _iterate(
    way: Callable[[Gaussians, Tensor], Tensor], scene: Gaussians, poses: Tensor, target: Tensor
) -> tuple[float, Tensor, Tensor, Tensor]:
    """Return the seconds of one forward and backward pass, the coded sum and two of the gradients."""
    scene = scene.map(lambda t: t.clone().requires_grad_())
    poses = poses.clone().requires_grad_()
    started = time.perf_counter()
    coded = way(scene, poses)
    (coded - target).square().mean().backward()
    seconds = time.perf_counter() - started
    assert scene.means.grad is not None
    assert poses.grad is not None
    return seconds, coded.detach(), scene.means.grad, poses.grad


def _compare_reuse(open_share: float) -> None:
    scene, intrinsics = fitted_like(GAUSSIANS, SIZE)
    poses, masks = small_motion(VIEWS), random_masks(VIEWS, SIZE, open_share)
    target = masks.sum(0)[..., None] * 0.5
    drifting = _drifted(scene, float(intrinsics[0, 0]), max(KEPT_FOR))
    backends = {every: load_backend("cpu", RasterSettings(relist_every=every)) for every in KEPT_FOR}
    codings = {every: backend.code(masks) for every, backend in backends.items()}
    seconds: dict[int, list[float]] = {every: [] for every in KEPT_FOR}
    coded: dict[int, Tensor] = {}
    for _ in range(DRIFT_ROUNDS):
        for every, backend in backends.items():
            way = partial(backend.coded, intrinsics=intrinsics, coding=codings[every], reuse=backend.reuse())
            taken = []
            for moved in drifting:
                took, coded[every], *_ = _iterate(way, moved, poses, target)
                taken.append(took)
            seconds[every].append(statistics.mean(taken))
    print(f"  lists kept while Gaussians drift by {DRIFT_PX} px per iteration, {open_share:.0%} open:")
    for every in KEPT_FOR:
        relative = min(seconds[every]) / min(seconds[1])
        apart = float((coded[every] - coded[1]).norm() / coded[1].norm())
        print(f"    for {every} iterations: {relative:.2f} of the time, {apart:.0e} apart")


def _drifted(scene: Gaussians, focal_px: float, count: int) -> list[Gaussians]:
    """Return the scene, and the scene after each of `count` - 1 steps of a random walk."""
    generator = torch.Generator().manual_seed(0)
    scenes = [scene]
    for _ in range(count - 1):
        last = scenes[-1]
        step = {
            name: torch.randn(tensor.shape, generator=generator)
            for name, tensor in (("means", last.means), ("scales", last.log_scales), ("logits", last.opacity_logits))
        }
        scenes.append(
            replace(
                last,
                means=last.means + DRIFT_PX * last.means[:, 2:] / focal_px * step["means"],
                log_scales=last.log_scales + DRIFT_LOG_SCALE * step["scales"],
                opacity_logits=last.opacity_logits + DRIFT_LOGIT * step["logits"],
            )
        )
    return scenes
