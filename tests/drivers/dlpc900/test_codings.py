"""ERLE: every image comes back through the firmware."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gs2ci.core.arrays import U32
from gs2ci_drivers.dlpc900 import erle
from tests.drivers.dlpc900.firmware import reads


def comes_back(image: U32) -> None:
    height, width = image.shape
    stream = erle.encode(image)
    assert len(stream) % 4 == 0
    np.testing.assert_array_equal(reads(stream, width, height), image)


def test_hard_images_come_back_through_the_firmware(image: U32) -> None:
    comes_back(image)


def test_any_small_image_comes_back_through_the_firmware(adversarial: st.SearchStrategy[U32]) -> None:
    given(adversarial)(comes_back)()
