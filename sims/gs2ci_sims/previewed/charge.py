"""The charge that a preview expects in the pixels, and how wrong that may be.

The third part of a preview (`gs2ci_sims.preview`). Not here: readings, and what effects change in them.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gs2ci.core.arrays import F64, rms_of
from gs2ci_sims.alignment import WeightSet
from gs2ci_sims.effects.base import Charging, Effect, Lowering, having
from gs2ci_sims.effects.counts import SIGMAS, TAIL_E, most_counted_e
from gs2ci_sims.effects.noises import ShotNoise
from gs2ci_sims.previewed.motion import PreviewedMotion


@dataclass(frozen=True)
class PreviewedCharge(PreviewedMotion):
    """The views of a quick look, their motion, and the charge that they make."""

    @cached_property
    def charge_e(self) -> F64:
        """Get the charge of each pixel under the nearest previewed views, with all light that effects add, [H, W, C].

        The true one differs by an rms of `charge_error_e` at most, and never exceeds `most_e`.
        """
        return self.recorded(self.light_e)

    @cached_property
    def light_e(self) -> F64:
        """Get the charge that the light of all three colours would make, [H, W, 3]."""
        total = np.zeros((len(self.views), *self.scene.size))
        for mask, nearest in zip(self.shown, self._nearest, strict=True):
            total[nearest] += mask
        return self.rig.full_scale_e * self.gain * np.einsum("khw,khwc->hwc", total, self.views)

    @cached_property
    def charge_error_e(self) -> float:
        """Get how far the charge may be from `charge_e`, rms over the pixels."""
        return self._error_e(self.colours)

    @cached_property
    def light_error_e(self) -> float:
        """Get how far what is recorded of the light may be from `light_e`, rms, wherever it falls then."""
        return self.colours * self._error_e(1.0)

    def _error_e(self, colours: float) -> float:
        departures = np.minimum(colours * self._departures(self.intervals_s), self.scene.brightest)
        if not departures.any():
            return 0.0
        worst = WeightSet(self.shown).worst_rms(departures, self.scene.brightest)
        return self.rig.full_scale_e * self.gain * worst

    @cached_property
    def most_e(self) -> F64:
        """Get the charge that no pixel exceeds: as if all it saw were the brightest of the scene, [H, W, 1]."""
        open_sum = self.shown.sum(axis=0, dtype=np.float64)
        return self.rig.full_scale_e * self.gain * self.scene.brightest * open_sum[..., None]

    @cached_property
    def charge_rms_e(self) -> float:
        """Get a bound of the rms over the pixels of the charge."""
        predicted = rms_of(self.charge_e) + self.charge_error_e
        return min(predicted, rms_of(self.most_e))

    @cached_property
    def light_rms_e(self) -> float:
        """Get a bound of the rms of the charge, wherever an effect may move the light before it is recorded."""
        predicted = self.colours * rms_of(self.light_e) + self.light_error_e
        return min(predicted, rms_of(self.most_e))

    @cached_property
    def charge_mean_e(self) -> float:
        """Get a bound of the mean over the pixels of the charge."""
        return min(float(self.charge_e.mean()) + self.charge_error_e, float(self.most_e.mean()))

    @cached_property
    def added_e(self) -> tuple[float, float]:
        """Get the charge that comes in the dark, its mean over the pixels and its largest."""
        added = [effect.added_e(self.rig, self.scene.size) for effect in having(self.effects, Charging)]
        return sum(mean for mean, _ in added), sum(most for _, most in added)

    @cached_property
    def lowered_dn(self) -> float:
        """Get by how much noises and shifts may take readings below the data sheet's black level, DN."""
        return sum(effect.lowered_dn(self.rig) for effect in having(self.effects, Lowering))

    @cached_property
    def _amplified(self) -> float:
        """Get by how much the effects after the counting of the electrons may enlarge a charge, at least 1."""
        counted = [effect for effect in self.effects if isinstance(effect, ShotNoise | Charging)]
        return max((self.gain_after(effect) for effect in counted), default=1.0)

    def excess_e(self, effect: Effect, capacity_e: float) -> tuple[float, float, float]:
        """Bound what the pixels have beyond a capacity: mean, rms and peak over the pixels, electrons.

        With n standard deviations of its noise, a charge q reads q + n q^(1/2) + c (`counts.most_counted_e`), times
        what amplifies it before the effect. Beyond the charge x that just fills the capacity, that grows by
        1 + n / (2 x^(1/2)) per electron at most, which is what an error of q adds.

        Args:
            effect: Which clips: what amplifies the charge after it does not count.
            capacity_e: The capacity, electrons.
        """
        added_e, after = self.added_e[1], self.gain_after(effect)
        before = self._amplified / after

        def beyond(charge_e: F64) -> F64:
            whole_e = charge_e / self._amplified + added_e
            return np.maximum(before * most_counted_e(whole_e) - capacity_e, 0.0) * (whole_e > 0)

        root = max(float(np.sqrt(SIGMAS**2 / 4 + max(capacity_e / before - TAIL_E, 0.0))) - SIGMAS / 2, 1e-9)
        error_e = (1 + SIGMAS / (2 * root)) * self.charge_error_e / after
        likely, most = beyond(self.charge_e), beyond(self.most_e)
        mean = min(float(likely.mean()) + error_e, float(most.mean()))
        return mean, min(rms_of(likely) + error_e, rms_of(most)), float(most.max())
