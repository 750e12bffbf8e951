"""A small shot of smooth views, for tests of what the whole way does with odd measurements."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci.core.records import Shot, Truth


@pytest.fixture(scope="session")
def smooth_shot():
    """Four views of 32 × 40 pixels behind masks that open four elements in ten."""
    rng = np.random.default_rng(0)
    picture = gaussian_filter(rng.random((32, 40, 3)), (3, 3, 0))
    picture = 0.2 + 0.6 * (picture - picture.min()) / np.ptp(picture)
    views = np.stack([np.roll(picture, step, axis=1) for step in range(4)]).astype(np.float32)
    masks = (rng.random((4, 32, 40)) < 0.4).astype(np.float32)
    measurement = (masks[..., None] * views).sum(axis=0)
    return Shot(measurement=measurement, masks=masks, weights=np.ones(4, np.float32), truth=Truth(views)).check()
