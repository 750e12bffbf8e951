"""The middle or a corner of a measurement, for use when the whole would take too long.

Here: `middle`, `corner`, the position of the middle, the size for a given number of pixels. Not here: their uses.
"""

from dataclasses import replace

import numpy as np

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot


def middle(shot: Shot, size: tuple[int, int]) -> Shot:
    """Crop the middle of a measurement.

    Args:
        shot: At least as large.
        size: Height and width of the crop, px. A colour mosaic begins with the same colour as before.

    Returns:
        The middle, unchecked: its masks may all be closed.

    Raises:
        InputError: The measurement is smaller, or a side is no count of pixels.
    """
    top, left = middle_begins(shot.size, size)
    return replace(_piece(shot, top, left, size), provenance={**shot.provenance, "middle": f"{size[0]} x {size[1]} px"})


def middle_begins(whole: tuple[int, int], size: tuple[int, int]) -> tuple[int, int]:
    """Return the row and column at which the middle of a picture begins: even, which keeps a colour mosaic's phase.

    Args:
        whole: Height and width of the picture, px.
        size: Height and width of its middle, px; no larger.
    """
    return (whole[0] - size[0]) // 4 * 2, (whole[1] - size[1]) // 4 * 2


def corner(shot: Shot, size: tuple[int, int], *, lower: bool, right: bool) -> Shot:
    """Crop a corner of a measurement, with the same conditions on the size as `middle`.

    Args:
        shot: At least as large.
        size: Height and width of the crop, px.
        lower: The lower instead of the upper.
        right: The right instead of the left.
    """
    top, left = (
        (whole - part) // 2 * 2 * far for whole, part, far in zip(shot.size, size, (lower, right), strict=True)
    )
    return _piece(shot, top, left, size)


def _piece(shot: Shot, top: int, left: int, size: tuple[int, int]) -> Shot:
    if not (0 < size[0] <= shot.size[0] and 0 < size[1] <= shot.size[1]):
        raise InputError(
            f"the middle or a corner, {size[0]} x {size[1]} px, of {shot.name}: {shot.size[0]} x {shot.size[1]} px",
            allowed="sides of at least 1 px and no larger than the measurement's",
        )
    rows, columns = slice(top, top + size[0]), slice(left, left + size[1])
    intrinsics, seen, depth = shot.intrinsics, shot.truth.views, shot.truth.depth
    return replace(
        shot,
        measurement=np.ascontiguousarray(shot.measurement[rows, columns]),
        masks=np.ascontiguousarray(shot.masks[:, rows, columns]),
        saturated=None if shot.saturated is None else shot.saturated[rows, columns],
        intrinsics=None if intrinsics is None else intrinsics - [[0, 0, left], [0, 0, top], [0, 0, 0]],
        truth=replace(
            shot.truth,
            views=None if seen is None else seen[:, rows, columns],
            depth=None if depth is None else depth[:, rows, columns],
        ),
    )


def size_of(shot: Shot, view_pixels: int, least_side: int = 1) -> tuple[int, int]:
    """Return height and width of a crop with the picture's proportions and a given number of pixels.

    Args:
        shot: A shot that is no larger is not cropped.
        view_pixels: Approximate number of pixels of all views together.
        least_side: Shortest side, px, unless the picture's own is shorter.
    """
    height, width = shot.size
    shrink = min(1.0, (view_pixels / (shot.views * height * width)) ** 0.5)
    rows, columns = (max(min(side, least_side), round(side * shrink)) for side in (height, width))
    return rows, columns
