"""The lamp's brightness from frame to frame, interpolated between references taken among the masks.

Every reference with all mirrors on gives one number, the lamp's level; in between it is interpolated in time. How much
each reference differs from the interpolation of its neighbours shows the changes that interpolation cannot correct.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64
from gs2ci_calibration.refusals import CalibrationError, Reason

DRIFT_MAX: Final = 0.25
"""A larger change of the lamp's level over a procedure means that it is not warm yet, or that the bench was touched."""
LAMP_SHARE_MAX: Final = 0.5
"""Share of the required accuracy that errors by the lamp may reach."""


@dataclass(frozen=True)
class LampRecord:
    """Levels of the lamp.

    Args:
        time_s: When each reference was taken, [R], in order.
        level: The lamp's level in it, [R]; 1 on average over the first ones.
        burst: The run of the modulator each belongs to, [R]; levels are not interpolated between runs.
    """

    time_s: F64
    level: F64
    burst: NDArray[np.int64]

    @property
    def drift(self) -> float:
        """Get the largest change of the level, as a share of its median."""
        return float(np.ptp(self.level) / np.median(self.level)) if len(self.level) else 0.0

    @property
    def flicker(self) -> float:
        """Get the relative rms error of one frame's light, from the differences between neighbouring references.

        A reference halfway between two others, minus their mean, has 3/2 of the variance of one. The result is 0 if
        every burst has fewer than three references.
        """
        total, count = 0.0, 0
        for burst in np.unique(self.burst):
            time, level = self.time_s[self.burst == burst], self.level[self.burst == burst]
            if len(time) < 3 or not (np.diff(time) > 0).all():
                continue
            share = (time[1:-1] - time[:-2]) / (time[2:] - time[:-2])
            foreseen = (1 - share) * level[:-2] + share * level[2:]
            total += float(np.sum(np.square(level[1:-1] / foreseen - 1) / (1 + share**2 + (1 - share) ** 2)))
            count += len(share)
        return float(np.sqrt(total / count)) if count else 0.0

    def require_steady(self, frames: int, accuracy: float) -> None:
        """Refuse a lamp that is too unsteady for masks measured with this many frames each.

        Args:
            frames: Frames of each mask, over which flicker averages out.
            accuracy: The required error of masks, rms.

        Raises:
            CalibrationError: It drifts or flickers too much.
        """
        left = self.flicker / np.sqrt(frames)
        if left > LAMP_SHARE_MAX * accuracy:
            raise CalibrationError(
                "masks",
                Reason.LAMP_FLICKERS,
                f"the light differs by {self.flicker:.2%} rms from frame to frame, an error of {left:.2%} in masks "
                f"of {frames} frames",
                allowed=f"{LAMP_SHARE_MAX * accuracy:.2%}",
                remedy="feed the lamp with direct current, expose for whole periods of the mains (10 or 8.33 ms each), "
                "or take more frames of each mask",
            )
        if self.drift > DRIFT_MAX:
            raise CalibrationError(
                "masks",
                Reason.LAMP_DRIFTS,
                f"the lamp's level changed by {self.drift:.1%} from reference to reference",
                allowed=f"up to {DRIFT_MAX:.0%}",
                remedy="let the lamp warm up, keep daylight out, do not touch the bench meanwhile",
            )


def burst_levels(references: F64, swing: F64) -> F64:
    """Return the lamp's level in frames with every mirror on.

    Args:
        references: Frames above dark at the valid pixels, [R, P].
        swing: Their mean, [P].
    """
    return references.sum(axis=1) / swing.sum()
