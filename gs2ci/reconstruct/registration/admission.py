"""Whether a correction is accepted: decodes of a crop with and without it, judged by pixels that neither saw.

Here: the crop and the short decodes. Not here: the proposed corrections (`proposals`, `sharpen`), the choice (`ways`).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64, Bool
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
# So many pixels are to judge. Small pictures are decoded repeatedly, each time without others of their pixels, since a
# few hundred do not tell a black level behind wide elements, which neighbours predict whatever it is.
_JUDGES: Final = 2000
_MOST_DECODES: Final = 5
# Share of the squared residuals that count as they are; larger ones count as much as the largest of these. Behind
# masks that pass a thousandth a decode divides by it, and one such neighbour would outweigh all other pixels.
_COUNTED: Final = 0.99


Corner = tuple[bool, bool]
"""Which corner of a picture: whether the lower, and whether the right one."""


def squares_of(
    shot: Shot,
    candidates: Sequence[Shot],
    scale: float,
    seed: int,
    at: Corner | None = None,
    but: Bool | None = None,
) -> F64:
    """Decode a crop of each candidate in few steps, and return the squared residuals at pixels that it did not see.

    Args:
        shot: Its masks and readings as stated, of which pixels are held out.
        candidates: The same with other masks and readings.
        scale: Divisor of the readings that brings the scene's levels to about a view's full scale.
        seed: Of the held-out pixels.
        at: The corner that is cropped; None crops the middle.
        but: Pixels that must not judge, [H, W]; None: all may.

    Returns:
        For each candidate, [D, K]; the few largest count no more than the others. K is 0 if no pixel is held out.
    """
    if but is not None:
        shot = replace(shot, saturated=but if shot.saturated is None else shot.saturated | but)
    part = _crop(shot, at)
    decodes = int(np.clip(np.ceil(_JUDGES / (_HELDOUT * part.masks[0].size)), 1, _MOST_DECODES))
    heldout = Holdout.of(part, decodes * _HELDOUT, seed).pixels
    turn = np.full(part.size, -1)
    turn[heldout] = np.arange(heldout.sum()) % decodes
    squares = np.zeros((len(candidates), *part.size))
    for left, candidate in zip(squares, candidates, strict=True):
        crop = _scaled_crop(candidate, scale, at)
        for number in range(int(turn.max()) + 1):
            holdout = Holdout(crop, turn == number)
            left[holdout.pixels] = holdout.squared_residuals(_decoded(holdout.seen))
    unseen = squares[:, heldout]
    return np.minimum(unseen, np.quantile(unseen, _COUNTED)) if unseen.size else unseen


def brief_views(shot: Shot, scale: float) -> F32:
    """Decode the middle of a measurement in few steps, [N, h, w, C]; readings are divided by the scale."""
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
