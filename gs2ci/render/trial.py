"""What Warp says of a computer's CUDA devices, and a small rendering that tells whether one of them works.

Not here: the choice among them (`gs2ci.render.devices`).
"""

import math
from typing import Final

import torch
from torch import Tensor

from gs2ci.render.adjoint import coded_with_pull
from gs2ci.render.backend import load_backend
from gs2ci.render.cards import Card, Cuda
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.interface import Backend
from gs2ci.render.settings import RasterSettings

_SIZE: Final = (24, 32)
_VIEWS: Final = 3
_GAUSSIANS: Final = 200
# Launches are made one by one in the first rendering, captured in the second, and replayed in the third.
_ONCE: Final = 1
_REPLAYED: Final = 3
# Neither renderer stops early, so that what differs is the arithmetic alone.
_WHOLE: Final = RasterSettings(termination_transmittance=0.0)


def cuda_here() -> Cuda:
    """Ask Warp for driver and cards.

    Raises:
        ModuleNotFoundError: Warp is not installed.
    """
    import warp as wp  # noqa: PLC0415  an extra

    # What it would print, the findings say.
    wp.config.log_level = wp.LOG_ERROR
    wp.init()
    toolkit = wp.get_cuda_toolkit_version() or (0, 0)
    archs = wp.get_cuda_supported_archs()
    return Cuda(
        driver=wp.get_cuda_driver_version(),
        # CUDA's libraries run on every driver of their major version.
        least_driver=(toolkit[0], 0),
        least_capability=_capability(min(archs)) if archs else (0, 0),
        cards=tuple(
            Card(
                device=str(one.alias),
                model=str(one.name),
                capability=_capability(int(one.arch)),
                memory_mib=int(one.total_memory // 2**20),
                free_mib=int(one.free_memory // 2**20),
            )
            for one in wp.get_cuda_devices()
        ),
    )


def _capability(arch: int) -> tuple[int, int]:
    major, minor = divmod(arch, 10)
    return major, minor


def error_on(device: str) -> float:
    """Return the largest error of a small coded sum and of its gradients on a device, relative to those of the CPU.

    In the 2-norm of each, of a first rendering and of one that replays it. The first call on a device compiles its
    kernels, which Warp keeps on disk.

    Raises:
        RuntimeError: The device fails.
        InputError: There is no such device.
    """
    truth = _outcome(load_backend("cpu", _WHOLE), _ONCE)
    errors = [
        float(torch.linalg.vector_norm(a - b) / torch.linalg.vector_norm(b))
        for renderings in (_ONCE, _REPLAYED)
        for a, b in zip(_outcome(load_backend(f"warp:{device}", _WHOLE), renderings), truth, strict=True)
    ]
    return max(errors) if all(map(math.isfinite, errors)) else math.inf


def _outcome(backend: Backend, renderings: int) -> list[Tensor]:
    """Render the scene so often and differentiate it: the image, the gradients by its parameters, that by the poses."""
    draws = torch.Generator().manual_seed(0)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=draws)

    places = torch.cat([uniform(_GAUSSIANS, 2) * 1.6 - 0.8, 1 + uniform(_GAUSSIANS, 1)], dim=1)
    scene = Gaussians(
        means=places,
        log_scales=uniform(_GAUSSIANS, 3) - 3.5,
        quaternions=uniform(_GAUSSIANS, 4) - 0.5,
        opacity_logits=2 * uniform(_GAUSSIANS) - 1,
        colours=uniform(_GAUSSIANS, 3),
    ).map(lambda one: one.requires_grad_())
    height, width = _SIZE
    intrinsics = torch.tensor([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]])
    poses = torch.eye(4).repeat(_VIEWS, 1, 1)
    poses[:, 0, 3] = torch.linspace(-0.05, 0.05, _VIEWS)
    masks = (uniform(_VIEWS, height, width) < 0.5).float()
    weights = uniform(height, width, 3) - 0.5
    reuse, mask_set = backend.reuse(), backend.code(masks)
    for _ in range(renderings):
        for one in scene.parameters().values():
            one.grad = None
        image, pull = coded_with_pull(backend, scene, poses, intrinsics, mask_set, reuse=reuse)
        by_poses = pull(weights.numpy())
    gradients = [one.grad for one in scene.parameters().values() if one.grad is not None]
    # The last row of a pose is fixed; of the others the gradient is that of twelve numbers.
    return [torch.as_tensor(image), *gradients, torch.as_tensor(by_poses)[:, :3]]
