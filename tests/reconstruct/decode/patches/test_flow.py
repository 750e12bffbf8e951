import cv2
import numpy as np
import pytest
from skimage import data

from gs2ci.reconstruct.decode.patches.flow import Flow


def sliding(views, step=(1, 3)):
    photograph = (data.camera() / 255).astype(np.float32)
    return np.stack([photograph[100 + step[0] * i :, 100 + step[1] * i :][:80, :96] for i in range(views)])


def test_a_sliding_photograph_slides():
    flow = Flow.between(sliding(4))
    assert np.median(flow.forward, axis=(0, 1, 2)) == pytest.approx((-3, -1), abs=0.1)
    assert np.median(flow.backward, axis=(0, 1, 2)) == pytest.approx((3, 1), abs=0.1)


def test_places_are_followed_both_ways():
    places = np.array([[40.0, 48.0], [30.0, 50.0]])
    followed = Flow.between(sliding(5)).follow(places, 2, 1, 4)
    expected = places[:, None] - np.array([[-1], [0], [1], [2]]) * np.array([1, 3])
    np.testing.assert_allclose(followed, expected, atol=0.5)
    np.testing.assert_array_equal(followed[:, 1], places)


@pytest.mark.parametrize("shape", [(1, 40, 40), (3, 5, 60), (2, 1, 1)])
def test_what_is_too_small_to_tell_stands_still(shape):
    flow = Flow.between(np.random.default_rng(0).random(shape).astype(np.float32))
    assert flow.forward.shape == flow.backward.shape == (shape[0] - 1, *shape[1:], 2)
    assert not flow.forward.any()


@pytest.mark.parametrize("scale", [0.0, 1e-6, 1e4, -1.0])
def test_any_brightness_gives_finite_motion(scale):
    views = sliding(2) * np.float32(scale)
    assert np.isfinite(Flow.between(views).forward).all()


def test_motion_is_the_same_for_any_number_of_opencv_threads():
    before, found = cv2.getNumThreads(), []
    try:
        for threads in (1, 4):
            cv2.setNumThreads(threads)
            found.append(Flow.between(sliding(3)).forward)
            assert cv2.getNumThreads() == threads
    finally:
        cv2.setNumThreads(before)
    np.testing.assert_array_equal(*found)
