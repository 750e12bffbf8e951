"""Pictures that are drawn, pan or bend, and what masks measure of them; for tests of rest and of displacements."""

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from gs2ci.core.records import Shot

SIZE, VIEWS = (112, 144), 10
# From -0.5 to 0.5 over the exposure.
EVENLY = np.linspace(-0.5, 0.5, VIEWS)
TO_AND_FRO = -0.5 * np.cos(2 * np.pi * (np.arange(VIEWS) + 0.5) / VIEWS)


def picture(seed=0):
    draw = np.random.default_rng(seed)
    layers = [gaussian_filter(draw.standard_normal((SIZE[0] + 40, SIZE[1] + 40)), size) * size for size in (1.2, 3, 8)]
    return (0.5 + 0.14 * sum(layers) / np.std(sum(layers))).clip(0, 1).astype(np.float32)


def seen(shifts, zoom=None):
    """The picture from displaced places: shifts (x, y) px for each view, and a bend that grows from the middle."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float32)
    from_middle = (columns - SIZE[1] / 2) / SIZE[1] * 2
    bends = np.zeros(VIEWS) if zoom is None else zoom
    views = [
        cv2.remap(picture(), columns + 20 + x + bend * from_middle**2, rows + 20 + y, cv2.INTER_CUBIC)
        for (x, y), bend in zip(shifts.astype(np.float32), bends.astype(np.float32), strict=True)
    ]
    return np.stack(views)[..., None]


AT_REST = seen(np.zeros((VIEWS, 2)))


def masks_of(kind):
    draw = np.random.default_rng(2)
    if kind == "random":
        return (draw.random((VIEWS, *SIZE)) < 0.5).astype(np.float32)
    pattern = gaussian_filter((draw.random((SIZE[0] + VIEWS, SIZE[1])) < 0.5).astype(np.float32), 0.5)
    return np.stack([pattern[VIEWS - k : VIEWS - k + SIZE[0]] for k in range(VIEWS)])


def mosaic(light, masks):
    """A shot of one colour at each pixel, in the order RGGB, of light in three colours."""
    bayer = np.empty((*SIZE, 1), np.float32)
    for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        bayer[row::2, column::2, 0] = light[row::2, column::2, channel]
    return Shot(bayer, masks, np.ones(VIEWS, np.float32), cfa="RGGB").check()


def exposed(views, masks, noise=0.005):
    light = np.einsum("nhw,nhwc->hwc", masks, views)
    light += noise * len(masks) / 2 * np.random.default_rng(3).standard_normal(light.shape)
    return Shot(light.astype(np.float32), masks, np.ones(len(masks), np.float32)).check()
