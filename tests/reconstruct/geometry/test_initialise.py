from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import GeometryError
from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.choices import LeftOut
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings
from gs2ci.reconstruct.geometry.initialise import PLANE_NOTE, GeometrySettings, initialise
from gs2ci.reconstruct.geometry.path.bundle import AdjustedBundle, adjust_bundle
from gs2ci.reconstruct.geometry.path.validity import Criteria
from gs2ci.reconstruct.geometry.points import seed_points

QUICK = GeometrySettings(sweep=SweepSettings(planes=48))


def assert_sane(geometry, views):
    n, height, width, _ = views.shape
    assert geometry.world_to_camera.shape == (n, 4, 4)
    assert np.isfinite(geometry.world_to_camera).all()
    np.testing.assert_array_equal(geometry.world_to_camera[geometry.reference], np.eye(4))
    assert geometry.inverse_depth.shape == (height, width)
    assert geometry.inverse_depth.dtype == np.float32
    assert np.isfinite(geometry.inverse_depth).all()
    assert geometry.inverse_depth.min() > 0
    assert geometry.intrinsics.shape == (3, 3)
    seeds = seed_points(geometry, views)
    assert len(seeds.positions) == len(seeds.colours) == len(seeds.spacing) > 0
    assert all(np.isfinite(part).all() for part in (seeds.positions, seeds.colours, seeds.spacing))


def assert_flat(geometry):
    assert geometry.verdict != "full"
    assert (geometry.inverse_depth == 1).all()
    assert PLANE_NOTE in geometry.notes


@pytest.mark.parametrize("channels", [1, 3])
def test_path_and_depth_of_two_planes_are_found(seen, compare, channels):
    scene = seen(channels=channels)
    listener = Silent()
    geometry = initialise(scene.views, scene.intrinsics, QUICK, listener)
    assert_sane(geometry, scene.views)
    assert (geometry.verdict, geometry.focal_source, geometry.notes) == ("full", "file", ())
    assert listener.sentences == []
    path_error, rotation_error_deg = compare
    assert path_error(geometry.world_to_camera, scene.poses) < 0.05
    assert rotation_error_deg(geometry.world_to_camera, scene.poses) < 0.5
    ratio = geometry.inverse_depth / scene.inverse_depth
    assert np.median(np.abs(ratio / np.median(ratio) - 1)) < 0.08
    assert geometry.parallax_px > 0.5
    assert 0 < geometry.path_error_expected < 0.05
    assert geometry.reprojection_rms_px < 1


def test_a_path_whose_halves_agree_is_believed_though_rotations_explain_the_tracks_hardly_worse(seen):
    """The criterion on what rotations leave is out of reach here, as it is where noise drowns the parallax."""
    scene = seen()
    drowned = Criteria(unexplained=1e9)
    believed = initialise(scene.views, scene.intrinsics, replace(QUICK, criteria=drowned))
    assert (believed.verdict, believed.notes) == ("full", ())
    assert believed.path_error_expected < drowned.agreement
    doubted = initialise(scene.views, scene.intrinsics, replace(QUICK, criteria=replace(drowned, agreement=0.0)))
    assert doubted.verdict == "rotation_only"


def test_where_freed_points_find_no_solution_the_path_with_fixed_ones_stands(seen, compare, monkeypatch):
    def none(*_args, **_options):
        raise GeometryError("no solution")

    scene = seen()
    freed = initialise(scene.views, scene.intrinsics, QUICK)
    monkeypatch.setattr("gs2ci.reconstruct.geometry.initialise.adjust_bundle", none)
    fixed = initialise(scene.views, scene.intrinsics, QUICK)
    assert (fixed.verdict, fixed.notes) == ("full", ())
    assert compare[0](fixed.world_to_camera, scene.poses) < 0.05
    assert not np.array_equal(fixed.world_to_camera, freed.world_to_camera)


def test_points_are_freed_once_and_of_the_last_tracks(seen, monkeypatch):
    scene, starts = seen(), []
    monkeypatch.setattr(
        "gs2ci.reconstruct.geometry.initialise.adjust_bundle",
        lambda tracks, *given, **how: starts.append(tracks) or adjust_bundle(tracks, *given, **how),
    )
    found = initialise(scene.views, scene.intrinsics, QUICK)
    (tracks,) = starts
    initialise(scene.views, scene.intrinsics, replace(QUICK, left_out=(LeftOut.TRACKS_SOUGHT_TWICE,)))
    assert found.has_path
    assert not np.array_equal(tracks.positions, starts[1].positions)


def test_freed_points_that_would_cost_the_verdict_are_not_freed(seen, monkeypatch):
    scene = seen()
    at_rest = np.tile(np.eye(4), (len(scene.views), 1, 1))
    at_rest[1:, 0, 3] = 1e-9  # explains nothing
    fixed = initialise(scene.views, scene.intrinsics, QUICK)
    monkeypatch.setattr(
        "gs2ci.reconstruct.geometry.initialise.adjust_bundle",
        lambda *_a, **_o: AdjustedBundle(at_rest, scene.intrinsics),
    )
    assert initialise(scene.views, scene.intrinsics, QUICK).verdict == fixed.verdict == "full"


