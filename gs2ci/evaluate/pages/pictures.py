"""Arrays as pictures inside a page, compressed to a budget of bytes.

Here: pictures as data URIs, colour maps, and the choice of size and quality. Not here: which pictures a page shows.
"""

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import U8, Bool
from gs2ci.core.errors import InputError

# Budget for all pictures of one page, as data URIs; style, text and charts take about 0.2 MB more.
BUDGET_BYTES: Final = 2_300_000
# Data URIs write three bytes as four characters.
BASE64: Final = 4 / 3
LONGEST_SIDE_PX: Final = 720
# Pictures smaller than this are shown pixel by pixel and encoded without loss, which takes few bytes.
PIXEL_ART_PX: Final = 160
QUALITIES: Final = (86, 78, 70)
SMALLEST_SIDE_PX: Final = 96
_ERRORS: Final = ("error", "disagreement", "views_error", "depth_error")
COLORMAPS: Final = {"depth": cv2.COLORMAP_VIRIDIS, **dict.fromkeys(_ERRORS, cv2.COLORMAP_INFERNO)}
_MAGIC: Final = ((b"\x89PNG\r\n\x1a\n", "image/png"), (b"\xff\xd8\xff", "image/jpeg"))


@dataclass(frozen=True)
class Picture:
    """An encoded picture; width and height are 0 where they are not needed."""

    content: bytes
    kind: str
    width: int = 0
    height: int = 0

    @property
    def uri(self) -> str:
        """Get the picture as a data URI."""
        return f"data:{self.kind};base64,{base64.b64encode(self.content).decode()}"


def media_type(content: bytes) -> str | None:
    """Recognise PNG, JPEG and WebP by their first bytes; None for all else."""
    for magic, kind in _MAGIC:
        if content.startswith(magic):
            return kind
    return "image/webp" if content[:4] == b"RIFF" and content[8:12] == b"WEBP" else None


def to_eight_bit(image: NDArray[Any]) -> U8:
    """Clamp to [0, 1] and round to 8 bits."""
    return np.asarray(np.round(255 * np.clip(np.nan_to_num(image), 0, 1)), np.uint8)


def colour(values: NDArray[Any], limits: tuple[float, float], colormap: str, *, empty: Bool) -> U8:
    """Colour a map [..., H, W]; pixels of `empty` become grey.

    Args:
        values: Finite where not empty.
        limits: The values that get the first and the last colour.
        colormap: One of `COLORMAPS`.
        empty: The same shape.
    """
    low, high = limits
    level = to_eight_bit((np.where(empty, low, values) - low) / max(high - low, 1e-12))
    table = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], COLORMAPS[colormap])[:, 0, ::-1]
    coloured: U8 = table[level]
    coloured[empty] = 128
    return coloured


def scale_strip(colormap: str) -> Picture:
    """Draw a colour map's own scale, from its first to its last colour."""
    ramp = np.linspace(0, 1, 256)[None].repeat(4, axis=0)
    return encode(colour(ramp, (0, 1), colormap, empty=np.zeros(ramp.shape, bool)), quality=None)


def encode(image: U8, *, quality: int | None) -> Picture:
    """Encode an image [H, W, 3] (RGB) or [H, W, 1]: as WebP of a quality in 1 to 100, or as PNG if None.

    Raises:
        InputError: The encoder refuses its size.
    """
    height, width = image.shape[:2]
    extension, options = (".png", []) if quality is None else (".webp", [cv2.IMWRITE_WEBP_QUALITY, quality])
    ordered = np.ascontiguousarray(image[..., ::-1] if image.shape[2] == 3 else image)
    done, content = cv2.imencode(extension, ordered, options)
    if not done:
        raise InputError(f"an image of {height} × {width} pixels cannot be encoded", allowed="1 to 16383 pixels a side")
    return Picture(content.tobytes(), "image/png" if quality is None else "image/webp", width, height)


def is_pixel_art(size: tuple[int, int]) -> bool:
    """Return whether images of this size are shown pixel by pixel."""
    return max(size) <= PIXEL_ART_PX


def encode_all(stacks: Mapping[str, Sequence[U8]], *, budget_bytes: int = BUDGET_BYTES) -> dict[str, list[Picture]]:
    """Encode named stacks of images together, so that the page's data URIs take no more than the budget.

    Small images stay lossless. Others are reduced to at most `LONGEST_SIDE_PX`; if the budget requires it, first their
    quality is reduced and then their size.

    Args:
        stacks: Images [H, W, 3] or [H, W, 1], uint8.
        budget_bytes: For all data URIs together.

    Raises:
        InputError: Not even thumbnails fit, or an image cannot be encoded.
    """
    longest = max((max(image.shape[:2]) for stack in stacks.values() for image in stack), default=0)
    if is_pixel_art((longest, longest)):
        found = _encode_at(stacks, longest, None)
        if _weight(found) <= budget_bytes:
            return found
    side = min(longest, LONGEST_SIDE_PX)
    while True:
        for quality in QUALITIES:
            found = _encode_at(stacks, side, quality)
            weight = _weight(found)
            if weight <= budget_bytes:
                return found
        if side <= SMALLEST_SIDE_PX:
            raise InputError(f"pictures of {weight} bytes for a page", allowed=f"{budget_bytes} bytes or less")
        # Bytes are about proportional to the area; the side is reduced slightly more, so that one round often suffices.
        side = max(SMALLEST_SIDE_PX, int(0.95 * side * math.sqrt(budget_bytes / weight)))


def _encode_at(stacks: Mapping[str, Sequence[U8]], side: int, quality: int | None) -> dict[str, list[Picture]]:
    return {name: [encode(shrink(image, side), quality=quality) for image in stack] for name, stack in stacks.items()}


def _weight(found: Mapping[str, Sequence[Picture]]) -> int:
    return round(BASE64 * sum(len(picture.content) for stack in found.values() for picture in stack))


def shrink(image: U8, side: int) -> U8:
    """Reduce an image, [H, W, C], to at most `side` pixels a side, each the mean of those it replaces."""
    height, width = image.shape[:2]
    share = side / max(height, width)
    if share >= 1:
        return image
    size = (max(1, round(share * width)), max(1, round(share * height)))
    shrunk = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(shrunk, np.uint8).reshape(size[1], size[0], image.shape[2])
