"""Every order of axes in use is understood; what fits in no order, or in several, is refused."""

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.options import ImportOptions


@pytest.mark.parametrize("masks_last", [False, True])
@pytest.mark.parametrize("order", ["HWC", "CHW"])
def test_colour_and_masks_may_come_first_or_last(scene, take, masks_last, order):
    made = scene()
    masks = made.masks.transpose(1, 2, 0) if masks_last else made.masks
    meas = made.meas if order == "HWC" else made.meas.transpose(2, 0, 1)
    shot = take(meas=meas, mask=masks).shots[0]
    assert np.array_equal(shot.measurement, made.meas.astype(np.float32))
    assert np.array_equal(shot.masks, made.masks)


@pytest.mark.parametrize(("bits", "row"), [(10, 40), (12, 48), (14, 56)])
def test_bytes_of_packed_pixels_are_named(scene, take, bits, row):
    made = scene(channels=1)
    with pytest.raises(InputError, match=f"rows of bytes are {bits / 8:g} times .*unpack pixels of {bits} bits"):
        take(meas=np.zeros((24, row), np.uint8), mask=made.masks)


@pytest.mark.parametrize("shape", ["HW", "HW1", "1HW"])
def test_a_single_channel_may_have_an_axis_of_its_own_or_not(scene, take, shape):
    made = scene(channels=1)
    meas = {"HW": made.meas[..., 0], "HW1": made.meas, "1HW": made.meas.transpose(2, 0, 1)}[shape]
    assert np.array_equal(take(meas=meas, mask=made.masks).shots[0].measurement, made.meas.astype(np.float32))


@pytest.mark.parametrize("last", [False, True])
def test_a_stack_of_measurements_becomes_several_shots_with_their_own_truth(scene, take, last):
    made = [scene(channels=1, seed=seed) for seed in range(5)]
    masks = made[0].masks
    coded = [np.einsum("nhw,nhwc->hwc", masks, m.views / 255.0) for m in made]
    axis = -1 if last else 0
    shots = take(
        meas=np.stack([c[..., 0] for c in coded], axis),
        mask=np.moveaxis(masks, 0, axis),
        orig=np.moveaxis(np.concatenate([m.views[..., 0] for m in made]), 0, axis),
    ).shots
    assert len(shots) == 5
    for shot, c, m in zip(shots, coded, made, strict=True):
        assert np.array_equal(shot.measurement, c.astype(np.float32))
        assert np.array_equal(np.rint(shot.truth.views * 255), m.views)
    assert shots[3].name == "file-3"


@pytest.mark.parametrize("order", ["KHWC", "HWCK", "HWKC", "KCHW"])
def test_colour_stacks_become_several_shots(scene, take, order):
    made = scene()
    stack = np.stack([made.meas, made.meas / 2], 0)
    shots = take(meas=np.einsum(f"KHWC->{order}", stack), mask=made.masks).shots
    assert np.array_equal(np.stack([shot.measurement for shot in shots]), stack.astype(np.float32))


def test_as_many_measurements_as_masks_are_no_pictures_two_pixels_wide(scene, take):
    """[H, W, 2, 3] under masks [H, W, 2] would also be H measurements of W x 2 pixels."""
    made = scene(n=2)
    stack = np.stack([made.meas, made.meas / 2], 2)
    shots = take(meas=stack, mask=made.masks.transpose(1, 2, 0)).shots
    assert [shot.size for shot in shots] == [made.meas.shape[:2]] * 2


def test_three_measurements_of_three_colours_are_said_to_be_a_guess(scene, take, said):
    made = scene()
    imported = take(meas=np.stack([made.meas, made.meas / 2, made.meas / 3], 3), mask=made.masks)
    assert np.array_equal(imported.shots[1].measurement, (made.meas / 2).astype(np.float32))
    assert said(imported, "taken as [H, W, C, K]")


def test_three_images_are_colour_unless_said_or_the_truth_says_otherwise(scene, take):
    made = scene()
    imported = take(meas=made.meas, mask=made.masks)
    assert len(imported.shots) == 1
    assert any("--meas-layout stack" in guess for guess in imported.guesses)
    assert len(take(ImportOptions(meas_layout="stack"), meas=made.meas, mask=made.masks).shots) == 3
    frames = made.views.transpose(3, 0, 1, 2).reshape(12, 24, 32)
    assert len(take(meas=made.meas, mask=made.masks, orig=frames).shots) == 3


def test_a_single_mask_is_a_single_view(scene, take):
    made = scene(n=1)
    assert take(meas=made.meas, mask=made.masks[0]).shots[0].views == 1


@pytest.mark.parametrize("axis", [0, 1, 3])
def test_masks_repeated_for_each_colour_are_taken_once(scene, take, axis):
    made = scene()
    masks = np.repeat(np.expand_dims(made.masks, axis), 3 if axis else 1, axis)
    assert np.array_equal(take(meas=made.meas, mask=masks).shots[0].masks, made.masks)


def test_masks_that_differ_between_colours_are_refused(scene, take):
    made = scene()
    masks = np.stack([made.masks, made.masks, 1 - made.masks], 3)
    with pytest.raises(InputError, match=r"key 'mask': masks that differ from colour to colour"):
        take(meas=made.meas, mask=masks)


def test_masks_of_four_true_axes_fit_nothing(scene, take):
    with pytest.raises(InputError, match="no order of axes"):
        take(meas=scene().meas, mask=np.ones((2, 4, 24, 32)))