def test_a_path_that_may_err_by_more_than_the_criterion_is_doubted_aloud(seen):
    scene, listener = seen(), Silent()
    strict = replace(QUICK, criteria=Criteria(path_error=1e-4))
    geometry = initialise(scene.views, scene.intrinsics, strict, listener)
    assert geometry.verdict == "full"
    assert geometry.path_error_expected > 1e-4
    assert geometry.notes[-1].code is Code.PATH_UNCERTAIN
    assert listener.sentences == [note.sentence for note in geometry.notes]


def test_poses_that_were_given_are_not_doubted(seen):
    scene = seen()
    geometry = initialise(scene.views, scene.intrinsics, QUICK, known_poses=scene.poses)
    assert geometry.verdict == "full"
    assert geometry.path_error_expected is None


def test_two_views_are_enough(seen):
    scene = seen(views=2)
    geometry = initialise(scene.views, scene.intrinsics, QUICK)
    assert_sane(geometry, scene.views)
    assert geometry.verdict == "full"


def test_without_a_camera_matrix_one_is_assumed_or_estimated_and_it_is_said(seen):
    scene, listener = seen(), Silent()
    geometry = initialise(scene.views, None, QUICK, listener)
    assert_sane(geometry, scene.views)
    assert geometry.focal_source in ("estimated", "default")
    assert any("focal length" in sentence for sentence in listener.sentences)
    assert listener.sentences == [note.sentence for note in geometry.notes]


def test_no_motion_falls_back_to_a_plane_and_says_so(seen):
    scene = seen(poses=np.tile(np.eye(4), (5, 1, 1)))
    geometry = initialise(scene.views, scene.intrinsics, QUICK)
    assert_sane(geometry, scene.views)
    assert_flat(geometry)
    assert geometry.verdict == "static"
    assert (geometry.world_to_camera == np.eye(4)).all()


def test_pure_rotation_falls_back_to_a_plane_but_keeps_the_rotations(seen, path, compare):
    poses = path(5, np.random.default_rng(0), length=0.0, turn=0.03)
    scene = seen(poses=poses)
    geometry = initialise(scene.views, scene.intrinsics, QUICK)
    assert_sane(geometry, scene.views)
    assert_flat(geometry)
    assert geometry.verdict == "rotation_only"
    assert compare[1](geometry.world_to_camera, poses) < 0.2


@pytest.mark.parametrize("shape", [(3, 40, 50, 3), (2, 16, 16, 1), (4, 1, 1, 3), (1, 30, 30, 3)])
def test_views_without_texture_fall_back_to_a_plane(shape):
    views = np.full(shape, 0.5, np.float32)
    for intrinsics in (None, np.array([[50.0, 0, 8], [0, 50, 8], [0, 0, 1]])):
        geometry = initialise(views, intrinsics, QUICK)
        assert_sane(geometry, views)
        assert_flat(geometry)
        assert geometry.verdict == "unsupported"


def test_sixteen_pixels_square_give_something_sane(seen):
    scene = seen(size=(16, 16), focal=20.0)
    assert_sane(initialise(scene.views, scene.intrinsics, QUICK), scene.views)


def test_pure_noise_gives_something_sane():
    views = np.random.default_rng(0).random((4, 40, 50, 3)).astype(np.float32)
    geometry = initialise(views, None, QUICK)
    assert_sane(geometry, views)
    assert_flat(geometry)


@pytest.mark.parametrize("lost", [0, 1])
def test_a_view_that_cannot_be_tracked_gets_a_pose_from_its_neighbours(seen, lost):
    scene = seen(views=6, size=(120, 160), focal=130.0)
    scene.views[lost] = 0
    geometry = initialise(scene.views, scene.intrinsics, QUICK)
    assert_sane(geometry, scene.views)
    assert geometry.verdict == "full"
    assert finding(Code.POSES_INTERPOLATED, views=[lost]) in geometry.notes
    if lost:
        between = geometry.world_to_camera[[0, 2], :3, 3].mean(0)
        np.testing.assert_allclose(geometry.world_to_camera[1, :3, 3], between, atol=0.01)
    else:
        np.testing.assert_allclose(geometry.world_to_camera[0], geometry.world_to_camera[1], atol=1e-9)


def test_same_views_give_the_same_bits(seen):
    scene = seen()
    a, b = (initialise(scene.views, scene.intrinsics, QUICK) for _ in range(2))
    np.testing.assert_array_equal(a.world_to_camera, b.world_to_camera)
    np.testing.assert_array_equal(a.inverse_depth, b.inverse_depth)
