"""Images that are hard on a run-length coder, shared by the coding tests."""

import numpy as np
import pytest
from hypothesis import strategies as st

from gs2ci.core.arrays import U32


def _images() -> dict[str, U32]:
    rng = np.random.default_rng(1)

    def random(*shape: int) -> U32:
        return rng.integers(0, 1 << 24, shape, dtype=np.uint32)

    y, x = np.mgrid[:40, :300].astype(np.uint32)
    edge = np.zeros((3, 130), np.uint32)
    edge[:, 127:] = 0xFFFFFF
    pairs = np.repeat(random(20, 50), 2, axis=1)
    nearly = np.tile(random(1, 260), (12, 1))
    nearly[:, ::7] = random(12, 38)
    return {
        "one pixel": random(1, 1),
        "one row": random(1, 513),
        "one column": random(77, 1),
        "random": random(64, 200),
        "uniform": np.full((50, 1920), 0x010203, np.uint32),
        "dark": np.zeros((20, 256), np.uint32),
        "checker": (x + y) % 2 * np.uint32(0xFFFFFF),
        "columns": x % 2,
        "rows": y % 2,
        "runs of two": pairs,
        "runs around 127 to 129": edge,
        "nearly the row above": nearly,
        "looks like marks": np.full((9, 33), 0x000100, np.uint32),
        "superpixels": np.kron(random(30, 60), np.ones((4, 4), np.uint32)),
        "one bit": rng.integers(0, 2, (60, 300), dtype=np.uint32),
    }


IMAGES = _images()


@pytest.fixture(params=sorted(IMAGES))
def image(request: pytest.FixtureRequest) -> U32:
    """A hard image."""
    return IMAGES[request.param]


@pytest.fixture
def adversarial() -> st.SearchStrategy[U32]:
    """A strategy of small images from few words, so that every kind of run meets every other."""
    words = st.sampled_from([0, 1, 0x000100, 0x010000, 0xFFFFFF, 0x00FF00])

    def of(shape: tuple[int, int]) -> st.SearchStrategy[U32]:
        height, width = shape
        rows = st.lists(words, min_size=height * width, max_size=height * width)
        return rows.map(lambda row: np.array(row, np.uint32).reshape(height, width))

    return st.tuples(st.integers(1, 5), st.integers(1, 12)).flatmap(of)
