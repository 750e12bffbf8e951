"""Masks, measurement and truth are tested against each other."""

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.agreement import fit, mosaic
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.records import CFA_PATTERNS


@pytest.mark.parametrize(
    ("turn", "word"),
    [
        (lambda m: m[:, ::-1], "upside down"),
        (lambda m: m[:, :, ::-1], "mirrored"),
        (lambda m: m[:, ::-1, ::-1], "turned by 180 degrees"),
        (lambda m: m.transpose(0, 2, 1), "transposed"),
    ],
)
def test_turned_masks_are_found_out_and_passed_on(scene, take, said, turn, word):
    made = scene(n=5, height=48, width=48)
    imported = take(meas=made.meas, mask=turn(made.masks))
    assert said(imported, f"key 'mask': the masks are {word}")
    assert said(imported, "the registration of `gs2ci reconstruct` corrects this")


def test_light_where_turned_masks_are_closed_is_no_offset(scene, take, said):
    made = scene(n=5, height=48, width=48)
    assert not said(take(meas=made.meas, mask=made.masks[:, ::-1]), "pixels that no mask opens read")
    lifted = take(ImportOptions(scale=1.0), meas=made.meas + 0.3, mask=made.masks[:, ::-1])
    assert said(lifted, "pixels that no mask opens read 0.3 ")


@pytest.mark.parametrize("moved", [(0, 3), (-5, 0), (4, -7)])
def test_moved_masks_are_found_out_and_passed_on(scene, take, said, moved):
    made = scene(n=5, height=48, width=64)
    imported = take(meas=made.meas, mask=np.roll(made.masks, (-moved[0], -moved[1]), axis=(1, 2)))
    assert said(imported, f"displaced by {moved[0]:+.1f} px down and {moved[1]:+.1f} px")


def test_masks_of_another_measurement_are_doubted(scene, take, said):
    made, other = scene(height=60, width=60), scene(height=60, width=60, seed=9)
    imported = take(ImportOptions(scale=1.0), meas=made.meas, mask=other.masks)
    assert said(imported, "no trace of these masks")
    assert not said(imported, "pixels that no mask opens read")


def test_a_video_without_its_measurement_is_not_taken_for_one(take):
    """Benchmarks hold true views under names of their own, beside the masks or alone."""
    rng = np.random.default_rng(3)
    masks = rng.random((8, 60, 64)) < 0.5
    row, column = np.mgrid[:60, :64]
    views = np.stack([128 + 100 * np.sin(0.2 * row + 0.3 * column + 0.1 * t) for t in range(16)])
    with pytest.raises(
        InputError, match=r"'patch_save': has no known name, and shows no trace of the masks.*--meas-key"
    ):
        take(patch_save=views, mask=masks)
    assert len(take(ImportOptions(meas_key="patch_save"), patch_save=views, mask=masks).shots) == 16


def test_true_views_with_red_and_blue_exchanged_are_refused(scene, take):
    """OpenCV reads them so; without the mosaic's name its greens would fit, and red would become blue."""
    made = scene(n=6, height=40, width=48)
    coded = np.einsum("nhw,nhwc->hwc", made.masks, made.views / 255.0)
    with pytest.raises(InputError, match="red and blue exchanged"):
        take(meas=coded, masks=made.masks, orig=made.views[..., ::-1])
    raw = mosaic(coded, "RGGB")[..., 0]
    given = {"meas_bayer": raw, "mask_bayer": made.masks, "Bayer_mode": "rggb"}
    shot = take(**given, orig=made.views).shots[0]
    assert shot.cfa == "RGGB"
    assert np.allclose(shot.measurement[..., 0], raw, rtol=1e-5)
    with pytest.raises(InputError, match="red and blue exchanged"):
        take(**given, orig=made.views[..., ::-1])


def test_a_lamp_that_outshines_the_scene_does_not_hide_the_pattern_of_the_masks(scene, take, said):
    made = scene(n=8, height=60, width=60)
    views = 0.1 * made.views / 255.0
    views[:, 20:24, 10:14] = 20.0
    meas = np.einsum("nhw,nhwc->hwc", made.masks, views)
    others = scene(n=8, height=60, width=60, seed=9).masks
    assert not said(take(ImportOptions(scale=1.0), meas=meas, mask=made.masks), "no trace of these masks")
    assert said(take(ImportOptions(scale=1.0), meas=meas, mask=others), "no trace of these masks")


def test_masks_that_always_open_the_same_number_leave_nothing_to_test(scene, take, said):
    made = scene(n=2)
    masks = np.stack([made.masks[0], 1 - made.masks[0]])
    meas = np.einsum("nhw,nhwc->hwc", masks, made.views / 255.0)
    assert not said(take(meas=meas, mask=masks), "WARNING: the measurement")


def test_a_reversed_order_of_masks_is_found_through_the_truth(scene, take):
    made = scene()
    with pytest.raises(InputError, match=r"reversed order.*--reverse-masks"):
        take(meas=made.meas, mask=made.masks[::-1], truth=made.views)
    options = ImportOptions(reverse_masks=True)
    shot = take(options, meas=made.meas, mask=made.masks[::-1], truth=made.views).shots[0]
    assert np.array_equal(shot.masks, made.masks)


