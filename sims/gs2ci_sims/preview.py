"""What the planner and the bounds know of a measurement before it is simulated: one quick look. For effects.

A preview renders up to three views along the path and derives from them, the masks and the rig's figures what every
bound needs: the charge that each pixel collects, the spectrum of the image, its motion. Its numbers are those of the
nominal light path: everything off. Two assumptions make cheap bounds of them, and the tests of the bounds hold them
to it: the image keeps its spectrum while it moves, and the masks are not aligned with the scene. Not here: any effect.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import torch
from scipy.fft import dctn

from gs2ci.core.arrays import F32, F64
from gs2ci_sims.effects.base import Bound
from gs2ci_sims.motion import image_motion_px, image_travel_px
from gs2ci_sims.path import CameraPath
from gs2ci_sims.radiance import Renderer, binned
from gs2ci_sims.rig import Rig
from gs2ci_sims.scenes.base import Scene

# Begin, middle and end of the exposure are looked at; of an image that moves by less than this, the middle alone.
MOMENTS: Final = 3
STILL_PX: Final = 0.25
# A spectrum needs some pixels: smaller sensors are previewed with a margin.
SIDE_MIN_PX: Final = 24
SPECTRUM_BINS: Final = 193
# The rasteriser's graininess, rms, of full scale: measured on planes, where it is 5e-5 to 8e-5.
RENDER_GRAIN: Final = 1e-4
# What other effects (flicker, PRNU, leakage, dark current) and the preview's coarseness may add to its figures.
HEADROOM: Final = 1.3


@dataclass(frozen=True)
class Preview:
    """One quick look at a measurement.

    Args:
        scene: What is seen.
        path: Where the camera is at any time.
        masks: As nominally shown, at the sensor's pixels, [N, H, W].
        rig: The figures.
        fine_views: Radiance at moments from the begin to the end of the exposure, full scale 1, before it is averaged
            over the pixels' areas, [P, H' s, W' s, 3], with a margin on small sensors.
        samples: s, per pixel side.
        margin: That margin, pixels.
        render_s: What rendering one view took.
        object_px_per_s: How fast objects move across the image by themselves, at most.
    """

    scene: Scene
    path: CameraPath
    masks: F32
    rig: Rig
    fine_views: F32
    samples: int
    margin: int
    render_s: float
    object_px_per_s: float = 0.0

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
    def open_sum(self) -> F64:
        """Get how many open masks each pixel sees, weighted by transmission, [H, W]."""
        return np.asarray(self.masks.sum(axis=0, dtype=np.float64))

    @property
    def full_scale_dn(self) -> float:
        """Get the reading above black of radiance 1 through one open mask."""
        return self.rig.full_scale_e * self.rig.dn_per_e

    @cached_property
    def charge_e(self) -> F64:
        """Get the charge of each pixel under the brightest of the previewed views, unclipped, [H, W, 3]."""
        return np.asarray(self.rig.full_scale_e * self.open_sum[..., None] * self.views.max(axis=0))

    @cached_property
    def signal_dn(self) -> F64:
        """Get the readings above black that belong to `charge_e`, [H, W, 3]."""
        return self.charge_e * self.rig.dn_per_e

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
    def wide_views(self) -> F64:
        """Get the previewed radiance with its margin, [P, H', W', 3]."""
        return binned(torch.from_numpy(self.fine_views), self.samples).astype(np.float64)

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

    def graininess(self, views: float) -> float:
        """Return what the rasteriser's own graininess makes of the readings, DN rms, with so many views.

        Views of a moving image differ by a little that is no light: splats dropped below 1/255 of opacity, orders
        of depth that flip, float32. It is independent from view to view, and a view that stands for several masks
        carries it into all of them.
        """
        return RENDER_GRAIN * self.full_scale_dn * float(np.sqrt(self._squares_sum * len(self.masks) / views))

    @cached_property
    def _squares_sum(self) -> float:
        """Mean over the pixels of the sum of the masks' squares."""
        return float(np.square(self.masks, dtype=np.float64).sum(axis=0).mean())

    def filtered(self, change: Callable[[F64], F64]) -> Bound:
        """Bound what a linear filter changes: Parseval's sum of the radiance's power times the squared change.

        Args:
            change: Largest change of amplitude, as a share, of a cosine of this frequency (cycles per pixel).
        """
        frequency, power = self._spectrum
        shares = change(frequency)
        rms = float(np.sqrt((power * np.square(shares)).sum()))
        peak = float(self.views.max() - self.views.min()) * min(1.0, float(np.max(shares)))
        return self.of_radiance(rms, peak)

    def shifted(self, shift_px: float) -> Bound:
        """Bound what shifting the image by up to `shift_px` in any direction changes.

        A cosine of frequency f shifted by d changes by at most 2 |sin(pi f d)| of its amplitude.
        """
        return self.filtered(lambda f: 2 * np.sin(np.minimum(np.pi * f * shift_px, np.pi / 2)))

    def of_radiance(self, rms: float, peak: float) -> Bound:
        """Turn a change of radiance, the same under every mask, into one of readings."""
        scale = HEADROOM * self.full_scale_dn
        return Bound(
            rms * scale * float(np.sqrt(np.square(self.open_sum).mean())), peak * scale * float(self.open_sum.max())
        )

    def of_masks(self, change: F64) -> Bound:
        """Bound what a change of the masks, [N, H, W], makes of the readings: each under the nearest previewed view."""
        nearest = np.rint(np.linspace(0, len(self.views) - 1, len(change))).astype(int)
        total = np.zeros((*self.scene.size, 3))
        for number, view in enumerate(self.views):
            total += change[nearest == number].sum(axis=0)[..., None] * view
        return self.of_readings(total * self.full_scale_dn)

    def of_readings(self, change_dn: F64) -> Bound:
        """Bound a change of readings, [H, W, C] in DN, that the preview predicts pixel by pixel."""
        return Bound(HEADROOM * float(np.sqrt(np.square(change_dn).mean())), HEADROOM * float(np.abs(change_dn).max()))

    def with_motion(self, steady: Bound, share: float) -> Bound:
        """Add to a change of the light over time what it makes of motion: this share of it falls elsewhere.

        Light that is collected earlier or later than the middle of a mask's interval shows the image by up to half of
        the interval's motion away.
        """
        moved = self.shifted(0.5 * float(self.motion_px.max()))
        return Bound(steady.rms_dn + share * moved.rms_dn, steady.peak_dn + share * moved.peak_dn)

    def of_share(self, share: float) -> Bound:
        """Bound what changing all the light by up to this share changes."""
        return self.of_readings(share * self.signal_dn)


def preview(scene: Scene, path: CameraPath, masks: F32, rig: Rig, renderer: Renderer | None = None) -> Preview:
    """Take a quick look: render a view, or three where the image moves."""
    whole = rig.timing.intervals_s(len(masks))[[0, -1], [0, 1]]
    moves = float(image_motion_px(scene, path, whole[None]).max()) > STILL_PX
    times = np.linspace(whole[0], whole[1], MOMENTS) if moves else whole.mean(keepdims=True)
    margin = max(0, -(-(SIDE_MIN_PX - min(scene.size)) // 2))
    renderer = renderer or Renderer()
    started = time.perf_counter()
    views = renderer.supersampled_views(scene, path.world_to_camera(times), margin=margin)
    render_s = (time.perf_counter() - started) / len(times)
    return Preview(scene, path, masks, rig, views, renderer.supersampling, margin, render_s)
