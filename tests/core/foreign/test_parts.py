"""Keys, single pixels, cameras and poses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import gs2ci
from gs2ci.core.errors import InputError
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.container import Array
from gs2ci.core.foreign.opening import load_single
from gs2ci.core.foreign.options import ImportOptions

MATRIX = np.array([[30.0, 0, 16], [0, 31.0, 12], [0, 0, 1]])


def poses(n=5):
    angle = np.linspace(0.1, 0.3, n)
    stack = np.tile(np.eye(4), (n, 1, 1))
    stack[:, 0, 0], stack[:, 0, 2] = np.cos(angle), np.sin(angle)
    stack[:, 2, 0], stack[:, 2, 2] = -np.sin(angle), np.cos(angle)
    stack[:, 0, 3] = np.arange(1, n + 1)
    return stack


def tum(n=5):
    inverse = np.linalg.inv(poses(n))
    return np.c_[np.arange(n), inverse[:, :3, 3], Rotation.from_matrix(inverse[:, :3, :3]).as_quat()]


def test_the_first_of_several_known_names_is_taken_and_said(scene, take, said):
    made = scene()
    imported = take(meas=made.meas, y=made.meas * 2, mask=made.masks)
    assert said(imported, "measurement: key 'meas', not 'y'; choose with --meas-key")
    chosen = take(ImportOptions(meas_key="y", scale=2.0), meas=made.meas * 0, y=made.meas * 2, mask=made.masks)
    assert np.allclose(chosen.shots[0].measurement, made.meas)


def test_names_do_not_depend_on_case_and_a_lone_array_needs_none(scene, take, said):
    made = scene()
    assert take(Meas=made.meas, MASK=made.masks).shots[0].views == 4
    lone = take(meas=made.meas, stuff=made.masks)
    assert said(lone, "masks: key 'stuff', the only array without a known name")


@pytest.mark.parametrize("last", [False, True])
def test_of_two_arrays_without_known_names_the_stack_is_the_masks(scene, take, said, last):
    """As np.savez("file.npz", measurement, masks) names them."""
    made = scene(channels=1)
    imported = take(arr_1=made.meas[..., 0], arr_0=np.moveaxis(made.masks, 0, -1) if last else made.masks)
    assert np.array_equal(imported.shots[0].masks, made.masks)
    assert said(imported, "measurement: key 'arr_1', of two arrays without known names the one with an axis less")
    assert said(take(ImportOptions(meas_key="arr_1"), arr_1=made.meas[..., 0], arr_0=made.masks), "masks: key 'arr_0'")
    with pytest.raises(InputError, match="no key for the measurement"):
        take(a=made.meas[..., 0], b=made.masks[:, 1:])


def test_coordinates_and_maps_of_defects_are_no_pictures_and_no_masks(scene, take, said):
    """xarray writes the axes y and mask beside a picture; "mask" of a camera's pictures are their bad pixels."""
    made = scene(n=4, channels=1)
    axes = {"y": np.arange(24) * 0.1, "x": np.arange(32) * 0.1, "mask": np.arange(4)}
    for extra in (axes, {"mask": np.zeros((24, 32), bool)}):
        shot = take(image=made.meas[..., 0], patterns=made.masks, **extra).shots[0]
        assert np.array_equal(shot.masks, made.masks)
        assert np.allclose(shot.measurement, made.meas, atol=1e-6)
    assert said(take(y=made.meas[..., 0], masks=made.masks), "keys: 'y' (measurement)")


def test_matlabs_scalars_are_no_images(scene, take, said):
    made = scene()
    imported = take(meas=made.meas, stuff=made.masks, note=np.array([[3.0]]), rates=np.arange(4.0)[None])
    assert said(imported, "masks: key 'stuff', the only array without a known name")


