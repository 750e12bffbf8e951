"""A coded rendering whose gradient is computed by a function call, as a fit does hundreds of times.

For a small rendering, torch's graph costs more than the kernels do, so a backend may compute the gradient itself. Here:
that interface, and the same by torch's graph for scenes and backends that need it. Not here: any rendering.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeGuard

import torch
from torch import Tensor

from gs2ci.core.arrays import F32
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.interface import Backend, MaskSet, Reuse
from gs2ci.render.places import on_device
from gs2ci.render.screen import ScreenStatistics

Image = F32 | Tensor
"""An array of the host, or a tensor of the device on which the scene lies."""
Pull = Callable[[Any], Any]
"""Takes the gradient of an objective by a rendered sum, [H, W, 3], adds those by the scene's parameters to their
`grad`, and returns that by the poses, [V, 4, 4], both as `Image`. It may be called once."""


class AdjointBackend(Backend, Protocol):
    """A backend that differentiates without torch's graph."""

    def coded_with_pull(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        mask_set: MaskSet,
        screen: ScreenStatistics | None = None,
        reuse: Reuse | None = None,
    ) -> tuple[Image, Pull]:
        """Render the coded sum of a scene that stands still and looks the same from everywhere, [H, W, 3].

        Arguments and errors as for `Backend.coded`.
        """


def coded_with_pull(
    backend: Backend,
    scene: Gaussians,
    world_to_camera: Tensor,
    intrinsics: Tensor,
    mask_set: MaskSet,
    screen: ScreenStatistics | None = None,
    reuse: Reuse | None = None,
    times: Tensor | None = None,
) -> tuple[Image, Pull]:
    """Render the coded sum, [H, W, 3], by any backend; arguments and errors as for `Backend.coded`."""
    if _has_adjoint(backend) and scene.motion is None and scene.harmonics is None:
        return backend.coded_with_pull(scene, world_to_camera, intrinsics, mask_set, screen, reuse)
    poses = world_to_camera.detach().requires_grad_()
    with torch.enable_grad():
        image = backend.coded(scene, poses, intrinsics, mask_set, screen, reuse, times)

    def pull(gradient: Image) -> Image:
        pull_back([image], [torch.as_tensor(gradient)])
        found = torch.zeros_like(poses) if poses.grad is None else poses.grad
        return as_image(found.float())

    return as_image(image.detach().float()), pull


def as_image(tensor: Tensor) -> Image:
    """Return a tensor as fits take it: as it is on a device, as an array of the same memory on the host."""
    return tensor if on_device(tensor) else tensor.numpy()


def pull_back(images: Sequence[Tensor], gradients: Sequence[Tensor]) -> None:
    """Add the gradients of leaves to theirs, given those by images: as `torch.autograd.backward`, to the bit.

    By the derivative of a product, because torch imports SymPy when it is given gradients: 0.6 s of each process.

    Args:
        images: What was computed from the leaves, of any shapes.
        gradients: Those of an objective by the images, of the same shapes.
    """
    products = [(image * gradient.to(image.dtype)).sum() for image, gradient in zip(images, gradients, strict=True)]
    torch.autograd.backward(products)


def _has_adjoint(backend: Backend) -> TypeGuard[AdjointBackend]:
    """Tell whether a backend differentiates itself, by one look-up: `isinstance` tries every member of a protocol."""
    return hasattr(backend, "coded_with_pull")


def accumulate(scene: Gaussians, gradients: Mapping[str, Image]) -> None:
    """Add gradients to those of a scene's parameters, by name; the scene owns them afterwards."""
    parameters = scene.parameters()
    for name, gradient in gradients.items():
        tensor, added = parameters[name], torch.as_tensor(gradient)
        tensor.grad = added.to(tensor.dtype) if tensor.grad is None else tensor.grad.add_(added)
