"""What travels along the light path before it is an image: slices of time, moving scenes, views.

Not here: who makes them (`exposure`) and what happens to them (`effects`), when views are rendered (`moments`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64
from gs2ci.render.gaussians import Gaussians

Index = NDArray[np.intp]

MovingScene = Callable[[float], Gaussians]
"""The Gaussians at a time in seconds; a scene at rest returns the same object every time."""


@dataclass(frozen=True)
class Shutter:
    """When a row of the sensor collects light: row y from opens_s to closes_s, both later by y line delays.

    Args:
        opens_s: Row 0 begins.
        closes_s: Row 0 ends.
        line_delay_s: From each row to the next, at least 0.
    """

    opens_s: float
    closes_s: float
    line_delay_s: float

    def open_share(self, start_s: F64, stop_s: F64, height: int) -> F64:
        """Get the share of each slice [S] of time, of positive length, for which each row collects, [S, H]."""
        late = self.line_delay_s * np.arange(height)
        begin = np.maximum(start_s[:, None], self.opens_s + late)
        end = np.minimum(stop_s[:, None], self.closes_s + late)
        return np.asarray(np.maximum(end - begin, 0.0) / (stop_s - start_s)[:, None])


@dataclass(frozen=True)
class Slices:
    """The exposure as slices of time, within each of which light is collected evenly through one mixture of masks.

    In slice s the sensor collects at the rate Σ_n mix[s, n] mask_n ⊙ L(t), in the rows that the shutter
    has opened. Slices may lie in any order and overlap: they add up. How finely L(t) is sampled is another matter
    (`moments`).

    Args:
        start_s: [S], seconds; 0 is the middle of the nominal exposure.
        stop_s: [S], not before the start.
        mix: [S, N], how much each mask contributes: 1 while it is on show under nominal light.
        shown: [S], index of the mask that the modulator was told to show.
        since_s: [S], when it was told so.
        shutter: When each row collects; None: all rows, all the time.
    """

    start_s: F64
    stop_s: F64
    mix: F64
    shown: Index
    since_s: F64
    shutter: Shutter | None = None

    @property
    def duration_s(self) -> F64:
        """Get the length of each slice, [S]."""
        return self.stop_s - self.start_s

    def weights_s(self) -> F64:
        """Get the effective time for which each mask is exposed in each slice, [S, N] seconds, of a whole row."""
        return self.duration_s[:, None] * self.mix

    def scaled(self, factor: F64) -> "Slices":
        """Return the same with each slice's light multiplied, [S]."""
        return replace(self, mix=self.mix * factor[:, None])

    def split(self, parts: int) -> "Slices":
        """Return each slice cut into equal parts, in its place."""
        if parts == 1:
            return self
        edges = self.start_s[:, None] + self.duration_s[:, None] * np.linspace(0, 1, parts + 1)
        return self._with_pieces(edges[:, :-1], edges[:, 1:])

    def split_at(self, times_s: F64) -> "Slices":
        """Return each slice s cut at the times [S, T] that lie within it; the others make pieces of no length."""
        inner = np.clip(np.sort(times_s, axis=1), self.start_s[:, None], self.stop_s[:, None])
        edges = np.concatenate([self.start_s[:, None], inner, self.stop_s[:, None]], axis=1)
        return self._with_pieces(edges[:, :-1], edges[:, 1:]).without_empty()

    def without_empty(self) -> "Slices":
        """Return the slices that have a length."""
        return self.only(self.stop_s > self.start_s)

    def only(self, keep: NDArray[np.bool_]) -> "Slices":
        """Return some of the slices, [S]."""
        return Slices(
            self.start_s[keep], self.stop_s[keep], self.mix[keep], self.shown[keep], self.since_s[keep], self.shutter
        )

    def _with_pieces(self, start: F64, stop: F64) -> "Slices":
        parts = start.shape[1]
        return Slices(
            start.ravel(),
            stop.ravel(),
            self.mix.repeat(parts, axis=0),
            self.shown.repeat(parts),
            self.since_s.repeat(parts),
            self.shutter,
        )


def nominal_slices(intervals_s: F64) -> Slices:
    """Return one slice per mask interval [N, 2]."""
    start, stop = intervals_s[:, 0], intervals_s[:, 1]
    return Slices(start, stop, np.eye(len(intervals_s)), np.arange(len(intervals_s)), start)


@dataclass(frozen=True)
class View:
    """The image at one moment, as it falls on the modulator, rendered with a margin around the sensor.

    Args:
        radiance: [H + 2 margin, W + 2 margin, 3], full scale 1.
        intrinsics: Of this enlarged image, [3, 3] pixels; pixel centres at +0.5.
        margin: Pixels on each side that belong to no sensor pixel.
        depth: z of what is seen, of the same height and width, scene units, NaN where nothing is; None where no
            effect asked for it.
    """

    radiance: F64
    intrinsics: F64
    margin: int = 0
    depth: F64 | None = None
