"""What the planner and the bounds know of a measurement before it is simulated: one quick look.

A preview renders up to three views along the path. From them, the masks and the rig's figures it derives what the
bounds need. The light behind mask n is V_k + D_n: V_k the previewed view nearest in time, D_n what the image has
changed since, by motion and by the optics.

- What the masks make of the V_k is computed, pixel by pixel.
- Of D_n only rms and peak are known, so it counts as if it were aligned with the masks in the worst way (`alignment`).
  At rest and behind perfect optics it is nothing, and the bounds are exact.

So bounds hold for every set of masks: those that add up to one, those that know the scene, those with one open pixel.
What is assumed is that the image keeps its spectrum while it moves; where the previewed views differ by more than that
allows, everything is scaled by as much.

Here: taking the look, and what a change of views, masks or light makes of the readings. What it is derived from, part
by part: `previewed.views`, `previewed.motion`, `previewed.charge`. Not here: any effect.
"""

import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64, rms_of
from gs2ci_sims.alignment import WeightSet
from gs2ci_sims.effects.base import Bound, BoundStep, Effect, LightStage, gain_step
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.motion import image_motion_px
from gs2ci_sims.path import CameraPath
from gs2ci_sims.previewed.charge import PreviewedCharge
from gs2ci_sims.previewed.views import spectral_margin, spectral_part
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.scene import Scene
from gs2ci_sims.spectrum import MovingSpectrum, moving_spectrum

# Begin, middle and end of the exposure are looked at; of an image that moves by less than this, the middle alone.
MOMENTS: Final = 3
STILL_PX: Final = 0.25
# Grain of a renderer: its largest value over the pixels against its rms (20 to 26 on planes), and the motion after
# which it is another (there its autocorrelation is nothing).
GRAIN_PEAK: Final = 25.0
GRAIN_PX: Final = 0.025


@dataclass(frozen=True)
class Preview(PreviewedCharge):
    """One quick look at a measurement: views, motion, charge, and what changes of them make of the readings."""

    def of_views(self, rms: float | F64, peak: float) -> Bound:
        """Bound what fields of this rms (of each, [N], or of all) and peak, radiance, make behind the masks."""
        weights, scale = self._most_open_weights, self.full_scale_dn
        each = np.minimum(self.colours * np.broadcast_to(rms, (len(self.masks),)), peak)
        most = float(each.max())
        worst = weights.worst_rms_of_one(most, peak) if self.at_rest else weights.worst_rms(each, peak)
        return Bound(scale * worst, scale * peak * weights.largest_sum).by(
            "S * a * rho",
            *self._full_scale_steps,
            BoundStep("rho", most, "", "change of a view, rms over the pixels as recorded; white is 1"),
            BoundStep("a", worst / most if most > 0 else 0.0, "", "what the masks make of it where they lie worst"),
        )

    def of_masks(self, effect: Effect, change: NDArray[Any], most: NDArray[Any] | None = None) -> Bound:
        """Bound what a change of the masks, [N, H, W], makes of the readings.

        Args:
            effect: Which does it.
            change: Its mean over each mask's interval; it may vary in time with one sign.
            most: The largest at any time, [N, H, W]; that of a change that lasts if not given.
        """
        modulation = self._modulation(effect)
        together = max(1.0, modulation) * np.maximum(change.max(axis=0), -change.min(axis=0))
        changes = (
            (one, np.abs(one), np.minimum(modulation * np.abs(largest), together))
            for one, largest in zip(change, change if most is None else most, strict=True)
        )
        return self._of_changes(changes, self.intervals_s, modulation)

    def of_mask_effect(self, effect: Effect) -> Bound:
        """Bound what an effect on masks changes: applied to the masks that it meets, with its device's own pattern."""
        before, after = self.masks_around(effect)
        return self.of_masks(effect, after - before)

    def of_shares(self, effect: Effect, mean: F64, swing: F64, most: float, intervals_s: F64 | None = None) -> Bound:
        """Bound what changing the light behind each mask by a share makes of the readings.

        Args:
            effect: Which does it.
            mean: The share that its whole light changes by, [N].
            swing: The mean magnitude of the change over the interval, [N], at least that of the mean: what is taken
                here and added there is light of another moment.
            most: The largest share that the light changes by at any time; 1 where light is lost or moved.
            intervals_s: All of the time that each mask's light is taken from or added to, [N, 2], if that is not its
                own interval.
        """
        modulation = self._modulation(effect)
        together = min(modulation * most, max(1.0, modulation) * float(swing.max(initial=0.0)))
        changes = (
            (float(share) * mask, float(size) * mask, together * mask)
            for mask, share, size in zip(self.shown, mean, swing, strict=True)
        )
        return self._of_changes(changes, self.intervals_s if intervals_s is None else intervals_s, modulation)

    def _of_changes(
        self,
        changes: Iterable[tuple[NDArray[Any], NDArray[Any], NDArray[Any]]],
        intervals_s: F64,
        modulation: float,
    ) -> Bound:
        """Bound changes of masks as computed for the V_k and at worst for the D_n.

        What other effects do to the light may coincide with a change, where it is largest or for all of its duration,
        and may pass another mask's light through this one.

        Args:
            changes: Of each mask: in the mean, in magnitude, and by how much other effects may alter this change.
            intervals_s: When, [N, 2].
            modulation: By what share others change the light of some masks more than of others.
        """
        total, size = (np.zeros((len(self.views), *self.scene.size)) for _ in range(2))

        def magnitudes() -> Iterator[NDArray[Any]]:
            for (mean, magnitude, altered), nearest in zip(changes, self._nearest, strict=True):
                total[nearest] += mean
                size[nearest] += altered
                yield magnitude + altered

        departures = np.minimum(self.colours * self._departures(intervals_s), self.scene.brightest)
        weights = WeightSet(magnitudes(), singly=bool(departures.any()))
        steady = self.recorded(np.einsum("khw,khwc->hwc", total, self.views))
        brightest = self.scene.brightest
        if modulation > 0:
            steady = np.abs(steady) + self.recorded(np.einsum("khw,khwc->hwc", size, self.views))
        rms = rms_of(steady)
        unseen = weights.worst_rms(departures, brightest) if departures.any() else 0.0
        peak = float(np.abs(steady).max()) + brightest * weights.largest_sum
        return Bound(self.full_scale_dn * (rms + unseen), self.full_scale_dn * peak).by(
            "S * (v + u)",
            *self._full_scale_steps,
            BoundStep(
                "m", modulation, "", "by what share other effects change when and through which mask light is collected"
            ),
            BoundStep(
                "v",
                rms,
                "",
                "changes of the masks, and what m makes of each, times the previewed views, rms; white is 1",
            ),
            BoundStep("u", unseen, "", "the same of what the image has changed since, where the masks lie worst"),
        )

    def of_photon_effect(self, effect: Effect, most: float) -> Bound:
        """Bound what a linear effect on the photons changes in the previewed measurement, and in what that differs by.

        Args:
            effect: Applied to what those before it leave of the measurement, with its device's own pattern.
            most: The largest share of an image, rms, that it can change.
        """
        names = [other.name for other in self._chain.at(LightStage.PHOTONS)]
        earlier = names.index(effect.name) if effect.name in names else 0
        chain = EffectChain(self._chain.at(LightStage.PHOTONS)[:earlier], self.seed, self.rig)
        before = chain.through(LightStage.PHOTONS, self.light_e)
        after = EffectChain([effect], self.seed, self.rig).through(LightStage.PHOTONS, before)
        change_e = np.abs(self.recorded(after - before))
        # Masks that add up to an even light no longer do where others change the light of some more than of others.
        unlike_e = self._modulation(effect) * self.light_rms_e
        seen_e, error_e = rms_of(change_e), self.light_error_e + unlike_e
        peak_e = min(float(change_e.max()) + most * error_e * change_e.size**0.5, most * float(self.most_e.max()))
        return Bound(self.rig.dn_per_e * (seen_e + most * error_e), self.rig.dn_per_e * peak_e).by(
            "K * (v + c * u)",
            BoundStep("v", seen_e, "e", "what it changes in the previewed measurement, rms"),
            BoundStep("c", most, "", "largest share that it changes of any image, rms"),
            BoundStep("u", error_e, "e", "by what the measurement may differ from the previewed, rms"),
            gain_step(self.rig),
        )

    def graininess(self, views: float) -> float:
        """Return what the rasteriser's own graininess makes of the readings, DN rms, with so many views.

        Views of a moving image differ by a little that is no light: splats dropped below 1/255 of opacity, orders
        of depth that flip, float32. It is independent in views between which the image moves by `GRAIN_PX`; a view
        that stands for several masks carries it into all of them.
        """
        independent = min(views, 1 + self._whole_travel_px / GRAIN_PX)
        rms = self.grain * float(np.sqrt(len(self.masks) / independent))
        return self.full_scale_dn * self._most_open_weights.worst_rms_of_independent(rms, GRAIN_PEAK * rms)