def test_keys_that_are_not_there_are_refused_with_those_that_are(scene, take):
    made = scene()
    with pytest.raises(InputError, match=r"no key for the measurement; the file holds mask \[4, 24, 32\].*--meas-key"):
        take(mask=made.masks, a=np.ones((2, 2)), b=np.ones((2, 2)))
    with pytest.raises(InputError, match="no key 'nope'; allowed: the file holds"):
        take(ImportOptions(mask_key="nope"), meas=made.meas, mask=made.masks)
    with pytest.raises(InputError, match="no key for the masks"):
        take(ImportOptions(mask_key="none"), meas=made.meas, mask=made.masks)


def test_only_the_first_masks_are_used_when_said(scene, take):
    made = scene(n=6)
    meas = np.einsum("nhw,nhwc->hwc", made.masks[:4], made.views[:4] / 255.0)
    shot = take(ImportOptions(views=4), meas=meas, mask=made.masks).shots[0]
    assert np.array_equal(shot.masks, made.masks[:4])
    for bad in (0, 7):
        with pytest.raises(InputError, match="allowed: 1 to 6"):
            take(ImportOptions(views=bad), meas=meas, mask=made.masks)


def test_weights_are_read_and_must_fit(scene, take, said):
    made = scene()
    weights = np.array([[1, 0.5, 1, 1]])
    meas = np.einsum("n,nhw,nhwc->hwc", weights[0], made.masks, made.views / 255.0)
    imported = take(meas=meas, mask=made.masks, truth=made.views, weights=weights)
    assert imported.shots[0].weights.tolist() == [1, 0.5, 1, 1]
    assert said(imported, "explains the measurement")
    assert said(imported, "key 'weights': weights of the masks, 0.5 to 1")
    for bad in (np.ones(3), -np.ones(4), np.full(4, np.nan), np.zeros(4)):
        with pytest.raises(InputError, match="key 'weights'"):
            take(meas=meas, mask=made.masks, weights=bad)


@pytest.mark.parametrize("unit", [12.5, 0.0125])
def test_exposure_times_in_place_of_weights_are_divided_by_the_longest(scene, take, said, unit):
    made = scene()
    weights = np.array([0.8, 1, 1, 1])
    meas = 255 * np.einsum("n,nhw,nhwc->hwc", weights, made.masks, made.views / 255.0)
    told = [take(meas=meas, mask=made.masks, weights=given) for given in (weights, unit * weights)]
    assert not said(told[0], "exposure times")
    assert said(told[1], "key 'weights': no shares of an interval, which are about 1: taken as exposure times")
    (right,), (shot,) = (imported.shots for imported in told)
    assert np.allclose(shot.weights, weights)
    assert np.allclose(shot.measurement, right.measurement)


@pytest.mark.parametrize("holder", ["meas.npz", "masks.npz"])
@pytest.mark.parametrize("count", [6, 4], ids=["all", "used"])
def test_weights_may_lie_beside_the_masks_and_cover_those_that_are_not_used(scene, tmp_path, holder, count):
    made = scene(n=6)
    weights = np.array([0.4, 0.6, 0.8, 1, 0.2, 0.3])
    meas = np.einsum("n,nhw,nhwc->hwc", weights[:4], made.masks[:4], made.views[:4] / 255.0)
    files = {"meas.npz": {"meas": meas}, "masks.npz": {"mask": made.masks}}
    files[holder]["weights"] = weights[:count]
    for name, arrays in files.items():
        np.savez(tmp_path / name, **arrays)
    imported = import_shots(tmp_path / "meas.npz", tmp_path / "masks.npz", ImportOptions(views=4))
    assert np.allclose(imported.shots[0].weights, weights[:4])
    assert any("weights of the masks" in guess and holder in guess for guess in imported.guesses)


