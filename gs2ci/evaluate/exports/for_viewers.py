"""A scene as viewers of Gaussian splatting draw it alike: fitted again under what they do otherwise than our renderer.

Two things differ. Viewers clamp a Gaussian's colour to 0 ... 1, ours does not. And a Gaussian narrower than a pixel is
widened by all of them to about half a pixel, but some keep its opacity, as Kerbl et al. (2023) do and the fit did,
while others lower it so that its light stays the same (Yu et al., "Mip-Splatting", CVPR 2024; the default of Spark). A
file cannot say which. So sizes get a part of the widening in space, which leaves less to the viewer, and then colours,
opacities and sizes are fitted under both conventions together to what the scene shows in the run's own views.

Here: `for_viewers`; `brought_nearer`, for formats whose places have few bits; `typical_depth`. Not here: files.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import torch
from torch import Tensor

from gs2ci.render.backend import load_backend
from gs2ci.render.conventions import DILATION_PX2, FRUSTUM_MARGIN, NEAR
from gs2ci.render.gaussians import Gaussians, logit, rotation_matrices
from gs2ci.render.harmonics import colours_seen
from gs2ci.render.interface import Backend

STEPS: Final = 96
# Steps of Adam at the beginning; they shrink along a cosine to a twentieth.
_RATES: Final = {"colours": 0.02, "opacity_logits": 0.1, "log_scales": 0.02, "harmonics": 0.002}
_LAST_RATE: Final = 0.05
# Widening in space before the fit, px² in the middle view: of 0 to 0.3 what leaves both conventions alike.
_BAKED_PX2: Final = 0.2
# Opacities stay below 1 and above 0 by this, so that their logits are finite.
_OPACITY_MARGIN: Final = 1e-6
_SEED: Final = 0
# Squares of sizes in a large or a small unit leave float32, and renderers have a nearest depth.
_SHOWN_DEPTH: Final = 10.0


@dataclass(frozen=True)
class Alike:
    """How alike a scene looks to its own views, in viewers that keep opacities and in those that keep light.

    Args:
        opacity_db: PSNR over the run's views where opacities are kept.
        light_db: The same where light is kept.
    """

    opacity_db: float
    light_db: float

    def in_words(self) -> str:
        """Return both figures, named."""
        return f"{self.opacity_db:.1f} dB where opacities are kept, {self.light_db:.1f} dB where light is"


@dataclass(frozen=True)
class ForViewers:
    """A scene for viewers, and what it cost.

    Args:
        scene: Its colours lie in 0 ... 1; nothing moves.
        before: How the scene as it was fitted looks in viewers.
        after: How this one does.
    """

    scene: Gaussians
    before: Alike
    after: Alike

    @property
    def sentence(self) -> str:
        """Say what was done."""
        return (
            "Colours, opacities and sizes are fitted to what viewers do, colours within 0 to 1: against the scene's "
            f"own views {self.after.in_words()}; as it was fitted, {self.before.in_words()}."
        )


def for_viewers(
    scene: Gaussians, world_to_camera: Tensor, intrinsics: Tensor, size: tuple[int, int], *, steps: int = STEPS
) -> ForViewers:
    """Fit a scene to viewers.

    Args:
        scene: The Gaussians; moving ones are taken at the middle of the exposure.
        world_to_camera: The run's path, [N, 4, 4].
        intrinsics: [3, 3], px.
        size: Height and width of the views, px.
        steps: Of the fit, each with one view under both conventions.
    """
    whole = scene.detach().at(0.0).map(torch.Tensor.double)
    scale = _SHOWN_DEPTH / typical_depth(whole.means, world_to_camera.double())
    still = _scaled(whole, scale).map(torch.Tensor.float)
    poses = world_to_camera.double().clone()
    poses[:, :3, 3] *= scale
    room = _Room(load_backend(), poses.float(), intrinsics.float(), size)
    with torch.no_grad():
        wanted = torch.stack([room.opacity_kept(still, view, clamped=False) for view in range(len(room.poses))])
    clamped = replace(still, colours=still.colours.clamp(0, 1))
    before = room.alike(clamped, wanted)
    fitted = _fitted(room, _widened(clamped, room), wanted, steps) if len(still) else clamped
    after = room.alike(fitted, wanted)
    # What is hardly seen in any view may be fitted to worse: then the scene is handed on with its colours clamped.
    if min(after.opacity_db, after.light_db) < min(before.opacity_db, before.light_db):
        fitted, after = clamped, before
    own = _scaled(fitted.map(torch.Tensor.double), 1 / scale)
    return ForViewers(replace(own, means=whole.means).map(torch.Tensor.float), before, after)


def brought_nearer(scene: Gaussians, world_to_camera: Tensor, distances: float) -> tuple[Gaussians, int]:
    """Bring Gaussians that are very far away nearer, their sizes with them: from the cameras they look as before.

    A few of a fit lie thousands of times as far away as what the cameras look at, without any parallax to hold them,
    and a format with one grid of places for all then has no steps left for the others.

    Args:
        scene: The Gaussians.
        world_to_camera: The run's path, [N, 4, 4].
        distances: The farthest that is left, in typical distances from the middle of the path.

    Returns:
        The scene, and how many Gaussians are brought nearer.
    """
    whole = scene.detach().map(torch.Tensor.double)
    poses = world_to_camera.double()
    middle = torch.linalg.inv(poses)[:, :3, 3].mean(dim=0)
    most = distances * typical_depth(whole.means, poses)
    away = (whole.means - middle).norm(dim=1)
    share = (most / away.clamp(min=most))[:, None]
    nearer = replace(whole, means=middle + share * (whole.means - middle), log_scales=whole.log_scales + share.log())
    return nearer.map(torch.Tensor.float), int((share < 1).sum())


@dataclass(frozen=True)
class _Room:
    """Cameras, and how viewers of both conventions draw a scene in them."""

    backend: Backend
    poses: Tensor
    intrinsics: Tensor
    size: tuple[int, int]

    def opacity_kept(self, scene: Gaussians, view: int, *, clamped: bool = True) -> Tensor:
        """Draw one view, [H, W, 3], within 0 ... 1, by viewers that keep opacities."""
        pose = self.poses[view : view + 1]
        colours = None
        if clamped:
            colours = scene.colours[None] if scene.harmonics is None else colours_seen(scene, pose)
            colours = colours.clamp(0, 1)
        shown, _ = self.backend.views(scene, pose, self.intrinsics, self.size, colours=colours)
        return shown[0].clamp(0, 1)

    def light_kept(self, scene: Gaussians, view: int) -> Tensor:
        """Draw the same by viewers that keep light."""
        opacity = torch.sigmoid(scene.opacity_logits) * self._kept(scene, self.poses[view])
        opacity = opacity.clamp(_OPACITY_MARGIN, 1 - _OPACITY_MARGIN)
        return self.opacity_kept(replace(scene, opacity_logits=logit(opacity)), view)

    def alike(self, scene: Gaussians, wanted: Tensor) -> Alike:
        """Measure both against what the scene's own renderer shows, [N, H, W, 3]."""
        figures = []
        with torch.no_grad():
            for draw in (self.opacity_kept, self.light_kept):
                errors = [(draw(scene, view) - wanted[view]).square().mean() for view in range(len(self.poses))]
                figures.append(-10 * math.log10(max(float(torch.stack(errors).mean()), 1e-12)))
        return Alike(*figures)

    def _kept(self, scene: Gaussians, pose: Tensor) -> Tensor:
        """Return the share of its opacity that each Gaussian keeps: its area before the widening by that after it."""
        rotation = pose[:3, :3]
        points = scene.means @ rotation.T + pose[:3, 3]
        depth = points[:, 2].clamp(min=NEAR)[:, None]  # nothing nearer is drawn
        extent = points.new_tensor([self.size[1], self.size[0]])
        focal, centre = self.intrinsics.diagonal()[:2], self.intrinsics[:2, 2]
        margin = FRUSTUM_MARGIN * extent / focal
        slopes = points[:, :2] / depth
        slopes = slopes.clamp(min=-centre / focal - margin, max=(extent - centre) / focal + margin)
        jacobian = torch.cat([torch.diag_embed(focal / depth), (-focal * slopes / depth)[:, :, None]], dim=2)
        axes = rotation @ (rotation_matrices(scene.quaternions) * scene.log_scales.exp()[:, None, :])
        across, down = (jacobian @ axes).unbind(dim=1)
        # det A Aᵀ is the sum of A's squared minors (Cauchy and Binet), which does not cancel for needles.
        before = torch.linalg.cross(across, down).square().sum(dim=1)
        after = before + DILATION_PX2 * (across.square() + down.square()).sum(dim=1) + DILATION_PX2**2
        # The root has no slope at 0.
        return (before / after).clamp(min=_OPACITY_MARGIN**2).sqrt()


