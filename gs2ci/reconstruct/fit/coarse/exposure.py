"""One exposure in a fit: its measurement, its path, and what a fit keeps for it alone.

Here: the record that a fit is given for each exposure, and its state between iterations. Not here: what all exposures
of a fit share, the Gaussians above all (`state.py`), the loop (`stage.py`).
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.fit.coarse.looks import Decode, LookedAt, Score, nothing
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.losses.objective import DataTerm, Term
from gs2ci.reconstruct.fit.optimiser.poses import PoseCorrections
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fit.surfaces.surfaces import Search, Surfaces, find_surfaces
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.places import is_apart
from gs2ci.render.screen import ScreenStatistics


@dataclass(frozen=True, eq=False)
class FittedExposure:
    """What a fit is given for one exposure.

    Args:
        holdout: The measurement (its truth is not read), and its pixels that the loss may not see.
        renderer: Renders for this measurement, with the geometry's camera matrix.
        geometry: Initial poses, in the coordinates of the scene that all exposures of the fit share.
        decode: Its result is added to the scene's views at looks, as before delivery.
        score: Turns refined views into a figure for the curve; it may know the truth.
    """

    holdout: Holdout
    renderer: ShotRenderer
    geometry: Geometry
    decode: Decode = nothing
    score: Score | None = None


class ExposureState:
    """The state of one exposure between iterations.

    Args:
        exposure: The exposure.
        settings: The schedule.
        alone: Whether it is the only one. Otherwise its lists of Gaussians are not kept for its next iteration: the
            others have moved the Gaussians by then, and all lists together would take more memory than anything else.
    """

    def __init__(self, exposure: FittedExposure, settings: CoarseSettings, *, alone: bool) -> None:
        holdout, renderer, geometry = exposure.holdout, exposure.renderer, exposure.geometry
        self.exposure = exposure
        self.surfaces: Surfaces | None = None
        self._with_moments = renderer
        self.renderer = renderer.with_one_moment() if settings.mask_moments_from > 0 else renderer
        self._alone = alone
        self.meet_others()
        refined = replace(settings.poses, refine=settings.poses.refine and not geometry.known_at_rest)
        self.poses = PoseCorrections(geometry.world_to_camera, refined, geometry.pose_errors)
        shot, seen = holdout.shot, ~holdout.pixels
        term = DataTerm(shot.measurement, seen, shot.saturated, settings.loss, renderer.exposure)
        self._data_term: Term = _where_scenes_lie(term, renderer.device)

    @property
    def awaits_moments(self) -> bool:
        """Get whether masks get their moments only later."""
        return self.renderer is not self._with_moments

    def split_masks(self) -> None:
        """Give masks their moments from now on."""
        self.renderer = self._with_moments
        self.meet_others()

    def meet_others(self) -> None:
        """Discard what renderings of the same Gaussians share, since the Gaussians are new now."""
        self._reuse = self.renderer.reuse() if self._alone else None

    def backward(self, scene: Gaussians, screen: ScreenStatistics) -> tuple[float | Tensor, Tensor]:
        """Accumulate the gradients of the data term; return its value and the present poses, [N, 4, 4].

        The value is a tensor [] of a scene on a device, so that nothing has to wait for it here.
        """
        poses = self.poses.world_to_camera()
        predicted, pull = self.renderer.measurement_with_pull(scene, poses, self._reuse, screen)
        loss, gradient = self._data_term.value_and_gradient(predicted)
        self.poses.pull(poses, pull(gradient))
        return loss, poses

    def dissimilarity(self, scene: Gaussians) -> Tensor:
        """Return the dissimilarity of the present prediction and the measurement, [H, W]."""
        predicted, _ = self.renderer.measurement_with_pull(scene, self.poses.world_to_camera(), self._reuse)
        return torch.as_tensor(self._data_term.dissimilarity(predicted))

    def path(self) -> F64:
        """Return the present poses, [N, 4, 4]."""
        return self.poses.world_to_camera().detach().double().numpy()

    def views(self, scene: Gaussians) -> F32:
        """Render the scene as each mask saw it, [N, H, W, C] float32, not clamped."""
        return self.renderer.exposed(scene, self.poses.world_to_camera())

    def seen(self, scene: Gaussians) -> LookedAt:
        """Return what a look at the fit judges for this exposure."""
        coded = self.renderer.measurement(scene, self.poses.world_to_camera()).cpu().numpy()
        exposure = self.exposure
        return LookedAt(exposure.holdout, exposure.decode, coded, lambda: self.views(scene), exposure.score)

    def find_surfaces(
        self, scene: Gaussians, settings: CoarseSettings, seed: int, search: Search
    ) -> tuple[Surfaces | None, dict[int, F32]]:
        """Search for surfaces in the views as they would be delivered; also return those views that show some.

        With their residual added, since depth swept in these is nearer the truth than that of the scene that they were
        rendered from (docs/decisions/surfaces.md).
        """
        assert settings.surfaces is not None
        views, poses = self.views(scene), self.path()
        added = self.exposure.decode(self.exposure.holdout.coded(views))
        if added is not None:
            views += added
        del added  # as large as the views, and the search takes much itself
        found = find_surfaces(self.renderer, scene, poses, views, settings.surfaces, seed, search)
        return found, {} if found is None else {view: views[view].copy() for view in found.views}


def _where_scenes_lie(term: DataTerm, device: torch.device) -> Term:
    if not is_apart(device):
        return term
    from gs2ci.reconstruct.fit.losses.device_losses import DataTermOnDevice  # noqa: PLC0415  an extra

    return DataTermOnDevice(term, device)