def test_bad_pixels_are_refused_or_replaced_from_their_neighbours(scene, take, said):
    made = scene(n=6, height=40, width=40)
    meas = made.meas.copy()
    meas[3, 5] = np.nan
    meas[0, 0, 1] = np.inf
    meas[20, 20] = 1e300
    with pytest.raises(InputError, match=r"key 'meas': 3 pixels.*row 0, column 0.*--bad-pixels median"):
        take(meas=meas, mask=made.masks)
    imported = take(ImportOptions(bad_pixels="median"), meas=meas, mask=made.masks)
    assert said(imported, "3 bad pixels replaced")
    measurement = imported.shots[0].measurement
    good = np.isfinite(meas) & (np.abs(meas) < 1e9)
    assert np.array_equal(measurement[good], made.meas[good].astype(np.float32))
    assert np.abs(measurement - made.meas).max() < 1.2


def test_dark_minus_lit_is_refused_and_a_dark_picture_about_zero_is_not(scene, take):
    made = scene(channels=1)
    with pytest.raises(InputError, match=r"100% of the readings lie below.*subtract the dark frame from the lit one"):
        take(meas=-made.meas[..., 0] - 1e-3, mask=made.masks)
    with pytest.raises(InputError, match="correct --offset"):
        take(ImportOptions(offset=99.0), meas=made.meas[..., 0], mask=made.masks)
    noise = np.random.default_rng(0).normal(size=made.meas.shape[:2])
    assert take(ImportOptions(scale=1.0), meas=noise, mask=made.masks).shots[0].measurement.shape == (24, 32, 1)


@pytest.mark.parametrize("offset", [0.0, 40.0, 256.0])
def test_a_bad_pixel_is_replaced_by_light_per_open_mask_without_the_offset(take, offset):
    masks = np.random.default_rng(3).random((8, 40, 50)) < 0.5
    light = 50.0 * masks.sum(axis=0)  # a scene of one brightness
    meas = offset + light
    bad = [(5, 6), (10, 20), (30, 41), (21, 11), (39, 49)]
    for place in bad:
        meas[place] = np.nan
    options = ImportOptions(bad_pixels="median", scale=100.0, offset=offset)
    measurement = take(options, meas=meas, mask=masks.astype(np.float64)).shots[0].measurement[..., 0]
    assert np.allclose(measurement, light / 100.0, atol=1e-6)


def test_too_many_bad_pixels_are_no_measurement(scene, take):
    made = scene()
    meas = made.meas.copy()
    meas[:6] = np.nan
    for options in (ImportOptions(bad_pixels="median"), ImportOptions()):  # which would not help
        with pytest.raises(InputError, match="what to do: mend the measurement"):
            take(options, meas=meas, mask=made.masks)


def test_a_pixel_without_any_good_neighbour_becomes_dark(take):
    meas = np.ones((3, 5))
    meas[1, 1] = np.nan  # its neighbours lie two apart: only (1, 3), which no mask opens
    masks = np.ones((2, 3, 5))
    masks[:, 1, 3] = 0
    for offset in (0.0, 0.5):
        options = ImportOptions(bad_pixels="median", scale=1.0, offset=offset)
        assert take(options, meas=meas, mask=masks).shots[0].measurement[1, 1, 0] == 0


def test_clipping_is_told_with_its_share_and_warned_of_where_it_is_much(scene, take, said):
    made = scene(n=8, height=40, width=50, channels=1)
    counts = np.rint(made.meas * 60)
    few, many = (float(np.quantile(counts, 1 - share)) for share in (0.01, 0.5))
    told = take(ImportOptions(saturation=few), meas=counts, mask=made.masks)
    assert said(told, "of all) at")
    assert not said(told, "WARNING")
    assert said(take(ImportOptions(saturation=many), meas=counts, mask=made.masks), "WARNING: ")


