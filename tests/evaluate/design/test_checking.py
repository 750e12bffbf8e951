import numpy as np
import pytest

from gs2ci.evaluate.design.checking import checked, expected_seconds, mean_db, pace
from gs2ci.evaluate.novel_views import NovelViews
from tests.exposed_rooms import camera, line, repeated, room, seen

SIZE = (36, 48)


def test_exposures_are_judged_by_the_wanted_views_of_their_scene():
    scene = room(0, SIZE)
    shots = repeated(scene, SIZE, 0, 1)
    poses = line(0.0, views=3)
    clock = iter((10.0, 12.5))
    found = checked(
        shots, NovelViews(seen(scene, poses, SIZE)[0], poses), camera(SIZE), "draft", 1, lambda: next(clock)
    )
    assert found.seconds == 2.5
    assert 15 < found.psnr_db < 50
    assert found.views_db > 20


def test_a_mean_of_decibels_is_one_of_square_errors():
    assert mean_db([30.0, 30.0]) == pytest.approx(30)
    assert mean_db([20.0, 60.0]) == pytest.approx(20 + 10 * np.log10(2), abs=0.01)


def test_time_is_expected_to_grow_with_views_pixels_and_less_than_exposures():
    rate = pace(10.0, 8, 1, 1000)
    assert expected_seconds(rate, 8, 1, 1000) == pytest.approx(10)
    assert expected_seconds(rate, 16, 1, 4000) == pytest.approx(80)
    assert 20 < expected_seconds(rate, 8, 4, 1000) < 30
