"""White and dark frames, exposures with masks of their own, and what a file holds beside."""

import h5py
import numpy as np
import pytest

from gs2ci.commands.import_ import run
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.container import Array
from gs2ci.core.foreign.fields import FieldFrame, frame_from, response
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.storage import read_shot


@pytest.fixture
def bench(scene):
    """A grey exposure in counts, its masks, and what the sensor sees of an even light."""
    made = scene(n=6, height=64, width=80, channels=1)
    rows, columns = np.mgrid[:64, :80]
    fall = 1 - 0.5 * np.hypot(rows - 32, columns - 40) / np.hypot(32, 40)
    views = 80 + 0.6 * made.views[..., 0].astype(float)
    return made.masks, np.einsum("nhw,nhw->hw", made.masks, views), fall


def test_readings_are_divided_by_the_white_frame(bench, take, said):
    """F7: keys were not mentioned; 19.8 instead of 22.5 dB."""
    masks, meas, fall = bench
    shot = take(ImportOptions(scale=255.0), meas=meas * fall, masks=masks, white=1000 * fall).shots[0]
    assert np.abs(shot.measurement[..., 0] * 255 - meas).max() < 0.02 * meas.max()
    left = take(ImportOptions(scale=255.0, white_key="none"), meas=meas * fall, masks=masks, white=1000 * fall)
    assert np.allclose(left.shots[0].measurement[..., 0] * 255, meas * fall, rtol=1e-5)
    assert said(left, "not used: 'white' [64, 80]")


def test_dark_and_white_frames_of_several_are_averaged(bench, take, said):
    masks, meas, fall = bench
    rng = np.random.default_rng(0)
    dark = 20 + rng.normal(0, 2, (8, 64, 80))
    white = 20 + 900 * fall + rng.normal(0, 9, (16, 64, 80))
    imported = take(ImportOptions(scale=255.0), meas=20 + meas * fall, masks=masks, flats=white, darks=dark)
    assert said(imported, "dark frame, mean 20")
    assert said(imported, "white frame, mean")
    error = imported.shots[0].measurement[..., 0] * 255 - meas
    assert np.abs(error).mean() < 0.01 * meas.max()


def test_masks_that_the_same_camera_recorded_keep_the_fall_off_and_lose_the_dark(bench, take, said):
    masks, meas, fall = bench
    recorded = 20 + 200 * masks * fall
    dark = np.full((64, 80), 20.0)
    imported = take(
        ImportOptions(scale=200.0, mask_scale=200.0), meas=20 + meas * fall, masks=recorded, white=900 * fall, dark=dark
    )
    assert said(imported, "the dark frame was subtracted from the masks")
    assert said(imported, "recorded through the same optics")
    assert np.allclose(imported.shots[0].masks, masks * fall, atol=1e-6)
    assert np.allclose(imported.shots[0].measurement[..., 0] * 200, meas * fall, atol=1e-3)


def test_an_offset_that_is_said_counts_before_the_dark_frame(bench, take, said):
    masks, meas, _ = bench
    imported = take(ImportOptions(scale=255.0, offset=20.0), meas=20 + meas, masks=masks, dark=np.full((64, 80), 33.0))
    assert said(imported, "not used, because --offset says the reading without light")
    assert np.allclose(imported.shots[0].measurement[..., 0] * 255, meas, atol=1e-3)


def test_the_noise_of_white_frames_is_kept_out_and_the_response_of_pixels_is_kept():
    rng = np.random.default_rng(0)
    pixels = 1 + 0.05 * rng.normal(size=(96, 96))
    frames = pixels + rng.normal(0, 0.02, (4, 96, 96))
    seen = response(frame_from(Array("w", frames), (96, 96), 1), None)[..., 0]
    assert np.corrcoef(seen.ravel(), pixels.ravel())[0, 1] > 0.95
    noisy = response(frame_from(Array("w", 1 + rng.normal(0, 0.02, (4, 96, 96))), (96, 96), 1), None)
    assert noisy.std() < 0.006


