"""The state that iterations of the coarse stage change: Gaussians, poses, surfaces, and statistics for density rules.

Here: the state, its gradients, its steps, and copies of it to go back to. Not here: when each is due (`coarse.py`), the
parts of a step (losses, optimiser, poses, density rules: one file each).
"""

import sys
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F32
from gs2ci.core.errors import ResourceError
from gs2ci.reconstruct.fit.coarse_settings import CoarseSettings
from gs2ci.reconstruct.fit.density.base import change_among
from gs2ci.reconstruct.fit.depth_field import DepthField, FieldStep
from gs2ci.reconstruct.fit.gathering import Gathering
from gs2ci.reconstruct.fit.looks import Decode
from gs2ci.reconstruct.fit.losses import DataTerm, add_regularisers
from gs2ci.reconstruct.fit.margin import MarginSource, margin
from gs2ci.reconstruct.fit.optimiser import GaussianOptimiser
from gs2ci.reconstruct.fit.poses import PoseCorrections, length_of, path_extent
from gs2ci.reconstruct.fit.raster_order import raster_order
from gs2ci.reconstruct.fit.relief import Exchange, Relief
from gs2ci.reconstruct.fit.rendering import ShotRenderer
from gs2ci.reconstruct.fit.surfaces import Search, Surfaces, find_surfaces, pixel_rays
from gs2ci.reconstruct.fit.view_steps import ReferenceView
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.render.gaussians import Gaussians, joined


@dataclass
class Snapshot:
    """A state to go back to."""

    scene: Gaussians
    twists: Tensor
    iteration: int
    surfaces: Surfaces | None
    outside: Tensor | None
    searches: tuple[Search, ...]


