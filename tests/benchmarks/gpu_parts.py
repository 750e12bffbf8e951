"""What `gpu` asks of a GPU, part by part; each prints its figures.

Everything takes the renderer's device from `WarpBackend.place`, so that the flow of each part runs by fibers too. Not
here: whole shots (`gpu_whole`), the order and time of all parts (`gpu`).
"""

import importlib.util
import itertools
import os
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch

from gs2ci.api.preparing import compile_kernels
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, decode_signed
from gs2ci.reconstruct.decode.patches.denoiser import _denoise
from gs2ci.reconstruct.decode.patches.flow import Flow
from gs2ci.reconstruct.decode.patches.matching import Lattice, find_groups
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings, sweep
from gs2ci.reconstruct.settings import Settings
from gs2ci.render import devices, places, recording
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.places import working_on
from gs2ci.render.settings import RasterSettings
from gs2ci.render.trial import error_on
from tests.benchmarks.scenes import fitted_like, random_masks, small_motion
from tests.render.reference import ReferenceBackend

SIZES = [(2000, (96, 128), 8), (12000, (192, 256), 8), (48000, (512, 512), 8), (48000, (512, 512), 32)]
LARGE_FIT = "48,000 Gaussians, 512 × 512 × 8"
ROUNDS = 20
_SANITIZED_S = 90
SANITIZERS = (Path("/usr/local/cuda/bin/compute-sanitizer"), Path("/opt/cuda/bin/compute-sanitizer"))


@dataclass(frozen=True)
class Asked:
    """What parts are given.

    Args:
        backend: The renderer `warp` on the device.
        small: Whether only the flow is run.
    """

    backend: Any
    small: bool

    @property
    def place(self) -> str:
        """Get the device, as Warp names it."""
        return str(self.backend.place)

    @property
    def is_cuda(self) -> bool:
        """Get whether it is one."""
        return self.place != "cpu"

    @property
    def rounds(self) -> int:
        """Get how often a short measurement is repeated."""
        return 2 if self.small else ROUNDS


def asked() -> Asked:
    """Return the renderer on the device that the environment names, and whether only the flow is to be run.

    Raises:
        SystemExit: It names none, and there is no CUDA device: minutes on a card are not to be spent on the host.
    """
    from gs2ci.render.warp.backend import WarpBackend  # noqa: PLC0415  an extra

    named, raster = os.environ.get("GS2CI_DEVICE"), Settings().raster
    if named is None:
        # Files that tell of a driver may be hidden from a container.
        found = devices.compute_devices(replace(devices.CudaProbe(), has_driver=lambda: True))
        if not any(name.startswith("cuda:") for name, _ in found):
            about = "".join(f"\n{name}: {words}" for name, words in found)
            raise SystemExit(f"no CUDA device; GS2CI_DEVICE=cpu GS2CI_SMALL=1 runs the flow of all by fibers{about}")
    return Asked(WarpBackend(raster, named), bool(os.environ.get("GS2CI_SMALL")))


# ------------------------------------------------------------------------------------------------ here and errors


def here(asked: Asked) -> None:
    """What is installed here, where tensors lie, and whether a card would be taken by `gs2ci reconstruct`."""
    import warp as wp  # noqa: PLC0415  an extra

    device = wp.get_device(asked.place)
    print(f"device: {device.name}, {asked.place}; warp {wp.config.version}, driver {wp.get_cuda_driver_version()}")
    print(
        f"Python {sys.version.split()[0]}, torch {torch.__version__}, numba {numba.__version__}, {os.cpu_count()} cores"
    )
    if asked.is_cuda:
        print(f"captures: {'by memory pools' if device.is_mempool_enabled else 'without memory pools'}")
        print(f"tensors of a fit lie on: {asked.backend.device}")
        if not torch.cuda.is_available():
            print("torch is built for the CPU, so that a fit stays there: scene and gradients are copied")
        tool = sanitizer()
        print(f"compute-sanitizer: {tool or 'not there'}; gsplat: {importlib.util.find_spec('gsplat') is not None}")


def compiled(asked: Asked) -> None:
    """Compile all kernels, the CPU's and the device's, so that no time below holds any of it; then try the device."""
    import warp as wp  # noqa: PLC0415  an extra

    from tests.benchmarks.gpu_kernels import modules  # noqa: PLC0415

    if not asked.small:
        print(f"the CPU's kernels: {compile_kernels(Silent()):.0f} s on {os.cpu_count()} cores", flush=True)
        began = time.perf_counter()
        for module, threads in modules():
            wp.force_load(asked.place, [module], block_dim=threads)
        print(f"the device's kernels: {time.perf_counter() - began:.0f} s", flush=True)
    print(f"small scene as by the CPU, to {error_on(asked.place):.1e}")


