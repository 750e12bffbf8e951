"""Gaussian scenes as SPZ files, a quarter of a PLY's size, which web viewers and phones open.

Here: `write_spz`. The format is Niantic's, version 3 (github.com/nianticlabs/spz, `load-spz.cc`, MIT): gzip over a
header of 16 bytes, then for all Gaussians together positions in 24-bit fixed point, opacities, colours and scales in
8 bits, the three smallest components of each rotation in 10 bits, and the coefficients of harmonics in 8 bits. Axes are
right, up, back. Not here: motion, which the format cannot store; reading.

The accuracy of these bits: scales within 3.2 %, colours within 0.4 % of full scale in their range of -0.4 to 1.4,
opacities within 0.2 %, rotations within a fifth of a degree, coefficients of harmonics within 0.004 in their range of
-1 to 1.
"""

import gzip
import math
import struct
from pathlib import Path
from typing import Final

import numpy as np
import torch

from gs2ci.core.arrays import F64, U8
from gs2ci.core.errors import InputError
from gs2ci.core.whole_file import write_whole
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.harmonics import SH_DC, degree_of, turned

MAGIC: Final = 0x5053474E
VERSION: Final = 3
# Readers refuse a file whose positions have no fractional bits.
LEAST_FRACTION_BITS: Final = 1
MOST_FRACTION_BITS: Final = 20
# Positions have 24 bits, one of them the sign.
_WHOLE_BITS: Final = 23
_COLOUR_SCALE: Final = 0.15
_SCALE_STEPS: Final = 16.0
_SCALE_LEAST: Final = -10.0
_PART_TOP: Final = 511
_HARMONIC_MIDDLE: Final = 128
_OUR_AXES: Final = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
"""Signs of our axes (right, down, ahead) in those of the format: half a turn about x."""


def write_spz(path: str | Path, gaussians: Gaussians) -> Path:
    """Write a scene as SPZ; the file appears whole or not at all.

    Args:
        path: Of the file; an existing file is replaced.
        gaussians: The scene.

    Returns:
        The path written.

    Raises:
        InputError: The Gaussians do not fit together, hold NaN, or lie too far away for 24 bits.
        StorageError: The file cannot be written.
    """
    scene = gaussians.check().detach()
    means = scene.means.double().numpy() * _OUR_AXES.diagonal().numpy()
    bits = _fraction_bits(float(np.abs(means).max(initial=0.0)))
    fixed = np.round(means * 2**bits).astype("<i4")
    positions = fixed.reshape(-1, 1).view("u1").reshape(-1, 4)[:, :3]
    own = torch.nn.functional.normalize(scene.quaternions.double(), dim=1)
    own = torch.where(own.norm(dim=1, keepdim=True) > 0, own, torch.tensor([1.0, 0, 0, 0], dtype=own.dtype))
    half_turn = (own * torch.tensor([1.0, 1, -1, -1], dtype=own.dtype)).numpy()
    harmonic = (scene.colours.double().numpy() - 0.5) / SH_DC
    parts = (
        positions,
        _bytes(255 * torch.sigmoid(scene.opacity_logits.double()).numpy()),
        _bytes(255 * (_COLOUR_SCALE * harmonic + 0.5)),
        _bytes(_SCALE_STEPS * (scene.log_scales.double().numpy() - _SCALE_LEAST)),
        _smallest_three(half_turn),
        _harmonics(scene),
    )
    header = struct.pack("<IIIBBBB", MAGIC, VERSION, len(scene), degree_of(scene), bits, 0, 0)
    body = header + b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
    # Without a time stamp, so that the same scene always gives the same file.
    return write_whole(path, gzip.compress(body, mtime=0))


def _fraction_bits(farthest: float) -> int:
    """Return how many of a position's bits can be fractional.

    Raises:
        InputError: Not even one, since a position is too far away.
    """
    whole = max(0, math.floor(math.log2(farthest)) + 1) if farthest >= 1 else 0
    bits = min(MOST_FRACTION_BITS, _WHOLE_BITS - whole)
    if round(farthest * 2.0**bits) >= 2**_WHOLE_BITS:
        bits -= 1
    if bits < LEAST_FRACTION_BITS:
        raise InputError(
            f"a Gaussian lies {farthest:.3g} units away",
            allowed=f"less than {2.0 ** (_WHOLE_BITS - LEAST_FRACTION_BITS):.3g} in an SPZ file",
        )
    return bits


def _harmonics(scene: Gaussians) -> U8:
    """Return the coefficients one after the other, red, green and blue for each, [G, K * 3]."""
    if scene.harmonics is None:
        return np.zeros((len(scene), 0), np.uint8)
    found = turned(scene.harmonics.double(), _OUR_AXES).numpy()
    return _bytes(_HARMONIC_MIDDLE * found + _HARMONIC_MIDDLE).reshape(len(scene), -1)


def _bytes(values: F64) -> U8:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def _smallest_three(quaternions: F64) -> U8:
    """Pack unit quaternions (w, x, y, z), [G, 4], into four bytes: index of the largest component, and the others.

    The others lie within ±√½; 9 bits hold each one's magnitude and one its sign, with the largest made positive.
    """
    parts = quaternions[:, [1, 2, 3, 0]]
    largest = np.abs(parts).argmax(axis=1)
    flipped = np.take_along_axis(parts, largest[:, None], axis=1) < 0
    packed = largest.astype(np.uint32)
    for k in range(4):
        size = np.round(_PART_TOP * np.minimum(np.abs(parts[:, k]) * math.sqrt(2), 1)).astype(np.uint32)
        sign = ((parts[:, k] < 0) ^ flipped[:, 0]).astype(np.uint32)
        packed = np.where(largest == k, packed, (packed << 10) | (sign << 9) | size)
    return np.frombuffer(packed.astype("<u4").tobytes(), np.uint8).reshape(-1, 4)
