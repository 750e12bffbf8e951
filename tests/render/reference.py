"""The definition of the image model: every pixel against every Gaussian, in torch float64.

It is written for readability and for autograd, and tests compare the fast paths with it. It never stops early and skips
nothing, so it is meant for tests and small scenes.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from gs2ci.render.conventions import (
    ALPHA_MAX,
    ALPHA_MIN,
    DILATION_PX2,
    FRUSTUM_MARGIN,
    LOG_SCALE_MAX,
    NEAR,
    SCREEN_SIGMA_MAX_PX,
)
from gs2ci.render.gaussians import Gaussians, rotation_matrices
from gs2ci.render.harmonics import colours_seen
from gs2ci.render.inputs import check_masks, check_rendering, check_screen, check_size, own_masks
from gs2ci.render.interface import MaskSet, Reuse
from gs2ci.render.sampling import CanvasSampling, check_sampling
from gs2ci.render.screen import RADIUS_SIGMAS, ScreenStatistics
from gs2ci.render.settings import RasterSettings
from gs2ci.render.stopping import (
    DEPTH_QUANTILE,
    NEARBY,
    PROFILE_REACH,
    PROFILE_SIGMA_RANGE,
    QUANTILE_SLACK,
    RATIO_MAX,
    RESOLUTION,
    SPREAD_QUANTILES,
    StoppedLight,
)


@dataclass(frozen=True)
class Splats:
    """Gaussians as one camera sees them, nearest first; those that are not drawn are left out.

    Args:
        means: Centres in pixels, [S, 2].
        covariances: 2D covariances with dilation, px^2, [S, 2, 2].
        opacities: [S].
        colours: [S, 3].
        index: Which of the scene's Gaussians each is, [S] int64.
        depths: Of the centres, [S].
        depth_slopes: Change of depth per px on screen, [S, 2], where the Gaussian is densest along the ray.
        depth_sigmas: Standard deviation of depth along a ray, [S].
    """

    means: Tensor
    covariances: Tensor
    opacities: Tensor
    colours: Tensor
    index: Tensor
    depths: Tensor
    depth_slopes: Tensor
    depth_sigmas: Tensor


def project(
    scene: Gaussians, world_to_camera: Tensor, intrinsics: Tensor, size: tuple[int, int], colours: Tensor
) -> Splats:
    """Project a scene into one camera by the affine approximation at each centre (EWA, Zwicker et al. 2001).

    Args:
        scene: The Gaussians, float64.
        world_to_camera: [4, 4].
        intrinsics: [3, 3].
        size: Height and width, px.
        colours: [G, 3].
    """
    rotation, translation = world_to_camera[:3, :3], world_to_camera[:3, 3]
    points = scene.means @ rotation.T + translation
    order = torch.argsort(points[:, 2], stable=True)
    order = order[points[order, 2] > NEAR]
    points = points[order]
    scales = scene.log_scales[order].clamp(max=LOG_SCALE_MAX).exp()
    factor = rotation_matrices(scene.quaternions[order]) * scales[:, None, :]
    factor = rotation @ factor
    screen_factor = _camera_jacobian(points, intrinsics, size) @ factor
    dilation = DILATION_PX2 * torch.eye(2, dtype=points.dtype)
    covariances = screen_factor @ screen_factor.transpose(1, 2) + dilation
    slopes = points[:, :2] / points[:, 2:]
    means = slopes * intrinsics.diagonal()[:2] + intrinsics[:2, 2]
    variances = covariances.diagonal(dim1=1, dim2=2)
    drawn = (variances.detach() <= SCREEN_SIGMA_MAX_PX**2).all(dim=1)
    opacities = torch.sigmoid(scene.opacity_logits[order])
    with torch.no_grad():
        along_axis = factor[:, 2]
        with_screen = (screen_factor @ along_axis[:, :, None])[:, :, 0]
        slopes = torch.linalg.solve(covariances, with_screen)
        depth_variances = along_axis.square().sum(dim=1) - (slopes * with_screen).sum(dim=1)
    return Splats(
        means=means[drawn],
        covariances=covariances[drawn],
        opacities=opacities[drawn],
        colours=colours[order][drawn],
        index=order[drawn],
        depths=points[drawn, 2],
        depth_slopes=slopes[drawn],
        depth_sigmas=depth_variances[drawn].clamp(min=0).sqrt(),
    )


def _camera_jacobian(points: Tensor, intrinsics: Tensor, size: tuple[int, int]) -> Tensor:
    """Differentiate the pinhole camera at points [S, 3] -> [S, 2, 3], slopes clamped to the widened frame."""
    extent = torch.tensor([size[1], size[0]], dtype=points.dtype)
    focal, centre = intrinsics.diagonal()[:2], intrinsics[:2, 2]
    margin = FRUSTUM_MARGIN * extent / focal
    depth = points[:, 2:]
    slopes = (points[:, :2] / depth).clamp(min=-centre / focal - margin, max=(extent - centre) / focal + margin)
    return torch.cat([torch.diag_embed(focal / depth), (-focal * slopes / depth)[:, :, None]], dim=2)


def alphas_at(splats: Splats, pixels: Tensor) -> Tensor:
    """Evaluate each splat at each pixel before thresholds, [S, P].

    The quadratic form is taken as the Gaussian of y times that of x given y, whose two terms are positive: even
    in float64 the inverse of a needle's covariance would cancel.

    Args:
        splats: S splats.
        pixels: Pixel centres, [P, 2].
    """
    offset = pixels[None] - splats.means[:, None]
    dx, dy = offset.unbind(-1)
    var_x, cov, var_y = splats.covariances[:, 0, 0], splats.covariances[:, 0, 1], splats.covariances[:, 1, 1]
    slope = cov / var_y
    var_x_given_y = var_x - slope * cov
    t = dx - slope[:, None] * dy
    mahalanobis2 = t * t / var_x_given_y[:, None] + dy * dy / var_y[:, None]
    return splats.opacities[:, None] * torch.exp(-0.5 * mahalanobis2)


def composite(splats: Splats, pixels: Tensor) -> tuple[Tensor, Tensor, float]:
    """Blend splats front to back over black.

    Args:
        splats: S splats, nearest first.
        pixels: Pixel centres, [P, 2].

    Returns:
        Colours [P, 3], alphas [P], and the margin: the smallest relative distance of any alpha from the thresholds
        `ALPHA_MIN` and `ALPHA_MAX`. The image is discontinuous there, so two correct renderers may differ.
    """
    weights, stopped, margin = weights_at(splats, pixels)
    return weights.T @ splats.colours, stopped, margin


def weights_at(splats: Splats, pixels: Tensor) -> tuple[Tensor, Tensor, float]:
    """Return the share of each pixel's light that each splat stops, [S, P], that all stop, [P], and the margin.

    Args:
        splats: S splats, nearest first.
        pixels: Pixel centres, [P, 2].
    """
    raw = alphas_at(splats, pixels)
    margin = min(_distance(raw, ALPHA_MIN), _distance(raw, ALPHA_MAX))
    alphas = torch.where(raw >= ALPHA_MIN, raw.clamp(max=ALPHA_MAX), torch.zeros_like(raw))
    through = torch.cumprod(1 - alphas, dim=0)
    arriving = torch.cat([raw.new_ones(1, len(pixels)), through])
    return alphas * arriving[:-1], 1 - arriving[-1], margin


def stop_light(splats: Splats, pixels: Tensor) -> tuple[StoppedLight, float]:
    """Find the depths at which the light of pixels is stopped: the definition of depth (`stopping.py`).

    Args:
        splats: S splats, nearest first.
        pixels: Pixel centres, [P, 2].

    Returns:
        Maps [P] float64, and the margin of `composite`.
    """
    weights, stopped, margin = weights_at(splats, pixels)
    offset = pixels[None] - splats.means[:, None]
    share = (splats.depth_slopes[:, None] * offset).sum(dim=2) / splats.depths[:, None]
    depths = splats.depths[:, None] / (1 - share).clamp(min=1 / RATIO_MAX)
    sigmas = splats.depth_sigmas[:, None].expand_as(depths)
    low, high = PROFILE_SIGMA_RANGE
    reach = PROFILE_REACH * torch.minimum(torch.maximum(sigmas, low * depths), high * depths)
    total = weights.sum(dim=0)

    def before(limit: Tensor) -> Tensor:
        along = ((limit - depths) / reach).clamp(-1, 1)
        return (weights * (0.5 + 0.75 * along - 0.25 * along**3)).sum(dim=0)

    def quantile(share: float) -> Tensor:
        touched = weights > 0
        near = torch.where(touched, depths - reach, torch.inf).amin(dim=0)
        far = torch.where(touched, depths + reach, -torch.inf).amax(dim=0)
        while bool((far - near > RESOLUTION * far).any()):
            middle = (near + far) / 2
            reached = before(middle) >= (share - QUANTILE_SLACK) * total
            near, far = torch.where(reached, near, middle), torch.where(reached, middle, far)
        return far

    if not len(depths):
        nothing = torch.zeros_like(stopped)
        return StoppedLight(nothing, nothing, stopped, nothing), margin
    depth = quantile(DEPTH_QUANTILE)
    spread = (depth / quantile(SPREAD_QUANTILES[0]) - depth / quantile(SPREAD_QUANTILES[1])) / 2
    nearby = before(depth * (1 + NEARBY)) - before(depth * (1 - NEARBY))
    some = total > 0
    return StoppedLight(*(torch.where(some, found, 0.0) for found in (depth, spread, stopped, nearby))), margin


def _distance(alphas: Tensor, threshold: float) -> float:
    return float((alphas.detach() / threshold - 1).abs().min()) if alphas.numel() else float("inf")


def _moments(scene: Gaussians, views: int, times: Tensor | None) -> list[Gaussians]:
    """Return the scene at the time of each view."""
    if times is None or scene.motion is None:
        return [scene] * views
    return [replace(scene, means=means) for means in scene.means_at(times.double())]


def _colours(scene: Gaussians, world_to_camera: Tensor, times: Tensor | None) -> list[Tensor]:
    """Return the colours that each view sees, [G, 3] each."""
    if scene.harmonics is None:
        return [scene.colours] * len(world_to_camera)
    return list(colours_seen(scene, world_to_camera, None if times is None else times.double()))


def pixel_centres(size: tuple[int, int]) -> Tensor:
    """Return the pixel centres of an image row by row, [H * W, 2] float64."""
    rows, columns = (torch.arange(n, dtype=torch.float64) + 0.5 for n in size)
    y, x = torch.meshgrid(rows, columns, indexing="ij")
    return torch.stack([x, y], dim=-1).reshape(-1, 2)


def looked_at(
    intrinsics: Tensor, size: tuple[int, int], sampling: CanvasSampling | None
) -> tuple[Tensor, tuple[int, int], Tensor]:
    """Return camera matrix, height and width of the frame to project into, and positions of pixels, [H * W, 2]."""
    if sampling is None:
        return intrinsics, size, pixel_centres(size)
    places = torch.from_numpy(sampling.places).reshape(-1, 2)
    return sampling.intrinsics_of_canvas(intrinsics), sampling.canvas, places


def watch(splats: Splats, size: tuple[int, int], screen: ScreenStatistics) -> None:
    """Register that the backward pass through these splats adds one view to the record.

    A splat is seen if its footprint, where its alpha reaches `ALPHA_MIN`, can touch the frame.

    Args:
        splats: S splats whose gradient will be computed.
        size: Height and width, px.
        screen: The record of the scene that they are part of.
    """
    means, covariances = splats.means.detach(), splats.covariances.detach()
    frame = torch.tensor([size[1], size[0]], dtype=means.dtype)
    levels = torch.log(splats.opacities.detach() / ALPHA_MIN)
    reach = (2 * levels.clamp(min=0)[:, None] * covariances.diagonal(dim1=1, dim2=2)).sqrt()
    seen = (levels >= 0) & ((means + reach >= 0) & (means - reach <= frame)).all(dim=1)
    radius = RADIUS_SIGMAS * torch.linalg.eigvalsh(covariances)[:, -1].sqrt()

    def add(gradient: Tensor) -> None:
        norm = (gradient * frame / 2).norm(dim=1)
        columns = (torch.where(seen, value, 0.0).float() for value in (norm, torch.ones_like(norm), radius))
        count = len(screen.sightings)
        screen.add(*(torch.zeros(count).index_add(0, splats.index, column) for column in columns))

    splats.means.register_hook(add)  # type: ignore[no-untyped-call]


@dataclass(frozen=True)
class ReferenceMaskSet(MaskSet):
    """The masks, [N, H, W] float64, and the positions of their pixels."""

    masks: Tensor
    sampling: CanvasSampling | None = None


class ReferenceBackend:
    """The definition behind the `Backend` interface; results are float64.

    It never stops early and reuses nothing from earlier renderings: the settings permit both but do not require it.

    Args:
        settings: What may be left out; None uses the defaults.

    Attributes:
        margin: Of the last rendering, see `composite`; for coded sums over the open pixels only.

    Raises:
        InputError: The settings make no sense.
    """

    name = "reference"
    device = torch.device("cpu")

    def __init__(self, settings: RasterSettings | None = None) -> None:
        (settings or RasterSettings()).check()
        self.margin = float("inf")

    def code(self, masks: Tensor, sampling: CanvasSampling | None = None) -> ReferenceMaskSet:
        """Keep the masks; see `Backend.code`."""
        check_masks(masks)
        views, height, width = masks.shape
        check_sampling(sampling, (height, width))
        return ReferenceMaskSet(views, (height, width), masks.detach().to(torch.float64), sampling)

    def reuse(self) -> Reuse:
        """Share nothing; see `Backend.reuse`."""
        return Reuse()

    def coded(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        mask_set: MaskSet,
        screen: ScreenStatistics | None = None,
        reuse: Reuse | None = None,
        times: Tensor | None = None,
    ) -> Tensor:
        """Render the coded sum; see `Backend.coded`. Nothing is shared, whatever `reuse`."""
        del reuse
        coded = own_masks(mask_set, ReferenceMaskSet, self.name)
        check_rendering(scene, world_to_camera, intrinsics, views=mask_set.views, times=times)
        check_screen(screen, scene)
        scene = scene.map(torch.Tensor.double)
        scenes = _moments(scene, len(world_to_camera), times)
        seen = _colours(scene, world_to_camera.double(), times)
        intrinsics, frame, pixels = looked_at(intrinsics.double(), coded.size, coded.sampling)
        total = torch.zeros(len(pixels), 3, dtype=torch.float64)
        self.margin = float("inf")
        for now, pose, view_colours, mask in zip(scenes, world_to_camera.double(), seen, coded.masks, strict=True):
            opened = mask.reshape(-1).nonzero().squeeze(1)
            splats = project(now, pose, intrinsics, frame, view_colours)
            if screen is not None:
                watch(splats, frame, screen)
            colours, _, margin = composite(splats, pixels[opened])
            total = total.index_add(0, opened, mask.reshape(-1)[opened, None] * colours)
            self.margin = min(self.margin, margin)
        return total.reshape(*mask_set.size, 3)

    def views(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        size: tuple[int, int],
        colours: Tensor | None = None,
        sampling: CanvasSampling | None = None,
        times: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Render whole views; see `Backend.views`."""
        check_size(size)
        check_sampling(sampling, size)
        check_rendering(scene, world_to_camera, intrinsics, colours=colours, times=times)
        scene = scene.map(torch.Tensor.double)
        scenes = _moments(scene, len(world_to_camera), times)
        per_view = _colours(scene, world_to_camera.double(), times) if colours is None else list(colours.double())
        intrinsics, frame, pixels = looked_at(intrinsics.double(), size, sampling)
        images, alphas = [torch.zeros(0, 3, dtype=torch.float64)], [torch.zeros(0, dtype=torch.float64)]
        self.margin = float("inf")
        for now, pose, view_colours in zip(scenes, world_to_camera.double(), per_view, strict=True):
            image, alpha, margin = composite(project(now, pose, intrinsics, frame, view_colours), pixels)
            images.append(image)
            alphas.append(alpha)
            self.margin = min(self.margin, margin)
        return torch.cat(images).reshape(-1, *size, 3), torch.cat(alphas).reshape(-1, *size)

    def depths(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        size: tuple[int, int],
        sampling: CanvasSampling | None = None,
        times: Tensor | None = None,
    ) -> StoppedLight:
        """Find the depths at which light is stopped; see `Backend.depths`."""
        check_size(size)
        check_sampling(sampling, size)
        check_rendering(scene, world_to_camera, intrinsics, times=times)
        scenes = _moments(scene.detach().map(torch.Tensor.double), len(world_to_camera), times)
        intrinsics, frame, pixels = looked_at(intrinsics.double(), size, sampling)
        maps = torch.zeros(4, len(world_to_camera), *size, dtype=torch.float64)
        self.margin = float("inf")
        for view, (now, pose) in enumerate(zip(scenes, world_to_camera.detach().double(), strict=True)):
            found, margin = stop_light(project(now, pose, intrinsics, frame, now.colours), pixels)
            for into, values in zip(maps, (found.depth, found.spread, found.stopped, found.nearby), strict=True):
                into[view] = values.reshape(size)
            self.margin = min(self.margin, margin)
        return StoppedLight(*maps)
