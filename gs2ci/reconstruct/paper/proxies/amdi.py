"""AMDI, adaptive mask-decoding initialisation: every view from a small least-squares problem around each pixel.

Here: the windows, their choice and the regularised solution (supplement, eqs. 5 to 8). Not here: when AMDI is the right
choice (`gs2ci.reconstruct.paper.proxies.routing`).

Cost: with E = N(N + 1)/2 + NC box sums a window size costs O(E) for each pixel that no smaller window sufficed for,
whatever its width, plus one Cholesky factorisation, O(N³), and one eigendecomposition for the few that pass it.
"""

from dataclasses import dataclass
from functools import partial
from typing import Final

import cv2
import numpy as np
import torch

from gs2ci.core.arrays import F32, F64, I32, I64, Bool, Size
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.paper.proxies.planes import CodedPlane, coded_planes
from gs2ci.reconstruct.threads import in_threads

# The paper's set, section I of its supplement.
WINDOW_SIZES: Final = (3, 5, 7, 9, 11, 13, 15, 17, 21, 25, 31, 41, 57, 81)
# Beyond the paper's set, sizes grow like its last ones, by about half an octave.
_GROWTH: Final = 2**0.5
LAMBDA_MIN: Final = 1.0
KAPPA_FACTOR: Final = 2.0
RIDGE: Final = 1e-3
# Tolerance for rounding of eigenvalues and box sums: windows of binary masks often meet a bound exactly.
_ROUNDING: Final = 1e-9
# Rows are processed in bands whose box sums are about this large: larger ones do not fit the cache.
_BAND_BYTES: Final = 12 * 2**20


@dataclass(frozen=True)
class MaskDecoding:
    """The result of AMDI.

    Args:
        views: [N, H, W, C] float32, full scale 1, not clamped.
        windows: Width of the window used for each pixel, [H, W, P] int32, in pixels; P is 1, or 3 for the three
            colours of a mosaic.
    """

    views: F32
    windows: I32


def mask_decoded_views(shot: Shot) -> MaskDecoding:
    """Solve for the views around each pixel, as if they were constant there.

    Around pixel p the measurement is y(q) ≈ u(p)ᵀ m(q), m(q) = (w₁M₁(q), …, w_N M_N(q)). The normal matrix
    G = Σ m mᵀ is summed over the smallest window that has N independent patterns, λ_min ≥ 1 and a condition number
    of at most twice the whole image's; then u = (G + 1e-3 tr(G)/N · 1)⁻¹ Σ m y.

    Args:
        shot: A checked shot: RGB, mono or mosaic; binary or grey masks. Each colour of a mosaic is decoded from its
            own pixels with windows of its own; saturated pixels do not count.

    Raises:
        InputError: The masks of the whole image do not distinguish the views (two are equal, one is closed, or all
            are nearly the same), so that no window can.

    Windows end at the border of the image. Sums are float64 integral images: compared with λ_min ≥ 1 their rounding, at
    most 1e-16 of the sum over a band, is negligible; for binary masks G is exact.
    """
    views = np.empty((shot.views, *shot.size, shot.channels), np.float32)
    windows = np.empty((*shot.size, 3 if shot.cfa else 1), np.int32)
    for p, plane in enumerate(coded_planes(shot)):
        decode_band = partial(
            _decode_band, plane, kappa_limit=KAPPA_FACTOR * _whole_image_condition(plane.transmissions)
        )
        bands = _bands(plane)
        for rows, (band_views, band_windows) in zip(bands, in_threads(decode_band, bands), strict=True):
            views[:, rows, :, plane.channels] = band_views
            windows[rows, :, p] = band_windows
    return MaskDecoding(views, windows)


def window_sizes(size: Size) -> tuple[int, ...]:
    """List the window widths for an image, in pixels: the paper's, then growing until one covers it from any pixel."""
    whole = 2 * max(size) - 1
    sizes = list(WINDOW_SIZES)
    while sizes[-1] < whole:
        sizes.append(2 * int(sizes[-1] * _GROWTH / 2) + 1)
    return (*(s for s in sizes if s < whole), max(whole, WINDOW_SIZES[0]))


def admissible(grams: F64, kappa_limit: float) -> Bool:
    """Tell which normal matrices have full numerical rank, λ_min ≥ 1 and a condition number within the limit.

    Args:
        grams: [P, N, N], symmetric, positive semidefinite.
        kappa_limit: Largest condition number allowed.

    Returns:
        [P] bool.
    """
    n = grams.shape[-1]
    # A Cholesky factorisation costs a sixth of the eigenvalues. 1ᵀG1/N is a lower bound of λ_max, so a matrix from
    # which max(1, λ_max / limit) cannot be subtracted on the diagonal surely fails; the others are tested exactly.
    floor = np.maximum(LAMBDA_MIN, grams.sum(axis=(1, 2)) / (n * kappa_limit)) * (1 - 1e-6)
    shifted = torch.from_numpy(grams - floor[:, None, None] * np.eye(n))
    passes: Bool = torch.linalg.cholesky_ex(shifted).info.numpy() == 0
    eigenvalues = np.linalg.eigvalsh(grams[passes])
    smallest, largest = eigenvalues[:, 0], eigenvalues[:, -1]
    passes[passes] = (
        (smallest > largest * n * np.finfo(np.float64).eps)
        & (smallest >= LAMBDA_MIN * (1 - _ROUNDING))
        & (largest <= kappa_limit * smallest * (1 + _ROUNDING))
    )
    return passes


