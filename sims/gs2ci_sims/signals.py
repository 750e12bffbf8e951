"""What travels along the light path before it is an image: slices of time, moving scenes, views. For effects.

Not here: who makes them (`exposure`) and what happens to them (`effects`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs2ci.render.gaussians import Gaussians

F64 = NDArray[np.float64]

MovingScene = Callable[[float], Gaussians]
"""The Gaussians at a time in seconds; a scene at rest returns the same object every time."""


@dataclass(frozen=True)
class Slices:
    """The exposure as slices of time, each short enough to be one view behind one (mixed) mask.

    The sensor collects Σ_s (stop - start)_s x rate x (Σ_n mix[s, n] mask_n) ⊙ view(at_s), with `rows[s, y]` as a
    further factor on row y.

    Args:
        start_s: [S], seconds; 0 is the middle of the nominal exposure.
        stop_s: [S], not before the start.
        at_s: [S], the moment whose view stands for the slice.
        mix: [S, N], how much each mask contributes: 1 while it is on show under nominal light.
        rows: [S, H], the share of the slice during which a row is exposed; None: all rows, all the time.
    """

    start_s: F64
    stop_s: F64
    at_s: F64
    mix: F64
    rows: F64 | None = None

    @property
    def duration_s(self) -> F64:
        """Get the length of each slice, [S]."""
        return self.stop_s - self.start_s

    def weights_s(self) -> F64:
        """Get the effective time for which each mask is exposed in each slice, [S, N] seconds."""
        return self.duration_s[:, None] * self.mix


def nominal_slices(intervals_s: F64) -> Slices:
    """Return one slice per mask interval [N, 2], seen from its middle."""
    start, stop = intervals_s[:, 0], intervals_s[:, 1]
    return Slices(start, stop, 0.5 * (start + stop), np.eye(len(intervals_s)))


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