def preview(
    scene: Scene,
    path: CameraPath,
    masks: F32,
    rig: RigFigures,
    renderer: Renderer | None = None,
    *,
    effects: tuple[Effect, ...] = (),
    seed: int = 0,
) -> Preview:
    """Take a quick look: render a view, or three where the image moves.

    Args:
        scene: What is seen.
        path: Where the camera is at any time, before effects.
        masks: As nominally shown, [N, H, W].
        rig: The figures.
        renderer: Draws the views.
        effects: All that the rig has.
        seed: Of the exposure.
    """
    whole = rig.timing.intervals_s(len(masks))[[0, -1], [0, 1]]
    moves = float(image_motion_px(scene, path, whole[None]).max()) > STILL_PX
    times = np.linspace(whole[0], whole[1], MOMENTS) if moves else whole.mean(keepdims=True)
    beside = spectral_margin(scene.size)
    # Of a camera at rest, the simulation takes the same view then, which the renderer remembers.
    margin = max(beside, EffectChain(effects, seed, rig).margin_px(scene.size, scene.intrinsics))
    renderer = renderer or Renderer()
    started = time.perf_counter()
    views = renderer.supersampled_views(scene, path.world_to_camera(times), margin=margin)
    render_s = (time.perf_counter() - started) / len(times)

    @cache
    def finer() -> MovingSpectrum:
        drawn, better, pixels = renderer.supersampling, renderer.finer(scene), math.prod(scene.size)
        if better is renderer:
            return moving_spectrum(spectral_part(views, scene.size, margin, drawn), drawn, drawn, 0.0, pixels)
        middle = path.world_to_camera(times[len(times) // 2, None])
        filter_px2 = renderer.sample_filter_px2 * (drawn**-2 - better.supersampling**-2)
        fine_views = better.supersampled_views(scene, middle, margin=beside)
        return moving_spectrum(fine_views, better.supersampling, drawn, filter_px2, pixels)

    return Preview(
        scene,
        path,
        masks,
        rig,
        times,
        views,
        renderer.supersampling,
        margin,
        render_s,
        renderer.grain_of(scene),
        finer,
        effects,
        seed,
    )
