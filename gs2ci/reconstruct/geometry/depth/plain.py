"""Plain areas beside things in front of them, moved to the depth of the surface that they belong to.

Beside a silhouette a plain wall has no texture that determines its depth, and a sweep of windows, or a fit that started
from one, gives it the depth of the thing in front: a skirt of tens of pixels, whose outer end is not at an edge of the
picture. Here each plain pixel gets votes on its depth from pixels of similar colour far around it, whose surfaces are
extended as planes. If the median of the votes is another surface, and the views agree there nearly as well, the pixel
is moved to it.

Here: slopes, votes, and the comparison of the views. Not here: the sweep (`sweep`).
"""

from typing import Final

import cv2
import numpy as np

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.kernels import EXACT, b1_2, f32, f32_2, f32_3, helper, i64, in_parts, kernel
from gs2ci.reconstruct.geometry.depth.sweep import LEAST_SIDE_OF_MAP, difference, features_of

# How far from a pixel others vote, as a share of the picture's longer side, and how many at most in each direction.
_REACH_SHARE: Final = 0.25
_VOTERS: Final = 5
# The standard deviation of similar colours, in full scales.
_SIGMA: Final = 0.03
# A depth that differs by more than this share of the map's range belongs to another surface.
_JUMP_SHARE: Final = 0.1
# The views may differ by so much more at the new depth, in medians of their difference.
_ALLOWED: Final = 3.0
_ROUNDS: Final = 2
# Votes are computed in a picture reduced to at most so many pixels, to bound the time.
_MOST_PIXELS: Final = 32_768
_ALL: Final = 0.999
# Colours of a plain area vary by less than this, full scales, in windows of this side.
_PLAIN_SIGMA: Final = 0.02
_PLAIN_WINDOW_PX: Final = 5
# Slopes are fitted to the pixels within this distance, and within this share of the range, of like colour.
_SLOPE_REACH_PX: Final = 8
_SLOPE_EVERY_PX: Final = 4
_SLOPE_GATE: Final = 0.03
_SLOPE_SIGMA: Final = 0.1
# Added to the spread of a fit's pixels, squared px: with few pixels the slope is then near zero.
_SLOPE_DAMPING: Final = 2.0
_LEVELS: Final = 256
_LEAST_LIKENESS: Final = 1e-4


def continued(inverse_depth: F32, views: F32, from_view: F64, intrinsics: F64, blur_px: float, window_px: int) -> F32:
    """Return a map with its skirts moved to the surface of similarly coloured pixels around, [H, W].

    Args:
        inverse_depth: Of the first of the views, [H, W].
        views: In full scales, [N, H, W, C]; N >= 2.
        from_view: The views' poses relative to the first, [N, 4, 4].
        intrinsics: [3, 3], px.
        blur_px: Of the views, before they are compared.
        window_px: Side of the window over which they are compared.
    """
    low, high = float(inverse_depth.min()), float(inverse_depth.max())
    if not low < high or min(inverse_depth.shape) < LEAST_SIDE_OF_MAP:
        return inverse_depth
    described = features_of(views, blur_px)

    def differ(wanted: F32) -> F32:
        return difference(wanted, described, from_view, intrinsics, window_px)

    found, plain = np.ascontiguousarray(inverse_depth, np.float32), plain_pixels(views[0])
    jump = _JUMP_SHARE * (high - low)
    before = differ(found)
    allowed = _ALLOWED * float(np.median(before))
    for _ in range(_ROUNDS):
        votes = _votes_of_planes(found, views[0], plain, (low, high))
        # Compared at full size: in the reduced picture a pixel shares its vote with a few neighbours.
        moved = plain & (np.abs(votes - found) > jump)
        if not moved.any():
            break
        after = differ(votes)
        moved &= after < before + allowed
        found, before = np.where(moved, votes, found), np.where(moved, after, before)
    return found


