"""Small scenes that many tests look at."""

import numpy as np
import pytest

from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.scenes.rgbd import motorcycle


@pytest.fixture(scope="session")
def small_scene() -> Scene:
    return planes(np.random.default_rng(5), (48, 64))


@pytest.fixture(scope="session")
def motorcycle_scene() -> Scene:
    return motorcycle()
