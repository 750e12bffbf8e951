"""Object motion: a part of the scene moves by itself during the exposure."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from pydantic import FiniteFloat

from gs2ci.core.arrays import Rng
from gs2ci.core.config import Positive
from gs2ci.core.errors import InputError
from gs2ci.render.gaussians import Gaussians
from gs2ci_sims.effects.base import NOTHING, Bound, BoundStep, EffectRecord, LightStage, Previewed, ViewPreview
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.signals import MovingScene


@dataclass(frozen=True)
class ObjectMotion(EffectRecord):
    """Move the Gaussians within a ball at constant velocity; at time 0, mid-exposure, they are as in the scene.

    Args:
        centre: Centre of the ball, scene units, [3].
        radius: Radius of the ball, scene units, more than 0.
        velocity: Velocity in scene units per second, along the scene's axes, [3].
    """

    stage = LightStage.SCENE
    cost_ns = 5.0

    centre: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    radius: Positive
    velocity: tuple[FiniteFloat, FiniteFloat, FiniteFloat]

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The change by a shift of half of the path, limited by the share of the frame of the object and its path.

        A pixel changes by at most the range of the radiance, and only pixels crossed by the silhouette change.
        """
        half_way_px = 0.5 * rig.exposure_s * self.image_px_per_s(scene)
        if half_way_px == 0:
            return NOTHING.by("0")
        near = scene.scene.depth_range()[0]
        radius_px = float(scene.scene.intrinsics[0, 0]) * self.radius / near + half_way_px
        share = min(1.0, np.pi * radius_px**2 / float(np.prod(scene.scene.size)))
        brightest = scene.scene.brightest
        return scene.of_views(min(scene.shifted(half_way_px)[0], brightest * share**0.5), brightest).after(
            BoundStep("s", self.image_px_per_s(scene), "px/s", "speed of the object in the image, at most"),
            BoundStep("t", rig.exposure_s, "s", "exposure"),
            BoundStep("d", half_way_px, "px", "way from the middle of the exposure", "s * t / 2"),
            BoundStep("c", share, "", "share of the frame that it may sweep"),
            BoundStep("top", brightest, "", "brightest light"),
            BoundStep(
                "most", brightest * share**0.5, "", "limit of rho: the whole range of the light there", "top * sqrt(c)"
            ),
        )

    def image_px_per_s(self, scene: ViewPreview) -> float:
        """Get the object's largest speed in the image: as if it were at the near end of the scene."""
        if not bool(self._members(scene.scene.gaussians).any()):
            return 0.0
        near = scene.scene.depth_range()[0]
        return float(scene.scene.intrinsics[:2, :2].max() * np.linalg.norm(self.velocity) / near)

    def apply(self, signal: MovingScene, rig: RigFigures, rng: Rng) -> MovingScene:
        """Return the scene with the object in motion.

        Raises:
            InputError: There are no Gaussians to move: a mesh cannot move.
        """
        if not len(signal(0.0)):
            raise InputError("object motion in a scene without Gaussians", remedy="leave [effects.object_motion] out")

        def at(time_s: float) -> Gaussians:
            gaussians = signal(time_s)
            shift = torch.tensor(self.velocity, dtype=gaussians.means.dtype) * time_s
            moved = gaussians.means + self._members(signal(0.0))[:, None] * shift
            return replace(gaussians, means=moved)

        return at

    def _members(self, gaussians: Gaussians) -> torch.Tensor:
        centre = torch.tensor(self.centre, dtype=gaussians.means.dtype)
        distance = torch.linalg.vector_norm(gaussians.means.detach() - centre, dim=1)
        return torch.le(distance, self.radius)
