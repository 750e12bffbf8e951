"""Gaussian scenes as SOG files (PlayCanvas, version 2), a twentieth of a PLY's size, for viewers in browsers.

Here: `write_sog`. The file is a ZIP of `meta.json` and lossless WebP pictures in which a pixel is a Gaussian: places in
16 bits of sign(x) ln(1 + |x|), sizes and colours as indices into codebooks of 256 values, opacities in 8 bits, three
components of rotations in 8 bits each, and harmonics as indices of a palette of 65,536 sets. Axes are those of
a PLY file, unturned: what writes SOG writes them so, although the format's page says that y is up. Not here: motion,
which the format cannot store; reading. Format: developer.playcanvas.com, "The SOG Format".
"""

import io
import json
import math
import zipfile
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from gs2ci.core.arrays import F64, U8
from gs2ci.core.errors import InputError
from gs2ci.core.whole_file import write_whole
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.half_turn import unit_quaternions
from gs2ci.render.harmonics import SH_DC, degree_of

VERSION: Final = 2
_LEVELS: Final = 256
_FINE: Final = 65_535
_PALETTE_MOST: Final = 65_536
_PALETTE_ALONG: Final = 64
_FIRST_INDEX: Final = 252
_ROUNDS: Final = 30
# Beyond this OpenCV writes WebP without loss.
_WITHOUT_LOSS: Final = 101
_SIDE_MOST: Final = 16_383
# ZIP files know no date before this one; a date of its own would make every file another one.
_DATE: Final = (1980, 1, 1, 0, 0, 0)


def write_sog(path: str | Path, gaussians: Gaussians) -> Path:
    """Write a scene as SOG; the file appears whole or not at all.

    Args:
        path: Of the file; an existing file is replaced.
        gaussians: The scene.

    Returns:
        The path written.

    Raises:
        InputError: The Gaussians do not fit together or hold NaN, there is none, or there are too many.
        StorageError: The file cannot be written.
    """
    scene = gaussians.check().detach().map(torch.Tensor.double)
    count = len(scene)
    # The side of the pictures is a multiple of 4, as textures like it.
    width = 4 * max(1, math.ceil(math.sqrt(count) / 4))
    if not 0 < count <= _SIDE_MOST**2 or width > _SIDE_MOST:
        raise InputError(f"{count} Gaussians", allowed=f"1 to {_SIDE_MOST**2} in a SOG file", remedy="export it as ply")
    place = np.sign(scene.means.numpy()) * np.log1p(np.abs(scene.means.numpy()))
    low, high = place.min(axis=0), place.max(axis=0)
    fine = np.rint(_FINE * (place - low) / np.where(high > low, high - low, 1)).astype(np.uint16)
    sizes, size_book = _coded(scene.log_scales.numpy())
    colours, colour_book = _coded((scene.colours.numpy() - 0.5) / SH_DC)
    opacity = np.rint(255 * torch.sigmoid(scene.opacity_logits).numpy()).astype(np.uint8)
    pictures = {
        "means_l.webp": _picture((fine & 255).astype(np.uint8), width),
        "means_u.webp": _picture((fine >> 8).astype(np.uint8), width),
        "scales.webp": _picture(sizes, width),
        "quats.webp": _picture(_smallest_three(unit_quaternions(scene.quaternions).numpy()), width),
        "sh0.webp": _picture(np.concatenate([colours, opacity[:, None]], axis=1), width),
    }
    meta: dict[str, Any] = {
        "version": VERSION,
        "asset": {"generator": "gs2ci"},
        "count": count,
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": size_book.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": colour_book.tolist(), "files": ["sh0.webp"]},
    }
    if scene.harmonics is not None:
        more, meta["shN"] = _harmonics(scene.harmonics.numpy(), degree_of(scene), width)
        pictures |= more
    return write_whole(path, _zipped({"meta.json": json.dumps(meta, separators=(",", ":")).encode(), **pictures}))


def _zipped(files: dict[str, bytes]) -> bytes:
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_STORED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name, _DATE), content)
    return held.getvalue()


