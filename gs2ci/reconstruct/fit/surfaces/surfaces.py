"""Surfaces that the views of a running fit show, and a loss term that draws a scene's light to them.

Views do not determine how the Gaussians along a ray share its light: half of a fitted scene may be fog that looks right
from the positions of the cameras. But unlike the decode, the views of a fit are good enough to find depth in them by a
plane sweep. So a few of them are swept during the fit, depth on which the sweeps agree is kept, and from then on the
loss penalises light that is stopped elsewhere. The weight of this term decreases, so that the measurement decides in
the end; light that has been drawn to surfaces stays there.

Here: the sweeps, the term. Not here: when it counts (`coarse/stage.py`), the sweep (`geometry.depth.sweep`), the
agreement of several (`geometry.depth.map_agreement`).
"""

from dataclasses import dataclass, field, replace
from typing import Annotated, Self

import cv2
import numpy as np
import torch
from pydantic import Field, PositiveInt
from torch import Tensor

from gs2ci.core.arrays import F32, F64
from gs2ci.core.bounds import Bounded
from gs2ci.core.cameras import path_extent
from gs2ci.core.config import Positive
from gs2ci.core.errors import InputError
from gs2ci.core.lens import pixel_centres, slopes_of
from gs2ci.reconstruct.fit.kernels.calling import call
from gs2ci.reconstruct.fit.kernels.surface_kernels import (
    add_mean_gradient,
    distance_to_surface,
    parallax_moments,
)
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fit.surfaces.depth_field import DepthFieldSettings, FieldStep
from gs2ci.reconstruct.fit.surfaces.margin import MarginSettings
from gs2ci.reconstruct.geometry.depth.map_agreement import agreement
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings, SweptViews
from gs2ci.reconstruct.measurement.lens import Lens
from gs2ci.render.adjoint import as_image, pull_back
from gs2ci.render.conventions import NEAR
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.interface import MaskSet

# The planes' range: that of the scene between these quantiles of inverse depth, widened at both ends.
_SCENE_QUANTILES = (0.005, 0.995)
_BEYOND = (0.5, 1.25)
# Below this distance the cost is a parabola, so that its gradient is defined at zero.
_ROUND_PX = 0.1


@dataclass(frozen=True)
class Search(Bounded):
    """One search for surfaces, and how strongly light is drawn to them until the next search.

    Args:
        begins: Share of the schedule that is done when it starts.
        weight: Weight of the term (the mean distance in px of parallax along the whole path) when the search starts, in
            the iterations in which the term counts.
        final_weight: At the end of the schedule; exponential in between.
    """

    begins: Annotated[float, Field(gt=0, le=1)]
    weight: Positive
    final_weight: Positive

    def weight_at(self, share: float) -> float:
        """Return the weight after a share of the schedule."""
        gone = (share - self.begins) / max(1 - self.begins, 1e-9)
        return float(self.weight * (self.final_weight / self.weight) ** min(max(gone, 0.0), 1.0))


@dataclass(frozen=True)
class SurfaceSettings(Bounded):
    """How light is drawn to surfaces.

    Args:
        searches: In order. The first keeps an early scene from becoming fog; the last uses views that are nearly the
            final ones, and finds depth in them that the scene does not have yet.
        every: The term counts once in so many iterations.
        views: How many views are swept, spread over the path.
        others: With how many others each is compared at most, spread over the path.
        pixel_share: Share of the pixels that the term uses.
        sweep: How finely to sweep.
        depth_field: How depths of whole regions move by the measurement alone, and these surfaces with them; None: not.
        margin: How the scene is continued beyond the borders of all views after the last search; None: not.
    """

    searches: tuple[Search, ...] = (Search(0.25, 8e-3, 2e-4), Search(0.7, 5e-2, 1e-3))
    every: PositiveInt = 2
    views: Annotated[int, Field(ge=2)] = 4
    others: Annotated[int, Field(ge=2)] = 4
    pixel_share: Annotated[float, Field(gt=0, le=1)] = 0.3
    sweep: SweepSettings = field(default_factory=lambda: SweepSettings(planes=64, window_px=5, blur_px=1.0))
    depth_field: DepthFieldSettings | None = field(default_factory=DepthFieldSettings)
    margin: MarginSettings | None = field(default_factory=MarginSettings)

    def check(self) -> Self:
        """Return self if the numbers make sense.

        Raises:
            InputError: One is out of its bounds, or the searches are none or not in the order in which they begin.
        """
        begins = [search.begins for search in self.searches]
        if not begins or begins != sorted(begins):
            raise InputError(f"surface settings whose searches begin at {begins}", allowed="one or more, in order")
        return super().check()


