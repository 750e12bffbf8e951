"""How far the image is from where a preview saw it, in pixels and in radiance.

The second part of a preview (`gs2ci_sims.preview`). The image behind mask n differs from the previewed view nearest in
time, V_k, by D_n: by the motion since, and by what the optics change. Here: the motion over time, and a bound of the
rms of D_n, to which what effects on views change belongs. Not here: what that makes of the charge or of the readings.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64, rms_of
from gs2ci_sims.effects.base import Effect, LightStage, Moving, ViewChange, having
from gs2ci_sims.effects.kernels import shift_shares
from gs2ci_sims.motion import displacement_px, image_motion_px, image_travel_px
from gs2ci_sims.path import CameraPath
from gs2ci_sims.previewed.views import PreviewedViews
from gs2ci_sims.radiance import with_margin
from gs2ci_sims.signals import View

TRAVEL_STEPS: Final = 65


@dataclass(frozen=True)
class PreviewedMotion(PreviewedViews):
    """The views of a quick look, and how far the image moves from them."""

    @cached_property
    def moved_path(self) -> CameraPath:
        """Get the path with all effects on it."""
        return self._chain.through(LightStage.MOTION, self.path)

    @cached_property
    def object_px_per_s(self) -> float:
        """Get how fast objects move across the image by themselves, at most."""
        return float(sum(effect.image_px_per_s(self) for effect in having(self.effects, Moving)))

    @cached_property
    def motion_px(self) -> F64:
        """Get how far the image moves within each mask interval, at most over the frame, [N] pixels."""
        own = self.object_px_per_s * np.diff(self.intervals_s, axis=1)[:, 0]
        return image_motion_px(self.scene, self.path, self.intervals_s) + own

    def travel_px(self, times_s: F64) -> F64:
        """Get how far the image has moved, at most over the frame, since the first of the times, [T] pixels."""
        own = self.object_px_per_s * (times_s - times_s[0])
        return image_travel_px(self.scene, self.path, times_s) + own

    @cached_property
    def _whole_travel_px(self) -> float:
        ends_s = np.linspace(self.intervals_s[0, 0], self.intervals_s[-1, 1], TRAVEL_STEPS)
        return float(self.travel_px(ends_s)[-1])

    @cached_property
    def at_rest(self) -> bool:
        """Get whether nothing moves during the exposure."""
        whole = self.intervals_s[[0, -1], [0, 1]]
        return not bool(image_motion_px(self.scene, self.moved_path, whole[None]).any()) and self.object_px_per_s == 0

    @cached_property
    def _nearest(self) -> NDArray[np.intp]:
        """Which previewed view is nearest to the middle of each mask's interval, [N]."""
        away = np.abs(self.intervals_s.mean(axis=1)[:, None] - self.times_s)
        return np.argmin(away, axis=1)

    def _departures(self, intervals_s: F64) -> F64:
        """Bound the rms of D_n at any time within intervals [N, 2], [N] radiance; kept: most ask for the same."""
        key = intervals_s.tobytes()
        if key not in self._departed:
            self._departed[key] = self._departures_within(intervals_s)
        return self._departed[key]

    @cached_property
    def _departed(self) -> dict[bytes, F64]:
        return {}

    def _departures_within(self, intervals_s: F64) -> F64:
        away_px = self._away_px(intervals_s)
        moved = self._excess_change * np.array([self._shifted_rms(float(px)) for px in away_px])
        # Two views of a moving image also differ by the rasteriser's grain in both.
        moved += np.where(away_px > 0, 2 * self.grain, 0.0)
        return np.minimum(moved + self._optics_rms, self.scene.brightest)

    def _away_px(self, intervals_s: F64) -> F64:
        """Return how far the image moves from the previewed views within intervals [N, 2], at most, [N] pixels."""
        seen_s = self.times_s[self._nearest]
        away_px = np.max(
            [
                displacement_px(self.scene, path, self.path, seen_s, intervals_s)
                for path in ([self.path] if self.moved_path is self.path else [self.path, self.moved_path])
            ],
            axis=0,
        )
        return away_px + self.object_px_per_s * np.abs(intervals_s - seen_s[:, None]).max(axis=1)

    @cached_property
    def _optics_rms(self) -> float:
        """Get by how much the effects between scene and modulator change a view, rms."""
        return sum(self.view_change(effect)[0] for effect in having(self.effects, ViewChange))

    def view_change(self, effect: ViewChange) -> tuple[float, float]:
        """Return rms and peak, radiance, of what an effect changes in a view; kept: those after it ask for it too."""
        kept = self._changed.get(effect.name)
        if kept is None or kept[0] is not effect:
            kept = self._changed[effect.name] = effect, effect.view_change(self)
        return kept[1]

    @cached_property
    def _changed(self) -> dict[str, tuple[ViewChange, tuple[float, float]]]:
        return {}

    def changed(
        self, effect: Effect, change: Callable[[View], F64], shares: Callable[[F64], F64]
    ) -> tuple[float, float]:
        """Return rms and peak, radiance, of what an effect on views changes in one.

        It changes the previewed views V_k as computed, pixel by pixel, also by light from beside the sensor. It changes
        the motion since and what effects before it do to V_k by no more than the shares of their cosines, and all of
        these together by no more than the shares of the view's own.

        Args:
            effect: Which.
            change: What it changes in a view with its margin, on the sensor alone, [H, W, C].
            shares: Largest change of amplitude, as a share, of a cosine of this frequency (cycles per pixel).
        """
        intrinsics = with_margin(self.scene.intrinsics, self.margin)
        seen = [change(View(view, intrinsics, self.margin)) for view in self.wide_views]
        rms = max(rms_of(one) for one in seen)
        peak = max(float(np.abs(one).max()) for one in seen)
        away_px = float(self._away_px(self.intervals_s).max())
        moved = self.filtered(lambda f: shares(f) * shift_shares(f, away_px))[0] * self._excess_change
        most = float(np.max(shares(self._spectrum[0])))
        if away_px > 0:
            moved += most * 2 * self.grain
        earlier = sum(self.view_change(one)[0] for one in having(self._around(effect)[0], ViewChange))
        whole_rms, whole_peak = self.filtered(shares)
        return max(rms, min(whole_rms, rms + moved + most * earlier)), max(peak, whole_peak)

    @cached_property
    def _excess_change(self) -> float:
        """Get by how much more the previewed views differ than a shifted spectrum would, at least 1."""
        worst = 1.0
        for first in range(len(self.views)):
            for second in range(first):
                moments = self.times_s[[first, second]]
                moved = displacement_px(
                    self.scene, self.path, self.path, moments[:1], moments[None, 1:].repeat(2, axis=1)
                )
                expected = self._shifted_rms(float(moved[0]))
                differ = rms_of(self.views[first] - self.views[second])
                # Views that differ by no more than the rasteriser's grain tell nothing.
                if differ > 10 * self.grain:
                    worst = max(worst, differ / max(expected, self.grain or 1e-12))
        return worst