def errors(asked: Asked) -> None:
    """Errors against the definition, of a rendering that is called and of one that is replayed; the same bits twice."""
    size = (40, 48)
    scene, intrinsics = fitted_like(60 if asked.small else 300, size, 2)
    poses, masks, weights = small_motion(3), random_masks(3, size, 0.25), torch.randn(*size, 3)
    exact = type(asked.backend)(RasterSettings(termination_transmittance=0.0), asked.place)
    given = (scene, poses, intrinsics, masks, weights)
    (truth,) = _outcomes(ReferenceBackend(), *given, times=1)
    captured = recording.captured()
    called, *others = _outcomes(exact, *given, times=4)
    for name, wanted in truth.items():
        error = float(torch.linalg.vector_norm(called[name].double() - wanted) / torch.linalg.vector_norm(wanted))
        print(f"error of {name}, relative in the 2-norm: {error:.1e}")
    same = all(torch.equal(one[name], called[name]) for one in others for name in truth)
    print(f"graphs captured: {recording.captured() - captured}; refused: {recording.refusal() or 'no'}")
    print(f"three replayed renderings have the bits of the one that was called: {'yes' if same else 'NO'}")


def beside_the_host(asked: Asked) -> None:
    """What else a device computes, beside the host's: a fit's iterations, groups of patches, GAP-TV, a plane sweep."""
    from tests.benchmarks.gpu_model import iteration, state  # noqa: PLC0415  it takes its sizes from here

    count, size = (60, (24, 32)) if asked.small else (2000, (96, 128))

    def fitted(backend: Any) -> list[torch.Tensor]:
        fit = state(count, size, 3, backend)
        for _ in range(6):
            iteration(fit)
        return [one.detach().cpu() for one in fit.scene.parameters().values()]

    there, again = fitted(asked.backend), fitted(asked.backend)
    with _the_hosts_turn():
        here = fitted(load_backend("cpu", Settings().raster))
    # Adam's first steps have the sign of a gradient, even if that is all rounding: not the largest tells.
    apart = max(float((one - other).abs().median()) for one, other in zip(there, here, strict=True))
    _tell("parameters after 6 iterations", apart, all(map(torch.equal, there, again)))
    draws = np.random.default_rng(0)
    views = (0.5 + 0.1 * draws.standard_normal((4, *size))).astype(np.float32)
    lattice = Lattice(per_group=16)
    groups = find_groups(views, Flow.between(views), lattice, 0)
    masks = (draws.random((4, *size)) < 0.5).astype(np.float32)
    shot = Shot((masks * views).sum(axis=0)[..., None], masks, np.ones(4, np.float32))
    poses = small_motion(4).double().numpy()
    intrinsics = np.array([[size[1], 0, size[1] / 2], [0, size[1], size[0] / 2], [0, 0, 1.0]])
    swept = SweepSettings(planes=16)
    for name, work in {
        "groups of patches": lambda: _denoise(views[None], groups, lattice.patch(size), 0.1, views[None]),
        "GAP-TV": lambda: decode_signed(shot, GapTvSettings(iterations=4)),
        "inverse depths of a sweep": lambda: sweep(views[..., None], poses, intrinsics, 0, (0.2, 1.0), swept),
    }.items():
        with working_on(asked.backend.device):
            found, same = work(), work()
        with _the_hosts_turn():
            _tell(name, float(np.median(np.abs(found - work()))), bool((found == same).all()))


@contextmanager
def _the_hosts_turn() -> Iterator[None]:
    """Let the host be the host, where it stands in for a device."""
    stands_in = places.is_apart(torch.device("cpu"))
    places.count_host_as_device(yes=False)
    try:
        yield
    finally:
        places.count_host_as_device(yes=stands_in)


def _tell(name: str, apart: float, same: bool) -> None:
    bits = "the same bits twice" if same else "OTHER BITS the second time"
    print(f"{name}: in the median {apart:.1e} from the host's; {bits}")


def _outcomes(
    backend: Any, scene: Gaussians, poses: Any, intrinsics: Any, masks: Any, weights: Any, times: int
) -> list[dict[str, torch.Tensor]]:
    kind = torch.float64 if backend.name == "reference" else torch.float32
    mask_set, reuse, found = backend.code(masks), backend.reuse(), []
    leaves = scene.map(lambda one: one.to(backend.device, kind, copy=True).requires_grad_())
    for _ in range(times):
        own = poses.to(backend.device, kind, copy=True).requires_grad_()
        image = backend.coded(leaves, own, intrinsics, mask_set, reuse=reuse)
        (image * weights.to(image)).sum().backward()
        gradients = {name: one.grad.cpu() for name, one in leaves.parameters().items() if one.grad is not None}
        found.append({"image": image.detach().cpu(), **gradients, "poses": own.grad.cpu()})
        for one in leaves.parameters().values():
            one.grad = None
    return found


