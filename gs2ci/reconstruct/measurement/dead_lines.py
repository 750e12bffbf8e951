"""Rows and columns of the sensor that read one value throughout: found, and left out.

Here: `close_dead_lines`. Not here: single hot pixels (`hot_pixels`), other doubts about a measurement
(`doubts`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import Bool
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import without_pixels

# A shorter line may read the same by chance.
_SHORTEST: Final = 8
_AXES: Final = ((1, "rows"), (0, "columns"))


def close_dead_lines(shot: Shot) -> tuple[Shot, tuple[Finding, ...]]:
    """Close the masks over dead lines, so that no stage uses their readings; report which.

    Working pixels differ from their neighbours at least by noise. Lines along the picture's border are kept: a constant
    value there may also be the black bars of a film.
    """
    opened: Bool = np.any(shot.masks > 0, axis=0)
    sound = opened.copy()
    notes = []
    for axis, name in _AXES:
        stuck = _stuck(shot, opened, axis)
        dead = stuck & ~_along_border(stuck)
        if axis == 1:
            sound[dead] = False
        else:
            sound[:, dead] = False
        for lines, code in ((dead, Code.DEAD_LINES), (stuck & ~dead, Code.STUCK_BORDER_LINES)):
            if lines.any():
                first = int(np.argmax(lines))
                notes.append(finding(code, count=int(lines.sum()), of=len(lines), lines=name, first=first))
    if (sound == opened).all():
        return shot, tuple(notes)
    return without_pixels(shot, ~sound), tuple(notes)


def _stuck(shot: Shot, opened: Bool, axis: int) -> Bool:
    """Find lines with a constant reading, although masks opened there and no clipping explains it."""
    measured = shot.measurement
    if measured.shape[axis] < _SHORTEST or measured.min() == measured.max():
        return np.zeros(measured.shape[1 - axis], bool)
    same = np.all(measured.max(axis=axis) == measured.min(axis=axis), axis=1)
    clipped = np.zeros_like(same) if shot.saturated is None else np.any(shot.saturated, axis=axis)
    found: Bool = same & np.any(opened, axis=axis) & ~clipped
    return found


def _along_border(stuck: Bool) -> Bool:
    """Mark the runs of lines that touch the first or the last."""
    live = np.flatnonzero(~stuck)
    if not len(live):
        return np.ones_like(stuck)
    index = np.arange(len(stuck))
    outside: Bool = np.logical_or(index < live[0], index > live[-1])
    return outside
