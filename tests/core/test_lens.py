"""The formula of a lens: OpenCV's, invertible as far as it says, and refused where it is no lens."""

import contextlib

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from gs2ci.core.errors import InputError
from gs2ci.core.lens import (
    COEFFICIENT_LIMIT,
    LEAST_STRETCH,
    check_distortion,
    distorted,
    pixels_of,
    slopes_of,
    stretch,
    undistorted,
)

CAMERA = np.array([[60.0, 0, 33], [0, 64, 22], [0, 0, 1]])
SIZE = (48, 64)
coefficient = st.floats(-0.2, 0.2)
lenses = st.tuples(coefficient, coefficient, st.floats(-0.02, 0.02), st.floats(-0.02, 0.02), coefficient).map(np.array)


def frame():
    rows, columns = np.mgrid[0 : SIZE[0] : 5, 0 : SIZE[1] : 5] + 0.5
    return slopes_of(np.stack([columns, rows], axis=-1), CAMERA)


@settings(max_examples=40, deadline=None)
@given(coefficients=lenses)
def test_rays_are_bent_as_opencv_bends_them(coefficients):
    rays = frame().reshape(-1, 2)
    points = np.concatenate([rays, np.ones((len(rays), 1))], axis=1) * 3.0
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), CAMERA, coefficients)
    ours = pixels_of(distorted(rays, coefficients), CAMERA)
    np.testing.assert_allclose(ours, theirs[:, 0], rtol=0, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(coefficients=lenses)
def test_the_way_back_leads_to_the_same_rays(coefficients):
    slopes = frame()
    try:
        check_distortion(coefficients, CAMERA, SIZE)
    except InputError:
        assume(False)
    rays = undistorted(slopes, coefficients)
    np.testing.assert_allclose(distorted(rays, coefficients), slopes, rtol=0, atol=1e-12)
    assert stretch(rays, coefficients).min() >= LEAST_STRETCH


def test_no_coefficients_bend_nothing():
    rays = frame()
    assert np.array_equal(distorted(rays, np.zeros(5)), rays)
    np.testing.assert_allclose(undistorted(rays, np.zeros(5)), rays, rtol=0, atol=1e-15)
    assert (stretch(rays, np.zeros(5)) == 1).all()


@settings(max_examples=20, deadline=None)
@given(coefficients=lenses)
def test_the_stretch_is_the_determinant_of_finite_differences(coefficients):
    rays, step = frame(), 1e-6
    assume(stretch(rays, coefficients).min() > 0)
    columns = [
        (distorted(rays + step * axis, coefficients) - distorted(rays - step * axis, coefficients)) / (2 * step)
        for axis in np.eye(2)
    ]
    np.testing.assert_allclose(
        stretch(rays, coefficients), np.linalg.det(np.stack(columns, axis=-1)), rtol=1e-6, atol=1e-8
    )


def test_a_picture_turned_inside_out_twice_does_not_count_as_stretched():
    """Where both directions are turned round the determinant is positive again."""
    assert stretch(np.array([1.0, 0.0]), np.array([-3.0, 0, 0, 0, 0])) < 0


@pytest.mark.parametrize("coefficients", [(-3.0, 0, 0, 0, 0), (0, 0, 1.0, 0, 0), (-2.0, 1.0, 0, 0, 0)])
def test_a_lens_that_folds_the_picture_over_is_refused(coefficients):
    with pytest.raises(InputError, match="folds the picture over"):
        check_distortion(np.array(coefficients), CAMERA, SIZE)


def test_a_fold_outside_the_frame_does_no_harm():
    """A barrel of -0.3 shows nothing beyond a slope of 0.70; the first frame ends at 0.65, the other at 1.9."""
    check_distortion(np.array([-0.3, 0, 0, 0, 0]), CAMERA, SIZE)
    with pytest.raises(InputError, match=r"folds .* k1 k2 p1 p2 k3"):
        check_distortion(np.array([-0.3, 0, 0, 0, 0]), CAMERA, (120, 160))


def test_beyond_a_fold_there_is_no_way_back():
    with pytest.raises(InputError, match=r"k1 = -0\.3"):
        undistorted(np.array([0.9, 0.0]), np.array([-0.3, 0, 0, 0, 0]))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 2 * COEFFICIENT_LIMIT])
@pytest.mark.parametrize("place", range(5))
def test_absurd_coefficients_are_refused(place, value):
    coefficients = np.zeros(5)
    coefficients[place] = value
    with pytest.raises(InputError, match="finite numbers within"):
        check_distortion(coefficients, CAMERA, SIZE)


@pytest.mark.parametrize("shape", [(), (4,), (8,), (1, 5)])
def test_another_number_of_coefficients_is_refused(shape):
    with pytest.raises(InputError, match=r"\[5\]: k1 k2 p1 p2 k3"):
        check_distortion(np.zeros(shape), CAMERA, SIZE)


@pytest.mark.parametrize("focal", [1e-3, 1e9])
@pytest.mark.parametrize("value", [-COEFFICIENT_LIMIT, COEFFICIENT_LIMIT, 1e-300])
def test_extreme_cameras_and_coefficients_end_in_an_answer(focal, value):
    camera = np.array([[focal, 0, 1e6], [0, focal, -1e6], [0, 0, 1]])
    for place in range(5):
        coefficients = np.zeros(5)
        coefficients[place] = value
        with contextlib.suppress(InputError):
            check_distortion(coefficients, camera, SIZE)
