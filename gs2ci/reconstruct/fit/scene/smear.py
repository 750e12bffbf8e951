"""A test for views smeared by a camera that moves during each mask: fine detail across its motion, none along it.

A mask transmits the mean of what the camera sees while it is displayed. Over d pixels of steady motion, this mean
removes nearly all detail along the motion that is finer than d, and none across it. Scenes whose own detail differs as
much between two directions are rare but exist (a fence, a blind, the sea), so the test gives a doubt, not a
measurement. Here: the test. Not here: how far the image moves, and how moments of a mask recover the detail
(`mask_moments`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.findings import Code, Findings, finding

# With less motion, the band of frequencies that it removes is too narrow to test.
_LEAST_PX: Final = 3.0
# A mean over d pixels removes the frequency 1 / d entirely, and passes up to a fifth of higher ones. Near a frequency
# of 1/2, detail is noise.
_BAND_FROM: Final = 1.2
_HIGHEST: Final = 0.45
# Frequencies within so many degrees count as along or across the motion.
_WEDGE_DEG: Final = 30.0
# In a picture of a few pixels, the band has too few frequencies to tell.
_LEAST_PLACES: Final = 16
# Ratio of the amplitude along the motion to that across it: 0.2 for planes that moved by 5 px during each mask; 0.67 to
# 2.4 for sharp pictures with an assumed horizontal motion, 0.42 for one of a tower with a vertical one
# (`test_smear.py`).
_SMEARED: Final = 0.35


def smeared_views(views: F32, motion_px: F64) -> Findings:
    """Report views that hold little fine detail along the camera's motion within a mask.

    Args:
        views: Of one pose for each mask, [N, H, W, C].
        motion_px: How far the image moves while each mask is displayed, [N, 2] as (x, y).
    """
    longest = float(np.linalg.norm(motion_px, axis=1).max(initial=0.0))
    share = detail_along(views, motion_px)
    if share is None or share >= _SMEARED:
        return ()
    return (finding(Code.VIEWS_SMEARED, motion_px=longest, share=share),)


def detail_along(views: F32, motion_px: F64) -> float | None:
    """Return the fine detail of views along a motion, as a share of that across it; None if it cannot be measured.

    Args:
        views: [N, H, W, C].
        motion_px: [N, 2] as (x, y).
    """
    height, width = views.shape[1:3]
    window = np.hanning(height)[:, None] * np.hanning(width)
    down, right = np.meshgrid(np.fft.fftfreq(height), np.fft.rfftfreq(width), indexing="ij")
    radius = np.hypot(down, right)
    least = np.cos(np.deg2rad(_WEDGE_DEG))
    sums = np.zeros((2, 2))  # power and places, along and across
    for view, motion in zip(views.mean(axis=3, dtype=np.float64), motion_px, strict=True):
        length = float(np.linalg.norm(motion))
        if length < _LEAST_PX:
            continue
        power = np.abs(np.fft.rfft2((view - view.mean()) * window)) ** 2
        band = (radius >= _BAND_FROM / length) & (radius <= _HIGHEST)
        x, y = motion / length
        for k, cosine in enumerate((right * x + down * y, right * y - down * x)):
            inside = band & (np.abs(cosine) >= least * radius)
            sums[k] += power[inside].sum(), inside.sum()
    if not (sums[:, 1].min() >= _LEAST_PLACES and sums[1, 0] > 0):
        return None
    along, across = sums[:, 0] / sums[:, 1]
    return float(np.sqrt(along / across))