@pytest.mark.parametrize(("first", "words"), [(1, "one mask later"), (-1, "one mask earlier")])
def test_true_views_that_begin_with_another_mask_are_doubted(scene, take, said, first, words):
    """A film whose first frame is missing: scores would compare each view with its neighbour."""
    made = scene(n=8)
    moved = take(meas=made.meas, mask=made.masks, truth=np.roll(made.views, -first, axis=0))
    assert said(moved, f"explain the measurement better {words} (residual")
    right = take(meas=made.meas, mask=made.masks, truth=made.views)
    assert not said(right, "explain the measurement better")


def test_weights_are_reversed_with_their_masks(scene, take, said):
    """Otherwise the option that the error names would make the import worse."""
    made = scene()
    weights = np.array([0.4, 0.6, 0.8, 1.0])
    meas = np.einsum("n,nhw,nhwc->hwc", weights, made.masks, made.views / 255.0)
    file = {"meas": meas, "mask": made.masks[::-1], "truth": made.views, "weights": weights[::-1]}
    with pytest.raises(InputError, match=r"reversed order.*--reverse-masks"):
        take(**file)
    imported = take(ImportOptions(reverse_masks=True), **file)
    (shot,) = imported.shots
    assert np.array_equal(shot.masks, made.masks)
    assert np.array_equal(shot.weights, weights.astype(np.float32))
    assert np.allclose(shot.measurement, meas)
    assert said(imported, "truth: explains the measurement")
    assert not said(imported, "WARNING")


def test_a_truth_of_another_scene_is_doubted(scene, take, said):
    made = scene()
    other = (np.random.default_rng(5).random(made.views.shape) > 0.9) * np.uint8(255)
    assert said(take(meas=made.meas, mask=made.masks, truth=other), "WARNING: the truth does not explain")


def test_a_truth_that_explains_no_more_than_even_views_is_doubted(scene, take, said):
    """Any views of the right brightness explain most of what half-open masks pass."""
    made = scene(n=8, height=40, width=50)
    other = np.random.default_rng(5).random(made.views.shape)
    imported = take(meas=made.meas, mask=made.masks, truth=other)
    assert said(imported, "WARNING: the truth does not explain")
    assert imported.shots[0].provenance["unit_stated"] is False


def test_a_black_level_that_the_truth_shows_is_named_and_not_taken_for_light(scene, take, said):
    made = scene(n=8, height=40, width=50)
    imported = take(meas=200 * made.meas + 90, mask=made.masks, truth=made.views)
    assert said(imported, "above a reading of 90 without light")
    assert imported.shots[0].provenance["full_scale"] == pytest.approx(200)
    assert not said(take(meas=200 * made.meas, mask=made.masks, truth=made.views), "without light")
    options = ImportOptions(offset=90.0)
    assert not said(take(options, meas=200 * made.meas + 90, mask=made.masks, truth=made.views), "without light")


@pytest.mark.parametrize("cfa", CFA_PATTERNS)
def test_a_mosaic_is_recognised_through_its_true_colours_or_its_key(scene, take, said, cfa):
    made = scene()
    meas = mosaic(made.meas, cfa)[..., 0]
    assert take(meas=meas, mask=made.masks, truth=made.views).shots[0].cfa == cfa
    assert take(ImportOptions(cfa=cfa), meas=meas, mask=made.masks).shots[0].cfa == cfa
    assert take(meas=meas, mask=made.masks, bayer=cfa.lower()).shots[0].cfa == cfa
    imported = take(meas=meas, mask=made.masks, bayer=cfa.encode())
    assert imported.shots[0].cfa == cfa
    assert said(imported, f"key 'bayer': colour filter array {cfa}")


def test_a_mosaic_without_truth_is_doubted_to_be_mono(scene, take, said):
    made = scene(height=64, width=64)
    meas = mosaic(made.meas * np.array([1.0, 0.5, 0.6]), "RGGB")[..., 0]
    assert said(take(meas=meas, mask=made.masks), "RGGB or BGGR")
    assert not said(take(meas=made.meas[..., 0], mask=made.masks), "mosaic")


def test_a_filter_array_that_does_not_fit_is_refused(scene, take):
    made = scene()
    with pytest.raises(InputError, match=r"--cfa.*3 channel"):
        take(ImportOptions(cfa="RGGB"), meas=made.meas, mask=made.masks)
    with pytest.raises(InputError, match=r"key 'cfa'.*'XTRANS'"):
        take(meas=made.meas[..., 0], mask=made.masks, cfa="xtrans")


def test_truth_and_measurement_of_different_colours_are_a_contradiction(scene, take):
    made = scene()
    with pytest.raises(InputError, match=r"true views with 3 channel\(s\).*--cfa"):
        take(meas=made.meas.mean(axis=2), mask=made.masks, truth=made.views)
    with pytest.raises(InputError, match=r"true views with 1 channel\(s\)"):
        take(meas=made.meas, mask=made.masks, truth=made.views[..., :1])


def test_fit_of_nothing_to_nothing_is_exact_and_of_nothing_to_something_is_not():
    zero, one = np.zeros((2, 2)), np.ones((2, 2))
    assert fit(zero, zero) == (0.0, 0.0)
    assert fit(one, zero) == (0.0, 1.0)
    assert fit(zero, one) == (0.0, 1.0)
