"""Sets of masks that cancel, align or concentrate: what a bound for every set of masks has to withstand.

Each family returns [N, H, W] float32 in [0, 1]. Those named "aligned" know the scene: they open where its image is
steepest or brightest, which is the worst that masks can do to a bound that only knows rms values.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.linalg import hadamard
from scipy.ndimage import gaussian_gradient_magnitude

from gs2ci.core.arrays import F32, F64
from gs2ci_sims.masks import random_masks
from tests.sims.grey_masks import random_grey_masks

Family = Callable[[int, F64, np.random.Generator], F32]
"""From a number of masks and an image of the scene, [H, W], to masks."""


def _complementary(count: int, image: F64, rng: np.random.Generator) -> F32:
    half = random_masks(max(count // 2, 1), image.shape, 0.5, rng)
    return _cut(np.stack([half, 1 - half], axis=1).reshape(-1, *image.shape), count)


def _hadamard(count: int, image: F64, rng: np.random.Generator) -> F32:
    """Rows of a Hadamard matrix over blocks of 4 x 4 pixels, each followed by its negative: +H, -H, ..."""
    height, width = image.shape
    rows = hadamard(16)[1 + rng.permutation(15)[: max(count // 2, 1)]]
    tiles = np.tile(rows.reshape(-1, 4, 4), (1, -(-height // 4), -(-width // 4)))[:, :height, :width]
    return _cut(np.stack([0.5 + 0.5 * tiles, 0.5 - 0.5 * tiles], axis=1).reshape(-1, height, width), count)


def _one_hot(count: int, image: F64, rng: np.random.Generator) -> F32:
    """At each pixel exactly one mask is open."""
    return np.asarray(rng.integers(0, count, image.shape) == np.arange(count)[:, None, None], dtype=np.float32)


def _identical(count: int, image: F64, rng: np.random.Generator) -> F32:
    return np.repeat(random_masks(1, image.shape, 0.4, rng), count, axis=0)


def _shifts(count: int, image: F64, rng: np.random.Generator) -> F32:
    base = random_masks(1, image.shape, 0.4, rng)[0]
    return np.stack([np.roll(base, (n, 2 * n), axis=(0, 1)) for n in range(count)])


def _stripes(count: int, image: F64, rng: np.random.Generator) -> F32:
    """Every second column, then the others: the highest frequency that pixels can show."""
    columns = np.arange(image.shape[1]) % 2
    return np.stack([np.broadcast_to(columns == n % 2, image.shape) for n in range(count)]).astype(np.float32)


def _all_open(count: int, image: F64, rng: np.random.Generator) -> F32:
    return np.ones((count, *image.shape), dtype=np.float32)


def _single_pixel(count: int, image: F64, rng: np.random.Generator) -> F32:
    masks = np.zeros((count, *image.shape), dtype=np.float32)
    masks[:, rng.integers(image.shape[0]), rng.integers(image.shape[1])] = 1
    return masks


def _aligned_with_edges(count: int, image: F64, rng: np.random.Generator) -> F32:
    steep = gaussian_gradient_magnitude(image, 0.7)
    return np.repeat((steep >= np.quantile(steep, 0.9))[None], count, axis=0).astype(np.float32)


def _aligned_by_turns(count: int, image: F64, rng: np.random.Generator) -> F32:
    """Where the image is bright in the first half of the exposure, where it is dark in the second."""
    bright = (image >= np.median(image)).astype(np.float32)
    return np.stack([bright if n < count / 2 else 1 - bright for n in range(count)])


def _random(count: int, image: F64, rng: np.random.Generator) -> F32:
    return random_masks(count, image.shape, 0.35, rng)


def _grey(count: int, image: F64, rng: np.random.Generator) -> F32:
    return random_grey_masks(count, image.shape, 0.5, rng)


def _cut(masks: F64 | F32, count: int) -> F32:
    return np.asarray(np.resize(masks, (count, *masks.shape[1:])), dtype=np.float32)


FAMILIES: Final[dict[str, Family]] = {
    "complementary": _complementary,
    "hadamard": _hadamard,
    "one-hot": _one_hot,
    "identical": _identical,
    "cyclic shifts": _shifts,
    "stripes at Nyquist": _stripes,
    "all open": _all_open,
    "single pixel": _single_pixel,
    "aligned with edges": _aligned_with_edges,
    "aligned by turns": _aligned_by_turns,
    "random": _random,
    "grey": _grey,
}
