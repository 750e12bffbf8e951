"""Masks moved and blurred by scipy, with nothing of the solver's own: what a bench did to them."""

import numpy as np
from scipy.ndimage import affine_transform, gaussian_filter, map_coordinates, maximum_filter, minimum_filter


def warped(masks, *, down_px=0.0, right_px=0.0, turn_deg=0.0, scale=1.0, mode="nearest"):
    """Move masks about their middle, by scipy: elements and pixels of one pitch overlap bilinearly."""
    turn = np.deg2rad(turn_deg)
    back = np.linalg.inv(scale * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]))
    middle = (np.array(masks.shape[1:]) - 1) / 2
    offset = middle - back @ (middle + np.array([down_px, right_px]))
    return np.stack([affine_transform(mask.astype(float), back, offset, order=1, mode=mode) for mask in masks])


def blurred(masks, sigma_px):
    return gaussian_filter(masks.astype(float), (0, sigma_px, sigma_px))


def regrown(masks, px, fine=20):
    """Let open elements reach so far beyond their edges, or end short of them, on a grid of so many points a pixel."""
    reach = round(abs(px) * fine)
    grow = maximum_filter if px > 0 else minimum_filter
    size = masks.shape[1:]
    return np.stack(
        [
            grow(mask.repeat(fine, 0).repeat(fine, 1), 2 * reach + 1, mode="nearest")
            .reshape(size[0], fine, size[1], fine)
            .mean(axis=(1, 3), dtype=float)
            for mask in np.asarray(masks, np.uint8)
        ]
    )


def bent(masks, *, radial_px=0.0, keystone_px=0.0):
    """Bend masks as a lens does: what lies at x from the middle is seen at x (1 + k |x|² + g · x), by scipy.

    Args:
        masks: [N, H, W].
        radial_px: How far the corners go outwards by k.
        keystone_px: How far the corners on the right go outwards by g, and those on the left inwards.

    Returns:
        The bent masks, and the displacement of what is seen at each pixel, [2, H, W].
    """
    size = np.array(masks.shape[1:])
    middle = ((size - 1) / 2)[:, None, None]
    seen = np.mgrid[: size[0], : size[1]] - middle
    far = np.hypot(*middle.ravel())
    source = seen.copy()
    for _ in range(30):
        moved = source * (radial_px * (source**2).sum(axis=0) / far**3 + keystone_px * source[1] / (middle[1] * far))
        source = seen - moved
    warped = [map_coordinates(mask.astype(float), source + middle, order=1, mode="nearest") for mask in masks]
    return np.stack(warped), seen - source
