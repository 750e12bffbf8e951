"""A pseudo-view, and the views of four cameras."""

import numpy as np
import pytest

from gs2ci.reconstruct.paper.priors2d.base import Question, SeenViews


@pytest.fixture
def question():
    rng = np.random.default_rng(0)

    def seen(count):
        images = rng.random((count, 20, 32, 3), np.float32)
        return SeenViews(images, np.ones(images.shape[:3], np.float32), np.tile(np.eye(4), (count, 1, 1)))

    return Question(seen(1), seen(4), np.diag([30.0, 30.0, 1.0]))
