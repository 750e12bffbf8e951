"""The number of frames of each mask that a required accuracy needs, computed from the first few. Pure."""

from typing import Final

import numpy as np

from gs2ci_calibration.refusals import CalibrationError, Reason

FRAMES_MAX: Final = 1024
"""Largest number of frames of each mask; beyond it, more light is better than more frames."""


def frames_wanted(rms_se: float, frames: int, fixed_se: float, accuracy: float, step: str) -> int:
    """Return how many frames of each mask reduce its error to the required accuracy.

    Args:
        rms_se: Standard error of masks from the first frames, rms over the pixels.
        frames: How many those were.
        fixed_se: The part of it that more frames do not reduce (the dark reading's).
        accuracy: Required standard error, rms.
        step: For messages.

    Raises:
        CalibrationError: The error of the dark reading alone is too large, or more than `FRAMES_MAX` frames are needed.
    """
    if fixed_se >= accuracy:
        raise CalibrationError(
            step,
            Reason.TOO_FEW_FRAMES,
            f"the error of the dark frames alone causes {fixed_se:.2%} rms in the masks",
            allowed=f"less than {accuracy:.2%} (mask_accuracy in [calibration])",
            remedy="take more dark frames (frames in [calibration]) with `gs2ci calibrate dark-flat`",
        )
    falling = max(rms_se**2 - fixed_se**2, 0.0) * frames
    wanted = int(np.ceil(falling / (accuracy**2 - fixed_se**2)))
    if wanted > FRAMES_MAX:
        raise CalibrationError(
            step,
            Reason.TOO_FEW_FRAMES,
            f"{wanted} frames of each mask would be needed for an error of {accuracy:.2%} rms; one frame has "
            f"an error of {np.sqrt(falling):.0%}",
            allowed=f"{FRAMES_MAX}",
            remedy="more light, or a larger mask_accuracy in [calibration]",
        )
    return max(wanted, 1)
