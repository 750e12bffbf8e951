"""What both run-length codings keep: every image comes back through the firmware."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gs2ci.core.arrays import U32
from gs2ci_drivers.dlpc900 import erle, rle
from tests.drivers.dlpc900.firmware import reads

CODINGS = {"rle": (rle.encode, 1), "erle": (erle.encode, 2)}


@pytest.fixture(params=CODINGS)
def come_back(request: pytest.FixtureRequest) -> Callable[[U32], None]:
    """Encode an image, let the firmware read it, and compare."""
    encode, compression = CODINGS[request.param]

    def compare(image: U32) -> None:
        height, width = image.shape
        stream = encode(image)
        assert len(stream) % 4 == 0
        np.testing.assert_array_equal(reads(stream, width, height, compression), image)

    return compare


def test_hard_images_come_back_through_the_firmware(come_back: Callable[[U32], None], image: U32) -> None:
    come_back(image)


def test_any_small_image_comes_back_through_the_firmware(
    come_back: Callable[[U32], None], adversarial: st.SearchStrategy[U32]
) -> None:
    given(adversarial)(come_back)()
