"""Light that oscillates periodically, integrated over slices of time."""

from typing import Final

import numpy as np

from gs2ci_sims.effects.base import BoundStep
from gs2ci_sims.signals import Slices

# Pieces per period, so that an oscillation is followed within a mask; for oscillations much faster than the masks only
# the mean over each piece matters, and that is exact.
PIECES_PER_PERIOD: Final = 12
PIECES_MAX: Final = 96


def swinging(slices: Slices, depth: float, hertz: float, phase: float) -> Slices:
    """Return the slices under a light of 1 + depth cos(2 pi hertz t + phase), cut finely enough to follow it."""
    longest = float(slices.duration_s.max(initial=0.0))
    parts = int(np.clip(np.ceil(longest * hertz * PIECES_PER_PERIOD), 1, PIECES_MAX))
    pieces = slices.split(parts)
    middle = 0.5 * (pieces.start_s + pieces.stop_s)
    mean = np.cos(2 * np.pi * hertz * middle + phase) * np.sinc(hertz * pieces.duration_s)
    return pieces.scaled(1 + depth * mean)


def swing_left(depth: float, frequency: BoundStep, interval_s: float) -> tuple[BoundStep, ...]:
    """Return how far the mean over an interval can be from 1, depth |sin x / x|, x = pi f interval, as the last step.

    Args:
        depth: Depth of the oscillation.
        frequency: The step that gives f, Hz.
        interval_s: The interval over which the light is averaged.
    """
    left = float(depth * np.abs(np.sinc(frequency.value * interval_s)))
    return (
        BoundStep("depth", depth, "", "swing of the light about its mean"),
        frequency,
        BoundStep("T", interval_s, "s", "time on show of each mask"),
        BoundStep(
            "c",
            left,
            "",
            "swing that an interval's mean keeps; sinc(x) = sin(pi x) / (pi x)",
            "depth * abs(sinc(f * T))",
        ),
    )