def solve_ridged(grams: F64, right: F64) -> F64:
    """Solve (G + 1e-3 tr(G)/N · 1) u = b for each pixel; [P, N, N] and [P, N, C] to [P, N, C]."""
    n = grams.shape[-1]
    ridge = RIDGE * np.trace(grams, axis1=1, axis2=2) / n
    return np.linalg.solve(grams + ridge[:, None, None] * np.eye(n), right)


def _whole_image_condition(transmissions: F64) -> float:
    """Measure κ₂ of the whole image's normal matrix, which must itself be admissible."""
    flat = transmissions.reshape(len(transmissions), -1)
    gram = flat @ flat.T
    if not admissible(gram[None], np.inf)[0]:
        smallest, *_, largest = np.linalg.eigvalsh(gram) if len(gram) > 1 else (gram[0, 0], gram[0, 0])
        raise InputError(
            f"these {len(gram)} masks do not distinguish their views: the eigenvalues of their Gram matrix reach from "
            f"{smallest:.3g} to {largest:.3g}",
            allowed="linearly independent masks, with a smallest eigenvalue of at least 1",
            remedy="use masks that differ, or energy-normalised proxies (eni)",
        )
    return float(np.linalg.cond(gram))


def _bands(plane: CodedPlane) -> list[slice]:
    n, height, width = plane.transmissions.shape
    sums = n * (n + 1) // 2 + n * plane.measured.shape[2]
    rows = max(1, _BAND_BYTES // (8 * sums * width))
    return [slice(r, min(r + rows, height)) for r in range(0, height, rows)]


def _decode_band(plane: CodedPlane, rows: slice, kappa_limit: float) -> tuple[F64, I64]:
    """Decode some rows; return their views, [N, R, W, C'], and window widths, [R, W]."""
    n, height, width = plane.transmissions.shape
    shape = (rows.stop - rows.start, width)
    views = np.empty((*shape, n, plane.measured.shape[2]))
    windows = np.zeros(shape, np.int64)
    pending = np.argwhere(windows == 0)
    for size in window_sizes((height, width)):
        if min(size, height) * min(size, width) < n:
            continue  # fewer samples than unknowns
        grams, right = _box_sums(plane, rows.start, pending, size // 2)
        ready = admissible(grams, kappa_limit)
        at = tuple(pending[ready].T)
        views[at] = solve_ridged(grams[ready], right[ready])
        windows[at] = size
        pending = pending[~ready]
        if not len(pending):
            break
    assert not len(pending), "the last window is the whole image, which is admissible"
    return views.transpose(2, 0, 1, 3), windows


def _box_sums(plane: CodedPlane, first_row: int, pixels: I64, radius: int) -> tuple[F64, F64]:
    """Sum m mᵀ and m yᵀ over the clipped window around each pixel, [P, N, N] and [P, N, C'].

    Args:
        plane: The whole image.
        first_row: The row from which the pixels' rows are counted.
        pixels: Row and column of each, [P, 2].
        radius: Of the windows: they are 2 radius + 1 wide.
    """
    n, height, width = plane.transmissions.shape
    row, column = pixels[:, 0] + first_row, pixels[:, 1]
    top, bottom = np.maximum(row - radius, 0), np.minimum(row + radius + 1, height)
    left, right = np.maximum(column - radius, 0), np.minimum(column + radius + 1, width)
    low, high = int(top.min()), int(bottom.max())
    stride = width + 1  # of an integral image, which begins with a row and a column of zeros
    corners = [(y - low) * stride + x for y, x in ((bottom, right), (top, left), (top, right), (bottom, left))]
    masks, measured = plane.transmissions[:, low:high], plane.measured[low:high].transpose(2, 0, 1)
    grams, moments = np.empty((len(pixels), n, n)), np.empty((len(pixels), n, len(measured)))
    for i in range(n):
        images = np.concatenate([masks[: i + 1], measured]) * masks[i]
        integrals = np.stack([cv2.integral(image, sdepth=cv2.CV_64F) for image in images]).reshape(len(images), -1)
        plus, plus_too, minus, minus_too = (integrals[:, index] for index in corners)
        sums = (plus + plus_too - minus - minus_too).T
        grams[:, i, : i + 1] = grams[:, : i + 1, i] = sums[:, : i + 1]
        moments[:, i] = sums[:, i + 1 :]
    return grams, moments
