"""What is left of a measurement when all but its middle is cut away."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.crop import middle
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot, Truth


@pytest.fixture
def known():
    draws = np.random.default_rng(0)
    views = draws.random((6, 16, 20, 3), dtype=np.float32)
    masks = (draws.random((6, 16, 20)) < 0.5).astype(np.float32)
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, 0, 3] = np.arange(6)
    return Shot(
        measurement=np.einsum("nhw,nhwc->hwc", masks, views),
        masks=masks,
        weights=np.full(6, 0.5, np.float32),
        truth=Truth(views, poses),
    )


def test_the_middle_keeps_its_camera_matrix_its_mosaic_and_its_clipped_pixels(known):
    mosaic = replace(
        known,
        measurement=known.measurement[..., :1],
        cfa="RGGB",
        intrinsics=np.array([[30.0, 0, 10], [0, 30, 8], [0, 0, 1]]),
        saturated=known.measurement[..., 0] > 1,
    )
    left = middle(mosaic, (10, 10))  # 3 rows and 5 columns would go at either end: an even number begins it
    assert np.array_equal(left.measurement, mosaic.measurement[2:12, 4:14])
    assert np.array_equal(left.saturated, mosaic.saturated[2:12, 4:14])
    assert left.intrinsics.tolist() == [[30, 0, 6], [0, 30, 6], [0, 0, 1]]
    assert mosaic.intrinsics[0, 2] == 10


@pytest.mark.parametrize("size", [(17, 20), (16, 21), (0, 20), (16, -1)])
def test_a_middle_that_is_not_there_is_refused(known, size):
    with pytest.raises(InputError, match="the middle"):
        middle(known, size)
