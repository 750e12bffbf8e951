"""Gaussian scenes as SPZ files, a quarter of a PLY's size, for viewers in browsers and on phones.

Here: `write_spz`, and `fitting_scale`, by which a scene has to be multiplied so that the format can hold it. The format
is Niantic's, versions 2 and 3 (github.com/nianticlabs/spz, `load-spz.cc`, MIT): gzip over a header of 16 bytes, then
for all Gaussians together positions in 24-bit fixed point, opacities, colours and scales in 8 bits, rotations, and the
coefficients of harmonics in 8 bits. Version 2 has x, y, z of each rotation in 8 bits, version 3 its three smallest
components in 10 bits. Axes are right, up, back. Not here: motion, which the format cannot store; reading.

The accuracy of these bits: scales within 3.2 %, colours within 0.4 % of full scale in their range of -0.4 to 1.4,
opacities within 0.2 %, rotations within a fifth of a degree (version 2: within half a degree),
coefficients of harmonics within 0.004 in their range of -1 to 1.
"""

import gzip
import math
import struct
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64, U8
from gs2ci.core.errors import InputError
from gs2ci.core.whole_file import write_whole
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.half_turn import half_turned
from gs2ci.render.harmonics import SH_DC, degree_of

SpzVersion = Literal[2, 3]
MAGIC: Final = 0x5053474E
# Readers refuse a file whose positions have no fractional bits.
LEAST_FRACTION_BITS: Final = 1
MOST_FRACTION_BITS: Final = 20
# Positions have 24 bits, one of them the sign.
_WHOLE_BITS: Final = 23
_COLOUR_SCALE: Final = 0.15
_SCALE_STEPS: Final = 16.0
LOG_SIZE_LEAST: Final = -10.0
LOG_SIZE_MOST: Final = LOG_SIZE_LEAST + 255 / _SCALE_STEPS
"""Natural logs of the sizes that the format holds."""
# A disc's thickness may be written as the least size, where that stays below this share of its width.
_THIN: Final = 1 / 8
# Positions are to be exact to this share of the widths of all but the smallest Gaussians, of which this share may be
# coarser.
_STEP_OF_WIDTH, _MAY_BE_COARSE = 1 / 2, 0.02
_WHOLE_LOG: Final = (_WHOLE_BITS - LEAST_FRACTION_BITS) * math.log(2)
# Readers that keep logits make infinities of 0 and 255.
_OPACITIES: Final = (1, 254)
_PART_TOP: Final = 511
_HARMONIC_MIDDLE: Final = 128


def write_spz(path: str | Path, gaussians: Gaussians, *, version: SpzVersion = 3, scale: float = 1.0) -> Path:
    """Write a scene as SPZ; the file appears whole or not at all.

    Args:
        path: Of the file; an existing file is replaced.
        gaussians: The scene.
        version: Of the format: 2 opens in older readers as well.
        scale: Factor of all lengths in the file; `fitting_scale` says which one is needed.

    Returns:
        The path written.

    Raises:
        InputError: There is none, which the format's own reader refuses; the Gaussians do not fit together, hold NaN,
            lie too far away for 24 bits, or have sizes that the format cannot hold; or there is no such version.
        StorageError: The file cannot be written.
    """
    if version not in get_args(SpzVersion):
        raise InputError(f"version {version} of SPZ", allowed=" or ".join(map(str, get_args(SpzVersion))))
    checked = gaussians.check().detach()
    if not len(checked):
        raise InputError("a scene without Gaussians", allowed="1 or more in an SPZ file", remedy="export it as ply")
    scene = half_turned(_scaled(checked, scale))
    if version == 2:
        scene = _axes_renamed(scene)
    _check_sizes(scene.log_scales.numpy())
    means = scene.means.numpy()
    bits = _fraction_bits(float(np.abs(means).max(initial=0.0)))
    fixed = np.round(means * 2**bits).astype("<i4")
    positions = fixed.reshape(-1, 1).view("u1").reshape(-1, 4)[:, :3]
    parts = (
        positions,
        np.clip(_bytes(255 * torch.sigmoid(scene.opacity_logits).numpy()), *_OPACITIES),
        _bytes(255 * (_COLOUR_SCALE * (scene.colours.numpy() - 0.5) / SH_DC + 0.5)),
        _bytes(_SCALE_STEPS * (scene.log_scales.numpy() - LOG_SIZE_LEAST)),
        (_first_three if version == 2 else _smallest_three)(scene.quaternions.numpy()),
        _harmonics(scene),
    )
    header = struct.pack("<IIIBBBB", MAGIC, version, len(scene), degree_of(scene), bits, 0, 0)
    body = header + b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
    # Without a time stamp, so that the same scene always gives the same file.
    return write_whole(path, gzip.compress(body, mtime=0))


