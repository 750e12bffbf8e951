"""How far a prediction is believed: each step of the hierarchy, and predictions that lie."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import GeometryError, InputError
from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings
from gs2ci.reconstruct.geometry.initialise import GeometrySettings
from gs2ci.reconstruct.geometry.path.focal import Focal
from gs2ci.reconstruct.geometry.prior import Request, find_geometry
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks
from gs2ci.reconstruct.learned.onnx_models import add_model
from gs2ci.reconstruct.learned.vggt import Prediction
from gs2ci.reconstruct.paper import hierarchy
from gs2ci.reconstruct.paper.hierarchy import FromVggt, gated_camera, orders

# A coarse sweep: these tests are about poses.
QUICK = GeometrySettings(sweep=SweepSettings(planes=24))


@pytest.fixture(scope="module")
def scene(seen):
    return seen()


@pytest.fixture
def request_for(scene, expose):
    return lambda **parts: Request(expose(scene, **parts), scene.views, QUICK)


# What the tracks of these small views give by themselves.
TRACKED = 0.12


def find(model, request):
    return find_geometry(FromVggt(model), request, Silent())


def path_error(geometry, poses):
    a, b = geometry.world_to_camera[:, :3, 3], poses[:, :3, 3]
    scale = (a * b).sum() / (a * a).sum()
    return np.abs(scale * a - b).max() / np.ptp(b, axis=0).max()


def turn_error(poses, truth):
    """Mean angle between the rotations relative to the middle view."""
    relative = [p[:, :3, :3] @ p[2, :3, :3].T for p in (poses, truth)]
    return Rotation.from_matrix(relative[0] @ relative[1].transpose(0, 2, 1)).magnitude().mean()


def refuse(monkeypatch, *steps):
    """Let the criteria of these steps fail."""
    real = hierarchy.shortcomings

    def judged(tracks, poses, intrinsics, camera, step, size, settings):
        refused = (finding(Code.FINE_UNCHANGED, why=f"refused {step}"),) if step in steps else ()
        return refused or real(tracks, poses, intrinsics, camera, step, size, settings)

    monkeypatch.setattr(hierarchy, "shortcomings", judged)


def test_a_good_prediction_is_adjusted_and_taken(make_vggt, request_for, scene):
    turned = scene.poses.copy()
    turned[:, :3, :3] = (
        Rotation.from_rotvec(0.004 * np.random.default_rng(0).normal(size=(5, 3))).as_matrix()
        @ (scene.poses[:, :3, :3])
    )
    found = find(make_vggt(scene, poses=turned), request_for())
    assert (found.source, found.verdict, found.focal_source) == ("vggt", "full", "file")
    assert found.notes[0].sentence == "VGGT's poses are used after adjustment, views in order."
    assert path_error(found, scene.poses) < TRACKED
    assert turn_error(found.world_to_camera, scene.poses) < 0.7 * turn_error(turned, scene.poses)


def test_before_the_adjustment_comes_after_it(make_vggt, request_for, scene, monkeypatch):
    refuse(monkeypatch, "after adjustment")
    found = find(make_vggt(scene), request_for())
    assert found.notes[0].sentence.startswith("VGGT's poses are used before adjustment, views in order")
    assert "refused after adjustment" in found.notes[0].sentence
    assert path_error(found, scene.poses) < 1e-5


def test_an_adjustment_that_fails_leaves_the_prediction(make_vggt, request_for, scene, monkeypatch):
    def fail(*arguments, **options):
        raise GeometryError("the bundle adjustment found no finite solution")

    monkeypatch.setattr(hierarchy, "adjust_bundle", fail)
    found = find(make_vggt(scene), request_for())
    assert found.notes[0].sentence.startswith("VGGT's poses are used before adjustment")


def test_retries_look_for_more_tracks_in_other_orders(make_vggt, request_for, scene, monkeypatch):
    """The model answers wrongly to the views in order, and rightly to them backwards."""
    shown = []
    real = hierarchy.Vggt.predict

    def predict(self, views, order):
        shown.append(tuple(order))
        right = real(self, views, order)
        lie = right.world_to_camera.copy()
        lie[:, :3, 3] *= -1
        return right if order[0] == len(views) - 1 else replace(right, world_to_camera=lie)

    monkeypatch.setattr(hierarchy.Vggt, "predict", predict)
    found = find(make_vggt(scene), request_for())
    assert found.source == "vggt"
    assert "views backwards (before that: in order, after adjustment" in found.notes[0].sentence
    assert shown == [(0, 1, 2, 3, 4), (4, 3, 2, 1, 0)]
    assert path_error(found, scene.poses) < TRACKED


def test_orders_are_fixed_and_show_every_view():
    assert [name for name, _ in orders(1)] == ["in order"]
    tried = list(orders(8))
    assert len({views for _, views in tried}) == 4
    assert all(sorted(views) == list(range(8)) for _, views in tried)


def test_the_models_own_depth_is_the_last_step(make_vggt, request_for, scene, monkeypatch):
    refuse(monkeypatch, "after adjustment", "before adjustment")
    found = find(make_vggt(scene), request_for())
    assert found.verdict == "full"
    assert found.notes[0].sentence.startswith("VGGT's own cameras and depth are used; the tracks lie 0.")
    assert path_error(found, scene.poses) < 1e-5
    relative = found.inverse_depth / np.median(found.inverse_depth) * np.median(scene.inverse_depth)
    assert np.median(np.abs(relative / scene.inverse_depth - 1)) < 0.01


def test_plain_views_are_taken_on_the_models_word(make_vggt, seen, expose):
    """Brightness still tells the views apart; there is nothing to track."""
    scene = seen()
    plain = replace(scene, views=np.stack([np.full_like(view, 0.4 + 0.05 * i) for i, view in enumerate(scene.views)]))
    found = find(make_vggt(plain), Request(expose(scene), plain.views, QUICK))
    assert (found.source, found.verdict, found.unit) == ("vggt", "full", None)
    assert "too few tracks to check them" in found.notes[0].sentence


def test_plain_views_before_a_camera_that_is_said_to_rest_end_in_a_plane(make_vggt, seen, expose):
    scene = seen()
    plain = replace(scene, views=np.stack([np.full_like(view, 0.4 + 0.05 * i) for i, view in enumerate(scene.views)]))
    model = make_vggt(plain, poses=np.tile(np.eye(4), (5, 1, 1)))
    found = find(model, Request(expose(scene), plain.views, QUICK))
    assert (found.source, found.verdict) == ("tracks", "unsupported")
    assert "its camera does not move" in found.notes[0].sentence


def lies(scene):
    backwards, far, turned = (scene.poses.copy() for _ in range(3))
    backwards[:, :3, 3] *= -1
    far[:, :3, 3] += 50 * np.random.default_rng(0).normal(size=(5, 3))
    turned[:, :3, :3] = Rotation.random(5, random_state=0).as_matrix()
    return {
        "backwards": {"poses": backwards},
        "far off": {"poses": far},
        "turned": {"poses": turned},
        "negative depth": {"depth": -1 / scene.inverse_depth},
        "still": {"poses": np.tile(np.eye(4), (5, 1, 1))},
    }


@pytest.mark.parametrize("lie", ["backwards", "far off", "turned", "negative depth", "still"])
def test_a_prediction_that_lies_ends_in_the_tracks_or_is_put_right(make_vggt, request_for, scene, lie):
    found = find(make_vggt(scene, **lies(scene)[lie]), request_for())
    assert found.verdict == "full"
    assert path_error(found, scene.poses) < TRACKED
    if found.source == "tracks":
        assert found.notes[0].sentence.startswith("No geometry from vggt: ")


def test_negative_depths_are_named(make_vggt, request_for, scene):
    found = find(make_vggt(scene, depth=-1 / scene.inverse_depth), request_for())
    assert found.source == "tracks"
    assert "100% of the predicted depths are not positive" in found.notes[0].sentence


def test_a_few_depths_that_are_not_positive_are_mended(make_vggt, request_for, scene, monkeypatch):
    refuse(monkeypatch, "after adjustment", "before adjustment")
    depth = 1 / scene.inverse_depth
    depth[:5] = -1
    found = find(make_vggt(scene, depth=depth), request_for())
    assert found.source == "vggt"
    assert found.inverse_depth.min() > 0


def test_an_answer_of_nan_ends_in_the_tracks(make_vggt, request_for, scene):
    poses = scene.poses.copy()
    model = make_vggt(scene, poses=poses, focal=np.nan)
    found = find(model, request_for())
    assert found.source == "tracks"
    assert "not finite" in found.notes[0].sentence


def prediction_of(scene, focal):
    return Prediction(scene.poses, np.broadcast_to(np.float64(focal), 5), np.ones((5, 90, 120), np.float32))


NO_TRACKS = Tracks(np.empty((0, 5, 2)), 2)


def test_a_known_camera_stands_and_a_doubt_is_said(request_for, scene):
    camera = gated_camera(request_for(), prediction_of(scene, 300), NO_TRACKS)
    np.testing.assert_array_equal(camera.intrinsics, scene.intrinsics)
    assert camera.notes == (finding(Code.VGGT_FOCAL_DIFFERS, focal_px=300.0, known_px=100.0),)
    assert gated_camera(request_for(), prediction_of(scene, 110), NO_TRACKS).notes == ()


def test_a_plausible_focal_length_passes_the_gate(request_for, scene):
    camera = gated_camera(request_for(intrinsics=None), prediction_of(scene, 110), NO_TRACKS)
    assert camera.source == "estimated"
    np.testing.assert_allclose(camera.intrinsics, [[110, 0, 60], [0, 110, 45], [0, 0, 1]])


@pytest.mark.parametrize(
    ("focal", "why"),
    [
        (20, "lenses lie between"),
        (2000, "lenses lie between"),
        (-50, "lenses lie between"),
        ([60, 100, 100, 100, 100], "its views differ by 40%"),
    ],
)
def test_a_focal_length_that_cannot_be_is_refused(request_for, scene, focal, why):
    camera = gated_camera(request_for(intrinsics=None), prediction_of(scene, focal), NO_TRACKS)
    assert camera.source == "default"
    assert why in camera.notes[0].sentence
    assert "60°" in camera.notes[1].sentence


def test_tracks_that_tell_another_focal_length_overrule_the_model(request_for, scene, monkeypatch):
    told = Focal(np.array([[100.0, 0, 60], [0, 100, 45], [0, 0, 1]]), "estimated", ("from the tracks: 100 px",))
    monkeypatch.setattr(hierarchy, "doubts_about_tracks", lambda *given: ())
    monkeypatch.setattr(hierarchy, "estimate_focal", lambda *given: told)
    camera = gated_camera(request_for(intrinsics=None), prediction_of(scene, 190), NO_TRACKS)
    assert camera.intrinsics is told.intrinsics
    assert camera.notes[0].sentence == "VGGT's focal length, 190 px, was refused: the tracks tell another one."
    assert camera.notes[1:] == told.notes
    assert gated_camera(request_for(intrinsics=None), prediction_of(scene, 140), NO_TRACKS).intrinsics[0, 0] == 140


def test_an_adjustment_that_changes_the_focal_length_too_far_is_refused(request_for, scene, tracked):
    made = tracked()
    settings = request_for().settings
    camera = Focal(made.intrinsics, "estimated", ())
    wrong = np.diag([2.0, 2.0, 1]) @ made.intrinsics
    wrong[:2, 2] = made.intrinsics[:2, 2]
    said = hierarchy.shortcomings(made.tracks, made.poses, wrong, camera, "after adjustment", (240, 320), settings)
    assert any("by a factor of 2.0" in one.sentence for one in said)


def test_views_that_see_too_little_are_counted_more_strictly_after_the_adjustment(request_for, tracked):
    made = tracked(points=300)
    positions = made.tracks.positions.copy()
    positions[:, 0] = np.nan
    settings, camera = request_for().settings, Focal(made.intrinsics, "file", ())
    tracks = replace(made.tracks, positions=positions)
    after, before = (
        hierarchy.shortcomings(tracks, made.poses, made.intrinsics, camera, step, (240, 320), settings)
        for step in ("after adjustment", "before adjustment")
    )
    assert after == (finding(Code.UNREGISTERED_VIEWS, share=0.875, needed=1.0),)
    assert before == ()


def test_auto_asks_vggt_where_it_is_known(make_vggt, request_for, scene, monkeypatch, tmp_path):
    monkeypatch.setenv("GS2CI_HOME", str(tmp_path / "home"))
    assert load_geometry_prior("auto")(request_for(), Silent()).notes == ()
    model = make_vggt(scene)
    add_model("vggt", model)
    assert "by the vggt." in load_geometry_prior("auto")(request_for(), Silent()).notes[0].sentence
    assert load_geometry_prior("vggt").name == load_geometry_prior(f"vggt:{model}").name == "vggt"
    model.unlink()
    assert "the vggt failed (the vggt model" in load_geometry_prior("auto")(request_for(), Silent()).notes[0].sentence
    with pytest.raises(InputError, match="is gone"):
        load_geometry_prior("vggt")