@dataclass(frozen=True)
class Surfaces:
    """Surfaces that several views agree on.

    Args:
        settings: Of the term.
        search: The search that found them.
        views: Which views were swept and agree with others somewhere, [K].
        inverse_depth: Of the surfaces seen in them, [K, H, W] float32, where the scene is fitted, as the rest.
        trust: Its weight, [K, H, W] float32 in [0, 1].
        parallax_px: The parallax along the whole path at an inverse depth of 1, px.
        rays: Of the pixels, at z = 1 in camera coordinates, [H, W, 2] float32.
        pixels: The pixels of each view that the term uses.
    """

    settings: SurfaceSettings
    search: Search
    views: tuple[int, ...]
    inverse_depth: Tensor
    trust: Tensor
    parallax_px: float
    rays: Tensor
    pixels: tuple["Pixels", ...]

    def without_masks(self) -> "Surfaces":
        """Return the same on the host, without what `with_masks` prepares again."""
        pixels = tuple(replace(one, mask_set=None, at=one.at.cpu()) for one in self.pixels)
        return replace(self._on(torch.device("cpu")), pixels=pixels)

    def with_masks(self, renderer: ShotRenderer) -> "Surfaces":
        """Return the same, prepared for a renderer."""
        pixels = tuple(_pixels(renderer, one.at, one.middle) for one in self.pixels)
        return replace(self._on(renderer.device), pixels=pixels)

    def _on(self, device: torch.device) -> "Surfaces":
        maps = (self.inverse_depth, self.trust, self.rays)
        inverse_depth, trust, rays = (one.to(device) for one in maps)
        return replace(self, inverse_depth=inverse_depth, trust=trust, rays=rays)

    def moved(self, step: FieldStep, world_to_camera: Tensor) -> "Surfaces":
        """Return the surfaces after a field was added to depths where the term looks, from poses, [N, 4, 4]."""
        inverse_depth, poses = self.inverse_depth.clone(), world_to_camera.detach().double().numpy()
        for found, pixels, view in zip(inverse_depth, self.pixels, self.views, strict=True):
            step.of_map(found, pixels.at, self.rays, poses[view])
        return replace(self, inverse_depth=inverse_depth)

    def draw(
        self, renderer: ShotRenderer, scene: Gaussians, world_to_camera: Tensor, turn: int, weight: float
    ) -> float | Tensor:
        """Add the term's gradient for one view; return the mean distance of its light from surfaces, px of parallax.

        For a pixel with weights w_i of Gaussians at parallaxes p_i and the surface at p, the distance is the root of
        sum_i w_i (p_i - p)^2: the root, so that light far off does not dominate.

        Args:
            renderer: Of the shot.
            scene: The Gaussians; `weight` times the gradient is added to theirs.
            world_to_camera: Poses of all views, [N, 4, 4]; they get no gradient.
            turn: Counts the calls; views are used in turn.
            weight: Of the term.
        """
        k = turn % len(self.views)
        pose = world_to_camera[self.views[k]].detach()
        if scene.motion is None:
            return self._draw(renderer, scene, pose, k, weight)
        with torch.enable_grad():
            there = scene.at(float(renderer.times[self.views[k]]))
        still = there.map(lambda tensor: tensor.detach())
        distance = self._draw(renderer, still, pose, k, weight)
        pairs = zip(_all(there), _all(still), strict=True)
        drawn = [(mine, other.grad) for mine, other in pairs if other.grad is not None]
        pull_back([mine for mine, _ in drawn], [gradient for _, gradient in drawn])
        return distance

    def _draw(self, renderer: ShotRenderer, scene: Gaussians, pose: Tensor, k: int, weight: float) -> float | Tensor:
        """Do so for the k-th swept view, of a scene that stands still."""
        pixels = self.pixels[k]
        means, ray = scene.means.detach(), pose[2].to(scene.means.device)
        # Distances are taken from the median surface, so that the squares do not cancel numerically.
        at = (NEAR, self.parallax_px)
        middle = self.parallax_px * pixels.middle
        moments = means.new_empty(len(scene), 3)
        call(parallax_moments, means, ray, *at, middle, moments)
        shown = replace(scene, colours=moments, harmonics=None)
        assert pixels.mask_set is not None
        image, pull = renderer.coded_with_pull(shown, pose[None], pixels.mask_set)
        shown_there = torch.as_tensor(image)
        gradient = torch.zeros_like(shown_there)
        distance: float | Tensor = call(
            distance_to_surface,
            shown_there.reshape(-1, 3),
            pixels.at,
            *(one[k].view(-1) for one in (self.inverse_depth, self.trust)),
            self.parallax_px,
            middle,
            _ROUND_PX,
            weight,
            gradient.view(-1, 3),
        )
        pull(as_image(gradient))
        assert moments.grad is not None
        assert scene.means.grad is not None
        call(add_mean_gradient, means, ray, *at, moments, moments.grad, scene.means.grad)
        return distance


def _all(scene: Gaussians) -> list[Tensor]:
    return list(scene.parameters().values())


@dataclass(frozen=True)
class Pixels:
    """The pixels of one view that the term uses.

    Args:
        mask_set: As the renderer prepared it; None where it is kept on a disk.
        at: Flat indices, [P] int64, where the scene is fitted.
        middle: The median inverse depth of the surfaces there, when they were found.
    """

    mask_set: MaskSet | None
    at: Tensor
    middle: float


