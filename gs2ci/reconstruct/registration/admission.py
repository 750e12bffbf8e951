"""Whether a correction is accepted: decodes of a crop with and without it, judged by pixels that neither saw.

Here: the crop and the short decodes. Not here: the proposed corrections (`proposals`, `sharpen`), the choice (`ways`).
"""

from dataclasses import replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, Bool
from gs2ci.core.crop import corner, middle, size_of
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, decode_signed
from gs2ci.reconstruct.measurement.coding import white_reading
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.registration.coarse import element_px
from gs2ci.reconstruct.registration.local_scene import Seen

_VIEW_PIXELS: Final = 160_000
_LEAST_SIDE_PX: Final = 48
_HELDOUT: Final = 0.1
_ITERATIONS: Final = 15


Corner = tuple[bool, bool]
"""Which corner of a picture: whether the lower, and whether the right one."""


class Trial:
    """A crop of a measurement, decoded in few steps.

    Args:
        shot: Its masks and readings as stated.
        scale: Divisor of the readings that brings the scene's levels to about a view's full scale.
        seed: Of the held-out pixels.
        at: The corner that is cropped; None crops the middle.
        but: Pixels that must not judge, [H, W]; None: all may.
    """

    def __init__(self, shot: Shot, scale: float, seed: int, at: Corner | None = None, but: Bool | None = None) -> None:
        self._scale = scale
        self._at = at
        if but is not None:
            shot = replace(shot, saturated=but if shot.saturated is None else shot.saturated | but)
        part = _crop(shot, at)
        self._heldout = Holdout.of(part, _HELDOUT, seed).pixels

    @property
    def can_tell(self) -> bool:
        """Get whether any pixel is held out."""
        return bool(self._heldout.any())

    def squares(self, shot: Shot) -> np.ndarray:
        """Return squared residuals, [K], of a measurement's decode at pixels that it did not see."""
        holdout = Holdout(_scaled_crop(shot, self._scale, self._at), self._heldout)
        return holdout.squared_residuals(_decoded(holdout.seen))


def brief_views(shot: Shot, scale: float) -> F32:
    """Decode the middle of a measurement in few steps, [N, h, w, C]; readings are scaled as in a `Trial`."""
    return _decoded(_scaled_crop(shot, scale))


def level_of(shot: Shot) -> float:
    """Return the divisor of readings that brings twice the scene's level to about full scale."""
    total = white_reading(shot)
    level = Seen.of(shot, element_px(total)).level(total)
    return max(2 * abs(float(np.median(level))), 1e-12)


def _decoded(shot: Shot) -> F32:
    return decode_signed(shot, GapTvSettings(iterations=_ITERATIONS))


def _scaled_crop(shot: Shot, scale: float, at: Corner | None = None) -> Shot:
    part = _crop(shot, at)
    return replace(part, measurement=(part.measurement / np.float32(scale)).astype(np.float32))


def _crop(shot: Shot, at: Corner | None) -> Shot:
    size = size_of(shot, _VIEW_PIXELS, _LEAST_SIDE_PX)
    part = middle(shot, size) if at is None else corner(shot, size, lower=at[0], right=at[1])
    if part.measurement.shape[2] == 3:  # grey gives the same information in a third of the time
        part = replace(part, measurement=part.measurement.mean(axis=2, keepdims=True))
    return part
