from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.findings import Code, finding
from gs2ci.reconstruct.geometry.path.motion import estimate_motion
from gs2ci.reconstruct.geometry.path.rotations import fit_rotations
from gs2ci.reconstruct.geometry.path.validity import (
    Criteria,
    classify_motion,
    coverage,
    doubts_about_path,
    doubts_about_tracks,
    parallax_px,
    supported_views,
)
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks

SIZE = (240, 320)


def verdict(scene, criteria=None):
    motion, kept = estimate_motion(scene.tracks, scene.intrinsics)
    rotations = fit_rotations(kept, scene.intrinsics)
    return classify_motion(len(scene.tracks), kept, motion, rotations, criteria or Criteria())


def turning(views, amount):
    poses = np.tile(np.eye(4), (views, 1, 1))
    along = (np.arange(views) - views // 2)[:, None] / views
    poses[:, :3, :3] = Rotation.from_rotvec(amount * along * (0.3, 1.0, 0.2)).as_matrix()
    return poses


@pytest.mark.parametrize("views", [2, 3, 8])
@pytest.mark.parametrize("noise_px", [0.0, 0.6])
class TestVerdict:
    def test_a_moving_camera_is_believed(self, tracked, views, noise_px):
        assert verdict(tracked(views=views, noise_px=noise_px)) == ("full", ())

    def test_a_turning_camera_finds_no_depth(self, tracked, views, noise_px):
        found, reasons = verdict(tracked(views=views, noise_px=noise_px, poses=turning(views, 0.1)))
        assert found == "rotation_only"
        assert reasons[0].code in (Code.CAMERA_ONLY_TURNED, Code.PARALLAX_MAY_DROWN)

    def test_a_still_camera_finds_no_depth(self, tracked, views, noise_px):
        found, reasons = verdict(tracked(views=views, noise_px=noise_px, poses=turning(views, 0.0)))
        assert found == "static"
        assert reasons[0].code is Code.CAMERA_STOOD_STILL


def test_a_turn_is_only_called_one_where_no_parallax_could_hide_in_the_errors(tracked, path):
    """A camera that moved by less than the tracks err, and one that turned, look alike."""
    _, (sure,) = verdict(tracked(noise_px=0.05, poses=turning(8, 0.1)))
    assert sure.code is Code.CAMERA_ONLY_TURNED
    moved = path(8, np.random.default_rng(0), length=0.002)
    for poses in (turning(8, 0.1), moved):
        found, (doubtful,) = verdict(tracked(noise_px=0.6, poses=poses))
        assert found == "rotation_only"
        assert doubtful.code is Code.PARALLAX_MAY_DROWN


def test_a_parallax_as_large_as_the_noise_is_noticed(tracked, path):
    poses = path(8, np.random.default_rng(0), length=0.006)
    scene = tracked(poses=poses, noise_px=0.6)
    motion, kept = estimate_motion(scene.tracks, scene.intrinsics)
    assert parallax_px(motion, fit_rotations(kept, scene.intrinsics)) < 1.0
    assert verdict(scene)[0] == "full"


@pytest.mark.parametrize(
    ("strict", "complaint"),
    [
        (Criteria(tracks=10_000), "explains only"),
        (Criteria(inliers=1.1), "explains only"),
        (Criteria(rms_px=1e-9), "px only"),
        (Criteria(behind=-1.0), "behind a camera"),
        (Criteria(turn_deg=0.0), "turns a view by"),
    ],
)
def test_each_criterion_speaks(tracked, strict, complaint):
    found, reasons = verdict(tracked(noise_px=0.3), strict)
    assert found == "unsupported"
    assert any(complaint in reason.sentence for reason in reasons)


def test_a_motion_that_turns_a_view_further_than_tracks_reach_is_refused(tracked):
    scene = tracked()
    motion, kept = estimate_motion(scene.tracks, scene.intrinsics)
    rotations = motion.rotations.copy()
    rotations[-1] = Rotation.from_euler("y", 98, degrees=True).as_matrix() @ rotations[-1]
    turned = replace(motion, rotations=rotations)
    found, (reason,) = classify_motion(
        len(scene.tracks), kept, turned, fit_rotations(kept, scene.intrinsics), Criteria(rms_px=np.inf)
    )
    assert found == "unsupported"
    assert reason.code is Code.TURN_TOO_LARGE
    assert 90 <= reason.figures["turn_deg"] < 100
    assert reason.figures["most_deg"] == 45


def test_a_view_that_no_track_supports_may_turn_as_it_likes(tracked):
    scene = tracked()
    motion, kept = estimate_motion(scene.tracks, scene.intrinsics)
    motion.rotations[-1] = Rotation.from_euler("y", 98, degrees=True).as_matrix()
    kept.positions[:, -1] = np.nan
    assert classify_motion(len(scene.tracks), kept, motion, fit_rotations(kept, scene.intrinsics), Criteria()) == (
        "full",
        (),
    )


def test_good_tracks_raise_no_doubts(tracked):
    assert doubts_about_tracks(tracked().tracks, SIZE, Criteria()) == ()


def test_too_few_tracks_are_named(tracked):
    few = doubts_about_tracks(tracked(points=5).tracks, SIZE, Criteria())[0]
    assert few == finding(Code.FEW_TRACKS, tracks=5, needed=20)


def test_tracks_in_one_corner_are_named(tracked):
    tracks = tracked().tracks
    tracks.positions[:] *= 0.1
    assert coverage(tracks, SIZE) < 0.05
    assert doubts_about_tracks(tracks, SIZE, Criteria())[0].code is Code.CLUSTERED_TRACKS


def test_views_that_see_too_little_are_named(tracked):
    tracks = tracked().tracks
    tracks.positions[:, [0, 1, 2, 6, 7]] = np.nan
    assert supported_views(tracks, Criteria()).tolist() == [False] * 3 + [True] * 3 + [False] * 2
    assert doubts_about_tracks(tracks, SIZE, Criteria())[0] == finding(Code.FEW_VIEWS_TRACKED, views=3, of=8, tracks=10)


def test_no_tracks_cover_nothing():
    assert coverage(Tracks(np.empty((0, 3, 2)), 1), SIZE) == 0.0


def test_a_path_that_errs_by_more_than_the_criterion_is_doubted_in_figures_and_with_a_remedy():
    (doubt,) = doubts_about_path(0.104, Criteria())
    assert doubt.code is Code.PATH_UNCERTAIN
    assert "10% of its extent" in doubt.sentence
    assert "texture" in doubt.advice


@pytest.mark.parametrize("errors", [None, 0.0, 0.05])
def test_a_path_that_errs_by_less_or_was_given_is_not_doubted(errors):
    assert doubts_about_path(errors, Criteria()) == ()