def test_a_pile_up_at_the_top_code_counts_as_clipped(scene, take):
    made = scene(n=8, height=40, width=50, channels=1)
    meas = np.minimum(np.rint(made.meas * 60), 254).astype(np.uint8)
    top = meas >= np.sort(meas.ravel())[-20]
    meas[top] = 255
    shot = take(meas=meas, mask=made.masks).shots[0]
    assert np.array_equal(shot.saturated, top[..., 0])
    assert take(ImportOptions(saturation=0.0), meas=meas, mask=made.masks).shots[0].saturated is None
    told = take(ImportOptions(saturation=100.0), meas=meas, mask=made.masks).shots[0]
    assert np.array_equal(told.saturated, (meas >= 100)[..., 0])


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_a_pile_up_at_the_top_code_in_the_high_bits_counts_as_clipped(scene, take, bits):
    made = scene(n=8, height=40, width=50, channels=1)
    top = 2**bits - 1
    meas = np.minimum(np.rint(made.meas * top / 3), top).astype(np.uint16)
    assert (meas == top).sum() > 0
    shot = take(meas=meas << (16 - bits), mask=made.masks).shots[0]
    assert np.array_equal(shot.saturated, (meas == top)[..., 0])


@pytest.mark.parametrize("level", [4031.0, 1.0, 0.1])
@pytest.mark.parametrize("channels", [1, 3])
def test_a_pile_up_at_another_level_is_pointed_out_with_an_option_that_works(scene, take, said, level, channels):
    """Readings without their black level, or divided by their largest one, no longer end at a converter's code."""
    made = scene(n=8, height=40, width=50, channels=channels)
    meas = np.minimum(made.meas / np.quantile(made.meas, 0.98), 1) * level
    imported = take(meas=meas, mask=made.masks)
    assert imported.shots[0].saturated is None
    assert said(imported, f"are exactly {level:.6g}, the largest, behind different numbers of open masks")
    words = next(guess for guess in imported.guesses if "are exactly" in guess).split()
    stated = take(ImportOptions(saturation=float(words[words.index("--saturation") + 1])), meas=meas, mask=made.masks)
    assert np.array_equal(stated.shots[0].saturated, (meas == level).any(axis=2))
    exact = take(ImportOptions(saturation=0.0), meas=meas, mask=made.masks)
    assert exact.shots[0].saturated is None
    assert not said(exact, "are exactly")


@pytest.mark.parametrize("steps", [0, 20, 255])
def test_a_white_scene_and_coarse_readings_are_not_said_to_be_clipped(take, said, scene, steps):
    made = scene(n=8, height=60, width=80, channels=1)
    white = np.minimum(made.views / np.quantile(made.views, 0.05), 1)
    meas = np.einsum("nhw,nhwc->hwc", made.masks, white) if steps == 0 else np.rint(made.meas * steps / 5)
    assert (meas == meas.max()).sum() >= (10 if steps == 0 else 1)
    assert not said(take(meas=meas, mask=made.masks), "are exactly")


@pytest.mark.parametrize("level", [np.nan, np.inf, -1.0])
def test_a_level_of_clipping_that_is_no_reading_is_refused(scene, take, level):
    made = scene(channels=1)
    with pytest.raises(InputError, match="--saturation"):
        take(ImportOptions(saturation=level), meas=made.meas, mask=made.masks)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"K": MATRIX}, MATRIX),
        ({"K": MATRIX.T}, MATRIX),
        ({"K": np.array([30.0, 31.0, 16.0, 12.0])}, MATRIX),
        ({"K": MATRIX.reshape(9)}, MATRIX),
        ({"K": np.pad(MATRIX, ((0, 0), (0, 1)))}, MATRIX),
        ({"K": np.pad(MATRIX, ((0, 1), (0, 1))) + np.diag([0, 0, 0, 1])}, MATRIX),
        ({"intrinsics": np.stack([MATRIX] * 4)}, MATRIX),
        ({"focal": 30.0}, np.array([[30.0, 0, 16], [0, 30.0, 12], [0, 0, 1]])),
        ({}, None),
    ],
)
def test_intrinsics_come_in_every_usual_form(scene, take, said, given, expected):
    made = scene()
    imported = take(meas=made.meas, mask=made.masks, **given)
    matrix = imported.shots[0].intrinsics
    assert (matrix is None and expected is None) or np.array_equal(matrix, expected)
    assert said(imported, "camera:")


