"""Several measurements of the same views, as equations that can be solved one after the other.

K measurements of N views are K equations at each pixel, y = Φ x. A projection onto all of them solves a system of K by
K. Turned by the eigenvectors of Φ Φᵀ, Uᵀ y = (Uᵀ Φ) x, the equations stand at right angles to each other: projecting
onto one after the other is then projecting onto all at once. The turn keeps lengths, so that white noise of the
readings stays white, and equations that say nearly the same become one that counts K times and others that hardly do.

Here: the turn. Not here: the projection (`kernels`), the decode (`pnp`).
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot

# Rows of pixels that are turned at once, so that memory holds a strip of them.
_STRIP: Final = 32


def check_same_views(shots: Sequence[Shot]) -> None:
    """Check that measurements may be of the same views.

    Raises:
        InputError: There are none, or they differ in the number of views, in size or in colours.
    """
    if not shots:
        raise InputError("no measurement to decode", allowed="one or more of the same views")
    first, *others = ((shot.views, shot.size, shot.channels, shot.cfa) for shot in shots)
    if any(other != first for other in others):
        raise InputError(
            "measurements that differ in their number of views, in size or in colours, decoded as of the same views",
            allowed="repeats of one path with one camera",
        )


def turned(shots: Sequence[Shot]) -> tuple[F32, F32]:
    """Return masks and readings of measurements of the same views, as equations at right angles to each other.

    Saturated readings, and those behind closed masks, become zero equations.

    Args:
        shots: K of them.

    Returns:
        Masks of either sign, [K, N, H, W], and readings, [K, C, H, W]; at each pixel ordered by how much they count.
    """
    check_same_views(shots)
    masks = np.stack([shot.masks * shot.weights[:, None, None] for shot in shots])
    read = np.stack([shot.measurement.transpose(2, 0, 1) for shot in shots])
    for k, shot in enumerate(shots):
        if shot.saturated is not None:
            masks[k][:, shot.saturated] = 0
        read[k][:, ~masks[k].any(axis=0)] = 0
    for top in range(0, masks.shape[2], _STRIP):
        strip = (slice(None), slice(None), slice(top, top + _STRIP))
        products = np.einsum("knhw,lnhw->hwkl", masks[strip], masks[strip], dtype=np.float64)
        turn = np.linalg.eigh(products)[1][..., ::-1]
        for part in (masks, read):
            part[strip] = np.einsum("hwkl,kchw->lchw", turn, part[strip], optimize=True)
    return np.ascontiguousarray(masks, np.float32), np.ascontiguousarray(read, np.float32)
