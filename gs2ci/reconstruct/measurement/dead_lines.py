"""Rows and columns of the sensor that read one value throughout: found, and left out.

Here: `close_dead_lines`. Not here: single hot pixels (`hot_pixels`), other doubts about a measurement
(`doubts`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, Bool
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import without_pixels

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
