"""What is left of a measurement when all but its middle is cut away."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.crop import middle, size_of
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot


def test_the_middle_keeps_its_camera_matrix_its_mosaic_and_its_clipped_pixels(random_shot):
    mosaic = replace(
        random_shot,
        measurement=random_shot.measurement[..., :1],
        cfa="RGGB",
        intrinsics=np.array([[30.0, 0, 10], [0, 30, 8], [0, 0, 1]]),
        saturated=random_shot.measurement[..., 0] > 1,
    )
    left = middle(mosaic, (10, 10))  # 3 rows and 5 columns would go at either end: an even number begins it
    assert np.array_equal(left.measurement, mosaic.measurement[2:12, 4:14])
    assert np.array_equal(left.saturated, mosaic.saturated[2:12, 4:14])
    assert left.intrinsics.tolist() == [[30, 0, 6], [0, 30, 6], [0, 0, 1]]
    assert mosaic.intrinsics[0, 2] == 10


@pytest.mark.parametrize("size", [(17, 20), (16, 21), (0, 20), (16, -1)])
def test_a_middle_that_is_not_there_is_refused(random_shot, size):
    with pytest.raises(InputError, match="the middle"):
        middle(random_shot, size)


def test_the_middle_of_so_many_pixels_has_about_as_many_and_the_phase_of_the_mosaic():
    rows, columns = np.mgrid[:90, :130]
    colour = (rows % 2 + columns % 2).astype(np.float32)[..., None]
    shot = Shot(colour, np.ones((2, 90, 130), np.float32), np.ones(2, np.float32), "RGGB")
    left = middle(shot, size_of(shot, 2000))
    assert 1700 < left.views * left.size[0] * left.size[1] < 2300
    assert left.measurement[0, 0, 0] == 0


def test_sides_of_the_middle_stay_as_long_as_they_must_and_are(random_shot):
    assert size_of(random_shot, 1, least_side=18) == (16, 18)
    assert size_of(random_shot, 10**9) == random_shot.size