def _votes_of_planes(inverse_depth: F32, view: F32, plain: Bool, span: tuple[float, float]) -> F32:
    """Return the votes, [H, W], computed in a reduced picture; pixels without votes keep their depth."""
    height, width = plain.shape
    shrink = min(1.0, (_MOST_PIXELS / (height * width)) ** 0.5)
    small = (max(1, round(width * shrink)), max(1, round(height * shrink)))
    nearest, area = {"interpolation": cv2.INTER_NEAREST}, {"interpolation": cv2.INTER_AREA}
    depths = cv2.resize(inverse_depth, small, **nearest)
    # A pixel of the small picture is plain if all pixels that it covers are.
    whole = cv2.resize(plain.astype(np.float32), small, **area) > _ALL
    colours = np.ascontiguousarray(cv2.resize(view, small, **area).reshape(*whole.shape, -1), np.float32)
    reach, jump = max(1, round(_REACH_SHARE * max(whole.shape))), _JUMP_SHARE * (span[1] - span[0])
    asked = whole & _jumps_near(depths, whole, reach, jump)
    if not asked.any():
        return inverse_depth
    slopes = plane_slopes(depths, colours, whole, np.float32(_SLOPE_GATE * (span[1] - span[0])))
    votes = plane_votes(depths, slopes, colours, (whole, asked), reach, span)
    said: F32 = np.where(
        cv2.resize(asked.astype(np.uint8), (width, height), **nearest) > 0,
        cv2.resize(votes, (width, height), **nearest),
        inverse_depth,
    )
    return said


def _jumps_near(inverse_depth: F32, plain: Bool, reach: int, jump: float) -> Bool:
    """Mark pixels with a jump of depth between plain pixels within reach, [H, W]: elsewhere votes change nothing."""
    window = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    # Not infinity, whose difference from itself is undefined.
    nobody = np.finfo(np.float32).max / 4
    nearest = cv2.dilate(np.where(plain, inverse_depth, -nobody).astype(np.float32), window)
    farthest = cv2.erode(np.where(plain, inverse_depth, nobody).astype(np.float32), window)
    near: Bool = nearest - farthest > jump
    return near


def plain_pixels(view: F32) -> Bool:
    """Mark the pixels around which a view, [H, W, C] in full scales, hardly varies, [H, W]."""
    window = (_PLAIN_WINDOW_PX, _PLAIN_WINDOW_PX)
    planes = np.ascontiguousarray(view.transpose(2, 0, 1), np.float64)
    variances = [cv2.blur(one * one, window) - cv2.blur(one, window) ** 2 for one in planes]
    plain: Bool = np.mean(variances, axis=0) < _PLAIN_SIGMA**2
    return plain


@helper(fastmath=EXACT)
def _likeness(view, r, c, i, j, sigma):
    """Return the similarity of the colours of two pixels of a view, [H, W, C]: 1 if equal, towards 0 if different."""
    total = np.float32(0)
    for k in range(view.shape[2]):
        apart = view[i, j, k] - view[r, c, k]
        total += apart * apart
    # Close to a normal distribution's shape up to two sigma, beyond with longer tails, and without an exponential.
    share = np.float32(1) + total / (np.float32(8) * sigma * sigma)
    share *= share
    return np.float32(1) / (share * share)


def plane_slopes(inverse_depth: F32, view: F32, plain: Bool, gate: np.float32) -> F32:
    """Fit a plane around each plain pixel to the pixels of its surface, [2, H, W]: change per px right, and down.

    Args:
        inverse_depth: [H, W] float32.
        view: [H, W, C] float32.
        plain: Pixels to fit around, [H, W]; the result is 0 elsewhere.
        gate: Pixels whose inverse depth differs by more lie on another surface.
    """
    found = np.zeros((2, *inverse_depth.shape), np.float32)
    in_parts(_slopes, len(inverse_depth), inverse_depth, view, plain, gate, found)
    return found