# ---------------------------------------------------------------------------------------------------------- times


def iterations(asked: Asked) -> None:
    """Milliseconds of an iteration at four sizes: rendering and gradient, and a whole iteration of a fit."""
    print(
        "| Gaussians | size | views | ms of kernels | ms, rendering and gradient | ms, fit's iteration | "
        "ms, CPU's rendering and gradient |\n|---:|---|---:|---:|---:|---:|---:|"
    )
    took = {}
    for count, size, views in [(200, (24, 32), 3)] if asked.small else SIZES:
        scene, intrinsics = fitted_like(count, size)
        poses, masks = small_motion(views), random_masks(views, size, 0.25)
        call = _rendering(asked.backend, scene, poses, intrinsics, masks)
        here = _rendering(load_backend("cpu"), scene, poses, intrinsics, masks)
        kernels, _ = _kernels_ms(asked, call)
        fit_ms = _fit_ms(asked, count, size, views)
        print(
            f"| {count} | {size[0]} × {size[1]} | {views} | {kernels} | {_least_ms(asked, call, asked.rounds):.2f} | "
            f"{fit_ms:.2f} | {_least_ms(asked, here, max(2, asked.rounds // 4)):.1f} |",
            flush=True,
        )
        took[count, size, views] = fit_ms
    beside_asked(f"iteration, {LARGE_FIT}", f"{took.get(SIZES[2], 0):.2f} ms", "2 ms")


def beside_asked(what: str, found: str, asked_for: str) -> None:
    """Print a figure beside what was asked."""
    print(f"asked of {what}: {asked_for}; found: {found}", flush=True)


def _rendering(backend: Any, scene: Gaussians, poses: Any, intrinsics: Any, masks: Any) -> Callable[[], object]:
    mask_set, reuse = backend.code(masks), backend.reuse()
    there = scene.map(lambda one: one.to(backend.device))
    height, width = mask_set.size
    weights = torch.from_numpy(np.random.default_rng(0).normal(size=(height, width, 3)).astype(np.float32))
    pulled: Any = weights.to(backend.device) if backend.device.type != "cpu" else weights.numpy()
    placed = poses.to(backend.device)

    def call() -> object:
        for one in there.parameters().values():
            one.grad = None
        return backend.coded_with_pull(there, placed, intrinsics, mask_set, reuse=reuse)[1](pulled)

    return call


def _fit_ms(asked: Asked, count: int, size: tuple[int, int], views: int) -> float:
    """Return the time of an iteration of a fit, before there are surfaces; the numbers that it waits for end it."""
    from tests.benchmarks.gpu_model import iteration, state  # noqa: PLC0415  it takes its sizes from here

    fit = state(count, size, views, asked.backend)
    return _least_ms(asked, lambda: iteration(fit), asked.rounds)


def _least_ms(asked: Asked, call: Callable[[], object], rounds: int) -> float:
    """Return the least time of a call, what it queued included; the first ones compile and capture."""
    times = []
    for _ in range(rounds + 3):
        began = time.perf_counter()
        call()
        _wait(asked)
        times.append(time.perf_counter() - began)
    return 1e3 * min(times[3:])


def _wait(asked: Asked) -> None:
    if asked.is_cuda:
        import warp as wp  # noqa: PLC0415  an extra

        wp.synchronize_device(asked.place)


def _kernels_ms(asked: Asked, call: Callable[[], object]) -> tuple[str, Counter[str]]:
    """Return the least time of the kernels of a call, and of each kernel, by the device's own events; of the CPU none.

    Events are not recorded in graphs, so that launches are made one by one here.
    """
    import warp as wp  # noqa: PLC0415  an extra

    if not asked.is_cuda:
        call()
        return "–", Counter()
    best: Counter[str] = Counter()
    may_capture, recording._may_capture = recording._may_capture, lambda _: False
    try:
        for _ in range(asked.rounds):
            wanted = wp.TIMING_KERNEL | wp.TIMING_KERNEL_BUILTIN | wp.TIMING_MEMSET
            wp.timing_begin(cuda_filter=wanted, synchronize=True)
            call()
            found: Counter[str] = Counter()
            for one in wp.timing_end(synchronize=True):
                found[one.name] += one.elapsed
            if not best or found.total() < best.total():
                best = found
    finally:
        recording._may_capture = may_capture
    return f"{best.total():.2f}", best