LENS = np.array([-0.1, 0.02, 1e-3, -1e-3, 0.0])


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"distortion": LENS}, LENS),
        ({"dist_coeffs": LENS[None]}, LENS),
        ({"distCoeffs": np.append(LENS, [0.0, 0, 0])[:, None]}, LENS),
        ({"distortion_coefficients": LENS[:4]}, LENS),
        ({}, None),
    ],
)
def test_a_lens_comes_as_opencv_hands_it_out(scene, take, said, given, expected):
    made = scene()
    imported = take(meas=made.meas, mask=made.masks, K=MATRIX, **given)
    lens = imported.shots[0].distortion
    assert (lens is None and expected is None) or np.array_equal(lens, expected)
    assert bool(given) == bool(said(imported, "lens: k1 -0.1"))


def test_the_users_lens_goes_before_the_files(scene, take):
    made = scene()
    options = ImportOptions(distortion=Array("--distortion", 2 * LENS), intrinsics=Array("x", MATRIX))
    shot = take(options, meas=made.meas, mask=made.masks, distortion=LENS).shots[0]
    assert np.array_equal(shot.distortion, 2 * LENS)


def test_a_files_lens_without_a_camera_matrix_is_left_out_and_the_users_is_refused(scene, take, said):
    made = scene()
    imported = take(meas=made.meas, mask=made.masks, distortion=LENS)
    assert imported.shots[0].distortion is None
    assert said(imported, "without a camera matrix was left out")
    with pytest.raises(InputError, match="without intrinsics"):
        take(ImportOptions(distortion=Array("--distortion", LENS)), meas=made.meas, mask=made.masks)


@pytest.mark.parametrize("numbers", [LENS[:3], np.append(LENS, [0.0, 0.1])])
def test_lenses_of_other_models_are_refused(scene, take, numbers):
    made = scene()
    with pytest.raises(InputError, match=r"key 'distortion'.*k1 k2 p1 p2"):
        take(meas=made.meas, mask=made.masks, K=MATRIX, distortion=numbers)


def test_intrinsics_that_are_none_or_change_are_refused(scene, take):
    made = scene()
    with pytest.raises(InputError, match=r"key 'K'.*fx and fy from"):
        take(meas=made.meas, mask=made.masks, K=np.zeros((3, 3)))
    with pytest.raises(InputError, match="key 'K'"):
        take(meas=made.meas, mask=made.masks, K=np.ones(7))
    with pytest.raises(InputError, match="change from view to view"):
        take(meas=made.meas, mask=made.masks, K=np.stack([MATRIX, MATRIX + np.eye(3)]))
    with pytest.raises(InputError, match="both given"):
        take(ImportOptions(focal_px=3.0, intrinsics=Array("x", MATRIX)), meas=made.meas, mask=made.masks)
    with pytest.raises(InputError, match="--focal-px"):
        take(ImportOptions(focal_px=-3.0), meas=made.meas, mask=made.masks)


def test_doubtful_intrinsics_are_said(scene, take, said):
    made = scene()
    outside = MATRIX.copy()
    outside[0, 2] = 99
    assert said(take(meas=made.meas, mask=made.masks, K=outside), "lies far from the middle")
    assert said(take(meas=made.meas, mask=made.masks, focal=3.0), "unusual")
    shares = np.array([[0.9, 0, 0.5], [0, 1.1, 0.5], [0, 0, 1]])
    assert said(take(meas=made.meas, mask=made.masks, K=shares), "shares of the width multiplied by 32")


@pytest.mark.parametrize(
    "given",
    [
        {"world_to_camera": poses()},
        {"w2c": poses()[:, :3]},
        {"extrinsics": poses().transpose(1, 2, 0)[:3]},
        {"w2c": poses().transpose(0, 2, 1)},
        {"c2w": np.linalg.inv(poses())},
        {"w2c": np.linalg.inv(poses())[:, :3].reshape(5, 12)},
        {"w2c": tum()},
    ],
    ids=["4x4", "3x4", "counted last", "transposed", "inverse", "KITTI", "TUM"],
)
def test_poses_come_in_every_usual_form(scene, take, said, given):
    made = scene(n=5)
    imported = take(meas=made.meas, mask=made.masks, **given)
    assert np.allclose(imported.shots[0].truth.world_to_camera, poses())
    assert said(imported, f"key '{next(iter(given))}': true poses")


