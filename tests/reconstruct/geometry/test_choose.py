"""The sources of first poses by name, `auto`, and what happens when one lies."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import GeometryError, InputError, NumericsError
from gs2ci.core.findings import Code, finding
from gs2ci.core.plugins import PluginError
from gs2ci.core.progress import Silent, said
from gs2ci.core.records import Truth
from gs2ci.evaluate.cameras import nerfstudio_transforms, write_colmap_model
from gs2ci.reconstruct.geometry import choose, prior
from gs2ci.reconstruct.geometry.choose import explains_more_than_rest, load_geometry_prior
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings
from gs2ci.reconstruct.geometry.initialise import GeometrySettings, OtherOrder, initialise
from gs2ci.reconstruct.geometry.path.telemetry import errors_of_given
from gs2ci.reconstruct.geometry.path.validity import Criteria
from gs2ci.reconstruct.geometry.prior import Request, find_geometry, from_tracks
from gs2ci.reconstruct.geometry.reversal import reversed_geometry
from gs2ci.reconstruct.geometry.sources.direct import at_rest

# A coarse sweep: these tests are about poses.
QUICK = GeometrySettings(sweep=SweepSettings(planes=24))


@pytest.fixture(scope="module", autouse=True)
def tracked_once():
    """Track the same views once: what is asked here comes after."""
    kept = {}

    def found(views, intrinsics, settings, progress=None, known_poses=None, seen=None):
        if known_poses is not None or seen is not None:
            return initialise(views, intrinsics, settings, progress, known_poses, seen)
        key = views.shape, views.tobytes(), None if intrinsics is None else intrinsics.tobytes(), settings
        if key not in kept:
            kept[key] = initialise(views, intrinsics, settings)
        said(kept[key].notes, progress or Silent())
        return kept[key]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(prior, "initialise", found)
        yield


@pytest.fixture(scope="module")
def scene(seen):
    return seen()


@pytest.fixture
def request_for(scene, expose):
    return lambda views=None, **parts: Request(expose(scene, **parts), scene.views if views is None else views, QUICK)


def moved(poses, scale=3.0):
    """The same path in another frame and unit."""
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_rotvec((0.3, 1.0, -0.5)).as_matrix()
    frame[:3, 3] = (4, -2, 7)
    scaled = poses.copy()
    scaled[:, :3, 3] *= scale
    return scaled @ frame


def path_of(geometry):
    return geometry.world_to_camera[:, :3, 3]


def same_path(geometry, poses, tolerance):
    """Compare translations up to scale."""
    scale = (path_of(geometry) * poses[:, :3, 3]).sum() / (poses[:, :3, 3] ** 2).sum()
    return (
        np.abs(path_of(geometry) - scale * poses[:, :3, 3]).max() < tolerance * np.ptp(path_of(geometry), axis=0).max()
    )


@pytest.fixture
def camera_file(tmp_path, scene):
    def write(poses=None, matrix=None):
        path = tmp_path / "transforms.json"
        held = nerfstudio_transforms(
            moved(scene.poses) if poses is None else poses, scene.intrinsics if matrix is None else matrix, (90, 120)
        )
        path.write_text(json.dumps(held))
        return f"file:{path}"

    return write


def find(name, request):
    return find_geometry(load_geometry_prior(name), request, Silent())


def test_a_file_in_any_frame_and_unit_gives_its_poses(request_for, camera_file, scene):
    found = find(camera_file(), request_for())
    assert (found.source, found.verdict, found.notes) == ("file", "full", ())
    assert same_path(found, scene.poses, 1e-6)
    share = np.abs(
        found.inverse_depth / np.median(found.inverse_depth) - scene.inverse_depth / np.median(scene.inverse_depth)
    )
    assert np.median(share) < 0.05


def test_a_view_too_plain_to_track_keeps_the_pose_that_the_file_gives(request_for, camera_file, scene):
    views = scene.views.copy()
    views[0] = 0.5
    found = find(camera_file(), request_for(views))
    assert found.verdict == "full"
    assert same_path(found, scene.poses, 1e-6)
    assert Code.POSES_INTERPOLATED not in [note.code for note in found.notes]


def test_a_stage_gives_its_poses(request_for, scene):
    found = find("stage", request_for(telemetry_world_to_camera=moved(scene.poses)))
    assert (found.source, found.verdict) == ("stage", "full")
    assert same_path(found, scene.poses, 1e-6)
    centres, told = (np.linalg.inv(poses)[:, :3, 3] for poses in (found.world_to_camera, moved(scene.poses)))
    assert found.unit == pytest.approx(np.linalg.norm(told[-1] - told[0]) / np.linalg.norm(centres[-1] - centres[0]))
    assert found.order_given
    # Nobody stated how exact it is: a hundredth of the path.
    assert found.pose_errors.position == pytest.approx(0.01 * np.linalg.norm(np.ptp(centres, axis=0)), rel=1e-6)


def test_a_stage_is_believed_as_far_as_it_states_its_error(request_for, scene):
    stated = {"telemetry": {"position_error": 0.003}}
    found = find("stage", request_for(telemetry_world_to_camera=moved(scene.poses), provenance=stated))
    assert found.pose_errors.position * found.unit == pytest.approx(0.003)
    turning = {"telemetry": {"turn_error_deg": 1.0}}
    found = find("stage", request_for(telemetry_world_to_camera=moved(scene.poses), provenance=turning))
    assert np.degrees(found.pose_errors.rotation) == pytest.approx(np.hypot(12**-0.5, np.degrees(0.1 / 100)), rel=0.01)


def test_places_that_the_tracks_contradict_are_held_loosely_whatever_the_stage_states(request_for, scene):
    late = scene.poses.copy()
    late[:, :3, 3] *= np.array([1.6, 0.4, 1, 1.6, 0.4])[:, None]
    stated = {"telemetry": {"position_error": 0.003}}
    found = find("stage", request_for(telemetry_world_to_camera=late, provenance=stated))
    assert (found.verdict, found.order_given) == ("full", True)
    assert found.pose_errors == errors_of_given(found.world_to_camera, found.intrinsics).loosened()
    assert [note.code for note in found.notes] == [Code.POSES_CONTRADICTED]


def test_a_files_poses_are_held_as_closely_as_a_stages_but_settle_no_order(request_for, camera_file, scene):
    found = find(camera_file(), request_for())
    assert not found.order_given
    assert found.pose_errors == errors_of_given(found.world_to_camera, found.intrinsics)
    late = scene.poses.copy()
    late[:, :3, 3] *= np.array([1.6, 0.4, 1, 1.6, 0.4])[:, None]
    contradicted = find(camera_file(poses=late), request_for())
    assert (contradicted.verdict, contradicted.pose_errors.contradicted) == ("full", True)
    assert reversed_geometry(found).pose_errors is None


def test_a_stage_that_reported_nothing_is_an_error(request_for):
    with pytest.raises(InputError, match="no poses from a stage"):
        find("stage", request_for())


def test_a_file_of_another_camera_is_believed_and_the_difference_said(request_for, camera_file, scene):
    wider = np.diag([0.9, 0.9, 1]) @ scene.intrinsics
    wider[:2, 2] = scene.intrinsics[:2, 2]
    found = find(camera_file(matrix=wider), request_for())
    np.testing.assert_allclose(found.intrinsics, wider)
    assert finding(Code.FOCAL_OF_CAMERA_FILE, of_file_px=90.0, of_shot_px=100.0) in found.notes


def test_poses_that_lie_end_in_the_tracks_with_the_reason(request_for, camera_file, scene):
    """The camera moves the other way: all points would lie behind it."""
    backwards = scene.poses.copy()
    backwards[:, :3, 3] *= -1
    found = find(camera_file(backwards), request_for())
    assert found.source == "tracks"
    assert found.verdict == "full"
    assert found.notes[0].sentence.startswith("No geometry from file: the known poses put most tracked points")


def test_without_tracks_the_points_of_a_model_give_the_range_of_depths(request_for, tmp_path, scene):
    """Views too plain to track, and a model that knows where things are."""
    plain = np.full_like(scene.views, 0.5)
    points = np.random.default_rng(0).uniform((-0.3, -0.2, 1.5), (0.3, 0.2, 2.5), (50, 3)).astype(np.float32)
    write_colmap_model(
        tmp_path, scene.poses, scene.intrinsics, (90, 120), points=points, colors=np.zeros((50, 3), np.float32)
    )
    found = find(f"file:{tmp_path}", request_for(plain))
    assert (found.source, found.verdict) == ("file", "full")
    assert same_path(found, scene.poses, 1e-6)
    assert np.isfinite(found.inverse_depth).all()
    assert found.inverse_depth.min() > 0
    assert found.notes[-1].code is Code.POSES_UNCHECKED


def test_one_view_shows_no_depth_whatever_the_points_of_a_model_say(request_for, tmp_path, scene):
    points = np.random.default_rng(0).uniform((-0.3, -0.2, 1.5), (0.3, 0.2, 2.5), (50, 3)).astype(np.float32)
    write_colmap_model(
        tmp_path, scene.poses[:1], scene.intrinsics, (90, 120), points=points, colors=np.zeros((50, 3), np.float32)
    )
    many = request_for()
    shot = replace(many.shot, masks=many.shot.masks[:1], weights=many.shot.weights[:1], truth=Truth())
    found = find(f"file:{tmp_path}", replace(many, shot=shot, views=many.views[:1]))
    assert found.verdict != "full"
    assert len(found.world_to_camera) == 1
    assert np.isfinite(found.inverse_depth).all()


def test_without_tracks_points_behind_the_camera_end_in_the_fallback(request_for, tmp_path, scene):
    plain = np.full_like(scene.views, 0.5)
    write_colmap_model(
        tmp_path,
        scene.poses,
        scene.intrinsics,
        (90, 120),
        points=np.tile(np.float32([0, 0, -2]), (9, 1)),
        colors=np.zeros((9, 3), np.float32),
    )
    found = find(f"file:{tmp_path}", request_for(plain))
    assert (found.source, found.verdict) == ("tracks", "unsupported")
    assert "9 of the file's 9 points lie behind" in found.notes[0].sentence


def test_without_tracks_and_points_a_file_leaves_a_plane(request_for, camera_file, scene):
    found = find(camera_file(), request_for(np.full_like(scene.views, 0.5)))
    assert found.verdict == "unsupported"
    assert np.all(found.inverse_depth == 1)


@pytest.mark.parametrize("error", [GeometryError("turned"), NumericsError("NaN"), PluginError("bad")])
def test_a_source_that_fails_gives_way_to_the_tracks(request_for, error):
    class Failing:
        name = "oracle"

        def __call__(self, request, progress):
            raise error

    found = find_geometry(Failing(), request_for(), Silent())
    assert found.source == "tracks"
    assert found.notes[0] == finding(Code.SOURCE_FAILED, source="oracle", problem=error.problem)


def test_auto_takes_the_tracks_without_a_word_where_nothing_else_is_known(request_for):
    found = find("auto", request_for())
    assert (found.source, found.notes) == ("tracks", ())
    assert same_path(found, find("tracks", request_for()).world_to_camera, 1e-12)


def test_auto_believes_a_stage_that_tracks_bear_out_and_seeks_no_other_path(request_for, scene, monkeypatch):
    monkeypatch.setattr(choose, "from_tracks", None)
    found = find("auto", request_for(telemetry_world_to_camera=moved(scene.poses)))
    assert (found.source, len(found.notes)) == ("stage", 1)
    assert found.notes[0].sentence.startswith("Geometry from stage. Residual of each source that was tried: 0.")
    assert found.notes[0].sentence.endswith(" by the stage.")
    assert same_path(found, scene.poses, 1e-6)


@pytest.mark.parametrize(("stretched", "taken"), [((1, 1, 1, 1, 1), "stage"), ((1.6, 0.4, 1, 1.6, 0.4), "tracks")])
def test_a_stage_that_tracks_bear_out_stands_whatever_its_depths_leave(
    request_for, scene, monkeypatch, stretched, taken
):
    poses = scene.poses.copy()
    poses[:, :3, 3] *= np.array(stretched)[:, None]
    left = {"stage": 0.06, "tracks": 0.05}
    monkeypatch.setattr(choose, "unexplained", lambda shot, views, geometry, lens: left[geometry.source])
    found = find("auto", request_for(telemetry_world_to_camera=poses))
    assert found.source == taken
    assert (Code.STAGE_NOT_TAKEN in [note.code for note in found.notes]) == (taken == "tracks")


def test_auto_says_what_to_check_where_a_stage_leaves_clearly_more_than_the_tracks(request_for, scene):
    """The stage reports its outer places too far and its inner ones too near."""
    late = scene.poses.copy()
    late[:, :3, 3] *= np.array([1.6, 0.4, 1, 1.6, 0.4])[:, None]
    found = find("auto", request_for(telemetry_world_to_camera=late))
    assert found.source == "tracks"
    assert found.notes[1].code is Code.STAGE_NOT_TAKEN
    # Which way it went it knows all the same.
    assert found.order_given


def test_a_stage_that_reports_another_axis_than_the_camera_moved_along_settles_no_order(request_for, scene):
    """Its depths are those of noise: they may turn right tracks inside out."""
    across = scene.poses.copy()
    across[:, :3, 3] = across[:, [1, 0, 2], 3] * np.array([1, -1, 1])
    found = find("auto", request_for(telemetry_world_to_camera=across))
    assert found.source == "tracks"
    assert Code.STAGE_NOT_TAKEN in [note.code for note in found.notes]
    assert not found.order_given
    right, stage = (
        from_tracks(request_for(), Silent()),
        find("stage", request_for(telemetry_world_to_camera=scene.poses)),
    )
    wrong = replace(stage, world_to_camera=across, inverse_depth=-right.inverse_depth)
    assert choose._in_the_order_of(wrong, right) is right
    assert choose._in_the_order_of(stage, right).order_given


def test_a_stage_with_a_map_of_one_depth_turns_no_tracks(request_for):
    found = find("tracks", request_for())
    flat = replace(found, inverse_depth=np.ones_like(found.inverse_depth))
    assert choose._with_order_of(flat, found) is found
    assert choose._with_order_of(reversed_geometry(found), found) is not found


def test_tracks_inside_out_are_turned_by_a_stage_that_is_not_taken_for_its_places(request_for, scene, monkeypatch):
    late = scene.poses.copy()
    late[:, :3, 3] *= np.array([1.6, 0.4, 1, 1.6, 0.4])[:, None]
    right = from_tracks(request_for(), Silent())
    inside_out = replace(reversed_geometry(right), other_order=OtherOrder.of(right))
    monkeypatch.setattr(choose, "from_tracks", lambda request, progress: inside_out)
    found = find("auto", request_for(telemetry_world_to_camera=late))
    assert found.source == "tracks"
    np.testing.assert_array_equal(found.world_to_camera, right.world_to_camera)


def test_auto_says_where_a_stage_reports_a_motion_of_which_nothing_shows(request_for, scene, monkeypatch):
    still = from_tracks(request_for(np.repeat(scene.views[:1], len(scene.views), axis=0)), Silent())
    assert still.verdict == "static"
    crept = replace(still, verdict="full", source="stage", notes=())
    monkeypatch.setattr(choose, "from_tracks", lambda request, progress: still)
    monkeypatch.setattr(choose, "from_stage", lambda request, progress: crept)
    found = find("auto", request_for(telemetry_world_to_camera=scene.poses))
    assert found.source == "stage"
    assert found.notes[1].code is Code.STAGE_MOTION_UNSEEN


def test_auto_takes_the_stage_where_tracks_find_nothing(request_for, scene, monkeypatch):
    """The views that the tracks see are plain; the stage's own geometry is found in the true ones, unconfirmed."""
    from_stage = choose.from_stage
    monkeypatch.setattr(choose, "from_stage", lambda *given: replace(from_stage(*given), pose_errors=None))
    request = request_for(telemetry_world_to_camera=scene.poses)

    def blind(request, progress):
        return from_tracks(replace(request, views=np.full_like(request.views, 0.5)), progress)

    monkeypatch.setattr(choose, "from_tracks", blind)
    found = find("auto", request)
    assert found.source == "stage"
    assert "by the tracks (unsupported)" in found.notes[0].sentence
    assert "by the stage, " in found.notes[0].sentence