class FitState:
    """The state of one fit between iterations.

    Args:
        holdout: The measurement, and its pixels that the loss may not see.
        renderer: Renders for this shot.
        start: Initial Gaussians.
        geometry: Initial poses.
        settings: The schedule.
        seed: For the density rule's draws.
        outside: Which initial Gaussians lie beyond the borders of all views, [G] bool; None: none.
    """

    def __init__(
        self,
        holdout: Holdout,
        renderer: ShotRenderer,
        start: Gaussians,
        geometry: Geometry,
        settings: CoarseSettings,
        seed: int,
        outside: Tensor | None = None,
    ) -> None:
        shot = holdout.shot
        self._seed = seed
        self._holdout = holdout
        # Without parallax, views show no depth.
        moved = settings.surfaces is not None and geometry.has_path
        self._searches = list(settings.surfaces.searches) if moved and settings.surfaces is not None else []
        self._surfaces: Surfaces | None = None
        self._outside = outside
        self._depth_field = _depth_field(settings, geometry, renderer) if moved and start.motion is None else None
        self._field_step: FieldStep | None = None
        self._exchange: Exchange | None = None
        # Not if a stage or a file gave the camera's turns, and not with moving things, whose motion looks like depth.
        free = geometry.has_path and not geometry.is_given and start.motion is None
        self._relief = Relief(settings.relief, geometry.reference) if settings.relief is not None and free else None
        self.settings = settings
        self._with_moments = renderer
        self._render_by(renderer.with_one_moment() if settings.mask_moments_from > 0 else renderer, len(start))
        # At depth 1, which is the scene's median depth.
        self._px_per_length = float(geometry.intrinsics[0, 0])
        self._pixels = shot.size[0] * shot.size[1]
        self.extent = length_of(settings.steps.unit, geometry.world_to_camera)
        self.cap = _UNBOUNDED
        if settings.gaussians_per_pixel is not None:
            self.cap = max(len(start), int(settings.gaussians_per_pixel * shot.size[0] * shot.size[1]))
        self._bounded = False
        self.optimiser = GaussianOptimiser(
            start, settings.steps, self.extent, _reference_view(geometry), self._px_per_length
        )
        refined = replace(settings.poses, refine=settings.poses.refine and not geometry.known_at_rest)
        self.poses = PoseCorrections(geometry.world_to_camera, refined, geometry.pose_errors)
        seen, exposure = ~holdout.pixels, renderer.exposure
        self.data_term = DataTerm(shot.measurement, seen, shot.saturated, settings.loss, exposure)
        self.generator = torch.Generator().manual_seed(seed)

    def views(self) -> F32:
        """Render the scene as each mask saw it, [N, H, W, C] float32, not clamped."""
        return self._renderer.exposed(self.optimiser.scene, self.poses.world_to_camera())

    def coded(self) -> F32:
        """Render the measurement as the scene predicts it, [H, W, C]."""
        with torch.no_grad():
            poses = self.poses.world_to_camera()
            return self._renderer.measurement(self.optimiser.scene, poses).numpy()

    def split_masks(self, share: float) -> None:
        """Give masks their moments if that is due after this share of the schedule."""
        if self.awaits_moments and share >= self.settings.mask_moments_from:
            self._render_by(self._with_moments, len(self.optimiser.scene))

    def _render_by(self, renderer: ShotRenderer, count: int) -> None:
        """Render by this from now on, and gather new statistics of so many Gaussians."""
        self._renderer = renderer
        self._gathering = Gathering(renderer, count, per_open_share=self.settings.per_open_share)
        self._reuse = renderer.reuse()

    def backward(self, share: float, iteration: int) -> float:
        """Accumulate gradients of the objective.

        Args:
            share: Share of the schedule that is done.
            iteration: Number of iterations done.

        Returns:
            The loss without the terms of surfaces and motion; NaN if a parameter is not finite.
        """
        if not self.optimiser.scene_is_finite():
            return float("nan")
        self.optimiser.let_colours_vary(self.settings.colours.at(share))
        scene, poses = self.optimiser.scene, self.poses.world_to_camera()
        predicted, pull = self._renderer.measurement_with_pull(scene, poses, self._reuse, self._gathering.screen)
        loss, gradient = self.data_term.value_and_gradient(predicted)
        self.poses.pull(poses, pull(gradient))
        loss += add_regularisers(scene, self.settings.loss)
        for further in (self.settings.motion.penalty(scene, self._px_per_length, self._pixels), self.poses.penalty()):
            if isinstance(further, Tensor):
                further.backward()  # type: ignore[no-untyped-call]
        # Before the surfaces' term: an exchange moves the surfaces too, so that their gradients must not influence it.
        self._exchange = self._exchange_wanted(poses, share)
        # Before there are surfaces, nothing holds regions where they are.
        field = None if self._surfaces is None else self._depth_field
        self._field_step = None if field is None else field.step(scene, poses, share, iteration)
        if self._surfaces is not None:
            turn, between = divmod(iteration, self._surfaces.settings.every)
            if between == 0:
                self._surfaces.draw(self._renderer, scene, poses, turn, self._surfaces.search.weight_at(share))
        return loss

    @property
    def awaits_surfaces(self) -> bool:
        """Get whether a search for surfaces is still to come."""
        return bool(self._searches)

    @property
    def awaits_moments(self) -> bool:
        """Get whether masks get their moments only later."""
        return self._renderer is not self._with_moments

    def find_surfaces(self, share: float, decode: Decode) -> bool:
        """Search for surfaces if a search is due, and tell whether some were found now.

        The plane sweep uses the views as they would be delivered, with their residual added: its depth is nearer the
        truth than that of the scene that they were rendered from (docs/decisions/surfaces.md).
        """
        settings = self.settings.surfaces
        if settings is None or not self._searches or share < self._searches[0].begins:
            return False
        search = self._searches.pop(0)
        scene, poses = self.optimiser.scene.detach(), self.poses.world_to_camera().detach().double().numpy()
        views = self.views()
        added = decode(self._holdout.coded(views))
        if added is not None:
            views += added
        found = find_surfaces(self._renderer, scene, poses, views, settings, self._seed, search)
        self._surfaces = found or self._surfaces
        if found is not None and not self._searches and settings.margin is not None:
            source = MarginSource(found.views, views, found.inverse_depth)
            self._continue_outwards(margin(self._renderer, scene, poses, source, settings.margin))
        return found is not None

    def _continue_outwards(self, added: Gaussians | None) -> None:
        """Add the Gaussians that continue the scene beyond the borders of all views, if there are any."""
        if added is None:
            return
        scene = self.optimiser.scene.detach()
        present = torch.arange(len(scene))
        new = torch.full((len(added),), -1, dtype=torch.int64)
        self.optimiser.replace(joined([scene, added]), torch.cat([present, new]))
        self._outside = torch.cat([present < 0, new < 0])
        self._meet_others()

    def is_finite(self, loss: float) -> bool:
        """Tell whether the loss and all gradients are finite, so that a step may be made."""
        return np.isfinite(loss) and self.optimiser.gradient_is_finite() and self.poses.gradient_is_finite()

    def step(self, share: float, damping: float) -> None:
        """Step the parameters by their gradients, and let the density rule shake the Gaussians."""
        exchange = self._exchange
        if self._outside is not None:
            self.optimiser.hold(self._outside)
        self.optimiser.step(share, damping)
        self.poses.step(share, damping)
        if exchange is not None:
            exchange.of_scene(self.optimiser.scene)
            self.poses.shift(exchange.twists)
            if self._surfaces is not None:
                self._surfaces = self._surfaces.exchanged(exchange)
        if self._field_step is not None:
            self._field_step.of_scene(self.optimiser.scene)
            if self._surfaces is not None:
                self._surfaces = self._surfaces.moved(self._field_step, self.poses.world_to_camera())
        rate = self.optimiser.means_rate(share, damping)
        moves = self.settings.density.shake(self.optimiser.scene, rate, self.generator)
        if moves is not None:
            self.optimiser.shift(moves)

    def _exchange_wanted(self, poses: Tensor, share: float) -> Exchange | None:
        """Choose by the present gradients how much turning becomes travel; None if this fit exchanges nothing."""
        gradient = self.poses.gradient()
        if self._relief is None or gradient is None:
            return None
        return self._relief.step(self.optimiser.scene, poses, gradient, share)

    def bound_population(self) -> None:
        """Bound the population by its size at the first call (paper, supplement II)."""
        if not self._bounded:
            self.cap = min(self.cap, len(self.optimiser.scene))
            self._bounded = True

    def densify(self, iteration: int) -> bool:
        """Apply the density rule; return whether it set the fit back on purpose, as a reset does.

        The rule passes over the Gaussians beyond the borders of all views: no pixel tells anything about them, and
        copies of them would be free to fade.

        Raises:
            ResourceError: The rule wants more Gaussians than the memory guard allows.
        """
        scene, poses = self.optimiser.scene, self.poses.world_to_camera()
        evidence = self._gathering.evidence(
            scene, poses, self._dissimilarity, extent=self.extent, cap=self.cap, iteration=iteration
        )
        inside = torch.ones(len(scene), dtype=torch.bool) if self._outside is None else ~self._outside
        change = change_among(self.settings.density, inside, scene, evidence, self.generator)
        _guard_memory(len(change.scene), self.settings.most_gaussians, iteration)
        middle = poses[len(poses) // 2].detach()
        order = raster_order(change.scene.means.detach(), middle, self._renderer.intrinsics)
        source = change.source[order]
        self.optimiser.replace(change.scene.map(lambda rows: rows[order]), source, change.forget)
        if self._outside is not None:
            self._outside = (source >= 0) & self._outside[source]
        self._meet_others()
        return bool(change.forget)

    def _meet_others(self) -> None:
        """Discard the statistics of the Gaussians and what their renderings share, since the Gaussians are new now."""
        self._gathering.start_again(len(self.optimiser.scene))
        self._reuse = self._renderer.reuse()

    def _dissimilarity(self) -> Tensor:
        """Return the dissimilarity of the present prediction and the measurement, [H, W]."""
        scene, poses = self.optimiser.scene, self.poses.world_to_camera()
        predicted, _ = self._renderer.measurement_with_pull(scene, poses, self._reuse)
        return torch.from_numpy(self.data_term.dissimilarity(predicted))

    def snapshot(self, iteration: int) -> Snapshot:
        """Copy the present state."""
        copy = self.optimiser.scene.map(lambda tensor: tensor.detach().clone())
        twists, searches = self.poses.snapshot(), tuple(self._searches)
        return Snapshot(copy, twists, iteration, self._surfaces, self._outside, searches)

    def restore(self, state: Snapshot) -> None:
        """Go back to a state; searches for surfaces that it had not made yet are due again, in its scene."""
        self.optimiser.restore(state.scene)
        self.poses.restore(state.twists)
        # One gradient of a state that ran away would leave squares that shorten their steps for hundreds of iterations.
        for others in (self._relief, self._depth_field):
            if others is not None:
                others.forget()
        # What later searches found fits their path, which exchanges of turning for travel may have moved since.
        self._surfaces, self._outside = state.surfaces, state.outside
        self._searches = list(state.searches)
        self._meet_others()


_UNBOUNDED: Final = sys.maxsize


def _depth_field(settings: CoarseSettings, geometry: Geometry, renderer: ShotRenderer) -> DepthField | None:
    """Return the field that moves depths of whole regions, at rest; None where the settings want none."""
    if settings.surfaces is None or settings.surfaces.depth_field is None:
        return None
    across, down = np.abs(pixel_rays(renderer)).max(axis=(0, 1)).tolist()
    return DepthField(settings.surfaces.depth_field, geometry.reference, (across, down))


def _reference_view(geometry: Geometry) -> ReferenceView | None:
    """Return the view in whose coordinates positions step; None without a path, when nothing tells depth."""
    if not geometry.has_path:
        return None
    poses = geometry.world_to_camera
    return ReferenceView(poses[geometry.reference], float(geometry.intrinsics[0, 0]), path_extent(poses))


def _guard_memory(count: int, most: int | None, iteration: int) -> None:
    """Raise an error if the population exceeds the memory guard."""
    if most is not None and count > most:
        raise ResourceError(
            f"the density rule wants {count:,} Gaussians at iteration {iteration}",
            allowed=f"at most {most:,}, the memory guard of this fit",
            remedy="bound the population (leave out `--without count-cap`), take another preset, or a smaller picture",
        )
