"""The overview picture: measurement, middle view, depth and error of one run beside each other, to skim many runs by.

Here: these tiles and their names. Not here: figures, charts and the other views, which are on the run's page, in the
same colours (`gs2ci.evaluate.pages`).
"""

from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import U8
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.evaluate.pages.pictures import colour, shrink, to_eight_bit
from gs2ci.evaluate.report import Report
from gs2ci.evaluate.scales import error_ceiling, inverse_depth_limits, white_level

COLUMNS: Final = 3
# Tiles are at most this long; smaller ones are enlarged by a whole number to about this.
SIDE_PX: Final = 480
_GAP_PX: Final = 8
_NAME_PX: Final = 26


def write_overview(path: Path, shot: Shot, result: RunResult, report: Report) -> None:
    """Draw a run's overview and write it as PNG.

    Args:
        path: The file.
        shot: The measurement, with its truth if there is one.
        result: The result of its reconstruction.
        report: The run's report (`gs2ci.evaluate.report`).
    """
    _, encoded = cv2.imencode(".png", draw_overview(shot, result, report)[..., ::-1])
    path.write_bytes(encoded.tobytes())


def draw_overview(shot: Shot, result: RunResult, report: Report) -> U8:
    """Draw a run's overview, [height, width, 3]: rows of three tiles, white between them.

    Args:
        shot: The measurement, with its truth if there is one.
        result: The result of its reconstruction.
        report: The run's report.
    """
    tiles = [_named(name, _fitted(tile)) for name, tile in _tiles(shot, result, report).items()]
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % COLUMNS)
    rows = [np.concatenate(tiles[first : first + COLUMNS], axis=1) for first in range(0, len(tiles), COLUMNS)]
    return np.concatenate(rows, axis=0)


def _tiles(shot: Shot, result: RunResult, report: Report) -> dict[str, U8]:
    """Return the pictures, [H, W, 3] each, by their names."""
    middle = result.views.shape[0] // 2
    view, truth = result.views[middle], shot.truth.views
    tiles = {
        "measurement": _grey_or_colour(shot.measurement / white_level(shot.measurement)),
        "decode": _grey_or_colour(result.decode[middle]),
        "result": _grey_or_colour(view),
    }
    if truth is not None:
        error = np.abs(np.clip(view, 0, 1) - np.clip(truth[middle], 0, 1)).mean(-1)
        tiles["truth"] = _grey_or_colour(truth[middle])
        tiles["error"] = colour(error, (0.0, error_ceiling(error)), "error", empty=np.zeros(error.shape, bool))
    if result.depth is not None and not report.known_at_rest:
        depth = result.depth[middle].astype(np.float64)
        empty = ~(depth > 0)
        if not empty.all():
            inverse = 1 / np.where(empty, 1.0, depth)
            tiles["depth"] = colour(inverse, inverse_depth_limits(inverse[~empty]), "depth", empty=empty)
    return tiles


def _grey_or_colour(image: NDArray[Any]) -> U8:
    return np.broadcast_to(to_eight_bit(image), (*image.shape[:2], 3))


def _fitted(tile: U8) -> U8:
    """Reduce a large tile, enlarge a small one pixel by pixel."""
    times = max(1, SIDE_PX // max(tile.shape[:2]))
    return shrink(tile, SIDE_PX).repeat(times, axis=0).repeat(times, axis=1)


def _named(name: str, tile: U8) -> U8:
    height, width = tile.shape[:2]
    framed = np.full((height + _NAME_PX + _GAP_PX, max(width, 4 * _NAME_PX) + _GAP_PX, 3), 255, np.uint8)
    framed[_NAME_PX : _NAME_PX + height, :width] = tile
    cv2.putText(framed, name, (0, _NAME_PX - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (30, 30, 30), 1, cv2.LINE_AA)
    return framed