def fitting_scale(gaussians: Gaussians) -> float:
    """Return the factor by which a scene has to be multiplied so that SPZ holds its sizes and positions: 1 if it does.

    Otherwise the largest power of ten by which nothing becomes too large: small sizes, and the steps of positions, are
    what is lost first.

    Raises:
        InputError: No factor will do, because the largest and the smallest things differ by too much.
    """
    scene = gaussians.check().detach().map(torch.Tensor.double)
    if not len(scene):
        return 1.0
    sizes, farthest = scene.log_scales.numpy(), float(scene.means.abs().max())
    if _holds(sizes, farthest, 1.0):
        return 1.0
    room = min(LOG_SIZE_MOST - float(sizes.max()), _WHOLE_LOG - math.log(max(farthest, 1e-300)))
    scale = 10.0 ** math.floor(room / math.log(10))
    if _holds(sizes, farthest, scale):
        return scale
    raise InputError(
        f"sizes from {math.exp(sizes.min()):.3g} to {math.exp(sizes.max()):.3g} units, up to {farthest:.3g} units away",
        allowed="in an SPZ file sizes of e^-10 to e^5.94 and positions of 24 bits, under one scale for all",
        remedy="export it as ply, sog or glb",
    )


def _holds(log_sizes: F64, farthest: float, scale: float) -> bool:
    """Tell whether the format holds sizes and positions that are multiplied by a factor."""
    if scale * farthest >= 2.0 ** (_WHOLE_BITS - LEAST_FRACTION_BITS):
        return False
    sizes = log_sizes + math.log(scale)
    widths = np.exp(np.sort(sizes, axis=1)[:, 1])
    coarse = float(np.mean(2.0 ** -_fraction_bits(scale * farthest) > _STEP_OF_WIDTH * widths))
    return bool(coarse <= _MAY_BE_COARSE and not _outside(sizes).any())


def _outside(log_sizes: F64) -> NDArray[np.bool_]:
    """Return which Gaussians the format cannot hold: too large, or too small for more than a disc's thickness, [G]."""
    width = np.sort(log_sizes, axis=1)[:, 1]
    lost = (log_sizes.min(axis=1) < LOG_SIZE_LEAST) & (width < LOG_SIZE_LEAST - math.log(_THIN))
    # Half a step: what is rounded to the last of the format's sizes is held.
    over: NDArray[np.bool_] = log_sizes.max(axis=1) > LOG_SIZE_MOST + 0.5 / _SCALE_STEPS
    return over | lost


def _check_sizes(log_sizes: F64) -> None:
    """Raise an InputError if a size would be clipped."""
    if not (outside := _outside(log_sizes)).any():
        return
    sizes = np.exp(log_sizes)
    raise InputError(
        f"{int(outside.sum())} of {len(sizes)} Gaussians have sizes that SPZ cannot hold: "
        f"{sizes.min():.3g} to {sizes.max():.3g} units",
        allowed=f"e^{LOG_SIZE_LEAST:g} to e^{LOG_SIZE_MOST:.4g} units: {math.exp(LOG_SIZE_LEAST):.2g} to "
        f"{math.exp(LOG_SIZE_MOST):.3g}",
        remedy="give the scale that fitting_scale returns, or write ply, sog or glb",
    )


def _scaled(scene: Gaussians, scale: float) -> Gaussians:
    if scale == 1:
        return scene
    own = scene.map(torch.Tensor.double)
    return replace(own, means=scale * own.means, log_scales=own.log_scales + math.log(scale))


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
    """Return the coefficients one after the other, red, green and blue for each, [G, K * 3].

    Raises:
        InputError: A coefficient lies outside the format's range.
    """
    if scene.harmonics is None:
        return np.zeros((len(scene), 0), np.uint8)
    found = scene.harmonics.numpy()
    most = float(np.abs(found).max(initial=0.0))
    if most > 1 + 0.5 / _HARMONIC_MIDDLE:
        raise InputError(
            f"a coefficient of a harmonic of {most:.3g}",
            allowed="-1 to 1 in an SPZ file",
            remedy="export it as ply, sog or glb",
        )
    return _bytes(_HARMONIC_MIDDLE * found + _HARMONIC_MIDDLE).reshape(len(scene), -1)


def _bytes(values: F64) -> U8:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def _first_three(quaternions: F64) -> U8:
    """Pack unit quaternions (w, x, y, z), [G, 4], into three bytes: x, y and z, where w is not negative."""
    signed = np.where(quaternions[:, :1] < 0, -1.0, 1.0) * quaternions[:, 1:]
    return _bytes(127.5 * signed + 127.5)


def _axes_renamed(scene: Gaussians) -> Gaussians:
    """Return the same Gaussians, their own axes renamed so that 8 bits lose the least of their rotations.

    An ellipsoid has 24 descriptions: its axes and sizes in any order. Of each Gaussian the one is taken whose rotation
    comes back most exactly.
    """
    group = Rotation.create_group("O")
    own = scene.quaternions.numpy()
    best, least = own.copy(), np.full(len(own), np.inf)
    sizes = scene.log_scales.numpy().copy()
    for turn in group:
        # The described axes are those of `own` after the turn: R turn, and sizes in the order that the turn gives.
        described = (Rotation.from_quat(own, scalar_first=True) * turn).as_quat(scalar_first=True) if len(own) else own
        three = _first_three(described) / 127.5 - 1
        back = np.concatenate([np.sqrt(np.maximum(1 - np.square(three).sum(axis=1, keepdims=True), 0)), three], axis=1)
        back /= np.linalg.norm(back, axis=1, keepdims=True)
        off = 1 - np.abs((back * described).sum(axis=1))
        better = off < least
        order = np.abs(turn.as_matrix()).argmax(axis=0)
        best[better], least[better] = described[better], off[better]
        sizes[better] = scene.log_scales.numpy()[better][:, order]
    return replace(scene, quaternions=torch.from_numpy(best), log_scales=torch.from_numpy(sizes))


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