def worst_kernel(asked: Asked) -> None:
    """Time of each kernel at the third size, and the worst one's bytes and operations a second, as modelled."""
    from tests.benchmarks.gpu_model import BLEND_OPERATIONS, BLOCK, GRADIENT_OPERATIONS  # noqa: PLC0415

    count, size, views = (200, (24, 32), 3) if asked.small else SIZES[2]
    scene, intrinsics = fitted_like(count, size)
    poses, masks = small_motion(views), random_masks(views, size, 0.25)
    _, each = _kernels_ms(asked, _rendering(asked.backend, scene, poses, intrinsics, masks))
    if not each:
        print("no events on this device")
        return
    for name, ms in each.most_common():
        print(f"{ms:8.3f} ms {ms / each.total():6.1%}  {name}")
    reuse = asked.backend.reuse()
    asked.backend.coded_with_pull(
        scene.map(lambda one: one.to(asked.backend.device)),
        poses.to(asked.backend.device),
        intrinsics,
        asked.backend.code(masks),
        reuse=reuse,
    )
    pairs = reuse.entries * BLOCK
    name, ms = each.most_common(1)[0]
    operations = GRADIENT_OPERATIONS if "backward" in name else BLEND_OPERATIONS
    print(
        f"{name}: {reuse.entries} entries of lists; if it blends, {pairs * operations / ms / 1e9:.2f} TFLOP/s of "
        "those that the model counts"
    )


# ------------------------------------------------------------------------------------------------- races, gsplat


def sanitizer() -> str | None:
    """Return where compute-sanitizer is; None: it is not installed."""
    return shutil.which("compute-sanitizer") or next((str(path) for path in SANITIZERS if path.exists()), None)


def races(asked: Asked) -> None:
    """Races and accesses out of bounds, by NVIDIA's compute-sanitizer in a process of its own, where it is there."""
    tool = sanitizer()
    if tool is None or not asked.is_cuda:
        print("compute-sanitizer is not there: races were not looked for" if tool is None else "no CUDA device")
        return
    for part, kind in itertools.product(("errors", "beside_the_host"), ("racecheck", "memcheck")):
        command = [tool, "--tool", kind, "--error-exitcode", "9", sys.executable, "-m", "tests.benchmarks", "gpu"]
        own = {"GS2CI_WATCHED": "1", "GS2CI_PARTS": part, "GS2CI_SMALL": "1", "GS2CI_DEVICE": asked.place}
        try:
            done = subprocess.run(
                command, env={**os.environ, **own}, capture_output=True, text=True, timeout=_SANITIZED_S, check=False
            )
        except subprocess.TimeoutExpired:
            print(f"{kind} of {part}: not done within {_SANITIZED_S} s", flush=True)
            continue
        summary = [line for line in done.stdout.splitlines() if line.startswith("=========")][-1:]
        said = " ".join(summary) or done.stderr.strip()[-300:]
        print(f"{kind} of {part}: exit {done.returncode}; {said}", flush=True)


def beside_gsplat(asked: Asked) -> None:
    """Forward and backward of the same views, unmasked, by gsplat, where it is installed and its kernels compile."""
    if importlib.util.find_spec("gsplat") is None or not asked.is_cuda:
        print("gsplat is not installed: nothing is compared with it")
        return
    # Its kernels are compiled when it is imported: for this card alone, on all cores.
    os.environ.setdefault("TORCH_CUDA_ARCH_LIST", ".".join(map(str, torch.cuda.get_device_capability())))
    os.environ.setdefault("MAX_JOBS", str(os.cpu_count()))
    from gsplat import rasterization  # type: ignore[import-not-found]  # noqa: PLC0415  not a dependency

    for count, size, views in SIZES[2:3]:
        scene, intrinsics = fitted_like(count, size)
        place, poses = asked.backend.device, small_motion(views)
        leaves = scene.map(lambda one, place=place: one.to(place).requires_grad_())
        whole = torch.ones(views, *size)
        ours = _rendering(asked.backend, scene, poses, intrinsics, whole)
        matrices, cameras = poses.to(place), intrinsics.to(place).expand(views, 3, 3).contiguous()

        def theirs(leaves=leaves, matrices=matrices, cameras=cameras, size=size) -> None:
            images, _, _ = rasterization(
                leaves.means,
                leaves.quaternions,
                leaves.log_scales.exp(),
                torch.sigmoid(leaves.opacity_logits),
                leaves.colours,
                matrices,
                cameras,
                size[1],
                size[0],
            )
            images.sum().backward()
            for one in leaves.parameters().values():
                one.grad = None

        try:
            took = _least_ms(asked, theirs, asked.rounds)
        except Exception as error:
            print(f"gsplat fails: {str(error).splitlines()[0][:200]}")
            return
        quarter = _rendering(asked.backend, scene, poses, intrinsics, random_masks(views, size, 0.25))
        print(
            f"{count} Gaussians, {size[0]} × {size[1]} × {views}: gsplat {took:.2f} ms; ours, all open, "
            f"{_least_ms(asked, ours, asked.rounds):.2f} ms, and a quarter open, "
            f"{_least_ms(asked, quarter, asked.rounds):.2f} ms"
        )
