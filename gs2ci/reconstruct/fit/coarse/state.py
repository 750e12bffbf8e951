"""The state that iterations of the coarse stage change: Gaussians, poses, surfaces, and statistics for density rules.

A fit holds one exposure or several. They share the Gaussians, their optimiser and the density rule; each has its own
masks, poses and surfaces (`exposure.py`). An iteration works on one of them, each in its turn, so that its time and
its memory are those of one exposure.

Here: the state, its gradients, its steps, and copies of it to go back to. Not here: when each is due (`stage.py`), the
parts of a step (losses, optimiser, poses, density rules: one file each).
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import ResourceError
from gs2ci.reconstruct.fit.coarse.exposure import ExposureState, FittedExposure
from gs2ci.reconstruct.fit.coarse.keeping import Keeper, KeptSearch, KeptState, Snapshot, kept_scene, scene_again
from gs2ci.reconstruct.fit.coarse.looks import LookedAt
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.density.base import change_among
from gs2ci.reconstruct.fit.density.gathering import Gathering
from gs2ci.reconstruct.fit.losses.objective import add_regularisers
from gs2ci.reconstruct.fit.optimiser.gaussians import GaussianOptimiser
from gs2ci.reconstruct.fit.optimiser.poses import length_of, path_length
from gs2ci.reconstruct.fit.optimiser.view_steps import ReferenceView
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fit.scene.start import raster_order
from gs2ci.reconstruct.fit.surfaces.depth_field import DepthField, FieldStep
from gs2ci.reconstruct.fit.surfaces.margin import MarginSource, margin
from gs2ci.reconstruct.fit.surfaces.surfaces import Surfaces, pixel_rays
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.render.gaussians import Gaussians, joined
from gs2ci.render.screen import ScreenStatistics

_ORDER_STREAM: Final = 0xE0  # makes the order of exposures independent of all other draws of the same seed


class FitState:
    """The state of one fit between iterations.

    Args:
        exposures: One or more, of one camera; their poses are in the coordinates of the first.
        start: Initial Gaussians.
        settings: The schedule.
        seed: For the density rule's draws, and for the order of exposures.
        outside: Which initial Gaussians lie beyond the borders of all views, [G] bool; None: none.
    """

    def __init__(
        self,
        exposures: Sequence[FittedExposure],
        start: Gaussians,
        settings: CoarseSettings,
        seed: int,
        outside: Tensor | None = None,
    ) -> None:
        first = exposures[0]
        geometry, size, alone = first.geometry, first.holdout.shot.size, len(exposures) == 1
        self._seed = seed
        self.settings = settings
        self.exposures = tuple(ExposureState(one, settings, alone=alone) for one in exposures)
        self._current = self.exposures[0]
        self._gather(len(start))
        # Without parallax, views show no depth.
        moved = settings.surfaces is not None and geometry.has_path
        self._searches = list(settings.surfaces.searches) if moved and settings.surfaces is not None else []
        self._outside = outside
        # Several exposures see depth from places of their own, and none of them may move it for all others.
        field = moved and start.motion is None and alone
        self._depth_field = _depth_field(settings, geometry, first.renderer) if field else None
        self._field_step: FieldStep | None = None
        self._is_given = geometry.is_given
        # At depth 1, which is the scene's median depth.
        self._px_per_length = float(geometry.intrinsics[0, 0])
        self._pixels = size[0] * size[1]
        paths = [one.geometry.world_to_camera for one in exposures]
        # Of one path, not of all together: with steps as short as parallax along all of them allows, a schedule does
        # not reach depths that first ones, found along one path, are far from.
        self.extent = float(np.median([length_of(settings.steps.unit, path) for path in paths]))
        self.cap = _UNBOUNDED
        if settings.gaussians_per_pixel is not None:
            self.cap = max(len(start), int(settings.gaussians_per_pixel * size[0] * size[1]))
        self._bounded = False
        self._device = first.renderer.device
        self.optimiser = GaussianOptimiser(
            self._there(start), settings.steps, self.extent, _reference_view(geometry, paths), self._px_per_length
        )
        self.generator = torch.Generator().manual_seed(seed)

    def _there(self, scene: Gaussians) -> Gaussians:
        """Return Gaussians where they are fitted."""
        return scene.map(lambda tensor: tensor.to(self._device))

    @property
    def scene(self) -> Gaussians:
        """Get the Gaussians as they are now, where they are fitted."""
        return self.optimiser.scene

    def views(self, number: int = 0) -> F32:
        """Render the scene as each mask of one exposure saw it, [N, H, W, C] float32, not clamped."""
        return self.exposures[number].views(self.scene)

    def seen(self) -> Iterator[LookedAt]:
        """Return what a look judges, exposure after exposure."""
        return (one.seen(self.scene) for one in self.exposures)

    def _in_turn(self, iteration: int) -> ExposureState:
        """Return the exposure that an iteration works on: each once in a round, in an order drawn for the round."""
        count = len(self.exposures)
        if count == 1:
            return self.exposures[0]
        turn, place = divmod(iteration, count)
        order = np.random.default_rng([self._seed, _ORDER_STREAM, turn]).permutation(count)
        return self.exposures[int(order[place])]

    def split_masks(self, share: float) -> None:
        """Give masks their moments if that is due after this share of the schedule."""
        if self.awaits_moments and share >= self.settings.mask_moments_from:
            for one in self.exposures:
                one.split_masks()
            self._gather(len(self.scene))

    def _gather(self, count: int) -> None:
        """Gather statistics of so many Gaussians anew."""
        renderers = [one.renderer for one in self.exposures]
        self._gathering = Gathering(renderers, count, comparable=self.settings.comparable_gradients)

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
        scene, self._current = self.scene, self._in_turn(iteration)
        current = self._current
        loss, poses = current.backward(scene, self._gathering.screen)
        loss += add_regularisers(scene, self.settings.loss)
        motion = self.settings.motion.penalty(scene, self._px_per_length, self._pixels)
        for further in (motion, current.poses.penalty()):
            if isinstance(further, Tensor):
                further.backward()  # type: ignore[no-untyped-call]
        surfaces = current.surfaces
        # Before there are surfaces, nothing holds regions where they are.
        field = None if surfaces is None else self._depth_field
        # A stage or a file gave the camera's turns, if it gave the path.
        by_twists = None if self._is_given else current.poses.gradient()
        self._field_step = None if field is None else field.step(scene, poses, share, iteration, by_twists)
        if surfaces is not None:
            turn, between = divmod(iteration // len(self.exposures), surfaces.settings.every)
            if between == 0:
                surfaces.draw(current.renderer, scene, poses, turn, surfaces.search.weight_at(share))
        return float(loss)

    @property
    def awaits_surfaces(self) -> bool:
        """Get whether a search for surfaces is still to come."""
        return bool(self._searches)

    @property
    def awaits_moments(self) -> bool:
        """Get whether masks get their moments only later."""
        return any(one.awaits_moments for one in self.exposures)

    def search_is_due(self, share: float) -> bool:
        """Tell whether a search for surfaces is due after this share of the schedule."""
        return bool(self._searches) and share >= self._searches[0].begins

    def find_surfaces(self, share: float, keeper: Keeper | None, at: tuple[int, int]) -> bool:
        """Search for surfaces in each exposure if a search is due, and tell whether some were found now.

        Args:
            share: Of the schedule that is done.
            keeper: Keeps what is found in each exposure.
            at: Iterations and rollbacks so far.
        """
        settings = self.settings.surfaces
        if settings is None or not self.search_is_due(share) or not self.optimiser.scene_is_finite():
            return False
        number, search = len(settings.searches) - len(self._searches), self._searches.pop(0)
        outwards = settings.margin if not self._searches else None
        scene = self.scene.detach()
        sources, before = [], 0
        for exposure, one in enumerate(self.exposures):
            kept = None if keeper is None else keeper.kept_search(number, exposure)
            if kept is not None and kept.at == at:
                found, shown = kept.surfaces, kept.shown
                found = None if found is None else found.with_masks(one.renderer)
            else:
                found, shown = one.find_surfaces(scene, self.settings, self._seed + exposure, search)
                if keeper is not None:
                    bare = None if found is None else found.without_masks()
                    keeper.keep_search(number, exposure, KeptSearch(at, bare, shown))
            if found is not None:
                one.surfaces = found
                numbers = tuple(before + view for view in found.views)
                shown = {before + view: seen for view, seen in shown.items()} if outwards is not None else {}
                sources.append(MarginSource(numbers, shown, found.inverse_depth.cpu().numpy()))
            before += len(one.path())
        if sources and outwards is not None:
            path = np.concatenate([one.path() for one in self.exposures])
            self._continue_outwards(margin(self.exposures[0].renderer, scene, path, _joined(sources), outwards))
        return bool(sources)

    def _continue_outwards(self, added: Gaussians | None) -> None:
        """Add the Gaussians that continue the scene beyond the borders of all views, if there are any."""
        if added is None:
            return
        scene, added = self.scene.detach(), self._there(added)
        present = torch.arange(len(scene))
        new = torch.full((len(added),), -1, dtype=torch.int64)
        self.optimiser.replace(joined([scene, added]), torch.cat([present, new]))
        self._outside = torch.cat([present < 0, new < 0])
        self._meet_others()

    def is_finite(self, loss: float) -> bool:
        """Tell whether the loss and all gradients are finite, so that a step may be made."""
        return np.isfinite(loss) and self.optimiser.gradient_is_finite() and self._current.poses.gradient_is_finite()

    def step(self, share: float, damping: float) -> None:
        """Step the parameters by their gradients, and let the density rule shake the Gaussians."""
        current = self._current
        if self._outside is not None:
            self.optimiser.hold(self._outside)
        self.optimiser.step(share, damping)
        current.poses.step(share, damping)
        if self._field_step is not None:
            self._field_step.of_scene(self.scene)
            if current.surfaces is not None:
                current.surfaces = current.surfaces.moved(self._field_step, current.poses.world_to_camera())
            if self._field_step.twists is not None:
                current.poses.shift(self._field_step.twists)
        rate = self.optimiser.means_rate(share, damping)
        moves = self.settings.density.shake(self.scene, rate, self.generator)
        if moves is not None:
            self.optimiser.shift(moves)

    def bound_population(self) -> None:
        """Bound the population by its size at the first call (paper, supplement II)."""
        if not self._bounded:
            self.cap = min(self.cap, len(self.scene))
            self._bounded = True

    def densify(self, iteration: int) -> bool:
        """Apply the density rule; return whether it set the fit back on purpose, as a reset does.

        The rule passes over the Gaussians beyond the borders of all views: no pixel tells anything about them, and
        copies of them would be free to fade.

        Raises:
            ResourceError: The rule wants more Gaussians than the memory guard allows.
        """
        here, paths = self.scene, [one.poses.world_to_camera() for one in self.exposures]
        evidence = self._gathering.evidence(
            here,
            paths,
            lambda: [one.dissimilarity(here) for one in self.exposures],
            extent=self.extent,
            cap=self.cap,
            iteration=iteration,
        )
        # Rules draw, and decide, on the host.
        scene = here.map(Tensor.cpu)
        inside = torch.ones(len(scene), dtype=torch.bool) if self._outside is None else ~self._outside
        change = change_among(self.settings.density, inside, scene, evidence, self.generator)
        _guard_memory(len(change.scene), self.settings.most_gaussians, iteration)
        middle = paths[0][len(paths[0]) // 2].detach()
        order = raster_order(change.scene.means.detach(), middle, self.exposures[0].renderer.intrinsics)
        source = change.source[order]
        self.optimiser.replace(self._there(change.scene.map(lambda rows: rows[order])), source, change.forget)
        if self._outside is not None:
            self._outside = (source >= 0) & self._outside[source]
        self._meet_others()
        return bool(change.forget)

    def _meet_others(self) -> None:
        """Discard the statistics of the Gaussians and what their renderings share, since the Gaussians are new now."""
        self._gather(len(self.scene))
        for one in self.exposures:
            one.meet_others()

    def snapshot(self, iteration: int) -> Snapshot:
        """Copy the present state."""
        copy = self.scene.map(lambda tensor: tensor.detach().clone())
        twists = tuple(one.poses.snapshot() for one in self.exposures)
        surfaces = tuple(one.surfaces for one in self.exposures)
        return Snapshot(copy, twists, iteration, surfaces, self._outside, tuple(self._searches))

    def kept(self, state: Snapshot) -> Snapshot:
        """Return a state for the disk."""
        return kept_scene(state, () if self.settings.surfaces is None else self.settings.surfaces.searches)

    def again(self, kept: Snapshot, keeper: Keeper) -> Snapshot:
        """Return the state that was kept."""
        renderers = [one.renderer for one in self.exposures]
        return replace(scene_again(kept, renderers, keeper), scene=self._there(kept.scene))

    def state(self) -> KeptState:
        """Return all that iterations change, on the host."""
        now = self.snapshot(0)
        screen = self._gathering.screen
        return KeptState(
            self.kept(now),
            self.optimiser.state(),
            tuple(one.poses.state() for one in self.exposures),
            not self.awaits_moments,
            (screen.gradient_sum, screen.sightings, screen.radius_px),
            self.generator.get_state(),
            self.cap if self._bounded else None,
        )

    def resume(self, kept: KeptState, keeper: Keeper) -> None:
        """Go on from the state of another fit of the same exposures."""
        if kept.split:
            self.split_masks(1.0)
        self.restore(self.again(kept.now, keeper))
        self.optimiser.resume(self._there(kept.now.scene), kept.moments)
        for one, poses in zip(self.exposures, kept.poses, strict=True):
            one.poses.resume(poses)
        self._gathering.screen = ScreenStatistics(*(one.to(self._device) for one in kept.screen))
        self.generator.set_state(kept.generator)
        if kept.bound is not None:
            self.cap, self._bounded = kept.bound, True

    def restore(self, state: Snapshot) -> None:
        """Go back to a state; searches for surfaces that it had not made yet are due again, in its scene."""
        self.optimiser.restore(state.scene)
        for one, twists, surfaces in zip(self.exposures, state.twists, state.surfaces, strict=True):
            one.poses.restore(twists)
            # What later searches found fits their path.
            one.surfaces = surfaces if isinstance(surfaces, Surfaces) else None
        # One gradient of a state that ran away would leave squares that shorten their steps for hundreds of iterations.
        if self._depth_field is not None:
            self._depth_field.forget()
        self._outside = state.outside
        self._searches = list(state.searches)
        self._meet_others()


_UNBOUNDED: Final = sys.maxsize


def _depth_field(settings: CoarseSettings, geometry: Geometry, renderer: ShotRenderer) -> DepthField | None:
    """Return the field that moves depths of whole regions, at rest; None where the settings want none."""
    if settings.surfaces is None or settings.surfaces.depth_field is None:
        return None
    across, down = np.abs(pixel_rays(renderer)).max(axis=(0, 1)).tolist()
    return DepthField(settings.surfaces.depth_field, geometry.reference, (across, down))


def _reference_view(geometry: Geometry, paths: Sequence[F64]) -> ReferenceView | None:
    """Return the view in whose coordinates positions step; None without a path, when nothing tells depth.

    Args:
        geometry: Of the first exposure.
        paths: Poses of each exposure, [N, 4, 4].
    """
    if not geometry.has_path:
        return None
    pose = geometry.world_to_camera[geometry.reference]
    length = float(np.median([path_length(path) for path in paths]))
    return ReferenceView(pose, float(geometry.intrinsics[0, 0]), length)


def _joined(sources: Sequence[MarginSource]) -> MarginSource:
    """Return what views of several exposures show, numbered through all of them."""
    numbers = tuple(number for one in sources for number in one.numbers)
    shown = {number: view for one in sources for number, view in one.views.items()}
    return MarginSource(numbers, shown, np.concatenate([one.inverse_depth for one in sources]))


def _guard_memory(count: int, most: int | None, iteration: int) -> None:
    """Raise an error if the population exceeds the memory guard."""
    if most is not None and count > most:
        raise ResourceError(
            f"the density rule wants {count:,} Gaussians at iteration {iteration}",
            allowed=f"at most {most:,}, the memory guard of this fit",
            remedy="bound the population (leave out `--without count-cap`), take another preset, or a smaller picture",
        )
