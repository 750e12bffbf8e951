"""Views as stacks of planes, and back."""

import numpy as np
import pytest

from gs2ci.reconstruct.decode.kernels import are_finite
from gs2ci.reconstruct.decode.planes import interleaved, planar, repeated


@pytest.mark.parametrize("channels", [1, 3])
def test_planes_are_the_transposed_views_and_return_to_them(channels):
    views = np.random.default_rng(0).random((2, 4, 5, channels), dtype=np.float32)
    planes = planar(views)
    np.testing.assert_array_equal(planes, views.transpose(0, 3, 1, 2))
    np.testing.assert_array_equal(interleaved(planes), views)
    assert planes.flags.c_contiguous
    assert planes.dtype == np.float32


def test_planes_share_no_memory_with_views_even_grey_ones():
    views = np.zeros((2, 3, 3, 1), np.float32)
    planar(views)[:] = 1
    interleaved(planar(views))[:] = 1  # of planes of their own
    assert not views.any()


def test_a_picture_in_every_view():
    picture = np.random.default_rng(0).random((3, 4, 5), dtype=np.float32)
    stack = repeated(picture, 6)
    assert stack.shape == (6, 3, 4, 5)
    assert (stack == picture).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_one_number_that_is_not_finite_marks_its_view(value):
    stack = np.full((3, 1, 4, 5), np.finfo(np.float32).max)
    assert are_finite(stack).all()
    stack[1, 0, 3, 4] = value
    assert are_finite(stack).tolist() == [True, False, True]
