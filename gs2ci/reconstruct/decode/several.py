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
# Of more measurements than views, an equation whose square is a smaller share of the largest is rounding.
_NOTHING: Final = 1e-10


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
        Masks of either sign, [K, N, H, W], and readings, [K, C, H, W]; at each pixel ordered by how much they count. No
        more than N of them, however many measurements there are.
    """
    check_same_views(shots)
    parts = [_turned_strip(shots, slice(top, top + _STRIP)) for top in range(0, shots[0].size[0], _STRIP)]
    masks, read = (np.concatenate(of_strips, axis=2) for of_strips in zip(*parts, strict=True))
    return masks, read


def _turned_strip(shots: Sequence[Shot], rows: slice) -> tuple[F32, F32]:
    """Return masks and readings of some rows of pixels."""
    masks, read = zip(*(_equation(shot, rows) for shot in shots), strict=True)
    if len(shots) <= shots[0].views:
        every, readings = np.stack(masks), np.stack(read)
        turn = np.linalg.eigh(np.einsum("knhw,lnhw->hwkl", every, every, dtype=np.float64))[1][..., ::-1]
        turned_masks, turned_read = (np.einsum("hwkl,kchw->lchw", turn, part) for part in (every, readings))
    else:
        # More equations than views say no more than as many as views: Φᵀ Φ and Φᵀ y hold all of it.
        pairs = list(zip(masks, read, strict=True))
        products = sum(np.einsum("nhw,mhw->hwnm", one, one, dtype=np.float64) for one in masks)
        answers = sum(np.einsum("nhw,chw->hwnc", one, values, dtype=np.float64) for one, values in pairs)
        squares, turn = (part[..., ::-1] for part in np.linalg.eigh(products))
        known = squares > _NOTHING * squares[..., :1]
        lengths = np.sqrt(np.where(known, squares, 0.0))
        turned_masks = np.einsum("hwnl,hwl->lnhw", turn, lengths)
        inverse = np.where(known, 1 / np.where(known, lengths, 1.0), 0.0)
        turned_read = np.einsum("hwnl,hwnc,hwl->lchw", turn, answers, inverse)
    return np.ascontiguousarray(turned_masks, np.float32), np.ascontiguousarray(turned_read, np.float32)


def _equation(shot: Shot, rows: slice) -> tuple[F32, F32]:
    """Return a measurement's masks, [N, h, W], and readings, [C, h, W]; zeros where it says nothing."""
    masks = shot.masks[:, rows] * shot.weights[:, None, None]
    read = shot.measurement[rows].transpose(2, 0, 1).copy()
    if shot.saturated is not None:
        masks[:, shot.saturated[rows]] = 0
    read[:, ~masks.any(axis=0)] = 0
    return masks, read