@pytest.mark.parametrize("form", ["first", "last"])
def test_four_poses_show_their_counting_axis_by_their_last_rows(scene, take, form):
    made = scene(n=4)
    stack = poses(4) if form == "first" else poses(4).transpose(1, 2, 0)
    assert np.allclose(take(meas=made.meas, mask=made.masks, w2c=stack).shots[0].truth.world_to_camera, poses(4))


def test_telemetry_is_kept_apart_from_the_truth(scene, take, said):
    made = scene(n=5)
    imported = take(meas=made.meas, mask=made.masks, telemetry_world_to_camera=poses())
    (shot,) = imported.shots
    assert said(imported, "key 'telemetry_world_to_camera': poses of the stage")
    assert np.array_equal(shot.telemetry_world_to_camera, poses())
    assert shot.truth.world_to_camera is None


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (poses(3), r"\[3, 4, 4\] for 5 views"),
        (poses() * 2, "no rigid motions"),
        (poses() * np.array([1, 1, -1, 1.0])[:, None], "no rigid motions"),
        (poses() * np.nan, "NaN"),
        (poses() * 1e200, "NaN"),
        (tum() * np.array([1, 1, 1, 1, 0, 0, 0, 0]), "row 1 holds no pose"),
        (np.ones((5, 12)), "no rigid motions"),
    ],
)
def test_poses_that_are_none_are_refused(scene, take, given, message):
    made = scene(n=5)
    with pytest.raises(InputError, match=f"key 'world_to_camera'.*{message}"):
        take(meas=made.meas, mask=made.masks, world_to_camera=given)


def test_one_pose_of_one_view_needs_no_counting_axis(scene, take):
    made = scene(n=1)
    shot = take(meas=made.meas, mask=made.masks, world_to_camera=np.eye(4)).shots[0]
    assert np.array_equal(shot.truth.world_to_camera, np.eye(4)[None])


def test_a_colour_filter_that_is_a_number_is_no_text(scene, take):
    made = scene(channels=1)
    with pytest.raises(InputError, match="key 'cfa': holds no text; allowed: a text; what to do: leave it out"):
        take(meas=made.meas, mask=made.masks, cfa=0)


def test_a_file_for_a_single_array_may_hold_only_one(tmp_path):
    np.savez(tmp_path / "one.npz", anything=np.eye(3))
    assert np.array_equal(load_single(tmp_path / "one.npz").values, np.eye(3))
    np.savez(tmp_path / "two.npz", a=np.eye(3), b=np.eye(3))
    with pytest.raises(InputError, match="a single array of numbers"):
        load_single(tmp_path / "two.npz")


def test_of_several_arrays_that_of_the_true_views_is_told_by_its_name(scene, tmp_path):
    made = scene()
    np.savez(tmp_path / "truth.npz", truth=made.views, depth=made.views[..., 0])
    path = tmp_path / "shot.npz"
    np.savez(path, meas=made.meas, mask=made.masks)
    views = gs2ci.load(path, truth=tmp_path / "truth.npz").truth.views
    named = gs2ci.load(path, truth=tmp_path / "truth.npz", truth_key="truth").truth.views
    assert np.allclose(views, made.views / 255)
    assert np.array_equal(views, named)
    np.savez(tmp_path / "other.npz", a=made.views, b=made.views)
    with pytest.raises(InputError, match="one of several named truth, orig"):
        gs2ci.load(path, truth=tmp_path / "other.npz")


def test_masks_in_place_of_the_measurement_are_recognised(scene, take):
    made = scene(channels=1)
    with pytest.raises(InputError, match=r"two values alone, as masks have.*exchange the two"):
        take(meas=made.masks, mask=made.meas)