def typical_depth(means: Tensor, world_to_camera: Tensor) -> float:
    """Return the median depth of what lies before the middle camera; 1 where nothing does."""
    pose = world_to_camera[len(world_to_camera) // 2]
    depth = means @ pose[2, :3] + pose[2, 3]
    ahead = depth[depth > 0]
    return float(ahead.median()) if len(ahead) else 1.0


def _scaled(scene: Gaussians, scale: float) -> Gaussians:
    return replace(scene, means=scale * scene.means, log_scales=scene.log_scales + math.log(scale))


def _widened(scene: Gaussians, room: _Room) -> Gaussians:
    """Widen Gaussians in space by a part of a pixel of the middle view, where they are."""
    pose = room.poses[len(room.poses) // 2]
    depth = scene.means @ pose[2, :3] + pose[2, 3]
    ahead = depth > 0
    pixel = torch.where(ahead, depth, 0.0) / room.intrinsics[0, 0]
    added = (_BAKED_PX2 * pixel.square())[:, None].clamp(min=torch.finfo(pixel.dtype).tiny)
    return replace(scene, log_scales=0.5 * torch.logaddexp(2 * scene.log_scales, added.log()))


def _fitted(room: _Room, scene: Gaussians, wanted: Tensor, steps: int) -> Gaussians:
    """Fit colours, opacities and sizes under both conventions, one view at a time."""
    fields = {name: tensor.clone().requires_grad_(name in _RATES) for name, tensor in scene.parameters().items()}
    rates = {name: rate for name, rate in _RATES.items() if name in fields}
    groups = [{"params": [fields[name]], "lr": rate} for name, rate in rates.items()]
    adam = torch.optim.Adam(groups, betas=(0.9, 0.99))
    draws = torch.Generator().manual_seed(_SEED)
    order: list[int] = []
    for step in range(steps):
        order = order or torch.randperm(len(room.poses), generator=draws).tolist()
        view = order.pop()
        share = _LAST_RATE + (1 - _LAST_RATE) * 0.5 * (1 + math.cos(math.pi * step / steps))
        for group, rate in zip(adam.param_groups, rates.values(), strict=True):
            group["lr"] = share * rate
        adam.zero_grad()
        now = Gaussians(**fields)
        drawn = (room.opacity_kept(now, view), room.light_kept(now, view))
        sum(((one - wanted[view]).square().mean() for one in drawn), torch.zeros(())).backward()  # type: ignore[no-untyped-call]
        adam.step()
        fields["colours"].data.clamp_(0, 1)
    return Gaussians(**fields).detach()
