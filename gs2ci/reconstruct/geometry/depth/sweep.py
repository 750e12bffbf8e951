"""Dense depth of the reference view: a plane sweep over inverse depth with semi-global smoothing.

Here: the range of planes, features, homographies, image size; the cost of a map that was not swept. Not here: the inner
loops (`kernels`). Semi-global matching: Hirschmüller 2008, four directions.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
import torch
from pydantic import AfterValidator, Field
from torch import Tensor

from gs2ci.core.arrays import F32, F64
from gs2ci.core.bounds import LARGEST_WINDOW_PX, Bounded, odd
from gs2ci.core.config import Positive
from gs2ci.reconstruct.geometry.depth.device_sweep import best_planes_on_device
from gs2ci.reconstruct.geometry.depth.eight import FEATURES
from gs2ci.reconstruct.geometry.depth.kernels import best_plane, matching_cost, smoothed
from gs2ci.reconstruct.geometry.tracks.brightened import brightened
from gs2ci.reconstruct.geometry.tracks.tracks import RESIDUE_BLUR_PX
from gs2ci.render.places import on_device, work_place

_GRADIENT_WEIGHT = 4.0
_LEAST_VIEWS_KEPT = 3
# Interpolation by a parabola needs three.
LEAST_PLANES = 3
# At least so many pixels along each side, for a window and a gradient.
_LEAST_SIDE = 4
_PIXEL_FROM_ARRAY = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])


@dataclass(frozen=True)
class SweepSettings(Bounded):
    """How finely to sweep.

    Args:
        planes: Number of inverse depths.
        far_share: The farthest plane, as a share of the tracks' median inverse depth. Ending at the tracks' own
            depths cost 3.4 dB on a scene with a far, plain background, which has no corners to track.
        near_factor: The nearest plane, as a multiple of the tracks' 99th percentile.
        most_pixels: Larger views are reduced before the sweep; its memory is 8 bytes per pixel and plane.
        window_px: Side of the window over which views are compared.
        blur_px: Standard deviation of a blur before that, since decoded views contain residue of their masks.
    """

    planes: Annotated[int, Field(ge=LEAST_PLANES)] = 96
    far_share: float = 0.03
    near_factor: float = 1.25
    most_pixels: int = 500_000
    window_px: Annotated[int, Field(ge=1, le=LARGEST_WINDOW_PX), AfterValidator(odd)] = 7
    blur_px: Positive = RESIDUE_BLUR_PX


def inverse_depth_range(tracked: F64, settings: SweepSettings) -> tuple[float, float]:
    """Choose the farthest and nearest plane from the tracks' inverse depths, [P] with P >= 1."""
    return settings.far_share * float(np.median(tracked)), settings.near_factor * float(np.percentile(tracked, 99))


def sweep(
    views: F32,
    world_to_camera: F64,
    intrinsics: F64,
    reference: int,
    span: tuple[float, float],
    settings: SweepSettings,
) -> F32:
    """Estimate the inverse depth at which the views agree, for every pixel of the reference view.

    Args:
        views: [N, H, W, C] float32 in [0, 1], N >= 2.
        world_to_camera: Poses, [N, 4, 4]; the identity for the reference view.
        intrinsics: Camera matrix in px, [3, 3]; pixel centres at +0.5.
        reference: Index of the reference view.
        span: Farthest and nearest inverse depth.
        settings: How finely to sweep.

    Returns:
        Inverse depth, [H, W] float32, within `span`.
    """
    order = first_of(len(views), reference)
    return SweptViews(views, settings).depth(order, world_to_camera[order], intrinsics, span)


def first_of(count: int, reference: int) -> list[int]:
    """Return the numbers of so many views, the reference view's first."""
    return [reference, *(i for i in range(count) if i != reference)]


