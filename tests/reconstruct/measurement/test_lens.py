"""A shot's lens: the canvas holds what the sensor sees, and pictures go there and back."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.lens import LARGEST_CANVAS, LEAST_SHIFT_PX, SMALLEST_CANVAS, Lens, straightened

SIZE = (48, 64)
CAMERA = np.array([[56.0, 0, 32], [0, 56, 24], [0, 0, 1]])
BARREL, PINCUSHION = np.array([-0.2, 0.02, 0, 0, 0]), np.array([0.2, 0, 1e-3, -2e-3, 0.01])


def shot_with(distortion, intrinsics=CAMERA, size=SIZE):
    masks = np.ones((2, *size), np.float32)
    return Shot(
        np.ones((*size, 1), np.float32), masks, np.ones(2, np.float32), intrinsics=intrinsics, distortion=distortion
    ).check()


@pytest.fixture(params=[BARREL, PINCUSHION], ids=["barrel", "pincushion"])
def lens(request):
    return Lens.of(shot_with(request.param))


def smooth(size, channels=3):
    noise = gaussian_filter(np.random.default_rng(0).random((2, *size, channels)), (0, 3, 3, 0))
    return ((noise - noise.min()) / np.ptp(noise)).astype(np.float32)


def test_a_pinhole_has_no_lens():
    assert Lens.of(shot_with(None)) is None
    assert Lens.of(shot_with(np.zeros(5))) is None
    assert Lens.of(replace(shot_with(BARREL), intrinsics=None)) is None
    views = smooth(SIZE)
    assert straightened(views, None) is views


def test_a_lens_that_shifts_nothing_noticeable_is_a_pinhole():
    """The corner lies at a slope of 0.71: k1 moves it by 0.71³ · 56 px · k1."""
    noticeable = LEAST_SHIFT_PX / (56 * np.hypot(32 / 56, 24 / 56) ** 3)
    assert Lens.of(shot_with(np.array([0.9 * noticeable, 0, 0, 0, 0]))) is None
    assert Lens.of(shot_with(np.array([1.5 * noticeable, 0, 0, 0, 0]))) is not None


def test_a_barrel_sees_more_than_its_frame_and_a_pincushion_less():
    assert Lens.of(shot_with(BARREL)).sampling.canvas > SIZE
    assert Lens.of(shot_with(PINCUSHION)).sampling.canvas < SIZE


def test_every_pixel_of_the_sensor_lies_on_the_canvas_with_neighbours_about_it(lens):
    height, width = lens.sampling.canvas
    places = lens.sampling.places
    assert places.shape == (*SIZE, 2)
    assert places.min() >= 1
    assert (places <= (width - 1, height - 1)).all()


def test_the_canvas_has_the_lens_s_focal_lengths_and_axis(lens):
    canvas = lens.canvas_intrinsics
    np.testing.assert_array_equal(canvas[:2, :2], CAMERA[:2, :2])
    # The axis is where nothing is bent: a sensor pixel about it looks at itself.
    here = lens.sampling.places[23, 31] + lens.sampling.origin
    np.testing.assert_allclose(here, (31.5, 23.5), atol=2e-3)
    np.testing.assert_array_equal(canvas[:2, 2] + lens.sampling.origin, CAMERA[:2, 2])


def test_where_the_sensor_sees_a_pixel_and_where_its_pixels_look_are_inverse(lens):
    """Read at the places where the sensor's pixels look, the map back names those pixels."""
    at = np.moveaxis(lens.sampling.places, -1, 0)[::-1] - 0.5
    back = np.stack([map_coordinates(lens.seen_at[..., k], at, order=3, mode="nearest") for k in (0, 1)], axis=-1)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    inner = np.s_[2:-2, 2:-2]
    np.testing.assert_allclose(back[inner], np.stack([columns, rows], -1)[inner], atol=0.01)


@pytest.mark.parametrize("channels", [1, 3])
def test_views_come_back_from_the_canvas(lens, channels):
    views = smooth(SIZE, channels)
    on_canvas = lens.straightened(views)
    assert on_canvas.shape == (2, *lens.sampling.canvas, channels)
    assert on_canvas.dtype == np.float32
    inner = np.s_[:, 2:-2, 2:-2]
    np.testing.assert_allclose(lens.bent(on_canvas)[inner], views[inner], atol=0.01)


def test_a_bent_line_is_straight_on_the_canvas():
    """A straight edge of the world, seen through the lens and put on the canvas, is straight to a tenth of a pixel."""
    lens = Lens.of(shot_with(BARREL))
    height, width = lens.sampling.canvas
    columns = np.arange(width) + 0.5
    edge = np.clip((columns - 12.0) / 6 + 0.5, 0, 1).astype(np.float32)
    bent = lens.bent(np.broadcast_to(edge[None, None, :, None], (1, height, width, 1)))
    crossings = {}
    for name, picture in (("sensor", bent[0, ..., 0]), ("canvas", lens.straightened(bent)[0, ..., 0])):
        rows = np.flatnonzero(np.arange(len(picture)) % 4 == 2)[1:-1]
        crossings[name] = np.array([np.interp(0.5, picture[row], np.arange(picture.shape[1])) for row in rows])
    assert np.ptp(crossings["sensor"]) > 0.5
    assert np.ptp(crossings["canvas"]) < 0.1


def test_what_the_sensor_does_not_see_is_told(lens):
    """A barrel's canvas has unseen rims between its corners; a pincushion's has hardly any."""
    height, width = lens.sampling.canvas
    seen = lens.seen
    assert seen[height // 2, width // 2]
    x, y = (lens.sampling.places[..., k].astype(int) for k in (0, 1))
    assert seen[y[2:-2, 2:-2], x[2:-2, 2:-2]].all()
    inside = (lens.seen_at >= 0).all(-1) & (lens.seen_at <= (SIZE[1], SIZE[0])).all(-1)
    assert not seen[~inside].any()
    assert 0 < (~seen).mean() < 0.3


def test_a_canvas_beyond_bounds_is_refused():
    wide = np.array([[30.19, 0, 32], [0, 30.19, 24], [0, 0, 1]])
    strong = np.array([-0.15681, 0.015566, 0, 0, -0.00056744])
    allowed = f"allowed: {SMALLEST_CANVAS:g} to {LARGEST_CANVAS:g} times the sensor"
    for distortion in (strong, np.array([5.0, 0, 0, 0, 0])):
        with pytest.raises(InputError, match=allowed):
            Lens.of(shot_with(distortion, wide))
