"""Display of records in a notebook: a table of facts with a picture above it.

Here: pictures as PNG, a row of pictures, the table. Not here: the contents for each record (its own `_repr_html_` and
`_repr_png_`, which notebooks call). All text is escaped: names come from files that are not trusted.
"""

import base64
import html
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import U8

# High enough to see the pixels of masks, low enough for four side by side in a cell.
TILE_PX: Final = 220
GAP_PX: Final = 6


def png_of(picture: NDArray[Any]) -> bytes:
    """Write a picture as PNG.

    Args:
        picture: [H, W], [H, W, 1] or [H, W, 3] in RGB; uint8, or numbers whose range 0 to 1 is shown.
    """
    import cv2  # noqa: PLC0415  not needed where nothing is shown

    shown = eight_bit(picture)
    done, content = cv2.imencode(".png", np.ascontiguousarray(shown[..., ::-1]))
    assert done  # PNG takes any picture of 8 bits
    return bytes(content)


def eight_bit(picture: NDArray[Any]) -> U8:
    """Convert a picture to RGB of 8 bits, [H, W, 3]; NaN becomes black."""
    whole = picture if picture.ndim == 3 else picture[..., None]
    if whole.dtype != np.uint8:
        whole = np.round(255 * np.clip(np.nan_to_num(whole.astype(np.float32)), 0, 1)).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(whole, (*whole.shape[:2], 3)))


def row_of(pictures: Iterable[NDArray[Any]], height: int = TILE_PX) -> U8:
    """Put pictures side by side, resized to one height, on a neutral grey."""
    import cv2  # noqa: PLC0415  as above

    tiles: list[U8] = []
    for picture in pictures:
        shown = eight_bit(picture)
        width = max(1, round(shown.shape[1] * height / shown.shape[0]))
        # Pixels stay visible when enlarged; a reduced picture is averaged.
        way = cv2.INTER_NEAREST if height > shown.shape[0] else cv2.INTER_AREA
        if tiles:
            tiles.append(np.full((height, GAP_PX, 3), 128, np.uint8))
        tiles.append(np.asarray(cv2.resize(shown, (width, height), interpolation=way), np.uint8))
    return np.concatenate(tiles, axis=1)


def card(title: str, facts: Iterable[tuple[str, object]], png: bytes | None = None, *, caption: str = "") -> str:
    """Lay out what a notebook shows of a record.

    Args:
        title: Its name.
        facts: Names and values.
        png: A picture of it.
        caption: What the picture shows.
    """
    picture = "" if png is None else f'<img style="max-width:100%" alt="{_text(caption)}" src="{data_uri(png)}">'
    below = f'<div style="opacity:.7">{_text(caption)}</div>' if caption and png is not None else ""
    cells = "".join(
        f'<tr><td style="text-align:left;opacity:.7">{_text(name)}</td>'
        f'<td style="text-align:left">{_text(value)}</td></tr>'
        for name, value in facts
    )
    return f"<div><strong>{_text(title)}</strong><div>{picture}</div>{below}<table>{cells}</table></div>"


def sheet(title: str, headings: Sequence[str], rows: Iterable[Sequence[object]], png: bytes | None = None) -> str:
    """Lay out a table with headings, as `card` lays out facts."""
    picture = "" if png is None else f'<div><img style="max-width:100%" alt="" src="{data_uri(png)}"></div>'
    head = "".join(f'<th style="text-align:left">{_text(heading)}</th>' for heading in headings)
    body = "".join(
        "<tr>" + "".join(f'<td style="text-align:left">{_text(value)}</td>' for value in row) + "</tr>" for row in rows
    )
    return f"<div><strong>{_text(title)}</strong>{picture}<table><tr>{head}</tr>{body}</table></div>"


def data_uri(png: bytes) -> str:
    """Return a PNG as a data URL."""
    return f"data:image/png;base64,{base64.b64encode(png).decode()}"


def _text(value: object) -> str:
    return html.escape(str(value))
