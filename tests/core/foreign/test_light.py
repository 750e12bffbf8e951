"""Readings that are no light are named, and undone where they show what they are."""

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.curves import CURVES, as_counts, full_scale
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.foreign.overflow import below_zero, unwrapped, wrap_of
from tests.benchmarks import import_forms as forms


@pytest.fixture
def bench(scene):
    """A scene bright and even enough for the question, in counts."""

    def make(seed=0, n=6):
        made = scene(n=n, height=96, width=112, channels=1, seed=seed, ones=0.4)
        views = 60 + made.views.astype(float) * 0.7
        meas = np.einsum("nhw,nhwc->hw", made.masks, views)
        return made.masks, np.rint(meas + np.random.default_rng(seed).normal(0, 1, meas.shape)).clip(0)

    return make


def wrong(imported):
    return [guess for guess in imported.guesses if guess.startswith("WARNING")]


def test_right_readings_are_left_alone_without_a_word(bench, take):
    masks, meas = bench()
    imported = take(meas=meas.astype(np.uint16), masks=masks)
    assert not wrong(imported)
    assert imported.shots[0].provenance["undone"] is None
    assert not imported.shots[0].provenance["curved"]


def test_readings_divided_by_the_masks_sum_are_multiplied_again(bench, take, said):
    """F1: 9.5 dB for 22.6, an invented leak of 0.38."""
    masks, meas = bench()
    total = masks.sum(axis=0)
    imported = take(ImportOptions(scale=255.0), meas=(meas / np.maximum(total, 1)).astype(np.float32), masks=masks)
    assert said(imported, "as readings divided by the sum of the masks does; undone, they do")
    assert imported.shots[0].provenance["undone"] == "divided"
    assert np.array_equal(imported.shots[0].measurement[..., 0] * 255, np.where(total > 0, meas, 0).astype(np.float32))


def test_one_of_six_masks_is_no_sum_by_which_readings_were_divided(bench, take, said):
    """Readings times one mask follow that mask whatever they are; but where it is closed they are bright."""
    masks, meas = bench()
    imported = take(ImportOptions(scale=255.0), meas=meas, masks=masks[:1])
    assert not said(imported, "divided by the sum of the masks does; undone")
    assert said(imported, "pixels that no mask opens read")
    assert imported.shots[0].provenance["undone"] is None
    assert np.array_equal(imported.shots[0].measurement[..., 0] * 255, meas.astype(np.float32))


@pytest.mark.parametrize(
    ("encode", "names"),
    [
        (lambda x: x ** (1 / 2.2), ("gamma", "srgb")),
        (forms.srgb, ("gamma", "srgb")),
        (np.sqrt, ("root",)),
    ],
)
def test_a_display_curve_in_8_bits_is_undone(bench, take, encode, names):
    """F2: 11.1 dB, a leak of 0.14."""
    masks, meas = bench()
    top = meas.max()
    stored = np.rint(255 * encode(np.clip(meas / top, 0, 1))).astype(np.uint8)
    imported = take(ImportOptions(scale=255.0), meas=stored, masks=masks)
    assert len(wrong(imported)) == 1
    assert imported.shots[0].provenance["undone"] in names
    back = imported.shots[0].measurement[..., 0] * top
    assert np.abs(back - meas).mean() < 0.02 * top


def test_a_logarithm_is_named_and_not_undone_because_its_constants_are_unknown(bench, take):
    masks, meas = bench()
    stored = (np.log1p(50 * np.clip(meas / meas.max(), 0, 1)) / np.log(51)).astype(np.float32)
    imported = take(ImportOptions(scale=1.0), meas=stored, masks=masks)
    assert any("as a logarithm does, whose constants the file does not tell" in guess for guess in wrong(imported))
    assert imported.shots[0].provenance["curved"]
    assert np.array_equal(imported.shots[0].measurement[..., 0], stored)


@pytest.mark.parametrize(("bits", "gain"), [(8, 1.0), (8, 0.5), (12, 8.0), (10, 2.0)])
def test_a_sum_that_overflowed_is_put_back(bench, take, said, bits, gain):
    """F3: 7.0 dB, a leak of 0.38; with few that went round 19.1 dB and not a word."""
    masks, meas = bench()
    counts = np.rint(meas * gain).astype(np.int64)
    stored = (counts % 2**bits).astype(np.uint8 if bits == 8 else np.uint16)
    assert (counts >= 2**bits).mean() > 0.01
    imported = take(ImportOptions(scale=255.0 * gain), meas=stored, masks=masks)
    assert said(imported, f"of the readings went round at {2**bits}")
    assert imported.shots[0].saturated is None
    back = np.rint(imported.shots[0].measurement[..., 0].astype(float) * 255 * gain)
    assert (back != counts).mean() < 0.03


