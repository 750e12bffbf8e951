"""`gs2ci measure`: the distance between two points that a run's views show. Here: the arguments and what is printed."""

from pathlib import Path
from typing import Annotated

import tyro

from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import say
from gs2ci.core.errors import InputError
from gs2ci.core.json_text import plain_json


def run(
    folder: Annotated[Path, tyro.conf.Positional],
    pixel: Annotated[str, tyro.conf.Positional],
    other_pixel: Annotated[str, tyro.conf.Positional],
    /,
    *,
    view: int | None = None,
    json: AsJson = False,
) -> float:
    """Measure the distance between the points that two pixels of a view show.

    Args:
        folder: The run folder, as `gs2ci reconstruct` wrote it.
        pixel: One end as COLUMN,ROW, counted from 0 at the upper left, as in 120,80.
        other_pixel: The other end, likewise.
        view: Which view, counted from 1; by default the middle one.

    Returns:
        The distance, in the unit of the path.

    Raises:
        Gs2ciError: The folder is no run with depth, or a pixel is outside the view or shows no surface.
    """
    pixels = [_place(text) for text in (pixel, other_pixel)]
    from gs2ci.api.scoring import finished_run, middle_view
    from gs2ci.api.scoring import measure as measured

    finished = finished_run(folder)
    chosen = middle_view(finished) if view is None else view
    found = measured(finished, *pixels, view=chosen)
    with answered(json) as answer:
        say(f"{found.length:.5g} ± {found.standard_error:.2g} {found.unit} (view {chosen})")
        for text, point, confidence in zip((pixel, other_pixel), found.points, found.confidence, strict=True):
            place = ", ".join(f"{value:.5g}" for value in point)
            say(f"  {text}: at {place}; confidence {confidence:.2f}")
        for doubt in found.doubts:
            say(doubt)
        answer({**plain_json(found), "view": chosen})
    return found.length


def _place(text: str) -> tuple[int, int]:
    try:
        column, row = (int(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"pixel {text!r}", allowed="COLUMN,ROW in whole pixels, as in 120,80") from error
    return column, row