def test_as_many_masks_as_rows_and_columns_need_a_word(scene, take):
    made = scene(n=8, height=8, width=8)
    with pytest.raises(InputError, match="--mask-axis first or --mask-axis last"):
        take(meas=made.meas, mask=made.masks)
    shot = take(ImportOptions(mask_axis="last"), meas=made.meas, mask=made.masks.transpose(1, 2, 0)).shots[0]
    assert np.array_equal(shot.masks, made.masks)


def test_exchanged_height_and_width_are_named(scene, take):
    made = scene()
    with pytest.raises(InputError, match=r"key 'mask'.*height and width of the masks are exchanged"):
        take(meas=made.meas, mask=made.masks.transpose(0, 2, 1))


def test_masks_as_the_modulator_has_them_are_told_how_to_become_the_sensors(scene, take):
    made = scene()
    with pytest.raises(InputError, match=r"in the sensor's pixels.*`gs2ci calibrate masks`"):
        take(meas=made.meas, mask=np.kron(made.masks, np.ones((1, 2, 2), np.uint8)))
    with pytest.raises(InputError, match=r"2 x 2 pixels exactly: masks\.repeat\(2, 1\)\.repeat\(2, 2\)"):
        take(meas=made.meas, mask=made.masks[:, ::2, ::2])
    with pytest.raises(InputError, match=r"4 x 4 pixels exactly: masks\.repeat\(4, 0\)\.repeat\(4, 1\)"):
        take(meas=made.meas, mask=np.moveaxis(made.masks[:, ::4, ::4], 0, -1))


def test_sizes_that_differ_are_refused_with_both_shapes(scene, take):
    made = scene()
    with pytest.raises(InputError, match=r"\[4, 20, 32\] fits the measurement's \[24, 32, 3\].*key 'meas'"):
        take(meas=made.meas, mask=made.masks[:, :20])
    with pytest.raises(InputError, match="leave out --mask-axis last"):
        take(ImportOptions(mask_axis="last"), meas=made.meas, mask=made.masks)
    with pytest.raises(InputError, match="no order of axes"):
        take(meas=made.meas[0, 0], mask=made.masks)


def test_a_wrong_number_of_true_views_is_a_contradiction(scene, take):
    made = scene()
    with pytest.raises(InputError, match=r"key 'truth'.*allowed: 4 views.*--truth-key none"):
        take(meas=made.meas, mask=made.masks, truth=made.views[:3])
    without = take(ImportOptions(truth_key="none"), meas=made.meas, mask=made.masks, truth=made.views[:3])
    assert without.shots[0].truth.views is None


@pytest.mark.parametrize("order", ["NHWC", "HWCN", "NCHW", "CNHW"])
def test_true_views_may_come_in_any_order(scene, take, order):
    made = scene()
    shot = take(meas=made.meas, mask=made.masks, truth=np.einsum(f"NHWC->{order}", made.views)).shots[0]
    assert np.array_equal(np.rint(shot.truth.views * 255), made.views)


def test_true_views_may_have_an_axis_of_length_one_and_be_no_scalar(scene, take):
    made = scene()
    shot = take(meas=made.meas, mask=made.masks, truth=np.einsum("NHWC->CNHW", made.views)[None]).shots[0]
    assert np.array_equal(np.rint(shot.truth.views * 255), made.views)
    grey = scene(channels=1)
    with pytest.raises(InputError, match=r"key 'truth': shape \[\] does not hold the true views"):
        take(meas=grey.meas, mask=grey.masks, truth=0.0)


def test_pixels_in_one_row_are_told_how_to_become_pictures(scene, take):
    made = scene(channels=1)
    with pytest.raises(InputError, match=r"one row of 768 numbers: reshape the masks to \[N, 24, 32\]"):
        take(meas=made.meas[..., 0], mask=made.masks.reshape(4, -1))
    with pytest.raises(InputError, match=r"reshape the masks to \[24, 32, N\]"):
        take(meas=made.meas[..., 0], mask=made.masks.reshape(4, -1).T)
    with pytest.raises(InputError, match=r"the measurement is one row of 768 numbers: reshape it to \[H, W\]"):
        take(meas=made.meas.reshape(-1), mask=made.masks)


def test_empty_arrays_are_refused(scene, take):
    with pytest.raises(InputError, match="empty"):
        take(meas=np.zeros((0, 4)), mask=scene().masks)


@pytest.mark.parametrize("opaque", [np.uint8(255), np.uint16(65535), 1.0])
@pytest.mark.parametrize("order", ["HWC", "CHW"])
def test_the_opacity_of_a_colour_picture_is_no_measurement(scene, take, said, order, opaque):
    made = scene()
    full = float(opaque)
    meas = (made.meas / made.meas.max() * full).astype(np.asarray(opaque).dtype)
    picture = np.concatenate([meas, np.full((*meas.shape[:2], 1), opaque)], axis=2)
    imported = take(ImportOptions(scale=full), meas=np.einsum(f"HWC->{order}", picture), mask=made.masks)
    assert said(imported, "as the opacity of a colour picture is: left out")
    (shot,) = imported.shots
    assert np.allclose(shot.measurement, meas / full)


def test_a_fourth_measurement_is_one(scene, take):
    made = scene()
    meas = np.concatenate([made.meas, made.meas[..., :1]], axis=2)
    assert len(take(meas=meas, mask=made.masks).shots) == 4


def test_one_measurement_on_an_axis_of_its_own_raises_no_question_of_colours(scene, take, said):
    made = scene()
    assert not said(take(meas=made.meas.mean(axis=2)[None], mask=made.masks), "--meas-layout stack")