def test_a_sum_that_overflowed_before_it_was_scaled_to_1_is_put_back(bench, take, said):
    masks, meas = bench()
    counts = np.rint(meas * 0.5).astype(np.int64)
    imported = take(ImportOptions(scale=127.5 / 255), meas=(counts % 256 / 255).astype(np.float32), masks=masks)
    assert said(imported, "went round at 1.00392")
    back = np.rint(imported.shots[0].measurement[..., 0].astype(float) * 127.5)
    assert (back != counts).mean() < 0.01


@pytest.mark.parametrize("dtype", [np.uint16, np.uint8, np.uint32])
def test_differences_below_zero_that_were_stored_without_a_sign_get_it_back(bench, take, said, dtype):
    """F12: -3 became 65533, and the question was whether masks and measurement belong together."""
    masks, meas = bench()
    counts = np.rint(meas * (0.05 if dtype is np.uint8 else 1)).astype(np.int64)
    rng = np.random.default_rng(1)
    dark = np.where(masks.sum(axis=0) == 0, rng.integers(-3, 2, counts.shape), counts)
    imported = take(ImportOptions(scale=255.0), meas=dark.astype(dtype), masks=masks)
    assert said(imported, "below zero were stored in integers without a sign")
    assert np.array_equal(np.rint(imported.shots[0].measurement[..., 0] * 255), dark)


def test_hot_pixels_and_clipped_ones_at_the_end_of_the_range_keep_their_readings(bench):
    _, meas = bench()
    stored = meas.astype(np.uint16)
    stored[:3, :5] = 65535
    assert below_zero(stored) is None
    assert below_zero(np.full((8, 8), 65530, np.uint16)) is None
    assert below_zero(stored.astype(np.int32)) is None


def test_what_overflowed_is_whole_numbers_that_fill_a_range():
    assert wrap_of(np.array([0, 250], np.uint8)) == 256
    assert wrap_of(np.array([0.0, 4090.0])) == 4096
    assert wrap_of(np.array([0, 2000], np.uint16)) is None
    assert wrap_of(np.array([0.5, 250.0])) is None
    assert wrap_of(np.array([3, 250], np.float32) / 255) == pytest.approx(256 / 255)
    assert wrap_of(np.array([3, 1020], np.float32) / 1023) == pytest.approx(1024 / 1023)
    assert wrap_of(np.array([0.1234567, 0.99])) is None
    assert wrap_of(np.array([-1, 250], np.int16)) is None
    assert wrap_of(np.array([0, 2**20], np.int32)) is None


def test_putting_back_goes_colour_by_colour_in_a_mosaic(bench):
    masks, meas = bench()
    colours = np.ones(meas.shape)
    colours[::2, ::2] = 0.2
    counts = np.rint(meas * colours).clip(0)
    back = unwrapped(counts % 256, masks.sum(axis=0).astype(float), 256.0, is_mosaic=True)
    assert (back != counts).mean() < 0.03


def test_what_the_user_says_of_the_readings_is_done(bench, take, said):
    masks, meas = bench()
    top = meas.max()
    stored = np.rint(255 * np.sqrt(np.clip(meas / top, 0, 1))).astype(np.uint8)
    linear = take(ImportOptions(scale=255.0, curve="linear"), meas=stored, masks=masks)
    assert not any("grow" in guess for guess in linear.guesses)
    assert np.array_equal(linear.shots[0].measurement[..., 0], (stored / 255).astype(np.float32))
    root = take(ImportOptions(scale=255.0, curve="root"), meas=stored, masks=masks)
    assert said(root, "was undone, as stated")
    assert np.abs(root.shots[0].measurement[..., 0] * top - meas).mean() < 0.01 * top
    counts = (np.rint(meas.clip(0)) % 256).astype(np.uint8)
    around = take(ImportOptions(scale=255.0, curve="overflow"), meas=counts, masks=masks)
    assert said(around, "went round after 256 were put back, as stated")


def test_what_a_curve_has_squeezed_has_not_gone_round(take):
    """A logarithm of 8 bits: a fifth of its readings were "put back"."""
    drawn = forms.spoiled(np.random.default_rng([10, 4]), "log")
    imported = take(meas=drawn.measurement, masks=drawn.masks, **({"cfa": drawn.cfa} if drawn.cfa else {}))
    assert imported.shots[0].provenance["undone"] is None
    assert any("as a logarithm does" in one for one in wrong(imported))


def test_an_overflow_that_cannot_be_is_refused(bench, take):
    masks, meas = bench()
    with pytest.raises(InputError, match=r"--curve overflow, but no range.*leave --curve out"):
        take(ImportOptions(curve="overflow"), meas=meas / 7, masks=masks)


def test_where_nothing_can_be_told_it_says_so(scene, take, said):
    made = scene(channels=1)
    assert said(take(meas=made.meas, mask=made.masks), "light: whether readings grow in proportion")


def test_every_curve_is_the_inverse_of_what_it_names():
    light = np.linspace(0, 1, 11)
    stored = {"srgb": forms.srgb(light), "gamma": light ** (1 / 2.2), "root": np.sqrt(light), "divided": light / 4}
    for curve in CURVES:
        back = curve.undo(255 * stored[curve.name], np.full(11, 4.0), 255.0)
        assert np.allclose(back, 255 * light, atol=1e-3), curve.name


