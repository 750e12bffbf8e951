import numpy as np
import pytest

from gs2ci.core.records import Shot


@pytest.fixture
def make_shot():
    """Code constant or given views under given masks."""

    def make(masks, views=None, *, channels=1, **parts):
        masks = np.asarray(masks, np.float32)
        if views is None:
            levels = np.linspace(0.2, 0.9, len(masks) * channels).reshape(len(masks), 1, 1, channels)
            views = np.broadcast_to(levels, (*masks.shape, channels))
        weights = np.asarray(parts.pop("weights", np.ones(len(masks))), np.float32)
        coded = ((weights[:, None, None] * masks)[..., None] * views).sum(axis=0).astype(np.float32)
        return Shot(parts.pop("measurement", coded), masks, weights, **parts).check()

    return make


@pytest.fixture
def random_masks():
    def make(n, size, share=0.5, seed=0, *, grey=False):
        rng = np.random.default_rng(seed)
        return rng.random((n, *size)) if grey else (rng.random((n, *size)) < share).astype(float)

    return make
