"""What the planner and the bounds know of a measurement before it is simulated: one quick look.

A preview renders up to three views along the path. From them, the masks and the rig's figures it derives what the
bounds need. The light behind mask n is V_k + D_n: V_k the previewed view nearest in time, D_n what the image has
changed since, by motion and by the optics.

- What the masks make of the V_k is computed, pixel by pixel.
- Of D_n only rms and peak are known, so it counts as if it were aligned with the masks in the worst way (`alignment`).
  At rest and behind perfect optics it is nothing, and the bounds are exact.

So bounds hold for every set of masks: those that add up to one, those that know the scene, those with one open pixel.
What is assumed is that the image keeps its spectrum while it moves; where the previewed views differ by more than that
allows, everything is scaled by as much. Not here: any effect.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.fft import dctn

from gs2ci.core.arrays import F32, F64
from gs2ci_sims.alignment import WeightSet
from gs2ci_sims.effects.base import (
    Bound,
    BoundStep,
    Brightening,
    Charging,
    Effect,
    Modulating,
    Moving,
    Stage,
    ViewChange,
    gain_step,
)
from gs2ci_sims.effects.counts import SIGMAS, TAIL_E, most_counted_e
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.motion import displacement_px, image_motion_px, image_travel_px
from gs2ci_sims.path import CameraPath
from gs2ci_sims.radiance import Renderer, binned
from gs2ci_sims.rig import Rig
from gs2ci_sims.scene import Scene
from gs2ci_sims.spectrum import MovingSpectrum, moving_spectrum

# Begin, middle and end of the exposure are looked at; of an image that moves by less than this, the middle alone.
MOMENTS: Final = 3
STILL_PX: Final = 0.25
# A spectrum needs some pixels: smaller sensors are previewed with a margin.
SIDE_MIN_PX: Final = 24
SPECTRUM_BINS: Final = 193
# Grain of a renderer: its largest value over the pixels against its rms (20 to 26 on planes), and the motion after
# which it is another (there its autocorrelation is nothing).
GRAIN_PEAK: Final = 25.0
GRAIN_PX: Final = 0.025
TRAVEL_STEPS: Final = 65


@dataclass(frozen=True)
class Preview:
    """One quick look at a measurement.

    Args:
        scene: What is seen.
        path: Where the camera is at any time, before effects.
        masks: As nominally shown, at the sensor's pixels, [N, H, W].
        rig: The figures.
        times_s: When the views are seen, [P], from the begin to the end of the exposure.
        fine_views: Radiance at these moments, full scale 1, before it is averaged over the pixels' areas,
            [P, H' s, W' s, 3], with a margin on small sensors.
        samples: s, per pixel side.
        margin: That margin, pixels.
        render_s: What rendering one view took.
        grain: The renderer's, of this scene.
        finer: Looks once more, with more samples where they show more, for the spectrum of what moves.
        effects: All that the rig has: each is bounded as it acts among the others.
        seed: Of the exposure: effects that shake the camera draw from it.
    """

    scene: Scene
    path: CameraPath
    masks: F32
    rig: Rig
    times_s: F64
    fine_views: F32
    samples: int
    margin: int
    render_s: float
    grain: float
    finer: Callable[[], MovingSpectrum]
    effects: tuple[Effect, ...] = ()
    seed: int = 0

    @cached_property
    def intervals_s(self) -> F64:
        """Get start and stop of the mask intervals, [N, 2]."""
        return self.rig.timing.intervals_s(len(self.masks))

    @cached_property
    def views(self) -> F64:
        """Get the previewed radiance on the sensor, [P, H, W, 3]."""
        height, width = self.scene.size
        return self.wide_views[:, self.margin : self.margin + height, self.margin : self.margin + width]

    @cached_property
    def wide_views(self) -> F64:
        """Get the previewed radiance with its margin, [P, H', W', 3]."""
        return binned(torch.from_numpy(self.fine_views), self.samples).astype(np.float64)

    @cached_property
    def full_scale_dn(self) -> float:
        """Get the reading above black of radiance 1 through one open mask, with all light that effects may add."""
        return self.rig.full_scale_e * self.rig.dn_per_e * self.gain

    @property
    def _full_scale_steps(self) -> tuple[BoundStep, ...]:
        rig = self.rig
        return (
            BoundStep("N_ph", rig.light.full_scale_photons, "", "photons of white through one open mask"),
            BoundStep("q", rig.sensor.quantum_efficiency, "e/photon", "quantum efficiency"),
            gain_step(rig),
            BoundStep("g", self.gain, "", "what other effects may brighten it by"),
            BoundStep("S", self.full_scale_dn, "DN", "reading of white through one open mask", "N_ph * q * K * g"),
        )

    @cached_property
    def gain(self) -> float:
        """Get by how much the effects together may brighten what a pixel collects, at least 1: a product."""
        factors = [effect.brightest(self) for effect in self.effects if isinstance(effect, Brightening)]
        return float(np.prod([max(factor, 1.0) for factor in factors]))

    # The masks: nominal, as they reach the sensor, and how open either is.

    def masks_before(self, effect: Effect) -> NDArray[Any]:
        """Return the masks as those effects leave them that act before this one, [N, H, W]."""
        names = [other.name for other in self._chain.at(Stage.MASKS)]
        earlier = names.index(effect.name) if effect.name in names else 0
        chain = EffectChain(self._chain.at(Stage.MASKS)[:earlier], self.seed, self.rig)
        return np.asarray(chain.through(Stage.MASKS, self.masks))

    def of_mask_effect(self, effect: Effect) -> Bound:
        """Bound what an effect on masks changes: applied to the masks that it meets, with its device's own pattern."""
        before = self.masks_before(effect)
        after: NDArray[Any] = EffectChain([effect], self.seed, self.rig).through(Stage.MASKS, before)
        return self.of_masks(effect, after - before)

    def of_photon_effect(self, effect: Effect, most: float) -> Bound:
        """Bound what a linear effect on the photons changes in the previewed measurement, and in what that differs by.

        Args:
            effect: Applied to what those before it leave of the measurement, with its device's own pattern.
            most: The largest share of an image, rms, that it can change.
        """
        names = [other.name for other in self._chain.at(Stage.PHOTONS)]
        earlier = names.index(effect.name) if effect.name in names else 0
        chain = EffectChain(self._chain.at(Stage.PHOTONS)[:earlier], self.seed, self.rig)
        before = chain.through(Stage.PHOTONS, self.charge_e)
        change_e = np.abs(EffectChain([effect], self.seed, self.rig).through(Stage.PHOTONS, before) - before)
        # Masks that add up to an even light no longer do where others change the light of some more than of others.
        unlike_e = self._modulation(effect) * self.charge_rms_e
        seen_e, error_e = float(np.sqrt(np.square(change_e).mean())), self.charge_error_e + unlike_e
        peak_e = min(float(change_e.max()) + most * error_e * change_e.size**0.5, most * float(self.most_e.max()))
        return Bound(self.rig.dn_per_e * (seen_e + most * error_e), self.rig.dn_per_e * peak_e).by(
            "K * (v + c * u)",
            BoundStep("v", seen_e, "e", "what it changes in the previewed measurement, rms"),
            BoundStep("c", most, "", "largest share that it changes of any image, rms"),
            BoundStep("u", error_e, "e", "by what the measurement may differ from the previewed, rms"),
            gain_step(self.rig),
        )

    @cached_property
    def shown(self) -> NDArray[Any]:
        """Get the masks with all effects on masks, [N, H, W]."""
        return np.asarray(self._chain.through(Stage.MASKS, self.masks))

    @cached_property
    def most_open(self) -> NDArray[Any]:
        """Get the larger of the nominal masks and those shown, [N, H, W]."""
        return self.masks if self.shown is self.masks else np.maximum(self.masks, self.shown)

    @cached_property
    def _most_open_weights(self) -> WeightSet:
        return WeightSet(self.most_open)

    @cached_property
    def _chain(self) -> EffectChain:
        return EffectChain(self.effects, self.seed, self.rig)

    # Motion: how far the image is from where a preview saw it.

    @cached_property
    def moved_path(self) -> CameraPath:
        """Get the path with all effects on it."""
        return self._chain.through(Stage.MOTION, self.path)

    @cached_property
    def object_px_per_s(self) -> float:
        """Get how fast objects move across the image by themselves, at most."""
        return float(sum(effect.image_px_per_s(self) for effect in self.effects if isinstance(effect, Moving)))

    @cached_property
    def motion_px(self) -> F64:
        """Get how far the image moves within each mask interval, at most over the frame, [N] pixels."""
        own = self.object_px_per_s * np.diff(self.intervals_s, axis=1)[:, 0]
        return np.asarray(image_motion_px(self.scene, self.path, self.intervals_s) + own)

    def travel_px(self, times_s: F64) -> F64:
        """Get how far the image has moved, at most over the frame, since the first of the times, [T] pixels."""
        own = self.object_px_per_s * (times_s - times_s[0])
        return np.asarray(image_travel_px(self.scene, self.path, times_s) + own)

    @cached_property
    def _nearest(self) -> NDArray[np.intp]:
        """Which previewed view is nearest to the middle of each mask's interval, [N]."""
        away = np.abs(self.intervals_s.mean(axis=1)[:, None] - self.times_s)
        return np.asarray(np.argmin(away, axis=1))

    def _departures(self, intervals_s: F64) -> F64:
        """Bound the rms of D_n at any time within intervals [N, 2], [N] radiance."""
        seen_s = self.times_s[self._nearest]
        away_px = np.max(
            [
                displacement_px(self.scene, path, self.path, seen_s, intervals_s)
                for path in (self.path, self.moved_path)
            ],
            axis=0,
        )
        away_px = away_px + self.object_px_per_s * np.abs(intervals_s - seen_s[:, None]).max(axis=1)
        moved = self._surprise * np.array([self._shifted_rms(float(px)) for px in away_px])
        # Two views of a moving image also differ by the rasteriser's grain in both.
        moved += np.where(away_px > 0, 2 * self.grain, 0.0)
        return np.asarray(np.minimum(moved + self._optics_rms, self.scene.brightest))

    @cached_property
    def _optics_rms(self) -> float:
        """Get by how much the effects between scene and modulator change a view, rms."""
        changing = [effect for effect in self.effects if isinstance(effect, ViewChange)]
        return sum(effect.view_change(self)[0] for effect in changing)

    @cached_property
    def _surprise(self) -> float:
        """Get by how much more the previewed views differ than a shifted spectrum would, at least 1."""
        worst = 1.0
        for first in range(len(self.views)):
            for second in range(first):
                moments = self.times_s[[first, second]]
                moved = displacement_px(
                    self.scene, self.path, self.path, moments[:1], moments[None, 1:].repeat(2, axis=1)
                )
                expected = self._shifted_rms(float(moved[0]))
                differ = float(np.sqrt(np.square(self.views[first] - self.views[second]).mean()))
                # Views that differ by no more than the rasteriser's grain tell nothing.
                if differ > 10 * self.grain:
                    worst = max(worst, differ / max(expected, self.grain or 1e-12))
        return worst

    # The spectrum, and fields that come of filters.

    @cached_property
    def _spectrum(self) -> tuple[F64, F64]:
        """Mean power of the radiance by frequency, in cycles per pixel, [BINS] each; a bin counts as its upper end.

        Of the finer image before it is averaged over the pixels' areas, times what this averaging leaves of each
        cosine: what a pixel cannot resolve still moves, and faster in phase.
        """
        _, height, width, _ = self.fine_views.shape
        power = np.square(dctn(self.fine_views, axes=(1, 2), norm="ortho")).mean(axis=(0, 3)) / (height * width)
        down = np.arange(height) / (2 * height) * self.samples
        right = np.arange(width) / (2 * width) * self.samples
        power *= np.square(np.sinc(down))[:, None] * np.square(np.sinc(right))
        frequency = np.hypot(down[:, None], right)
        ends = np.linspace(0, self.samples * np.sqrt(0.5), SPECTRUM_BINS)
        place = np.searchsorted(ends, frequency.ravel()).clip(max=SPECTRUM_BINS - 1)
        return ends, np.bincount(place, power.ravel(), SPECTRUM_BINS).astype(np.float64)

    @cached_property
    def spectrum(self) -> MovingSpectrum:
        """Get the power of a view by frequency and direction, as it turns in phase while the image moves."""
        return self.finer()

    def filtered(self, change: Callable[[F64], F64]) -> tuple[float, float]:
        """Return rms and peak, radiance, of what a linear filter changes in a view (Parseval).

        Args:
            change: Largest change of amplitude, as a share, of a cosine of this frequency (cycles per pixel).
        """
        frequency, power = self._spectrum
        shares = change(frequency)
        rms = float(np.sqrt((power * np.square(shares)).sum()))
        return rms, self.scene.brightest * min(1.0, float(np.max(shares)))

    def shifted(self, shift_px: float) -> tuple[float, float]:
        """Return rms and peak of what shifting a view by up to `shift_px` in any direction changes.

        A cosine of frequency f shifted by d changes by at most 2 |sin(pi f d)| of its amplitude.
        """
        return self.filtered(lambda f: 2 * np.sin(np.minimum(np.pi * f * shift_px, np.pi / 2)))

    def _shifted_rms(self, shift_px: float) -> float:
        return self.shifted(shift_px)[0] if shift_px > 0 else 0.0

    def of_views(self, rms: float | F64, peak: float) -> Bound:
        """Bound what fields of this rms (of each, [N], or of all) and peak, radiance, make behind the masks."""
        weights, scale = self._most_open_weights, self.full_scale_dn
        each = np.broadcast_to(rms, (len(self.masks),))
        most = float(each.max())
        worst = weights.worst_rms_of_one(most, peak) if self.at_rest else weights.worst_rms(each, peak)
        return Bound(scale * worst, scale * peak * weights.largest_sum).by(
            "S * a * rho",
            *self._full_scale_steps,
            BoundStep("rho", most, "", "change of a view, rms, by the image's spectrum; white is 1"),
            BoundStep("a", worst / most if most > 0 else 0.0, "", "what the masks make of it where they lie worst"),
        )

    @cached_property
    def at_rest(self) -> bool:
        """Get whether nothing moves during the exposure."""
        whole = self.intervals_s[[0, -1], [0, 1]]
        return not bool(image_motion_px(self.scene, self.moved_path, whole[None]).any()) and self.object_px_per_s == 0

    # The masks, and light that comes at another time.

    def of_masks(self, effect: Effect, change: NDArray[Any]) -> Bound:
        """Bound what a change of the masks, [N, H, W], makes of the readings; it may vary in time with one sign."""
        return self._of_changes(effect, ((one, np.abs(one)) for one in change), self.intervals_s)

    def of_shares(self, effect: Effect, mean: F64, swing: F64, intervals_s: F64 | None = None) -> Bound:
        """Bound what changing the light behind each mask by a share makes of the readings.

        Args:
            effect: Which does it.
            mean: The share that its whole light changes by, [N].
            swing: The mean magnitude of the change over the interval, [N], at least that of the mean: what is taken
                here and added there is light of another moment.
            intervals_s: All of the time that each mask's light is taken from or added to, [N, 2], if that is not its
                own interval.
        """
        changes = (
            (float(share) * mask, float(size) * mask) for mask, share, size in zip(self.shown, mean, swing, strict=True)
        )
        return self._of_changes(effect, changes, self.intervals_s if intervals_s is None else intervals_s)

    def _of_changes(
        self, effect: Effect, changes: Iterable[tuple[NDArray[Any], NDArray[Any]]], intervals_s: F64
    ) -> Bound:
        """Bound changes of masks, in the mean and in magnitude, as computed for the V_k and at worst for the D_n.

        Where other effects change the light of some masks more than of others, changes that cancel no longer do, by
        as large a share.
        """
        total, size = (np.zeros((len(self.views), *self.scene.size)) for _ in range(2))

        def magnitudes() -> Iterator[NDArray[Any]]:
            for (mean, magnitude), nearest in zip(changes, self._nearest, strict=True):
                total[nearest] += mean
                size[nearest] += np.abs(mean)
                yield magnitude

        departures = self._departures(intervals_s)
        weights = WeightSet(magnitudes(), singly=bool(departures.any()))
        steady = np.einsum("khw,khwc->hwc", total, self.views)
        brightest, modulation = self.scene.brightest, self._modulation(effect)
        if modulation > 0:
            steady = np.abs(steady) + modulation * np.einsum("khw,khwc->hwc", size, self.views)
        rms = float(np.sqrt(np.square(steady).mean()))
        unseen = weights.worst_rms(departures, brightest) if departures.any() else 0.0
        peak = float(np.abs(steady).max()) + brightest * weights.largest_sum
        return Bound(self.full_scale_dn * (rms + unseen), self.full_scale_dn * peak).by(
            "S * (v + u)",
            *self._full_scale_steps,
            BoundStep(
                "m", modulation, "", "by what share other effects treat masks differently, which undoes cancelling"
            ),
            BoundStep("v", rms, "", "changes of the masks times the previewed views, summed, rms; white is 1"),
            BoundStep("u", unseen, "", "the same of what the image has changed since, where the masks lie worst"),
        )

    def _modulation(self, effect: Effect) -> float:
        """Return by which share of a mask's light the other effects may change it against the others'."""
        shares = [
            other.modulation(self)
            for other in self.effects
            if isinstance(other, Modulating) and other.name != effect.name
        ]
        return float(np.prod([1 + share for share in shares])) - 1

    # Charge: what a pixel collects.

    @cached_property
    def charge_e(self) -> F64:
        """Get the charge of each pixel under the nearest previewed views, with all light that effects add, [H, W, 3].

        The true one differs by an rms of `charge_error_e` at most, and never exceeds `most_e`.
        """
        total = np.zeros((len(self.views), *self.scene.size))
        for mask, nearest in zip(self.shown, self._nearest, strict=True):
            total[nearest] += mask
        return np.asarray(self.rig.full_scale_e * self.gain * np.einsum("khw,khwc->hwc", total, self.views))

    @cached_property
    def charge_error_e(self) -> float:
        """Get how far the charge may be from `charge_e`, rms over the pixels."""
        departures = self._departures(self.intervals_s)
        if not departures.any():
            return 0.0
        worst = WeightSet(self.shown).worst_rms(departures, self.scene.brightest)
        return self.rig.full_scale_e * self.gain * worst

    @cached_property
    def most_e(self) -> F64:
        """Get the charge that no pixel exceeds: as if all it saw were the brightest of the scene, [H, W, 1]."""
        open_sum = self.shown.sum(axis=0, dtype=np.float64)
        return np.asarray(self.rig.full_scale_e * self.gain * self.scene.brightest * open_sum[..., None])

    @cached_property
    def charge_rms_e(self) -> float:
        """Get a bound of the rms over the pixels of the charge."""
        predicted = float(np.sqrt(np.square(self.charge_e).mean())) + self.charge_error_e
        return min(predicted, float(np.sqrt(np.square(self.most_e).mean())))

    @cached_property
    def charge_mean_e(self) -> float:
        """Get a bound of the mean over the pixels of the charge."""
        return min(float(self.charge_e.mean()) + self.charge_error_e, float(self.most_e.mean()))

    @cached_property
    def added_e(self) -> tuple[float, float]:
        """Get the charge that comes in the dark, its mean over the pixels and its largest."""
        added = [effect.added_e(self.rig, self.scene.size) for effect in self.effects if isinstance(effect, Charging)]
        return sum(mean for mean, _ in added), sum(most for _, most in added)

    def excess_e(self, capacity_e: float) -> tuple[float, float, float]:
        """Bound what the pixels have beyond a capacity: mean, rms and peak over the pixels, electrons.

        With n standard deviations of its noise, a charge q reads q + n q^(1/2) + c (`counts.most_counted_e`). Beyond
        the charge x that just fills the capacity, that grows by 1 + n / (2 x^(1/2)) per electron at most, which is
        what an error of q adds.
        """
        added_e = self.added_e[1]

        def beyond(charge_e: F64) -> F64:
            whole_e = charge_e + added_e
            return np.asarray(np.maximum(most_counted_e(whole_e) - capacity_e, 0.0) * (whole_e > 0))

        root = max(float(np.sqrt(SIGMAS**2 / 4 + max(capacity_e - TAIL_E, 0.0))) - SIGMAS / 2, 1e-9)
        error_e = (1 + SIGMAS / (2 * root)) * self.charge_error_e
        likely, most = beyond(self.charge_e), beyond(self.most_e)
        mean = min(float(likely.mean()) + error_e, float(most.mean()))
        rms = min(float(np.sqrt(np.square(likely).mean())) + error_e, float(np.sqrt(np.square(most).mean())))
        return mean, rms, float(most.max())

    def graininess(self, views: float) -> float:
        """Return what the rasteriser's own graininess makes of the readings, DN rms, with so many views.

        Views of a moving image differ by a little that is no light: splats dropped below 1/255 of opacity, orders
        of depth that flip, float32. It is independent in views between which the image moves by `GRAIN_PX`; a view
        that stands for several masks carries it into all of them.
        """
        independent = min(views, 1 + self._whole_travel_px / GRAIN_PX)
        rms = self.grain * float(np.sqrt(len(self.masks) / independent))
        return self.full_scale_dn * self._most_open_weights.worst_rms_of_independent(rms, GRAIN_PEAK * rms)

    @cached_property
    def _whole_travel_px(self) -> float:
        ends_s = np.linspace(self.intervals_s[0, 0], self.intervals_s[-1, 1], TRAVEL_STEPS)
        return float(self.travel_px(ends_s)[-1])


def preview(
    scene: Scene,
    path: CameraPath,
    masks: F32,
    rig: Rig,
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
    margin = max(0, -(-(SIDE_MIN_PX - min(scene.size)) // 2))
    if not moves:
        # The simulation then takes the same view, which the renderer remembers.
        margin = max(margin, EffectChain(effects, seed, rig).margin_px(scene.size, scene.intrinsics))
    renderer = renderer or Renderer()
    started = time.perf_counter()
    views = renderer.supersampled_views(scene, path.world_to_camera(times), margin=margin)
    render_s = (time.perf_counter() - started) / len(times)

    @cache
    def finer() -> MovingSpectrum:
        drawn, better = renderer.supersampling, renderer.finer(scene)
        if better is renderer:
            return moving_spectrum(views, drawn, drawn, 0.0)
        middle = path.world_to_camera(times[len(times) // 2, None])
        filter_px2 = renderer.sample_filter_px2 * (drawn**-2 - better.supersampling**-2)
        fine_views = better.supersampled_views(scene, middle, margin=margin)
        return moving_spectrum(fine_views, better.supersampling, drawn, filter_px2)

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
