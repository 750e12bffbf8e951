"""What only a GPU can tell of the renderer `warp`, in one run of a few minutes.

    python -m tests.benchmarks gpu      on the first CUDA device
    GS2CI_DEVICE=cpu GS2CI_SMALL=1 python -m tests.benchmarks gpu      its flow alone, by fibers

Errors against the definition, the same bits twice, then milliseconds of an iteration (coded rendering and its gradient)
at four sizes, with the copies to and from the host and without them, beside the CPU's renderer on the same machine, and
of an iteration of a fit whose tensors lie on the device. Then whole reconstructions by two presets, on the device and
on the CPU, with their seconds by stage.
"""

import os
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct import pipeline
from gs2ci.reconstruct.presets.named import preset
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.settings import RasterSettings
from tests.benchmarks.scenes import fitted_like, random_masks, small_motion
from tests.render.reference import ReferenceBackend
from tests.stability.benches import Bench

SIZES = [(2000, (96, 128), 8), (12000, (192, 256), 8), (48000, (512, 512), 8), (48000, (512, 512), 32)]
ROUNDS = 20


def run() -> None:
    """Print the figures."""
    import warp as wp  # noqa: PLC0415  an extra

    from gs2ci.render.warp.backend import WarpBackend  # noqa: PLC0415

    small = bool(os.environ.get("GS2CI_SMALL"))
    backend = WarpBackend(RasterSettings(), os.environ.get("GS2CI_DEVICE"))
    print(f"device: {wp.get_device(backend.place).name}; warp {wp.config.version}")
    began = time.perf_counter()
    _errors(WarpBackend(RasterSettings(termination_transmittance=0.0), backend.place))
    print(f"first rendering, with all compiling: {time.perf_counter() - began:.1f} s\n")
    print(
        "| Gaussians | size | views | entries | ms, device | ms, with copies | ms, CPU renderer | "
        "ms, fit's iteration | same bits twice |"
    )
    print("|---:|---|---:|---:|---:|---:|---:|---:|---|")
    for count, size, views in [(500, (48, 64), 4)] if small else SIZES:
        _row(backend, count, size, views, rounds=2 if small else ROUNDS)
    for name in ("draft",) if small else ("draft", "standard"):
        for where in (f"warp:{backend.place}", "cpu"):
            _whole(name, where, (48, 64) if small else (264, 353))


def _errors(backend) -> None:
    size = (40, 48)
    scene, intrinsics = fitted_like(300, size, 2)
    poses, masks, weights = small_motion(3), random_masks(3, size, 0.25), torch.randn(*size, 3)
    found, truth = (_outcome(one, scene, poses, intrinsics, masks, weights) for one in (backend, ReferenceBackend()))
    for name, exact in truth.items():
        error = float(torch.linalg.vector_norm(found[name].double() - exact) / torch.linalg.vector_norm(exact))
        print(f"error of {name}, relative in the 2-norm: {error:.1e}")


def _outcome(backend, scene: Gaussians, poses, intrinsics, masks, weights) -> dict[str, torch.Tensor]:
    kind = torch.float64 if backend.name == "reference" else torch.float32
    leaves = scene.map(lambda one: one.to(kind, copy=True).requires_grad_())
    poses = poses.to(kind, copy=True).requires_grad_()
    image = backend.coded(leaves, poses, intrinsics, backend.code(masks))
    (image * weights.to(kind)).sum().backward()
    return (
        {"image": image.detach()}
        | {name: one.grad for name, one in leaves.parameters().items()}
        | {"poses": poses.grad}
    )


def _row(backend, count: int, size: tuple[int, int], views: int, rounds: int) -> None:
    from gs2ci.render.warp.rendering import Rendering, SceneInputs  # noqa: PLC0415

    scene, intrinsics = fitted_like(count, size)
    poses, masks = small_motion(views), random_masks(views, size, 0.25)
    weights = np.random.default_rng(0).normal(size=(*size, 3)).astype(np.float32)
    padded = np.concatenate([weights.reshape(-1, 3), np.zeros((weights[..., 0].size, 1), np.float32)], axis=1)
    coding = backend.code(masks).coding
    fields = (scene.means, scene.log_scales, scene.quaternions, scene.opacity_logits, scene.colours, poses)
    inputs = SceneInputs.of(*fields)

    def iterate() -> list[np.ndarray]:
        rendering = Rendering(inputs, intrinsics, coding, 1e-4)
        found = rendering.differentiate(torch.from_numpy(padded))
        return [one.numpy() for one in (rendering.gathered(), found.means, found.poses)]

    one, other = iterate(), iterate()
    same = all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    cpu = load_backend("cpu")
    cpu_masks = cpu.code(masks)

    def on_cpu() -> None:
        cpu.coded_with_pull(scene.map(torch.clone), poses, intrinsics, cpu_masks)[1](weights)

    entries = Rendering(inputs, intrinsics, coding, 1e-4)._arrays._lists.total
    kernels = _kernel_ms(backend.place, iterate, rounds)
    print(
        f"| {count} | {size[0]} × {size[1]} | {views} | {entries} | {kernels} | {_least_ms(iterate, rounds):.2f} | "
        f"{_least_ms(on_cpu, max(2, rounds // 4)):.1f} | {_fit_ms(backend, count, size, views, rounds):.2f} | "
        f"{'yes' if same else 'NO'} |",
        flush=True,
    )


def _fit_ms(backend, count: int, size: tuple[int, int], views: int, rounds: int) -> float:
    """Return the time of an iteration of a fit, before there are surfaces; the numbers that it waits for end it."""
    from tests.benchmarks.gpu_model import iteration, state  # noqa: PLC0415  it takes its sizes from here

    fit = state(count, size, views, backend)
    return _least_ms(lambda: iteration(fit), rounds)


def _whole(name: str, backend: str, size: tuple[int, int]) -> None:
    shot = Bench("motorcycle").expose(size)
    began = time.perf_counter()
    found = pipeline.reconstruct(shot, replace(preset(name), backend=backend)).result
    took = time.perf_counter() - began
    psnr_db = float(np.mean(psnr_per_view(found.views, shot.truth.views)))
    stages = ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in found.seconds.items())
    print(f"{name}, {size[0]} × {size[1]}, {backend}: {took:.1f} s ({stages}), {psnr_db:.2f} dB", flush=True)


def _least_ms(call: Callable[[], object], rounds: int) -> float:
    times = []
    for _ in range(rounds):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return 1e3 * min(times)


def _kernel_ms(device: str, call: Callable[[], object], rounds: int) -> str:
    """Return the time of the kernels alone, by the device's own events; of the CPU none."""
    import warp as wp  # noqa: PLC0415

    if not wp.get_device(device).is_cuda:
        return "–"
    totals = []
    for _ in range(rounds):
        wp.timing_begin(cuda_filter=wp.TIMING_KERNEL | wp.TIMING_KERNEL_BUILTIN | wp.TIMING_MEMSET, synchronize=True)
        call()
        totals.append(sum(one.elapsed for one in wp.timing_end(synchronize=True)))
    return f"{min(totals):.2f}"
