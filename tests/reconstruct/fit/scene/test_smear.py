"""Views that were exposed on the move are told from sharp ones by the detail along that motion."""

import numpy as np
import pytest
from scipy.ndimage import rotate, uniform_filter1d
from skimage.data import astronaut, chelsea, coffee, rocket

from gs2ci.core.findings import Code
from gs2ci.reconstruct.fit.scene.smear import detail_along, smeared_views
from tests.stability.benches import Bench

LENGTH_PX = 5.5


def views_of(picture):
    return np.repeat(picture[None, ::3, ::3, :3].astype(np.float32) / 255, 3, axis=0)


def motion(angle_deg, length_px=LENGTH_PX, views=3):
    angle = np.deg2rad(angle_deg)
    return np.tile(length_px * np.array([np.cos(angle), np.sin(angle)]), (views, 1))


def smeared(views, angle_deg, length_px):
    """The mean along a motion, by scipy: turn it level, average along the rows, turn back."""
    turned = rotate(views, angle_deg, axes=(1, 2), reshape=False, order=3, mode="reflect")
    averaged = uniform_filter1d(turned, length_px, axis=2, mode="reflect")
    return rotate(averaged, -angle_deg, axes=(1, 2), reshape=False, order=3, mode="reflect")


@pytest.mark.parametrize("angle_deg", [0, 90, 35, -60])
@pytest.mark.parametrize("picture", [astronaut(), coffee(), chelsea()], ids=["astronaut", "coffee", "chelsea"])
def test_sharp_views_are_not_said_to_be_smeared_and_smeared_ones_are(picture, angle_deg):
    views = views_of(picture)
    assert detail_along(views, motion(angle_deg)) > 0.65
    assert smeared_views(views, motion(angle_deg)) == ()
    (note,) = smeared_views(smeared(views, angle_deg, 6), motion(angle_deg, 6))
    assert note.code == Code.VIEWS_SMEARED
    assert note.figures["motion_px"] == pytest.approx(6)
    assert note.figures["share"] < 0.3


@pytest.mark.parametrize("angle_deg", [0, 90])
@pytest.mark.parametrize("name", ["planes", "thicket", "ball", "boxes", "corridor", "motorcycle"])
def test_scenes_of_the_simulator_are_sharp(name, angle_deg):
    sharp = Bench(name, views=2).expose((72, 96)).truth.views
    assert smeared_views(sharp, motion(angle_deg, views=2)) == ()


def test_a_tower_is_upright_and_not_smeared():
    """As much of a direction as sharp pictures have: an upright thing, moving upright."""
    assert smeared_views(views_of(rocket()), motion(90)) == ()


def test_little_motion_and_no_detail_say_nothing():
    views = views_of(astronaut())
    assert detail_along(views, motion(0, 2.5)) is None
    assert detail_along(np.full_like(views, 0.4), motion(0)) is None
    assert detail_along(views[:, :3, :3], motion(0)) is None
    assert smeared_views(views, motion(0, 0.0)) == ()
