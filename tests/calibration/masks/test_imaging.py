import numpy as np
import pytest

from gs2ci_calibration.masks.imaging import PixelMap, blurred, convolved, sharp
from gs2ci_calibration.masks.imaging_kernels import SMOOTHED

SIZE = (9, 11)


def a_map(degree=1):
    bent = np.array([[20.0, 15.0], [11.0, 0.4], [-0.5, 11.3]])
    return PixelMap(SIZE, bent) if degree == 1 else PixelMap(SIZE, bent).raised(degree)


def mean_in_box(pattern, left, top, wide, high):
    """State readably what a pixel sees: the area-weighted mean of unit squares, beyond the rim 0."""
    total = 0.0
    for n in range(pattern.shape[0]):
        for m in range(pattern.shape[1]):
            across = max(0.0, min(left + wide, m + 1) - max(left, m))
            down = max(0.0, min(top + high, n + 1) - max(top, n))
            total += pattern[n, m] * across * down
    return total / (wide * high)


def test_a_pixel_sees_the_mean_of_its_box():
    pattern = np.random.default_rng(0).random((30, 40)).astype(np.float32)
    pixels = a_map()
    seen = sharp(pattern, pixels)[0]
    (u, v), (wide, high) = pixels.everywhere(), pixels.footprint
    expected = [
        [mean_in_box(pattern, u[i, j] - wide / 2, v[i, j] - high / 2, wide, high) for j in range(SIZE[1])]
        for i in range(SIZE[0])
    ]
    assert seen == pytest.approx(np.array(expected), abs=1e-6)


def test_nothing_passes_beyond_the_modulator():
    pixels = PixelMap(SIZE, np.array([[-50.0, 5.0], [5.0, 0.0], [0.0, 5.0]]))
    assert all(not image.any() for image in sharp(np.ones((10, 10), np.float32), pixels))


def test_derivatives_are_those_of_the_image_over_the_width_they_are_averaged_over():
    pattern = np.random.default_rng(1).random((30, 40)).astype(np.float32)
    pixels = a_map()
    slopes = sharp(pattern, pixels)[1:]
    for axis, (slope, side) in enumerate(zip(slopes, pixels.footprint, strict=True)):
        step = SMOOTHED * side
        ahead, behind = (
            sharp(pattern, PixelMap(SIZE, pixels.coefficients + sign * step * np.eye(3)[0][:, None] * np.eye(2)[axis]))
            for sign in (1, -1)
        )
        assert slope == pytest.approx((ahead[0] - behind[0]) / (2 * step), abs=1e-5)


def test_the_affine_maps_are_inverse_to_each_other():
    pixels = a_map()
    back, forth = pixels.sensor_from_modulator, pixels.modulator_from_sensor
    u, v = pixels.at(np.array([3.5]), np.array([7.5]))
    assert forth @ [3.5, 7.5, 1] == pytest.approx(np.array([u[0], v[0]]))
    assert back @ [u[0], v[0], 1] == pytest.approx(np.array([3.5, 7.5]))


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_a_raised_map_looks_at_the_same_places(degree):
    assert a_map(degree).degree == degree
    assert np.stack(a_map(degree).everywhere()) == pytest.approx(np.stack(a_map().everywhere()))


@pytest.mark.parametrize("way", list(np.ndindex(2, 2, 2)))
def test_a_turned_map_looks_where_the_turned_point_looked(way):
    transpose, flip_x, flip_y = (bool(one) for one in way)
    pixels = PixelMap((10, 10), np.random.default_rng(2).normal(size=(10, 2)))
    turned = pixels.turned(transpose=transpose, flip_x=flip_x, flip_y=flip_y)
    x, y = 2.0, 9.0
    a, b = (10 - x if flip_x else x), (10 - y if flip_y else y)
    a, b = (b, a) if transpose else (a, b)
    seen, expected = turned.at(np.array([a]), np.array([b])), pixels.at(np.array([x]), np.array([y]))
    assert np.stack(seen) == pytest.approx(np.stack(expected))


def test_blur_keeps_the_light_and_has_the_variance_it_says():
    point = np.zeros((41, 41))
    point[20, 20] = 1.0
    for variance in (0.0, 0.1, 2.0):
        image = blurred(point, variance)
        y = np.arange(41) - 20.0
        assert image.sum() == pytest.approx(1.0)
        assert float((image.sum(axis=1) * y**2).sum()) == pytest.approx(variance, abs=2e-5)


def test_a_convolution_moves_light_towards_its_tap():
    point, kernel = np.zeros((7, 7)), np.zeros((3, 3))
    point[3, 3], kernel[0, 1] = 1.0, 1.0
    assert convolved(point, kernel)[2, 3] == 1.0
