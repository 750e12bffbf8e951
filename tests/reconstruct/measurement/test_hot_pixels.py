from dataclasses import replace

import numpy as np

from gs2ci.core.findings import Code, finding
from gs2ci.reconstruct.measurement.faulty import close_hot_pixels

HOT = ((3, 4), (10, 11), (10, 12), (31, 39))


def with_readings(shot, places, reading=9.0):
    measurement = shot.measurement.copy()
    for place in places:
        measurement[place] = reading
    return replace(shot, measurement=measurement)


def test_a_sound_measurement_is_left_alone(smooth_shot):
    closed, notes = close_hot_pixels(smooth_shot)
    assert closed is smooth_shot
    assert notes == ()


def test_hot_pixels_are_closed_and_counted(smooth_shot):
    closed, notes = close_hot_pixels(with_readings(smooth_shot, HOT))
    hot = np.zeros(smooth_shot.size, bool)
    hot[tuple(zip(*HOT, strict=True))] = True
    np.testing.assert_array_equal(closed.masks, smooth_shot.masks * ~hot)
    assert (closed.measurement[hot] == 0).all()
    np.testing.assert_array_equal(closed.measurement[~hot], smooth_shot.measurement[~hot])
    assert notes == (finding(Code.HOT_PIXELS, pixels="4 pixels read", count=4),)


def test_one_hot_colour_makes_a_hot_pixel(smooth_shot):
    measurement = smooth_shot.measurement.copy()
    measurement[3, 4, 0] = 9.0
    closed, (note,) = close_hot_pixels(replace(smooth_shot, measurement=measurement))
    assert not closed.masks[:, 3, 4].any()
    assert note.sentence.startswith("1 pixel reads more")


def test_where_no_mask_opens_light_is_hot(smooth_shot):
    masks = smooth_shot.masks.copy()
    masks[:, 7, 8] = 0
    closed, _ = close_hot_pixels(with_readings(replace(smooth_shot, masks=masks), [(7, 8)], 0.2))
    assert closed.measurement[7, 8].max() == 0


def test_a_region_beyond_white_is_not_hot_but_of_another_unit(smooth_shot):
    region = [(row, column) for row in range(8, 14) for column in range(8, 14)]
    closed, _ = close_hot_pixels(with_readings(smooth_shot, region))
    inside = closed.measurement[9:13, 9:13]
    assert (inside == 9.0).all()


def test_clipped_readings_are_not_hot(smooth_shot):
    shot = with_readings(smooth_shot, HOT)
    saturated = np.zeros(shot.size, bool)
    saturated[tuple(zip(*HOT, strict=True))] = True
    assert close_hot_pixels(replace(shot, saturated=saturated))[1] == ()


def test_where_one_pixel_in_eight_is_beyond_white_none_is_closed(smooth_shot):
    sparse = [(row, column) for row in range(0, 32, 2) for column in range(0, 40, 4)]
    shot = with_readings(smooth_shot, sparse)
    assert close_hot_pixels(shot) == (shot, ())
