"""The mean picture of an exposure: less noise than a view, no smear, and few views where the path turns far."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.reconstruct.exposures.pictures import depths_of, pictures_of, sampled
from gs2ci.reconstruct.geometry.depth.view_depths import ViewDepth
from gs2ci.reconstruct.geometry.kinds import Verdict
from tests.reconstruct.exposures.rooms import VIEWS, exposure, middle


def rms(one, other):
    border = slice(8, -8)
    return float(np.sqrt(np.mean((one - other)[border, border] ** 2)))


def test_the_mean_of_warped_views_has_less_noise_than_the_middle_one_and_shows_the_same():
    clean, noisy = exposure("clean", middle()), exposure("noisy", middle(), noise=0.1)
    true = clean.views[VIEWS // 2]
    (picture,) = pictures_of(noisy.views, noisy.geometry)
    assert rms(picture.image, true) < 0.8 * rms(noisy.views[VIEWS // 2], true)
    assert rms(pictures_of(clean.views, clean.geometry)[0].image, true) < 0.05
    assert len(picture.places) == len(picture.descriptors) > 50
    np.testing.assert_array_equal(picture.centre, 0)


def test_points_are_lifted_by_the_depth_map():
    one = exposure("one", middle(), unit=2.0)
    (picture,) = pictures_of(one.views, one.geometry)
    np.testing.assert_allclose(picture.lifted(np.array([[5.0, 5.0]]))[0, 2], 2.0 / 2.0, rtol=1e-6)
    np.testing.assert_allclose(picture.lifted(np.array([[64.0, 48.0]])), [[0, 0, 1.1 / 2.0]], atol=1e-6)
    # Beside the picture the depth is that of its border.
    np.testing.assert_allclose(picture.lifted(np.array([[-3.0, 200.0]]))[0, 2], 1.0, rtol=1e-6)


@pytest.mark.parametrize(("verdict", "known"), [(Verdict.FULL, True), (Verdict.ROTATION_ONLY, False)])
def test_depths_of_exposures_without_a_path_of_their_own_are_hardly_known(verdict, known):
    one = exposure("one", middle())
    geometry = replace(one.geometry, verdict=verdict)
    assert (pictures_of(one.views, geometry)[0].depth_error < 0.2) == known


def test_where_the_path_turns_far_each_view_with_a_depth_has_a_picture_of_its_nearest_views():
    turned = np.stack([middle(turn_deg=(0, turn, 0)) for turn in (-18.0, -1.0, 0.0, 1.0, 18.0)])
    one = exposure("far", middle(), poses=turned)
    black = one.views.copy()
    black[[0, 4]] = 0
    depths = (ViewDepth(2, one.geometry.inverse_depth), ViewDepth(1, one.geometry.inverse_depth))
    geometry = replace(one.geometry, view_depths=depths)
    assert depths_of(geometry) == depths
    pictures = pictures_of(black, geometry)
    assert len(pictures) == 2
    # One of the far views is the fourth nearest; the other is not in the mean.
    assert np.median(pictures[0].image / np.maximum(one.views[2], 0.05)) > 0.7


def test_places_outside_an_image_are_told():
    image = np.arange(12, dtype=np.float32).reshape(3, 4, 1)
    found, inside = sampled(image, np.array([[[0.5, 0.5], [2.0, 1.5], [4.5, 1.0], [np.nan, 1.0]]]))
    assert inside.tolist() == [[True, True, False, False]]
    np.testing.assert_allclose(found[0, :2, 0], [0, 5.5])