def _picture(pixels: U8, width: int) -> bytes:
    """Encode pixels in their order, [P, 3 or 4], as a picture of a width, without loss; the rest of it is 0."""
    height = max(1, math.ceil(len(pixels) / width))
    whole = np.zeros((height * width, pixels.shape[1]), np.uint8)
    whole[: len(pixels)] = pixels
    shown = whole.reshape(height, width, -1)[..., [2, 1, 0, *range(3, pixels.shape[1])]]
    done, content = cv2.imencode(".webp", np.ascontiguousarray(shown), [cv2.IMWRITE_WEBP_QUALITY, _WITHOUT_LOSS])
    assert done  # sizes and kinds are what the encoder takes
    return bytes(content)


def _coded(values: F64) -> tuple[U8, F64]:
    """Return indices into a codebook of 256 values, which minimise the squared error, and the codebook (Lloyd 1982)."""
    ordered = np.sort(values.ravel())
    total = np.concatenate([[0.0], np.cumsum(ordered)])
    # From levels spread evenly over the range and over the values, half each, to leave no part of either without one.
    even = np.linspace(ordered[0], ordered[-1], _LEVELS // 2)
    book = np.sort(np.concatenate([even, ordered[np.linspace(0, len(ordered) - 1, _LEVELS // 2).round().astype(int)]]))
    for _ in range(_ROUNDS):
        ends = np.concatenate([[0], np.searchsorted(ordered, (book[1:] + book[:-1]) / 2), [len(ordered)]])
        held = np.diff(ends)
        book = np.where(held > 0, np.diff(total[ends]) / np.maximum(held, 1), book)
    book = book.astype(np.float32).astype(np.float64)
    return np.searchsorted((book[1:] + book[:-1]) / 2, values).astype(np.uint8), book


def _smallest_three(quaternions: F64) -> U8:
    """Pack unit quaternions (w, x, y, z), [G, 4], into four bytes: the three smallest components, which was largest."""
    largest = np.abs(quaternions).argmax(axis=1)
    signs = np.where(np.take_along_axis(quaternions, largest[:, None], axis=1) < 0, -1.0, 1.0)
    others = np.array([[k for k in range(4) if k != one] for one in range(4)])[largest]
    three = signs * np.take_along_axis(quaternions, others, axis=1) * math.sqrt(2)
    packed = np.rint(255 * np.clip(0.5 * three + 0.5, 0, 1)).astype(np.uint8)
    return np.concatenate([packed, (_FIRST_INDEX + largest)[:, None].astype(np.uint8)], axis=1)


def _harmonics(found: F64, degree: int, width: int) -> tuple[dict[str, bytes], dict[str, Any]]:
    """Return the pictures of harmonics, [G, K, 3], and what `meta.json` says of them."""
    flat = found.reshape(len(found), -1)
    labels = np.arange(len(flat)) if len(flat) <= _PALETTE_MOST else _grouped(flat, _PALETTE_MOST)
    size = int(labels.max()) + 1
    held = np.bincount(labels, minlength=size)
    sets = np.stack([np.bincount(labels, flat[:, k], size) for k in range(flat.shape[1])], axis=1) / held[:, None]
    indices, book = _coded(sets)
    # Sixty-four sets in a row of the picture, their coefficients beside each other.
    centroids = _picture(indices.reshape(-1, 3), _PALETTE_ALONG * found.shape[1])
    pixels = np.stack([labels & 255, labels >> 8, np.zeros_like(labels)], axis=1).astype(np.uint8)
    names = ["shN_centroids.webp", "shN_labels.webp"]
    told = {"count": size, "bands": degree, "codebook": book.tolist(), "files": names}
    return dict(zip(names, (centroids, _picture(pixels, width)), strict=True)), told


def _grouped(points: F64, most: int) -> NDArray[np.int64]:
    """Return groups of like points, [P], at most so many: halves at the median of the most varied axis, in turn."""
    labels = np.zeros(len(points), np.int64)
    groups = 1
    while 2 * groups <= most:
        order = np.argsort(labels, kind="stable")
        for part in np.split(order, np.searchsorted(labels[order], np.arange(1, groups))):
            if len(part) < 2:
                continue
            own = points[part]
            axis = own.var(axis=0).argmax()
            half = part[np.argsort(own[:, axis], kind="stable")[len(part) // 2 :]]
            labels[half] += groups
        groups *= 2
    return np.unique(labels, return_inverse=True)[1].reshape(-1).astype(np.int64)
