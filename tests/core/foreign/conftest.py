"""A simulated exposure as plain arrays, and a way to import arrays as if they had been a file."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage

from gs2ci.core.foreign.assemble import Imported, import_shots
from gs2ci.core.foreign.options import ImportOptions


@pytest.fixture
def scene():
    """Binary masks, smooth true views in bytes and their coded sum, in full scales of one view."""

    def make(n=4, height=24, width=32, *, channels=3, seed=0, ones=0.5):
        rng = np.random.default_rng(seed)
        masks = (rng.random((n, height, width)) < ones).astype(np.uint8)
        views = ndimage.gaussian_filter(rng.random((n, height, width, channels)), (1, 3, 3, 0))
        views = np.rint(255 * (views - views.min()) / np.ptp(views)).astype(np.uint8)
        meas = np.einsum("nhw,nhwc->hwc", masks, views / 255.0)
        return SimpleNamespace(masks=masks, views=views, meas=meas, n=n)

    return make


@pytest.fixture
def take(tmp_path):
    """Save arrays as .npz and import them."""

    def run(options: ImportOptions | None = None, **arrays: object) -> Imported:
        path: Path = tmp_path / "file.npz"
        np.savez(path, **arrays)
        return import_shots(path, None, options or ImportOptions())

    return run


@pytest.fixture
def said():
    """Tell whether a guess contains some words."""
    return lambda imported, words: any(words in guess for guess in imported.guesses)