@pytest.mark.parametrize(
    ("shape", "channels"),
    [((8, 9), 1), ((1, 8, 9), 1), ((5, 8, 9), 1), ((8, 9, 5), 1), ((8, 9, 3), 3), ((5, 8, 9, 3), 3)],
)
def test_frames_come_in_every_order_that_fits(shape, channels):
    assert frame_from(Array("w", np.ones(shape)), (8, 9), channels).values.shape[:2] == (8, 9)


def test_frames_that_do_not_fit_are_refused(bench, take):
    masks, meas, _ = bench
    with pytest.raises(InputError, match=r"frames of shape \[3, 4\].*--white-key none"):
        take(meas=meas, masks=masks, white=np.ones((3, 4)))
    with pytest.raises(InputError, match="no brighter than the dark one"):
        response(FieldFrame(np.ones((8, 9, 1)), 0, 1), FieldFrame(np.ones((8, 9, 1)), 0, 1))


def test_what_a_file_holds_beside_is_named(bench, take, said):
    masks, meas, _ = bench
    imported = take(ImportOptions(scale=255.0), meas=meas, masks=masks, exposure_ms=np.array(3.0), note="lamp 2")
    assert said(imported, "not used: 'exposure_ms' [], 'note' []")
    assert not said(take(ImportOptions(scale=255.0), meas=meas, masks=masks), "not used")


@pytest.mark.parametrize("shape", [(1, 1, 6, 64, 80), (1, 6, 64, 80), (6, 1, 64, 80), (6, 64, 80, 1, 1)])
def test_axes_of_length_1_are_dropped(bench, take, shape):
    """F11: "check that masks and measurement belong together"."""
    masks, meas, _ = bench
    shot = take(ImportOptions(scale=255.0), meas=meas[None, None, None], masks=masks.reshape(shape)).shots[0]
    assert np.array_equal(shot.masks, masks)
    assert np.allclose(shot.measurement[..., 0] * 255, meas, rtol=1e-5)


@pytest.fixture
def own(scene):
    """Three exposures, each of other views behind masks of its own."""
    made = [scene(n=8, height=64, width=72, channels=1, seed=seed) for seed in range(3)]
    views = [80 + 0.6 * one.views[..., 0].astype(float) for one in made]
    meas = [np.einsum("nhw,nhw->hw", one.masks, shown) for one, shown in zip(made, views, strict=True)]
    return np.stack(meas), np.stack([one.masks for one in made]), np.stack(views)


@pytest.mark.parametrize("last", [False, True])
def test_exposures_with_masks_of_their_own_are_as_many_shots(own, take, said, last):
    """F11: [3, 8, H, W] did not belong together."""
    meas, masks, views = own
    given = {"meas": meas, "masks": masks, "truth": views.reshape(24, 64, 72)}
    if last:
        given = {name: np.moveaxis(given[name], 0, -1) for name in ("meas", "truth")}
        given["masks"] = masks.transpose(2, 3, 1, 0)
    imported = take(ImportOptions(scale=255.0), **given)
    assert said(imported, "3 exposures, each with masks of its own")
    assert said(imported, "exposure 2: truth: explains the measurement")
    for shot, own_masks, one, true in zip(imported.shots, masks, meas, views, strict=True):
        assert np.array_equal(shot.masks, own_masks)
        assert np.allclose(shot.measurement[..., 0] * 255, one, rtol=1e-5)
        assert np.allclose(shot.truth.views[..., 0] * 255, true, rtol=1e-5)


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (1, 0, 2, 3), (2, 3, 0, 1), (2, 3, 1, 0)])
@pytest.mark.parametrize("count", [2, 3])
def test_masks_of_their_own_may_count_exposures_or_masks_first(own, take, order, count):
    """As many masks as exposures, counted first, were taken for the exposures', and eight views became one."""
    meas, masks, views = own
    meas = np.rint(np.einsum("knhw,knhw->khw", masks[:count, :3], views[:count, :3].reshape(count, 3, 64, 72)))
    given = meas if order[0] < 2 else np.moveaxis(meas, 0, -1)
    shots = take(ImportOptions(scale=255.0), meas=given, masks=masks[:count, :3].transpose(order)).shots
    for shot, own_masks, one in zip(shots, masks[:, :3], meas, strict=False):
        assert np.array_equal(shot.masks, own_masks)
        assert np.allclose(shot.measurement[..., 0] * 255, one, rtol=1e-5)


