"""One scene from several exposures: what is recovered, what is recorded, what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.cameras import pinhole
from gs2ci.core.errors import GeometryError, InputError
from gs2ci.core.findings import Code
from gs2ci.core.records import Shot, Truth
from gs2ci.core.summed import summed
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct import pipeline
from gs2ci.reconstruct.exposures.joint import reconstruct_together
from gs2ci.reconstruct.paper.fine import FineSettings
from gs2ci.reconstruct.presets.named import preset, rescheduled
from gs2ci.reconstruct.registration.register import RegistrationSettings
from tests.exposed_rooms import adjacent, room
from tests.reconstruct.exposures.rooms import FOCAL_PX, PLACES, seen, textures

SIZE = (48, 64)
DRAFT = preset("draft")
SETTINGS = replace(DRAFT, registration=RegistrationSettings("off"), fit=rescheduled(DRAFT.fit, 60))


@pytest.fixture(scope="module")
def shots():
    return adjacent(room(0, SIZE), SIZE, 0, 3, noise=0.01)


@pytest.fixture(scope="module")
def together(shots):
    return reconstruct_together(shots, SETTINGS)


@pytest.mark.slow
def test_all_exposures_lie_on_one_path_and_show_one_scene(shots, together):
    truth = np.concatenate([shot.truth.world_to_camera for shot in shots])
    assert trajectory_errors(together.result.world_to_camera, truth).nate < 0.005
    assert together.result.views.shape == (24, *SIZE, 3)
    views = np.concatenate([shot.truth.views for shot in shots])
    assert np.mean(psnr_per_view(together.result.scene_views, views)) > 25
    assert together.left_out == ()
    assert Code.EXPOSURES_TOGETHER in {note.code for note in together.result.notes}


@pytest.mark.slow
def test_the_record_of_all_is_that_of_the_sum_of_the_readings(shots, together):
    whole = summed(shots, "sum")
    assert together.shot.views == whole.views
    left = whole.measurement - together.result.predicted_measurement
    assert np.sqrt(np.mean(left**2)) < 0.1
    told = together.result.exposures
    assert [(one.name, one.first_view, one.views) for one in told] == [
        (shot.name, 8 * number, 8) for number, shot in enumerate(shots)
    ]
    assert all(one.path == "stage" for one in told)


@pytest.mark.slow
def test_each_exposure_shows_the_scene_as_its_own_part_of_the_record_does(together):
    at = 0
    for part in together.parts:
        assert np.array_equal(part.views, together.result.views[at : at + 8])
        assert np.array_equal(part.depth, together.result.depth[at : at + 8])
        # Not a second time in memory.
        assert all(np.shares_memory(getattr(part, name), getattr(together.result, name)) for name in ("views", "depth"))
        at += 8


@pytest.mark.slow
def test_what_each_exposure_alone_shows_is_said(together):
    first, middle, last = (one.seen_alone for one in together.result.exposures)
    assert min(first, last) > 2 * middle


@pytest.mark.slow
def test_each_exposure_has_standard_errors_of_its_own(together):
    whole = together.result.uncertainty.check(together.result.views.shape[:3])
    for name in ("views", "depth", "positions", "rotations"):
        parts = np.concatenate([getattr(part.uncertainty, name) for part in together.parts])
        np.testing.assert_array_equal(getattr(whole, name), parts)
        assert parts.any()


def test_the_same_seed_gives_the_same_scene(shots, together):
    again = reconstruct_together(shots, SETTINGS)
    assert np.array_equal(again.result.views, together.result.views)


@pytest.mark.slow
def test_one_exposure_alone_is_fitted_as_a_reconstruction_of_it_fits(shots):
    still = replace(SETTINGS, motion="off", look_again=False)
    joint = reconstruct_together(shots[:1], still)
    single = pipeline.reconstruct(shots[0], still)
    # The race may add hypotheses; the fit of the first is the same, look by look.
    assert [(point.iteration, point.loss, point.heldout) for point in joint.result.curve] == [
        (point.iteration, point.loss, point.heldout) for point in single.result.curve
    ]
    assert np.array_equal(joint.result.scene_views, single.result.scene_views)
    assert joint.result.exposures == ()


@pytest.mark.slow
def test_an_exposure_of_another_room_is_left_out_by_name_and_changes_nothing(shots, together):
    stray = adjacent(room(7, SIZE), SIZE, 7, 1, staged=False)[0]
    found = reconstruct_together([*shots, replace(stray, name="stray")], SETTINGS)
    assert [note.figures["name"] for note in found.left_out] == ["stray"]
    assert np.array_equal(found.result.views, together.result.views)


@pytest.mark.slow
def test_without_a_camera_matrix_that_of_the_first_is_taken_for_all_and_measurements_stay_as_given(shots):
    unknown = [replace(shot, intrinsics=None) for shot in shots[:2]]
    moved = [replace(one, masks=np.ascontiguousarray(np.roll(one.masks, 2, axis=2))) for one in unknown]
    found = reconstruct_together(moved, replace(SETTINGS, registration=RegistrationSettings()))
    assert found.shot.intrinsics is None
    assert np.array_equal(found.shot.masks, np.concatenate([one.masks for one in moved]))
    assert found.result.registered is not None
    right = np.concatenate([shot.masks for shot in shots[:2]])
    off, left = (np.mean(np.abs(one.masks - right)) for one in (found.shot, found.result.registered))
    assert left < 0.1 * off


@pytest.mark.slow
def test_exposures_that_nothing_ties_are_refused():
    small = (32, 40)
    untold = [adjacent(room(seed, small), small, seed, 1, staged=False)[0] for seed in (1, 2)]
    with pytest.raises(GeometryError, match="nothing ties"):
        reconstruct_together(untold, SETTINGS)


@pytest.mark.slow
def test_exposures_without_a_stage_are_tied_by_what_they_show():
    rng, shots = np.random.default_rng(0), []
    for at in PLACES[:3]:
        poses = np.tile(at, (6, 1, 1))
        poses[:, 0, 3] -= np.linspace(-0.06, 0.06, 6)
        views = np.stack([seen(pose, textures(0))[0] for pose in poses])
        masks = (rng.random(views.shape[:3]) < 0.3).astype(np.float32)
        coded = np.einsum("nhw,nhwc->hwc", masks, views)
        shots.append(Shot(coded, masks, intrinsics=pinhole(FOCAL_PX, views.shape[1:3]), truth=Truth(views, poses)))
    found = reconstruct_together(shots, SETTINGS)
    assert found.left_out == ()
    truth = np.concatenate([shot.truth.world_to_camera for shot in shots])
    assert trajectory_errors(found.result.world_to_camera, truth).nate < 0.03


@pytest.mark.slow
def test_an_exposure_whose_place_the_stage_misreports_is_placed_by_its_pictures():
    size = (96, 128)
    shots = adjacent(room(0, size), size, 0, 4, step=0.25, noise=0.01)
    off = shots[1].telemetry_world_to_camera.copy()
    off[:, 1, 3] += 0.6
    wrong = replace(shots[1], telemetry_world_to_camera=off)
    found = reconstruct_together([shots[0], wrong, *shots[2:]], SETTINGS)
    told = [note for note in found.result.notes if note.code is Code.EXPOSURE_PLACED_OTHERWISE]
    assert [note.figures["name"] for note in told] == ["path 1"]
    truth = np.concatenate([shot.truth.world_to_camera for shot in shots])
    assert trajectory_errors(found.result.world_to_camera, truth).nate < 0.02


def test_exposures_of_different_cameras_are_refused(shots):
    smaller = adjacent(room(0, (40, 64)), (40, 64), 0, 1)
    with pytest.raises(InputError, match="size"):
        reconstruct_together([shots[0], *smaller], SETTINGS)
    with pytest.raises(InputError, match="no exposures"):
        reconstruct_together([], SETTINGS)


@pytest.mark.parametrize(
    ("changes", "said"),
    [({"motion": "on"}, "things move"), ({"fine": FineSettings()}, "fine stage")],
)
def test_what_several_exposures_cannot_have_is_refused(shots, changes, said):
    with pytest.raises(InputError, match=said):
        reconstruct_together(shots, replace(SETTINGS, **changes))
