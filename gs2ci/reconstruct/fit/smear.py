"""Whether views look as where the camera goes on while a mask is on show: fine detail across its motion, none along it.

A mask lets through the mean of what the camera saw meanwhile. Over d pixels of steady motion that takes nearly all of
the detail along it that is finer than d, and none across. A scene whose own detail differs by so much between two
directions is rare but there is such (a fence, a blind, the sea), so that this is a doubt and no measurement.
Here: the test. Not here: how far the image moves, and what moments of a mask give back (`mask_moments`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.findings import Code, Finding, finding

# Less motion than this leaves too narrow a band of detail that it takes away.
_LEAST_PX: Final = 3.0
# A mean over d pixels passes the frequency 1 / d not at all, and beyond it up to a fifth. Near a half, detail is noise.
_BAND_FROM: Final = 1.2
_HIGHEST: Final = 0.45
# Frequencies count as along or across within so many degrees.
_WEDGE_DEG: Final = 30.0
# Of a picture of a few pixels so few frequencies are in the band that chance decides.
_LEAST_PLACES: Final = 16
# Amplitude along the motion, against that across it: 0.2 where planes were exposed on the move, by 5 px a mask; 0.67 to
# 2.4 in sharp pictures whose motion is level, and 0.42 in one of a tower that would move upright (`test_smear.py`).
_SMEARED: Final = 0.35


def smeared_views(views: F32, motion_px: F64) -> tuple[Finding, ...]:
    """Say that views hold little fine detail along the camera's motion within a mask, where that is so.

    Args:
        views: Of one pose for each mask, [N, H, W, C].
        motion_px: How far the image moves while each mask is on show, [N, 2] as (x, y).
    """
    longest = float(np.linalg.norm(motion_px, axis=1).max(initial=0.0))
    share = detail_along(views, motion_px)
    if share is None or share >= _SMEARED:
        return ()
    return (finding(Code.VIEWS_SMEARED, motion_px=longest, share=share),)


def detail_along(views: F32, motion_px: F64) -> float | None:
    """Return how much fine detail views hold along a motion, as a share of that across it; None where nothing tells.

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