def _pixels(renderer: ShotRenderer, at: Tensor, middle: float) -> Pixels:
    mask = torch.zeros(1, *renderer.size)
    mask.view(-1)[at] = 1
    return Pixels(renderer.code(mask), at.to(renderer.device), middle)


def find_surfaces(
    renderer: ShotRenderer,
    scene: Gaussians,
    world_to_camera: F64,
    views: F32,
    settings: SurfaceSettings,
    seed: int,
    search: Search | None = None,
) -> Surfaces | None:
    """Sweep a few views of a fit, and keep the depth on which the sweeps agree; None if they agree nowhere.

    A view whose depth agrees with no other is left out, as one that looks past what all others see.

    Args:
        renderer: Of the shot, with its lens.
        scene: The Gaussians; their depths are the range that is swept.
        world_to_camera: Poses, [N, 4, 4].
        views: The views from these poses, [N, H, W, C].
        settings: How many views, how finely.
        seed: Of the choice of pixels.
        search: One of the settings' searches; the first if None.
    """
    count, lens = len(views), renderer.lens
    middle = (world_to_camera[count // 2][None], renderer.times[count // 2][None])
    # Some depths of one view give the range well enough; those of all views would cost as much as a fifth of a fit.
    span = _span(renderer.stopped_light(scene, *middle, some=True).surface().cpu().numpy())
    extent = path_extent(world_to_camera)
    if count < 2 or span is None or extent == 0:
        return None
    intrinsics = renderer.intrinsics.double().numpy() if lens is None else lens.canvas_intrinsics
    chosen, beside = _spread(count, settings.views), _spread(count, settings.others + 1)
    used = sorted({*chosen, *beside})
    swept, maps = SweptViews(np.stack([_straightened(views[view], lens) for view in used]), settings.sweep), []
    for view in chosen:
        order = [view, *[i for i in beside if i != view][: settings.others]]
        from_view = world_to_camera[order] @ np.linalg.inv(world_to_camera[view])
        maps.append(swept.depth([used.index(i) for i in order], from_view, intrinsics, span))
    parallax_px = float(intrinsics[0, 0]) * extent
    trust = agreement(np.stack(maps), world_to_camera[list(chosen)], intrinsics, parallax_px)
    inverse_depth, trust = (_on_sensor(one, lens) for one in (np.stack(maps), trust))
    draw = np.random.default_rng(np.random.SeedSequence([seed, 0x5F]))
    taken = (draw.random(trust.shape) < settings.pixel_share) & (trust > 0)
    agreed = np.array([pixels.any() for pixels in taken])
    if not agreed.any():
        return None
    pixels = tuple(
        _pixels(renderer, torch.from_numpy(np.flatnonzero(mask)), float(np.median(depth[mask])))
        for mask, depth in zip(taken[agreed], inverse_depth[agreed], strict=True)
    )
    found = Surfaces(
        settings,
        search or settings.searches[0],
        tuple(view for view, agrees in zip(chosen, agreed.tolist(), strict=True) if agrees),
        torch.from_numpy(inverse_depth[agreed]),
        torch.from_numpy(trust[agreed]),
        parallax_px,
        torch.from_numpy(pixel_rays(renderer)),
        pixels,
    )
    return found._on(renderer.device)


def _span(depth: F32) -> tuple[float, float] | None:
    """Choose the farthest and the nearest plane from a scene's depths, [N, H, W]; None if there is no depth."""
    seen = depth[depth > 0]
    if not seen.size:
        return None
    low, high = np.quantile(1 / seen.astype(np.float64), _SCENE_QUANTILES)
    return float(low * _BEYOND[0]), float(high * _BEYOND[1])


def _straightened(view: F32, lens: Lens | None) -> F32:
    """Return one view, [H, W, C], as a pinhole sees it, from black to white."""
    straight: F32 = view if lens is None else lens.straightened(view[None])[0]
    return np.clip(straight, 0, 1).astype(np.float32, copy=False)


def _spread(count: int, wanted: int) -> tuple[int, ...]:
    """Choose at most so many of `count` views, evenly, the first and the last among them."""
    return tuple(int(i) for i in np.unique(np.linspace(0, count - 1, min(wanted, count)).round()))


def pixel_rays(renderer: ShotRenderer) -> F32:
    """Return the rays of the sensor's pixels, at z = 1, [H, W, 2]."""
    lens = renderer.lens
    places = pixel_centres(renderer.size) if lens is None else lens.sampling.places
    intrinsics = renderer.intrinsics.double().numpy() if lens is None else lens.canvas_intrinsics
    return slopes_of(places, intrinsics).astype(np.float32)


def _on_sensor(maps: F32, lens: Lens | None) -> F32:
    """Sample maps of the canvas, [K, Hc, Wc], along the rays of the sensor's pixels, without mixing across edges."""
    if lens is None:
        return maps
    x, y = ((lens.sampling.places[..., axis] - 0.5).astype(np.float32) for axis in (0, 1))
    border = {"borderMode": cv2.BORDER_REPLICATE}
    return np.stack([cv2.remap(one, x, y, cv2.INTER_NEAREST, **border) for one in maps])
