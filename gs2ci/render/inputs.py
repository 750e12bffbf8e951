"""Checks of a renderer's input, shared by all backends."""

from typing import TypeVar

import torch
from torch import Tensor

from gs2ci.core.errors import InputError
from gs2ci.core.records import check_intrinsics
from gs2ci.render.gaussians import Gaussians, check_tensor
from gs2ci.render.interface import MaskSet, Reuse
from gs2ci.render.screen import ScreenStatistics

OwnMasks = TypeVar("OwnMasks", bound=MaskSet)
OwnReuse = TypeVar("OwnReuse", bound=Reuse)


def own_masks(given: MaskSet, kind: type[OwnMasks], backend: str) -> OwnMasks:
    """Return a mask set as what a backend made of it.

    Raises:
        InputError: Another backend made it.
    """
    if not isinstance(given, kind):
        raise InputError(
            f"a mask set of type {type(given).__name__} given to the {backend} backend",
            allowed="what this backend's code(masks) returned",
        )
    return given


def own_reuse(given: Reuse | None, kind: type[OwnReuse], backend: str) -> OwnReuse | None:
    """Return work that is shared, if any, as what a backend made of it.

    Raises:
        InputError: Another backend made it.
    """
    if given is not None and not isinstance(given, kind):
        raise InputError(
            f"shared work of type {type(given).__name__} given to the {backend} backend",
            allowed="what this backend's reuse() returned",
        )
    return given


def check_masks(masks: Tensor) -> None:
    """Check mask values [N, H, W].

    Raises:
        InputError: Another shape, an empty image, or a value that is negative or not finite.
    """
    if masks.ndim != 3 or min(masks.shape) < 1:
        raise InputError(f"masks have shape {list(masks.shape)}", allowed="[N, H, W] with N, H, W >= 1")
    check_tensor("masks", masks, tuple(masks.shape))
    if bool((masks < 0).any()):
        raise InputError(f"masks reach down to {float(masks.min()):.4g}", allowed="values >= 0")


def check_size(size: tuple[int, int]) -> None:
    """Check an image size.

    Raises:
        InputError: Height or width below one pixel.
    """
    if min(size) < 1:
        raise InputError(f"image size {tuple(size)}", allowed="(height, width) of at least one pixel")


def check_screen(screen: ScreenStatistics | None, scene: Gaussians) -> None:
    """Check the record that a rendering is to fill, if there is one.

    Raises:
        InputError: It is for another number of Gaussians.
    """
    if screen is not None and len(screen.sightings) != len(scene):
        raise InputError(
            f"screen statistics of {len(screen.sightings)} Gaussians, a scene of {len(scene)}", allowed="equal numbers"
        )


def check_rendering(
    scene: Gaussians,
    world_to_camera: Tensor,
    intrinsics: Tensor,
    *,
    views: int | None = None,
    colours: Tensor | None = None,
    times: Tensor | None = None,
) -> None:
    """Check a scene, poses and intrinsics.

    Args:
        scene: The Gaussians.
        world_to_camera: Poses, [V, 4, 4].
        intrinsics: Camera matrix, [3, 3].
        views: How many poses there must be; None accepts any number.
        colours: Colours per view, [V, G, 3], or None.
        times: When each pose was taken, [V], or None.

    Raises:
        InputError: Shapes disagree, a number is not finite, or a scene moves and no times are given.
    """
    scene.check()
    count = int(world_to_camera.shape[0]) if views is None and world_to_camera.ndim else (views or 0)
    check_tensor("world_to_camera", world_to_camera, (count, 4, 4))
    check_tensor("intrinsics", intrinsics, (3, 3))
    check_intrinsics(intrinsics.detach().to(torch.float64).numpy())
    if colours is not None:
        check_tensor("colours per view", colours, (count, len(scene), 3))
    if times is not None:
        check_tensor("times of the poses", times, (count,))
    elif scene.motion is not None:
        raise InputError(
            "Gaussians that move, rendered at no time",
            allowed="a time for each pose",
            remedy="give times, or the scene at one moment: Gaussians.at",
        )