@kernel(i64, i64, f32_2, f32_3, b1_2, f32, f32_3, fastmath=EXACT)
def _slopes(from_task, to_task, inverse_depth, view, plain, gate, found):
    """Weight by similarity of colour, and solve the two normal equations."""
    height, width = inverse_depth.shape
    sigma = np.float32(_SLOPE_SIGMA)
    for r in range(from_task, to_task):
        for c in range(width):
            if not plain[r, c]:
                continue
            n = x1 = y1 = d1 = xx = yy = xy = xd = yd = 0.0
            # The grid of samples always includes the pixel itself.
            top = r - min(_SLOPE_REACH_PX, r) // _SLOPE_EVERY_PX * _SLOPE_EVERY_PX
            left = c - min(_SLOPE_REACH_PX, c) // _SLOPE_EVERY_PX * _SLOPE_EVERY_PX
            for i in range(top, min(r + _SLOPE_REACH_PX + 1, height), _SLOPE_EVERY_PX):
                for j in range(left, min(c + _SLOPE_REACH_PX + 1, width), _SLOPE_EVERY_PX):
                    d = inverse_depth[i, j] - inverse_depth[r, c]
                    if abs(d) > gate:
                        continue
                    w = _likeness(view, r, c, i, j, sigma)
                    x, y = float(j - c), float(i - r)
                    n += w
                    x1 += w * x
                    y1 += w * y
                    d1 += w * d
                    xx += w * x * x
                    yy += w * y * y
                    xy += w * x * y
                    xd += w * x * d
                    yd += w * y * d
            a, b, m = xx - x1 * x1 / n + _SLOPE_DAMPING, yy - y1 * y1 / n + _SLOPE_DAMPING, xy - x1 * y1 / n
            p, q = xd - x1 * d1 / n, yd - y1 * d1 / n
            det = a * b - m * m
            found[0, r, c], found[1, r, c] = (b * p - m * q) / det, (a * q - m * p) / det


def plane_votes(
    inverse_depth: F32, slopes: F32, view: F32, where: tuple[Bool, Bool], reach: int, span: tuple[float, float]
) -> F32:
    """Return the median vote of plain pixels of similar colour, extended as planes, on each pixel's depth, [H, W].

    Args:
        inverse_depth: [H, W] float32.
        slopes: Of each pixel's plane, [2, H, W] float32.
        view: [H, W, C] float32.
        where: Pixels that may vote, and pixels that are voted on, [H, W] each; others keep their depth.
        reach: Largest distance of voters, px.
        span: Farthest and nearest inverse depth, to which votes are limited.
    """
    low, step = np.float32(span[0]), np.float32((span[1] - span[0]) / (_LEVELS - 1))
    found, every = inverse_depth.copy(), max(1, reach // _VOTERS)
    in_parts(_votes, len(found), inverse_depth, slopes, view, *where, reach, every, low, step, found)
    return np.clip(found, *span)


@kernel(i64, i64, f32_2, f32_3, f32_3, b1_2, b1_2, i64, i64, f32, f32, f32_2, fastmath=EXACT)
def _votes(from_task, to_task, inverse_depth, slopes, view, voting, asked, reach, every, low, step, found):
    """Find the weighted median by a histogram, and return the mean of the votes in its cell."""
    height, width = inverse_depth.shape
    sigma, least = np.float32(_SIGMA), np.float32(_LEAST_LIKENESS)
    for r in range(from_task, to_task):
        weights, sums = np.empty(_LEVELS, np.float32), np.empty(_LEVELS, np.float32)
        top, bottom = r - min(reach, r) // every * every, min(r + reach + 1, height)
        for c in range(width):
            if not asked[r, c]:
                continue
            weights[:] = np.float32(0)
            sums[:] = np.float32(0)
            total = np.float32(0)
            left, right = c - min(reach, c) // every * every, min(c + reach + 1, width)
            for i in range(top, bottom, every):
                for j in range(left, right, every):
                    if not voting[i, j]:
                        continue
                    w = _likeness(view, r, c, i, j, sigma)
                    if w < least:
                        continue
                    said = inverse_depth[i, j]
                    said += slopes[0, i, j] * np.float32(c - j) + slopes[1, i, j] * np.float32(r - i)
                    level = min(max(int((said - low) / step + np.float32(0.5)), 0), _LEVELS - 1)
                    weights[level] += w
                    sums[level] += w * said
                    total += w
            reached, median = weights[0], 0
            while reached < np.float32(0.5) * total and median < _LEVELS - 1:
                median += 1
                reached += weights[median]
            if weights[median] > 0:
                found[r, c] = sums[median] / weights[median]
