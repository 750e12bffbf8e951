"""All pixels that the measurement itself shows to be faulty, closed before anything is decoded.

Here: dead lines, then hot pixels; and regions where no mask opens, which are filled. Not here: other doubts (`doubts`).
"""

from dataclasses import replace
from typing import Final

import numpy as np
import torch
from scipy.ndimage import convolve, distance_transform_edt

from gs2ci.core.arrays import F32, Bool
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import MOST_OUTLIERS, Coding, beyond_white, without_pixels

# Regions where no mask opens, filled for the fit with the decoder's continuation of their surroundings.

# First Gaussians are three pixels apart: those nearer to an open pixel than this are constrained by its light.
_REACH_PX: Final = 3.0


def fill_holes(shot: Shot, decoded: F32) -> Shot:
    """Return a measurement as if grey masks had shown the decoded views, [N, H, W, C], in wide dark regions.

    Gaussians that reach no measured pixel are changed only by the term that makes them fade, and a dark region would
    turn black whatever surrounds it. Masks are set to their mean over the open pixels there, so that the brightness of
    the measurement does not jump at the region's border.
    """
    hole = distance_transform_edt(~shot.lit) > _REACH_PX
    if not hole.any():
        return shot
    level = np.float32(shot.masks[:, shot.lit].mean())
    filled = replace(shot, masks=np.where(hole, level, shot.masks))
    expected = Coding.of(filled).forward(torch.from_numpy(decoded)).numpy()
    return replace(filled, measurement=np.where(hole[..., None], expected, shot.measurement))


# Rows and columns of the sensor that read one value throughout: found, and left out.

# Fewer pixels may read the same by chance.
_FEWEST: Final = 8
_AXES: Final = ((1, "rows"), (0, "columns"))
# Where two dead lines cross, one of them reads the other's value: it is found once the other is left out.
_ROUNDS: Final = 2


def close_dead_lines(shot: Shot) -> tuple[Shot, Findings]:
    """Close the masks over dead lines, so that no stage uses their readings; report which.

    Working pixels differ from their neighbours at least by noise. Lines are judged by their pixels that got light and
    are not clipped, since those known to be bad were given another reading. Lines along the picture's border are kept:
    a constant value there may also be the black bars of a film.
    """
    judged, closed = shot.usable, np.zeros(shot.size, bool)
    stuck = {axis: np.zeros(shot.size[1 - axis], bool) for axis, _ in _AXES}
    for _ in range(_ROUNDS):
        for axis, _ in _AXES:
            stuck[axis] |= _stuck(shot.measurement, judged & ~closed, axis)
            closed |= np.expand_dims(stuck[axis] & ~_along_border(stuck[axis]), axis)
    notes = []
    for axis, name in _AXES:
        border = _along_border(stuck[axis])
        for lines, code in ((stuck[axis] & ~border, Code.DEAD_LINES), (stuck[axis] & border, Code.STUCK_BORDER_LINES)):
            if lines.any():
                first = int(np.argmax(lines))
                notes.append(finding(code, count=int(lines.sum()), of=len(lines), lines=name, first=first))
    return without_pixels(shot, closed) if closed.any() else shot, tuple(notes)


def _stuck(measured: F32, judged: Bool, axis: int) -> Bool:
    """Find lines whose pixels to be judged, [H, W], have one reading, unless the whole measurement has."""
    if measured.min() == measured.max():
        return np.zeros(judged.shape[1 - axis], bool)
    asked = judged[..., None]
    least, most = np.where(asked, measured, np.inf).min(axis=axis), np.where(asked, measured, -np.inf).max(axis=axis)
    return np.all(least == most, axis=1) & (judged.sum(axis=axis) >= _FEWEST)


def _along_border(stuck: Bool) -> Bool:
    """Mark the runs of lines that touch the first or the last."""
    live = np.flatnonzero(~stuck)
    if not len(live):
        return np.ones_like(stuck)
    index = np.arange(len(stuck))
    return np.logical_or(index < live[0], index > live[-1])


# Single pixels that read more light than any scene sends: found, and left out.

# At most so many neighbours of a hot pixel may be hot as well: if one pixel in twenty is hot, 99 % of the hot pixels
# have no more. A region that is brighter than white because of a wrong unit or wrong masks has more, and is kept.
_NEIGHBOURS: Final = 2


def close_hot_pixels(shot: Shot) -> tuple[Shot, Findings]:
    """Close the masks over hot pixels, so that no stage uses their readings; report how many.

    No view can explain them, and a fit would make a bright Gaussian of each that disturbs all views. A reading known to
    be clipped is a lower bound and is not a hot pixel. If many pixels read too much, masks or unit are wrong, and none
    is closed.
    """
    odd = beyond_white(shot)
    if odd.mean() > MOST_OUTLIERS:
        return shot, ()
    if shot.saturated is not None:
        odd &= ~shot.saturated
    beside = convolve(odd.astype(np.int64), np.ones((3, 3), np.int64), mode="constant") - odd
    hot = odd & (beside <= _NEIGHBOURS)
    if not hot.any():
        return shot, ()
    count = int(hot.sum())
    pixels = f"{count} pixels read" if count > 1 else "1 pixel reads"
    return without_pixels(shot, hot), (finding(Code.HOT_PIXELS, pixels=pixels, count=count),)


def close_faulty_pixels(shot: Shot) -> tuple[Shot, Findings]:
    """Return the shot with every mask closed over dead lines and hot pixels; report which."""
    alive, dead = close_dead_lines(shot)
    sound, hot = close_hot_pixels(alive)
    return sound, (*dead, *hot)