def test_auto_drops_a_stage_that_lies(request_for, scene):
    backwards = scene.poses.copy()
    backwards[:, :3, 3] *= -1
    found = find("auto", request_for(telemetry_world_to_camera=backwards))
    assert found.source == "tracks"
    assert "the stage failed (the known poses put most tracked points" in found.notes[0].sentence
    assert found.notes[1].code is Code.STAGE_SIGN_CONTRADICTED
    assert not found.order_given


@pytest.fixture
def lost_request(seen, expose):
    """Make a request in which no track is believed."""
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, :3, 3] = (np.arange(5) - 2)[:, None] * (0.03, 0.01, 0)
    scene = seen(poses=poses)
    settings = replace(QUICK, criteria=Criteria(tracks=100_000))
    return lambda **parts: Request(expose(scene, **parts), scene.views, settings)


def test_a_camera_may_be_said_to_be_at_rest(request_for):
    found = find("rest", request_for())
    assert (found.source, found.verdict) == ("rest", "static")
    assert [note.code for note in found.notes] == [Code.CAMERA_GIVEN_AT_REST]
    unknown = find("rest", request_for(intrinsics=None))
    assert unknown.focal_source == "default"


def test_a_right_path_explains_more_than_rest_and_rest_no_more_than_itself(request_for):
    request = request_for()
    found = from_tracks(request, Silent())
    assert explains_more_than_rest(request, found)
    assert not explains_more_than_rest(request, at_rest(found))


