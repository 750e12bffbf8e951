"""What a shot's check refuses beyond shapes and axes: numbers of a size that no bench gives."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.records import (
    FOCAL_RANGE_PX,
    LONGEST_TYPICAL_SHARE,
    MEASUREMENT_LIMIT,
    POSITION_LIMIT,
    PRINCIPAL_POINT_LIMIT_PX,
    WEIGHT_RANGE,
    Shot,
    Truth,
    check_intrinsics,
    check_rigid,
)


@pytest.fixture
def shot():
    return Shot(np.ones((4, 5, 1), np.float32), np.ones((2, 4, 5), np.float32), np.ones(2, np.float32)).check()


@pytest.mark.parametrize("weights", [[-0.1, 1], [0, 0]])
def test_weights_that_no_exposure_has_are_refused(shot, weights):
    with pytest.raises(InputError, match=r"mask weights.*what to do: give for each mask the share of its interval"):
        replace(shot, weights=np.array(weights, np.float32)).check()


@pytest.mark.parametrize(
    ("part", "remedy"),
    [
        ("measurement", "--bad-pixels median"),
        ("masks", "every mask to 0 at these pixels"),
        ("weights", "share of its interval"),
        ("intrinsics", "leave them out"),
    ],
)
def test_what_to_do_about_numbers_that_are_not_finite_depends_on_what_holds_them(shot, part, remedy):
    shot = replace(shot, intrinsics=np.diag([4.0, 4.0, 1.0]))
    damaged = getattr(shot, part).copy()
    damaged.flat[0] = np.nan
    with pytest.raises(InputError, match=f"{part} holds 1 values that are NaN") as refused:
        replace(shot, **{part: damaged}).check()
    assert remedy in refused.value.remedy


def test_a_mask_that_is_closed_where_it_was_not_finite_is_taken(shot):
    masks = shot.masks.copy()
    masks[:, 0, 0] = 0
    assert not replace(shot, masks=masks).check().usable[0, 0]


@pytest.mark.parametrize(
    ("depth", "problem"),
    [
        (np.ones((4, 12, 15), np.float32), r"true depth has shape \[4, 12, 15\]"),
        (np.full((4, 12, 16), np.nan, np.float32), "true depth holds 768 values that are NaN"),
        (np.full((4, 12, 16), -1, np.float32), "true depth holds negative values"),
    ],
)
def test_a_true_depth_that_is_none_is_refused(make_shot, depth, problem):
    with pytest.raises(InputError, match=problem):
        make_shot(truth=Truth(depth=depth)).check()
    assert make_shot(truth=Truth(depth=np.zeros((4, 12, 16), np.float32))).check().truth.depth is not None


def test_masks_of_which_those_with_a_weight_are_closed_are_refused(shot):
    masks = shot.masks.copy()
    masks[1] = 0
    with pytest.raises(InputError, match="every mask is closed or has weight zero"):
        replace(shot, masks=masks, weights=np.array([0, 1], np.float32)).check()


@pytest.mark.parametrize("name", ["measurement", "masks"])
def test_a_shot_without_measurement_or_masks_is_none(shot, name):
    with pytest.raises(InputError, match=f"{name} of a shot is NoneType.*allowed: a numpy array"):
        replace(shot, **{name: None})


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("truth", np.ones((2, 4, 5, 1), np.float32)),
        ("truth", None),
        ("name", None),
        ("name", 3),
        ("provenance", None),
        ("provenance", ["a"]),
    ],
)
def test_other_parts_than_arrays_are_held_to_their_kinds(shot, name, other):
    with pytest.raises(InputError, match=f"{name} of a shot is {type(other).__name__}; allowed: .*or leave it out"):
        replace(shot, **{name: other}).check()


def still():
    return np.repeat(np.eye(4)[None], 2, axis=0)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_measurement_far_beyond_full_scale_is_refused(shot, sign):
    most = np.full_like(shot.measurement, sign * MEASUREMENT_LIMIT)
    replace(shot, measurement=most).check()
    with pytest.raises(InputError, match="full scales of a view"):
        replace(shot, measurement=2 * most).check()


@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 2), (0, 5, 1), (4, 0, 3), (2, 4, 5, 3)])
def test_a_measurement_that_is_no_image_is_refused(shot, shape):
    with pytest.raises(InputError, match="measurement has shape"):
        replace(shot, measurement=np.ones(shape, np.float32), masks=np.ones((2, *shape[:2]), np.float32)).check()


@pytest.mark.parametrize(("value", "remedy"), [(-0.01, "set what lies below 0 to 0"), (1.5, "--mask-scale")])
def test_masks_beyond_their_range_are_refused_with_what_helps(shot, value, remedy):
    masks = shot.masks.copy()
    masks[0, 0, 0] = value
    with pytest.raises(InputError, match="masks reach from") as refused:
        replace(shot, masks=masks).check()
    assert remedy in refused.value.remedy


def test_masks_hardly_above_one_are_told_with_enough_digits(shot):
    masks = shot.masks.copy()
    masks[0, 0, 0] = np.nextafter(np.float32(1), np.float32(2))
    with pytest.raises(InputError, match=r"masks reach from .* to 1\.00000012"):
        replace(shot, masks=masks).check()


def test_masks_that_let_next_to_nothing_through_are_refused(shot):
    with pytest.raises(InputError, match="no mask lets through more than"):
        replace(shot, masks=shot.masks * np.float32(1e-7)).check()


def test_weights_out_of_range_are_refused(shot):
    for weight in (WEIGHT_RANGE[0], LONGEST_TYPICAL_SHARE):
        replace(shot, weights=np.array([0, weight], np.float32)).check()
    for weight in (0.1 * WEIGHT_RANGE[0], 10 * WEIGHT_RANGE[1]):
        with pytest.raises(InputError, match="largest mask weight"):
            replace(shot, weights=np.array([0, weight], np.float32)).check()


def test_exposure_times_in_place_of_weights_are_refused(shot):
    with pytest.raises(InputError, match=r"weights are 12\.5 in the median.*too dark.*divide exposure times"):
        replace(shot, weights=np.array([12.5, 12.5], np.float32)).check()


@pytest.mark.parametrize("damage", ["stretched", "mirrored", "bottom row", "far away"])
def test_poses_that_are_no_rigid_motions_are_refused(damage):
    poses = still()
    if damage == "stretched":
        poses[1, :3, :3] *= 1.01
    elif damage == "mirrored":
        poses[1, 0, 0] = -1
    elif damage == "bottom row":
        poses[1, 3] = (0, 0, 1, 1)
    else:
        poses[1, 0, 3] = 10 * POSITION_LIMIT
    with pytest.raises(InputError, match="telemetry poses are no rigid motions"):
        check_rigid("telemetry poses", poses)


def test_poses_rounded_to_four_digits_pass():
    angle = 0.3
    poses = still()
    poses[1, :2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    check_rigid("telemetry poses", poses.round(4))


@pytest.mark.parametrize(
    ("focal_px", "centre_px"),
    [
        (0.1 * FOCAL_RANGE_PX[0], 0),
        (10 * FOCAL_RANGE_PX[1], 0),
        (-50, 0),
        (50, 2 * PRINCIPAL_POINT_LIMIT_PX),
        (50, -2 * PRINCIPAL_POINT_LIMIT_PX),
    ],
)
def test_a_camera_out_of_range_is_refused(focal_px, centre_px):
    check_intrinsics(np.array([[50.0, 0, 3], [0, 50, 3], [0, 0, 1]]))
    with pytest.raises(InputError, match="intrinsics"):
        check_intrinsics(np.array([[focal_px, 0, centre_px], [0, 50, 0], [0, 0, 1]]))


@pytest.mark.parametrize("place", [(2, 0), (2, 1), (2, 2)])
def test_a_last_row_other_than_0_0_1_is_refused_beyond_rounding(place):
    matrix = np.array([[50.0, 0, 3], [0, 50, 3], [0, 0, 1]])
    matrix[place] += 5e-9
    check_intrinsics(matrix)
    matrix[place] += 2e-5
    with pytest.raises(InputError, match=r"intrinsics.*fx, 0, cx"):
        check_intrinsics(matrix)


@pytest.mark.parametrize("place", [(0, 1), (1, 0)])
def test_a_skew_is_refused_as_no_part_of_the_solver_knows_one(place):
    matrix = np.array([[500.0, 0, 3], [0, 500, 3], [0, 0, 1]])
    matrix[place] = 0.4  # what a calibration that fits it leaves by its noise
    check_intrinsics(matrix)
    matrix[place] = 4
    with pytest.raises(InputError, match=r"intrinsics.*fx, 0, cx"):
        check_intrinsics(matrix)


LENS = np.array([-0.1, 0, 0, 0, 0])


def test_a_lens_needs_the_camera_matrix_that_it_was_measured_with(shot):
    camera = np.array([[6.0, 0, 2.5], [0, 6, 2], [0, 0, 1]])
    replace(shot, intrinsics=camera, distortion=LENS).check()
    with pytest.raises(InputError, match="without intrinsics"):
        replace(shot, distortion=LENS).check()


def test_a_lens_that_folds_the_frame_is_refused(shot):
    camera = np.array([[1.0, 0, 2.5], [0, 1, 2], [0, 0, 1]])
    with pytest.raises(InputError, match="folds the picture over"):
        replace(shot, intrinsics=camera, distortion=LENS).check()


def test_lit_are_the_pixels_that_light_reached_through_a_mask_of_some_weight(shot):
    masks = np.zeros_like(shot.masks)
    masks[0, :2], masks[1, :, :3] = 1, 0.25
    seen = replace(shot, masks=masks, weights=np.array([0, 1], np.float32))
    np.testing.assert_array_equal(seen.lit, masks[1] > 0)


def test_usable_are_the_lit_pixels_that_are_not_saturated(shot):
    saturated = np.zeros(shot.size, bool)
    saturated[0, 0] = True
    np.testing.assert_array_equal(replace(shot, saturated=saturated).usable, shot.lit & ~saturated)
    np.testing.assert_array_equal(replace(shot, saturated=None).usable, shot.lit)


def test_a_tensor_of_the_right_type_is_not_copied():
    torch = pytest.importorskip("torch")
    masks = torch.ones(2, 4, 5)
    shot = Shot(np.ones((4, 5, 1), np.float32), masks)
    assert np.shares_memory(shot.masks, masks.numpy())


def test_an_array_of_the_right_type_and_layout_is_not_copied(shot):
    again = replace(shot)
    assert again.masks is shot.masks
    assert again.measurement is shot.measurement


@pytest.mark.parametrize(
    "laid_out",
    [
        lambda array: array[::-1],
        lambda array: array[:, ::-1],
        lambda array: array[..., ::-1],
        np.asfortranarray,
        lambda array: np.broadcast_to(array[:1], array.shape),
        lambda array: np.repeat(array, 2, axis=1)[:, ::2],
        lambda array: np.frombuffer(array.tobytes(), array.dtype).reshape(array.shape),
    ],
    ids=["reversed", "upside down", "mirrored", "columns first", "broadcast", "every second", "read-only"],
)
def test_arrays_of_any_layout_become_such_as_torch_takes(laid_out):
    """A shot of another layout has the same numbers as one of its copies."""
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(0)
    given = {
        "measurement": laid_out(rng.random((4, 5, 3), np.float32)),
        "masks": laid_out(rng.random((2, 4, 5), np.float32)),
        "telemetry_world_to_camera": laid_out(rng.random((2, 4, 4))),
        "saturated": laid_out(rng.random((4, 5)) < 0.5),
    }
    views = laid_out(rng.random((2, 4, 5, 3), np.float32))
    shot = Shot(**given, truth=Truth(views=views))
    for taken, array in ((shot.truth.views, views), *((getattr(shot, name), array) for name, array in given.items())):
        np.testing.assert_array_equal(taken, array)
        assert taken.flags.c_contiguous
        assert taken.flags.writeable
        torch.from_numpy(taken)


def test_masked_numbers_are_refused_as_they_would_be_taken_for_readings(shot):
    for kind in (np.float32, np.float64):
        array = np.ma.masked_less(np.arange(20, dtype=kind).reshape(4, 5, 1), 3)
        with pytest.raises(InputError, match=r"measurement of a shot is MaskedArray.*some of its numbers are masked"):
            replace(shot, measurement=array)
    assert type(replace(shot, measurement=np.ma.array(shot.measurement)).measurement) is np.ndarray


def test_shots_are_compared_as_objects(shot):
    """A comparison of arrays has no single answer, and a shot in a set or a dictionary needs a hash."""
    assert shot == shot  # noqa: PLR0124
    assert shot != replace(shot)
    assert {shot: 1, shot.truth: 2}[shot] == 1