@pytest.mark.parametrize("flat", [False, True])
def test_poses_and_weights_of_a_file_go_to_the_exposures_that_they_belong_to(own, take, flat):
    meas, masks, _ = own
    poses = np.tile(np.eye(4), (3, 8, 1, 1))
    poses[..., 0, 3] = np.arange(24.0).reshape(3, 8)
    weights = np.linspace(0.5, 1, 24).reshape(3, 8)
    given = {"world_to_camera": poses, "telemetry_world_to_camera": -poses + 2 * np.eye(4), "weights": weights}
    if flat:
        given = {name: value.reshape(24, *value.shape[2:]) for name, value in given.items()}
    shots = take(ImportOptions(scale=255.0), meas=meas, masks=masks, **given).shots
    for k, shot in enumerate(shots):
        assert np.array_equal(shot.truth.world_to_camera, poses[k])
        assert np.array_equal(shot.telemetry_world_to_camera[:, 0, 3], -poses[k, :, 0, 3])
        assert np.allclose(shot.weights, weights[k])
    alike = take(ImportOptions(scale=255.0), meas=meas, masks=masks, world_to_camera=poses[0], weights=weights[0]).shots
    assert all(np.array_equal(shot.truth.world_to_camera, poses[0]) for shot in alike)
    assert all(np.allclose(shot.weights, weights[0]) for shot in alike)


def test_masks_that_are_stored_for_each_exposure_but_alike_are_shared(own, take):
    meas, masks, _ = own
    same = np.repeat(masks[:1], 3, axis=0)
    shots = take(ImportOptions(scale=255.0), meas=meas, masks=same).shots
    assert all(np.array_equal(shot.masks, masks[0]) for shot in shots)


def test_exposures_with_masks_of_their_own_become_one_file(own, tmp_path, capsys):
    meas, masks, _ = own
    np.savez(tmp_path / "multi.npz", meas=meas, masks=masks)
    assert run(tmp_path / "multi.npz", out=tmp_path / "shot.h5", scale=255.0) == tmp_path / "shot.h5"
    assert "3 shots in" in capsys.readouterr().out
    for k in range(3):
        assert np.array_equal(read_shot(tmp_path / "shot.h5", k).masks, masks[k])


def test_exposures_with_weights_of_their_own_are_said_to_need_a_file_each(own, tmp_path):
    meas, masks, _ = own
    weights = 1 + 0.1 * np.arange(3 * masks.shape[1]).reshape(3, -1)
    np.savez(tmp_path / "multi.npz", meas=meas, masks=masks, weights=weights)
    with pytest.raises(StorageError, match=r"differs from shot 0 in weights.*write a file for each"):
        run(tmp_path / "multi.npz", out=tmp_path / "shot.h5", scale=255.0)
    run(tmp_path / "multi.npz", out=tmp_path / "shot.h5", scale=255.0, index=2)
    assert np.allclose(read_shot(tmp_path / "shot.h5").weights, weights[2] / weights[2].max())


def test_other_hdf5_files_name_what_is_left(bench, tmp_path):
    masks, meas, _ = bench
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["meas"], file["masks"], file["log/text"] = meas, masks, "made by hand"
    imported = import_shots(tmp_path / "a.h5", None, ImportOptions(scale=255.0))
    assert any("not used: 'log/text' []" in guess for guess in imported.guesses)


def test_a_dark_frame_of_one_number_is_the_reading_without_light(bench, take):
    masks, meas, _ = bench
    shot = take(ImportOptions(scale=255.0), meas=64 + meas, masks=masks, dark=np.array(64)).shots[0]
    assert np.allclose(shot.measurement[..., 0] * 255, meas, atol=1e-3)


def test_a_table_of_correction_factors_is_doubted_as_a_white_frame(bench, take, said):
    masks, meas, fall = bench
    assert said(take(meas=meas * fall, masks=masks, flat=1 / fall), "if it holds factors of correction, save 1 / it")
    assert not said(take(meas=meas * fall, masks=masks, flat=fall), "factors of correction")