def test_auto_keeps_the_path_of_tracks_whose_halves_disagree_where_nothing_else_is_known(request_for, monkeypatch):
    doubted = replace(from_tracks(request_for(), Silent()), path_error_expected=0.2)
    monkeypatch.setattr(choose, "from_tracks", lambda request, progress: doubted)
    assert find("auto", request_for()) is doubted


def test_without_tracks_the_measurement_bears_out_a_stage_or_not(lost_request):
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, :3, 3] = (np.arange(5) - 2)[:, None] * (7.5, 2.5, 0)
    found = find("auto", lost_request(telemetry_world_to_camera=poses))
    assert (found.source, found.verdict) == ("stage", "full")
    assert found.unit == pytest.approx(
        np.linalg.norm(poses[4, :3, 3]) / np.linalg.norm(found.world_to_camera[4, :3, 3])
    )
    assert found.notes[-1].code is Code.DEPTH_RANGE_FOUND

    wrong_way = find(
        "stage", lost_request(telemetry_world_to_camera=poses * np.float64([1, 1, 1, -1]) + 2 * np.diag([0, 0, 0, 1.0]))
    )
    assert wrong_way.verdict == "unsupported"
    assert wrong_way.notes[-1].code is Code.POSES_NOT_BORNE_OUT


def test_without_tracks_the_measurement_bears_out_the_poses_of_a_file(lost_request, tmp_path):
    request = lost_request()
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, :3, 3] = (np.arange(5) - 2)[:, None] * (0.03, 0.01, 0)
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(nerfstudio_transforms(poses, request.shot.intrinsics, (90, 120))))
    found = find(f"file:{path}", request)
    assert (found.source, found.verdict) == ("file", "full")


def test_auto_lets_the_measurement_decide(request_for, monkeypatch):
    """Two sources with a full verdict; one has its depth inside out."""
    good = from_tracks(request_for(), Silent())
    bad = replace(good, inverse_depth=np.float32(2) - good.inverse_depth.clip(0.1, 1.9), source="liar")
    for first, second, winner in ((good, bad, "tracks"), (bad, replace(good, source="truth"), "truth")):
        monkeypatch.setattr(choose, "from_tracks", lambda request, progress, first=first: first)
        monkeypatch.setattr(choose, "from_stage", lambda request, progress, second=second: second)
        stage = {"telemetry_world_to_camera": np.tile(np.eye(4), (5, 1, 1))}
        assert find("auto", request_for(**stage)).source == winner


def test_names_that_are_not_known_are_refused_at_once(tmp_path):
    with pytest.raises(InputError, match="geometry 'lidar'"):
        load_geometry_prior("lidar")
    with pytest.raises(InputError, match="no camera file"):
        load_geometry_prior(f"file:{tmp_path}/absent.json")