class SweptViews:
    """Views, described once for several sweeps, on the device where these are made.

    Args:
        views: [N, H, W, C] float32 in [0, 1], N >= 2.
        settings: How finely to sweep.
    """

    def __init__(self, views: F32, settings: SweepSettings) -> None:
        self._settings, self._size = settings, views.shape[1:3]
        # Penalties are in full scales.
        features = _features_of(brightened(_reduced(views, settings.most_pixels)), settings.blur_px)
        self._features = torch.from_numpy(features).to(work_place())

    def depth(self, order: Sequence[int], world_to_camera: F64, intrinsics: F64, span: tuple[float, float]) -> F32:
        """Estimate the inverse depth at which some of the views agree, for every pixel of the first of them.

        Args:
            order: Indices of at least two views.
            world_to_camera: Their poses, [M, 4, 4]; the identity for the first.
            intrinsics: As for `sweep`.
            span: As for `sweep`.

        Returns:
            As `sweep`.
        """
        settings, (height, width) = self._settings, self._size
        down, across = self._features.shape[1:3]
        scale = np.array([across / width, down / height, 1.0])
        inverse_depths = np.linspace(*span, settings.planes)
        homographies = plane_homographies(world_to_camera[1:], scale[:, None] * intrinsics, inverse_depths)
        # A place is assumed to be seen in two thirds of the other views.
        others = len(order) - 1
        best = max(min(_LEAST_VIEWS_KEPT, others), others * 2 // 3)
        index = _best_planes(self._features, order, homographies, best, settings.window_px)
        step = (span[1] - span[0]) / (settings.planes - 1)
        inverse_depth: F32 = (span[0] + step * index).astype(np.float32)
        if (down, across) != self._size:
            inverse_depth = cv2.resize(inverse_depth, (width, height), interpolation=cv2.INTER_LINEAR)
        return inverse_depth


def _best_planes(features: Tensor, order: Sequence[int], homographies: F64, best: int, window: int) -> F32:
    """Compare some of the views, [N, H, W, 8], with the first of them on planes, [D, M - 1, 3, 3].

    Returns:
        The best plane with its fraction, [H, W].
    """
    if on_device(features):
        return best_planes_on_device(features[list(order)], homographies, best, window)
    cost = matching_cost(features.numpy(), order, homographies, best, window)
    return best_plane(torch.from_numpy(smoothed(cost))).numpy()


def _reduced(views: F32, most_pixels: int) -> F32:
    """Reduce views to at most so many pixels, or enlarge them to the least size that the sweep needs."""
    height, width = views.shape[1:3]
    shrink = min(1.0, (most_pixels / (height * width)) ** 0.5)
    new_height, new_width = (max(_LEAST_SIDE, round(side * shrink)) for side in (height, width))
    if (new_height, new_width) == (height, width):
        return views
    resized = [cv2.resize(view, (new_width, new_height), interpolation=cv2.INTER_AREA) for view in views]
    return np.stack(resized).reshape(len(views), new_height, new_width, -1)


def _features_of(views: F32, blur_px: float) -> F32:
    """Describe each pixel by its colour, of total weight 3, and its luminance gradient; zeros up to [N, H, W, 8].

    Args:
        views: [N, H, W, C] in full scales.
        blur_px: Standard deviation of a blur before that.
    """
    channels = views.shape[3]
    features = np.empty((*views.shape[:3], FEATURES), np.float32)
    nothing = [np.zeros(views.shape[1:3], np.float32)] * (FEATURES - channels - 2)
    for view, described in zip(views, features, strict=True):
        blurred = cv2.GaussianBlur(view, (0, 0), blur_px).reshape(view.shape)
        grey = cv2.cvtColor(blurred, cv2.COLOR_RGB2GRAY) if channels == 3 else blurred[..., 0]
        # A Sobel operator of size 3 returns eight times the derivative of a ramp.
        gradient = [
            np.float32(_GRADIENT_WEIGHT / 8) * cv2.Sobel(grey, cv2.CV_32F, *axis, ksize=3) for axis in ((1, 0), (0, 1))
        ]
        cv2.merge([*cv2.split(np.float32(3 / channels) * blurred), *gradient, *nothing], dst=described)
    return features


def plane_homographies(world_to_camera: F64, intrinsics: F64, inverse_depths: F64) -> F64:
    """Map array coordinates of the reference view to those of each view through each plane, [D, V, 3, 3].

    Args:
        world_to_camera: The views' poses relative to the reference view, [V, 4, 4].
        intrinsics: [3, 3], px; pixel centres at +0.5.
        inverse_depths: [D].
    """
    rotation, translation = world_to_camera[:, :3, :3], world_to_camera[:, :3, 3]
    # X = R ray + t ρ, and the third component of a ray is 1: so ρ t is added to the third column of R.
    through = np.repeat(rotation[None], len(inverse_depths), axis=0)
    through[..., 2] += inverse_depths[:, None, None] * translation
    ray_from_array = np.linalg.inv(intrinsics) @ _PIXEL_FROM_ARRAY
    homographies: F64 = np.linalg.inv(_PIXEL_FROM_ARRAY) @ intrinsics @ through @ ray_from_array
    return np.ascontiguousarray(homographies)
