"""The signals along the light path before the image: slices of time, moving scenes, views.

Not here: their construction (`exposure`), the effects on them (`effects`), the times of the views (`moments`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64
from gs2ci.render.gaussians import Gaussians

Index = NDArray[np.intp]

ROW_PARTS: Final = 16
"""Parts of the time in which the rows of a rolling shutter open, one after the other, and of that in which they close.
Within a part each row's light is taken from all of it in the same way."""

MovingScene = Callable[[float], Gaussians]
"""The Gaussians at a time in seconds; a scene at rest returns the same object every time."""


@dataclass(frozen=True)
class Shutter:
    """The times at which a row of the sensor collects light: row y from opens_s to closes_s, plus y line delays.

    Args:
        opens_s: Begin of the exposure of row 0.
        closes_s: End of the exposure of row 0.
        line_delay_s: Delay from each row to the next, at least 0.
    """

    opens_s: float
    closes_s: float
    line_delay_s: float

    def later(self, delay_s: float) -> "Shutter":
        """Return the shutter whose rows open and close later by a delay, or earlier if that is negative."""
        return replace(self, opens_s=self.opens_s + delay_s, closes_s=self.closes_s + delay_s)

    def open_share(self, start_s: F64, stop_s: F64, height: int) -> F64:
        """Get the share of each slice [S] of time, of positive length, in which each row collects light, [S, H]."""
        late = self.line_delay_s * np.arange(height)
        begin = np.maximum(start_s[:, None], self.opens_s + late)
        end = np.minimum(stop_s[:, None], self.closes_s + late)
        return np.maximum(end - begin, 0.0) / (stop_s - start_s)[:, None]

    def turns_s(self, height: int) -> F64:
        """Get times between the first and the last row's opening, and between their closing, close together, [T]."""
        late = self.line_delay_s * (height - 1) * np.linspace(0, 1, ROW_PARTS + 1)
        return np.concatenate([self.opens_s + late, self.closes_s + late])


@dataclass(frozen=True)
class Slices:
    """The exposure as slices of time, within each of which light is collected evenly through one mixture of masks.

    In slice s the sensor collects light at the rate Σ_n mix[s, n] mask_n ⊙ L(t), in the rows that the shutter has
    opened. Slices may have any order and may overlap: their light is added. The sampling of L(t) is independent of them
    (`moments`).

    Args:
        start_s: [S], seconds; 0 is the middle of the nominal exposure.
        stop_s: [S], not before the start.
        mix: [S, N], the contribution of each mask: 1 while it is shown under nominal light.
        shown: [S], index of the mask that the modulator was commanded to show.
        since_s: [S], time of this command.
        shutter: The times at which each row collects light; None for all rows, all the time.
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
        """Get the effective time for which each mask is exposed in each slice, [S, N] seconds, in open rows."""
        return self.duration_s[:, None] * self.mix

    def scaled(self, factor: F64) -> "Slices":
        """Return the slices with the light of each multiplied by a factor, [S]."""
        return replace(self, mix=self.mix * factor[:, None])

    def split(self, parts: int) -> "Slices":
        """Return each slice cut into equal parts, in the same order."""
        if parts == 1:
            return self
        edges = self.start_s[:, None] + self.duration_s[:, None] * np.linspace(0, 1, parts + 1)
        return self._with_pieces(edges[:, :-1], edges[:, 1:])

    def split_at(self, times_s: F64) -> "Slices":
        """Return each slice s cut at the times [S, T] within it; other times make pieces of no length."""
        inner = np.clip(np.sort(times_s, axis=1), self.start_s[:, None], self.stop_s[:, None])
        edges = np.concatenate([self.start_s[:, None], inner, self.stop_s[:, None]], axis=1)
        return self._with_pieces(edges[:, :-1], edges[:, 1:]).without_empty()

    def cut_by_rows(self, height: int) -> "Slices":
        """Return the slices cut finely where rows of the sensor open and close: in the others they all do, or none.

        Of a slice that a row opens within, its share of the light of the whole slice is taken, which is wrong where the
        light changes in that time.
        """
        if self.shutter is None:
            return self
        turns = self.shutter.turns_s(height)
        return self.split_at(np.broadcast_to(turns, (len(self.start_s), len(turns))))

    def without_empty(self) -> "Slices":
        """Return the slices with a positive length."""
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
    """The image at one moment on the modulator, rendered with a margin around the sensor.

    Args:
        radiance: [H + 2 margin, W + 2 margin, 3], full scale 1.
        intrinsics: Camera matrix of this enlarged image, [3, 3] pixels; pixel centres at +0.5.
        margin: Pixels on each side outside the sensor.
        depth: z of the visible surface, of the same height and width, scene units, NaN where there is none; None if no
            effect needs it.
    """

    radiance: F64
    intrinsics: F64
    margin: int = 0
    depth: F64 | None = None

    def inner(self, image: F64) -> F64:
        """Return the part of an image of this size that is on the sensor."""
        height, width = image.shape[:2]
        return image[self.margin : height - self.margin, self.margin : width - self.margin]
