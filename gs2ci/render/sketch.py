"""A scene at a glance: the Gaussians' centres as discs in their colours, the nearest last.

Here: `sketch`, which needs neither a camera nor a rasteriser. Not here: rendering (`backend`), the definitions.
"""

from typing import Final

import cv2
import numpy as np

from gs2ci.core.arrays import F64, U8

SIZE_PX: Final = (300, 400)
# Less opaque Gaussians show no surface; more discs than this look the same.
LEAST_OPACITY: Final = 0.1
MOST_DISCS: Final = 60_000
# Share of the centres left out at either end of each axis: single distant Gaussians would reduce the rest to a dot.
_LEFT_OUT: Final = 0.02
# Radius of a disc in standard deviations of its Gaussian, and its bound: the largest belong to the far background.
_SHOWN_SIGMAS: Final = 0.8
MOST_RADIUS_PX: Final = 12
BACKGROUND: Final = 24
_MARGIN: Final = 1.15


def sketch(centres: F64, colours: F64, opacities: F64, sizes: F64) -> U8 | None:
    """Draw a scene's centres, [H, W, 3]; None if none is opaque enough to be seen.

    The camera looks along +z, as our reference cameras do, from in front of the scene's middle.

    Args:
        centres: [G, 3].
        colours: Clipped to [0, 1], [G, 3].
        opacities: [G].
        sizes: Of each Gaussian, its standard deviation across, [G].
    """
    seen = (opacities >= LEAST_OPACITY) & np.isfinite(centres).all(axis=1)
    if not seen.any():
        return None
    chosen = np.flatnonzero(seen)
    chosen = chosen[np.linspace(0, len(chosen) - 1, min(len(chosen), MOST_DISCS)).astype(int)]
    centres, colours, sizes = centres[chosen], colours[chosen], sizes[chosen]
    low, high = np.quantile(centres, (_LEFT_OUT, 1 - _LEFT_OUT), axis=0)
    middle, extent = (low + high) / 2, np.maximum(high - low, 1e-9)
    height, width = SIZE_PX
    # In front of the nearest centre that is shown, far enough to keep near and far in proportion.
    stand = low[2] - max(extent[0] * height / width, extent[1], 0.5 * extent[2])
    depth = centres[:, 2] - stand
    before = depth > 1e-6 * (middle[2] - stand)
    centres, colours, sizes, depth = centres[before], colours[before], sizes[before], depth[before]
    focal = min(width / extent[0], height / extent[1]) * (low[2] - stand) / _MARGIN
    across = width / 2 + focal * (centres[:, 0] - middle[0]) / depth
    down = height / 2 + focal * (centres[:, 1] - middle[1]) / depth
    radius = np.clip(np.round(_SHOWN_SIGMAS * focal * sizes / depth), 1, MOST_RADIUS_PX).astype(int)
    shades = np.round(255 * np.clip(np.nan_to_num(colours), 0, 1)).astype(int)
    picture = np.full((height, width, 3), BACKGROUND, np.uint8)
    near = 2 * MOST_RADIUS_PX
    inside = (np.abs(across - width / 2) < width / 2 + near) & (np.abs(down - height / 2) < height / 2 + near)
    for k in np.argsort(-depth, kind="stable"):
        if inside[k]:
            place, shade = (int(across[k]), int(down[k])), tuple(shades[k].tolist())
            cv2.circle(picture, place, int(radius[k]), shade, -1, cv2.LINE_AA)
    return picture
