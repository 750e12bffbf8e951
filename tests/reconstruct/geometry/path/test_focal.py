import numpy as np
import pytest

from gs2ci.reconstruct.geometry.path.focal import (
    FocalSettings,
    _spread,
    default_focal,
    estimate_focal,
    focal_from_view_angle,
)
from gs2ci.reconstruct.geometry.path.motion import MotionSettings

SIZE = (240, 320)


def estimate(scene, **settings):
    return estimate_focal(scene.tracks, SIZE, FocalSettings(**settings), MotionSettings())


def test_view_angle_and_focal_length_belong_together():
    assert focal_from_view_angle(90, 320) == pytest.approx(160)


@pytest.mark.parametrize("focal", [180.0, 300.0, 480.0])
def test_the_focal_length_is_found_where_motion_and_relief_show_it(tracked, path, focal):
    poses = path(6, np.random.default_rng(2), length=0.25, turn=0.05)
    found = estimate(tracked(views=6, points=150, focal=focal, poses=poses, noise_px=0.2))
    assert found.source == "estimated"
    assert found.intrinsics[0, 0] == pytest.approx(focal, rel=0.1)
    assert f"{found.intrinsics[0, 0]:.0f} px" in found.notes[0].sentence


def test_a_still_camera_leaves_it_at_the_default(tracked):
    poses = np.tile(np.eye(4), (5, 1, 1))
    found = estimate(tracked(views=5, points=60, poses=poses, noise_px=0.3))
    assert found.source == "default"
    assert found.intrinsics[0, 0] == pytest.approx(focal_from_view_angle(60, 320))
    assert "60°" in found.notes[0].sentence


def test_a_best_fit_at_the_end_of_the_range_is_refused(tracked, path):
    poses = path(6, np.random.default_rng(2), length=0.25, turn=0.05)
    scene = tracked(views=6, points=100, focal=300.0, poses=poses)
    found = estimate(scene, widest_deg=30.0, narrowest_deg=10.0, default_deg=20.0)
    assert found.source == "default"
    assert "end of the plausible range" in found.notes[0].sentence


def test_default_says_what_it_assumes_and_why():
    focal = default_focal(SIZE, "nobody asked", FocalSettings(default_deg=45))
    assert focal.source == "default"
    assert "nobody asked" in focal.notes[0].sentence
    assert "45°" in focal.notes[0].sentence


@pytest.mark.parametrize("sigma", [0.002, 0.02, 0.2])
@pytest.mark.parametrize("between", [0.0, 0.25, 0.5])
def test_the_spread_of_a_focal_length_does_not_depend_on_where_between_the_tried_ones_it_lies(sigma, between):
    tried = np.linspace(4.7, 7.1, 13)
    best = tried[6] + between * (tried[1] - tried[0])
    assert _spread(tried, 0.5 * ((tried - best) / sigma) ** 2) == pytest.approx(sigma, rel=0.02)


@pytest.mark.parametrize("focal", [216.0, 225.0, 240.0, 255.0])
def test_the_stated_spread_of_a_focal_length_covers_its_error(tracked, path, focal):
    """Each track's noise is its own, so that all residuals count."""
    poses = path(6, np.random.default_rng(2), length=0.25, turn=0.05)
    found = estimate(tracked(views=6, points=100, focal=focal, poses=poses, noise_px=0.1), independent=1.0)
    spread = found.notes[0].figures["spread"]
    assert 5e-4 < spread < 2e-2
    assert abs(np.log(found.intrinsics[0, 0] / focal)) < 3 * spread