def test_counts_come_back_whole_and_the_full_scale_of_a_curve_is_that_of_the_numbers():
    assert np.array_equal(as_counts(np.array([2.999, 7.001])), [3, 7])
    assert np.array_equal(as_counts(np.array([2.9, 7.0])), [2.9, 7.0])
    assert np.array_equal(as_counts(np.array([0.001, 0.999])), [0.001, 0.999])
    assert full_scale(np.array([3], np.uint8)) == 255
    assert full_scale(np.array([0.7])) == 1
    assert full_scale(np.array([3000], np.uint16)) == 4095
    assert full_scale(np.array([1e6])) == 1e6


@pytest.mark.parametrize("seed", range(40))
def test_drawn_right_measurements_raise_no_alarm(seed, tmp_path):
    drawn = forms.right(np.random.default_rng([seed, 1]))
    np.savez(tmp_path / "right.npz", meas=drawn.measurement, masks=drawn.masks)
    imported = import_shots(tmp_path / "right.npz", None, ImportOptions(scale=drawn.full, cfa=drawn.cfa))
    assert not [guess for guess in wrong(imported) if "count as clipped" not in guess and "--saturation" not in guess]
    assert len(imported.shots[0].masks) == len(drawn.masks)


@pytest.mark.parametrize("how", forms.SPOILS)
def test_drawn_spoiled_measurements_are_named_at_import(how, tmp_path):
    """One of sixteen masks that is missing cannot always be told; all else can."""
    named = 0
    for seed in range(8):
        drawn = forms.spoiled(np.random.default_rng([seed, 2]), how)
        np.savez(tmp_path / "spoiled.npz", meas=drawn.measurement, masks=drawn.masks)
        imported = import_shots(tmp_path / "spoiled.npz", None, ImportOptions(scale=drawn.full, cfa=drawn.cfa))
        named += bool(wrong(imported))
        if how == "more":
            assert len(imported.shots[0].masks) == len(drawn.shown)
    assert named >= (6 if how == "fewer" else 8)


@pytest.mark.parametrize("power", [1.0, 0.5])
def test_masks_that_were_divided_where_readings_were_not_are_taken_as_they_were(bench, take, said, power):
    masks, meas = bench()
    divided = masks / np.maximum(masks.sum(axis=0), 1) ** power
    imported = take(ImportOptions(scale=255.0), meas=meas, masks=divided)
    assert said(imported, "the masks were divided at each pixel by their")
    assert np.allclose(imported.shots[0].masks, masks, atol=1e-6)
    both = take(ImportOptions(scale=255.0), meas=meas / np.maximum(masks.sum(axis=0), 1) ** power, masks=divided)
    assert not said(both, "were divided at each pixel")
    in_turn = (np.arange(4)[:, None, None] == np.arange(masks[0].size).reshape(masks[0].shape) % 5).astype(float)
    once = take(ImportOptions(scale=255.0), meas=in_turn.sum(axis=0) * meas.mean(), masks=in_turn)
    assert not said(once, "were divided at each pixel")
    assert np.allclose(both.shots[0].masks, divided, atol=1e-6)


def test_a_negative_is_refused_and_not_taken_for_inverted_masks(bench, take):
    masks, meas = bench()
    with pytest.raises(InputError, match=r"a negative: .*1023 - reading grows"):
        take(meas=(1023 - meas * 0.5).clip(0).astype(np.uint16), masks=masks)


def test_readings_whose_bytes_are_exchanged_are_refused(bench, take):
    masks, meas = bench()
    with pytest.raises(InputError, match="two bytes of each reading are exchanged"):
        take(meas=np.rint(meas).astype(np.uint16).byteswap(), masks=masks)


def test_a_sum_that_went_round_too_often_is_not_said_to_be_mended(bench, take, said):
    masks, meas = bench()
    imported = take(
        ImportOptions(scale=255.0), meas=(np.rint(meas * 1.3).astype(int) % 256).astype(np.uint8), masks=masks
    )
    assert said(imported, "too many for all to be put back")


def test_a_stretched_contrast_that_clips_is_named(bench, take, said):
    masks, meas = bench()
    low, high = np.quantile(meas, (0.25, 0.99))
    imported = take(meas=np.rint(255 * ((meas - low) / (high - low)).clip(0, 1)).astype(np.uint8), masks=masks)
    assert said(imported, "times as fast as the masks open: was too much subtracted")


def test_readings_from_which_a_mean_was_subtracted_are_named(bench, take, said):
    masks, meas = bench()
    assert said(take(meas=(meas - meas.mean()) / meas.std(), masks=masks), "as after a mean is subtracted")
    assert said(
        take(ImportOptions(scale=255.0), meas=meas - 1.05 * meas.mean(), masks=masks), "as after a mean is subtracted"
    )
