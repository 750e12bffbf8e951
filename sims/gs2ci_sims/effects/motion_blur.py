"""Motion blur: the camera moves while a mask is shown, so the light behind each mask is an integral over time."""

from dataclasses import dataclass

import numpy as np

from gs2ci.core.arrays import Rng
from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import NOTHING, Bound, BoundStep, EffectRecord, LightStage, Previewed
from gs2ci_sims.moments import Moments, one_per_interval
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.signals import nominal_slices
from gs2ci_sims.waves import FREQUENCIES, CollectedWaves


@dataclass(frozen=True)
class MotionBlur(EffectRecord):
    """Sample the moving image at as many moments as its motion requires, and integrate over all of them.

    Without this effect, each mask sees one moment: the middle of its interval.

    Args:
        nodes: Views per panel of time, at least 1; the planner chooses.
        edges_s: Ends of the panels, increasing; empty: one panel per mask interval.
    """

    stage = LightStage.MOMENTS
    cost_ns = 0.0

    nodes: int = 3
    edges_s: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.nodes < 1 or len(self.edges_s) == 1:
            raise InputError(
                f"motion blur with {self.nodes} views in each panel between {self.edges_s}",
                allowed="1 or more; two or more ends of panels, or none",
            )

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Each view's spectrum, times the error of one view per mask instead of the sweep through its interval.

        A cosine of frequency f swept over d pixels keeps sin(x)/x of its amplitude, x = pi f d: the transfer
        function of linear motion (Boreman, Modulation Transfer Function in Optical Systems, section 2.2). A camera
        that oscillates also has its mean position elsewhere than in the middle of the interval.
        """
        if not scene.motion_px.any():
            return NOTHING.by("0")
        intervals_s = scene.intervals_s
        waves = CollectedWaves(scene.scene, scene.path, nominal_slices(intervals_s), scene.object_px_per_s)
        return sampling_bound(scene, waves, one_per_interval(intervals_s)).after(
            BoundStep(
                "d",
                float(scene.motion_px.max()),
                "px",
                "motion of the image under one mask, at most; a cosine of frequency k keeps sinc(k d)",
            ),
        )

    def apply(self, signal: Moments, rig: RigFigures, rng: Rng) -> Moments:
        """Replace the one moment per interval."""
        return Moments(np.array(self.edges_s) if self.edges_s else signal.edges_s, self.nodes)


def sampling_bound(scene: Previewed, waves: CollectedWaves, moments: Moments) -> Bound:
    """Bound the error of sampling the moving image at these moments.

    It is, behind each mask, the image's spectrum times the error of each cosine by the sampled views.
    """
    missed = waves.missed(moments, scene.rig.timing.interval_s)
    rms, shares = scene.spectrum.missed(FREQUENCIES, missed)
    return scene.of_views(rms, scene.scene.brightest * min(1.0, float(shares.max())))
