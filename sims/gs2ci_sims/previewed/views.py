"""The previewed views and masks of a measurement: what they show, how bright, and how finely structured.

The first part of a preview (`gs2ci_sims.preview`): of what is held here, the parts on motion, on charge and on bounds
are derived. Here: the views on the sensor, the masks as effects leave them, the light that effects may add, and what a
filter or a shift changes in a view. Not here: anything that happens while the image moves.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64
from gs2ci_sims.alignment import WeightSet
from gs2ci_sims.effects.base import BoundStep, Brightening, Effect, LightStage, Modulating, gain_step, having
from gs2ci_sims.effects.bayer_filter import BayerFilter
from gs2ci_sims.effects.kernels import shift_shares
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.path import CameraPath
from gs2ci_sims.radiance import binned
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.scene import Scene
from gs2ci_sims.spectrum import MovingSpectrum, moving_spectrum

# A spectrum needs some pixels: that of a smaller sensor is measured with a margin.
SIDE_MIN_PX: Final = 24


@dataclass(frozen=True)
class PreviewedViews:
    """The views and masks of one quick look at a measurement.

    Args:
        scene: What is seen.
        path: Where the camera is at any time, before effects.
        masks: As nominally shown, at the sensor's pixels, [N, H, W].
        rig: The figures.
        times_s: When the views are seen, [P], from the begin to the end of the exposure.
        fine_views: Radiance at these moments, full scale 1, before it is averaged over the pixels' areas,
            [P, H' s, W' s, 3], with the margin that effects on views need.
        samples: s, per pixel side.
        margin: That margin, pixels, at least `spectral_margin`.
        render_s: What rendering one view took.
        grain: The renderer's, of this scene.
        finer: Looks once more, with more samples where they show more, for the spectrum of what moves.
        effects: All that the rig has: each is bounded as it acts among the others.
        seed: Of the exposure: effects that shake the camera draw from it.
    """

    scene: Scene
    path: CameraPath
    masks: F32
    rig: RigFigures
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
    def _mosaic(self) -> EffectChain:
        return EffectChain([effect for effect in self.effects if isinstance(effect, BayerFilter)], self.seed, self.rig)

    def recorded(self, light: F64) -> F64:
        """Return what the sensor records of light of three colours, [H, W, 3]: one of them in each pixel, or all."""
        return self._mosaic.through(LightStage.CHARGE, light)

    @cached_property
    def colours(self) -> float:
        """Get by how much the rms of what is recorded of a field may exceed that over its pixels and three colours.

        Behind a mosaic each colour may be where its pixels are and nowhere else: three times the mean square.
        """
        return 3**0.5 if self._mosaic.effects else 1.0

    @cached_property
    def deviation(self) -> tuple[float, float]:
        """Get limits of the rms and the peak of a view less its mean, radiance.

        They hold on the sensor and on an area of its size anywhere within the margin: all that is seen may be there.
        """
        apart = self.wide_views - self.wide_views.mean(axis=(1, 2), keepdims=True)
        peak = float(np.abs(apart).max())
        squares = np.square(apart).sum(axis=(1, 2)).mean(axis=-1) / np.prod(self.scene.size)
        return min(float(np.sqrt(squares.max())), peak), peak

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
        return self._brightened_by(self.effects)

    def gain_after(self, effect: Effect) -> float:
        """Return by how much the effects after this one may enlarge a change of the charge, at least 1."""
        return self._brightened_by(self._around(effect)[1])

    def _brightened_by(self, effects: Sequence[Effect]) -> float:
        return float(np.prod([max(effect.brightest(self), 1.0) for effect in having(effects, Brightening)]))

    def masks_around(self, effect: Effect) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the masks as the effects before this one leave them, and as this one does then, [N, H, W] each."""
        acting = self._chain.at(LightStage.MASKS)
        names = [other.name for other in acting]
        earlier = names.index(effect.name) if effect.name in names else 0
        number, before = self._latest_masks.get("after", (0, self.masks))
        if number != earlier:
            before = EffectChain(acting[:earlier], self.seed, self.rig).through(LightStage.MASKS, self.masks)
        after: NDArray[Any] = EffectChain([effect], self.seed, self.rig).through(LightStage.MASKS, before)
        self._latest_masks.clear()
        # The next effect is asked about next; after the last one they are `shown`.
        if effect in acting[:-1]:
            self._latest_masks["after"] = earlier + 1, after
        return before, after

    @cached_property
    def _latest_masks(self) -> dict[str, tuple[int, NDArray[Any]]]:
        return {}

    @cached_property
    def shown(self) -> NDArray[Any]:
        """Get the masks with all effects on masks, [N, H, W]."""
        return np.asarray(self._chain.through(LightStage.MASKS, self.masks))

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

    def _around(self, effect: Effect) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
        """Return the effects before and after this one on the light path; both are all of them if it is not on it."""
        every = self._chain.effects
        place = next((number for number, one in enumerate(every) if one.name == effect.name), None)
        return (every, every) if place is None else (every[:place], every[place + 1 :])

    def _modulation(self, effect: Effect) -> float:
        """Return by which share of a mask's light the other effects may change it against the others'."""
        return float(np.prod([1 + share for name, share in self._modulations.items() if name != effect.name])) - 1

    @cached_property
    def _modulations(self) -> dict[str, float]:
        """By which share of a mask's light each effect may change it; kept, as every bound asks for all of them."""
        return {effect.name: effect.modulation(self) for effect in having(self.effects, Modulating)}

    @cached_property
    def _spectrum(self) -> tuple[F64, F64]:
        """Mean power of the radiance by frequency, in cycles per pixel, [BINS] each; a bin counts as its upper end.

        Of the finer image before it is averaged over the pixels' areas, times what this averaging leaves of each
        cosine: what a pixel cannot resolve still moves, and faster in phase. What lies beside a small sensor counts in
        full, as if it were seen.
        """
        views = spectral_part(self.fine_views, self.scene.size, self.margin, self.samples)
        found = moving_spectrum(views, self.samples, self.samples, 0.0, math.prod(self.scene.size))
        return found.frequency, found.power.sum(axis=1)

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
        rms, peak = float(np.sqrt((power * np.square(shares)).sum())), self.scene.brightest * float(np.max(shares))
        return min(rms, peak), min(peak, self.scene.brightest)

    def shifted(self, shift_px: float) -> tuple[float, float]:
        """Return rms and peak of what shifting a view by up to `shift_px` in any direction changes.

        A cosine of frequency f shifted by d changes by at most 2 |sin(pi f d)| of its amplitude.
        """
        return self.filtered(lambda f: shift_shares(f, shift_px))

    def _shifted_rms(self, shift_px: float) -> float:
        return self.shifted(shift_px)[0] if shift_px > 0 else 0.0


def spectral_margin(size: tuple[int, int]) -> int:
    """Return how many pixels on each side of a sensor of this size its spectrum is measured with."""
    return max(0, -(-(SIDE_MIN_PX - min(size)) // 2))


def spectral_part(fine_views: F32, size: tuple[int, int], margin: int, samples: int) -> F32:
    """Cut views [P, H' s, W' s, 3] with a margin, s samples per pixel side, to the margin of their spectrum."""
    edge = (margin - spectral_margin(size)) * samples
    return fine_views[:, edge : fine_views.shape[1] - edge, edge : fine_views.shape[2] - edge]
