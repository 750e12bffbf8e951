"""Which of a file's masks were shown, by their traces."""

import numpy as np
import pytest
from scipy import ndimage

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.foreign.shown import traces


@pytest.fixture
def many(scene):
    """Sixteen masks, and what a grey scene reads behind some of them."""
    made = scene(n=16, height=80, width=96, channels=1)
    views = 80 + 0.6 * made.views[..., 0].astype(float)

    def read(shown, weights=None):
        weights = np.ones(len(shown)) if weights is None else weights
        return sum(w * made.masks[k] * views[k] for w, k in zip(weights, shown, strict=True))

    return made.masks, read


@pytest.mark.parametrize(
    ("shown", "words"),
    [
        (range(8), "8 to 15 left no trace"),
        (range(8, 16), "0 to 7 left no trace"),
        (range(0, 16, 2), "1, 3, 5, 7, 9, 11, 13, 15 left no trace"),
        ((0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 15), "of 16 masks 13 left no trace"),
    ],
)
def test_masks_that_were_not_shown_are_named_and_left_out(many, take, said, shown, words):
    """F4: import was silent, views of masks never shown were delivered."""
    masks, read = many
    imported = take(ImportOptions(scale=255.0), meas=read(shown), masks=masks)
    assert said(imported, words)
    assert np.array_equal(imported.shots[0].masks, masks[list(shown)])


def test_masks_that_the_user_counts_are_kept_but_named(many, take, said):
    masks, read = many
    imported = take(ImportOptions(scale=255.0, views=12), meas=read(range(8)), masks=masks)
    assert said(imported, "8 to 11 left no trace")
    assert said(imported, "Taken as --views says")
    assert len(imported.shots[0].masks) == 12


def test_weights_and_poses_stay_with_the_masks_that_were_shown(many, take):
    masks, read = many
    weights = np.linspace(0.5, 1, 16)
    poses = np.tile(np.eye(4), (16, 1, 1))
    poses[:, 0, 3] = np.arange(16)
    shot = take(
        ImportOptions(scale=255.0),
        meas=read(range(4, 12), weights[4:12]),
        masks=masks,
        weights=weights,
        world_to_camera=poses,
        telemetry_world_to_camera=poses,
    ).shots[0]
    assert np.allclose(shot.weights, weights[4:12])
    assert np.array_equal(shot.truth.world_to_camera[:, 0, 3], np.arange(4, 12))
    assert np.array_equal(shot.telemetry_world_to_camera[:, 0, 3], np.arange(4, 12))


@pytest.mark.parametrize("lost", [1, 3])
def test_masks_that_are_missing_are_named_as_the_cause(many, take, said, lost):
    """F13: warned, without the cause."""
    masks, read = many
    imported = take(ImportOptions(scale=255.0), meas=read(range(9)), masks=masks[: 9 - lost])
    assert said(imported, "were more masks shown than the file holds")


def test_light_of_masks_that_are_missing_is_not_called_an_offset(many, take, said):
    masks, read = many
    imported = take(ImportOptions(scale=255.0), meas=read(range(8)), masks=masks[:5])
    assert said(imported, "(about 3 more)")
    assert not said(imported, "pixels that no mask opens read")


def test_a_leak_is_not_taken_for_a_missing_mask(many, take, said):
    masks, _ = many
    even = np.full(masks.shape[1:], 120.0)
    meas = even * (masks[:8] * 0.8 + 0.2).sum(axis=0)
    assert not said(take(ImportOptions(scale=255.0), meas=meas, masks=masks[:8]), "more masks shown")


@pytest.fixture
def mosaic():
    """Nine half-open masks, and what a Bayer sensor reads of a picture of fine texture behind some of them."""
    rng = np.random.default_rng(8)
    masks = (rng.random((9, 72, 96)) < 0.5).astype(np.uint8)
    texture = ndimage.gaussian_filter(rng.random((72, 104)), 0.8)
    texture = 0.15 + 0.7 * (texture - texture.min()) / np.ptp(texture)
    gains = np.tile([[0.9, 0.6], [0.6, 0.4]], (36, 48))
    views = [texture[:, k // 2 : 96 + k // 2] for k in range(9)]

    def read(shown, black=0.0):
        return 700 * (gains * sum(masks[k] * views[k] for k in shown) + black)

    return masks, read


@pytest.mark.parametrize(("black", "hot"), [(0.0, 0), (0.3, 0), (0.3, 20)])
def test_a_black_level_below_texture_in_a_mosaic_is_not_taken_for_a_missing_mask(mosaic, take, said, black, hot):
    masks, read = mosaic
    readings = read(range(8), black)
    rng = np.random.default_rng(9)
    readings[rng.integers(0, 72, hot), rng.integers(0, 96, hot)] = 1.3 * readings.max()
    imported = take(ImportOptions(scale=700.0, cfa="RGGB"), meas=readings, masks=masks[:8])
    assert not said(imported, "more masks shown")


def test_a_mask_that_is_missing_is_named_in_a_mosaic_of_fine_texture(mosaic, take, said):
    masks, read = mosaic
    imported = take(ImportOptions(scale=700.0, cfa="RGGB"), meas=read(range(9)), masks=masks[:8])
    assert said(imported, "explained neither by these 8 masks nor by texture: were more masks shown")
    assert said(imported, "(about 1 more)")


def test_a_mask_that_was_shown_twice_is_named(many, take, said):
    masks, read = many
    imported = take(ImportOptions(scale=255.0), meas=read([0, 1, 2, 3, 4, 5, 2]), masks=masks[:6])
    assert said(imported, "masks 2 left 2.0 times the trace of the others")


def test_masks_that_are_inverted_are_taken_the_other_way_round(many, take, said):
    masks, read = many
    imported = take(ImportOptions(scale=255.0), meas=read(range(8)), masks=1 - masks[:8])
    assert said(imported, "the masks are inverted")
    assert np.array_equal(imported.shots[0].masks, masks[:8])


def test_masks_that_are_displaced_are_asked_where_they_show(many, take, said):
    masks, read = many
    imported = take(ImportOptions(scale=255.0), meas=np.roll(read(range(8)), (3, -2), (0, 1)), masks=masks)
    assert said(imported, "8 to 15 left no trace")
    assert said(imported, "displaced by +3.0 px down and -2.0 px")


def test_pictures_that_tell_nothing_choose_no_masks(many):
    masks, read = many
    image = read(range(8))
    masks = masks.astype(np.float32)
    assert traces(image[:12, :12], masks[:, :12, :12]) is None
    assert traces(0 * image, masks) is None
    assert traces(image, np.repeat(masks[:1], 4, axis=0)) is None
    assert traces(-image, masks) is None
    noise = np.random.default_rng(0).random(image.shape)
    assert traces(noise, masks).shown.all()


@pytest.mark.parametrize("background", [0.06, 0.12, 0.2])
def test_a_background_in_the_masks_goes_with_the_offset_of_the_readings(many, take, said, background):
    """F8: the true offset made it worse, 19.6 instead of 22.2 dB."""
    masks, read = many
    recorded = np.rint(250 * (background + (1 - background) * masks[:8])).astype(np.uint8)
    offset = 40.0
    imported = take(ImportOptions(scale=255.0, offset=offset), meas=offset + read(range(8)), masks=recorded)
    assert said(imported, "the masks lie on a background of")
    assert np.abs(imported.shots[0].masks - masks[:8]).max() < 0.02


def test_an_offset_that_is_too_large_for_masks_that_close_is_named(many, take, said):
    masks, read = many
    imported = take(ImportOptions(scale=255.0, offset=150.0), meas=40 + read(range(8)), masks=masks[:8])
    assert said(imported, "is the offset too large?")
    right = take(ImportOptions(scale=255.0, offset=40.0), meas=40 + read(range(8)), masks=masks[:8])
    assert not [guess for guess in right.guesses if guess.startswith("WARNING")]


def test_a_black_level_that_was_subtracted_too_far_is_named(many, take, said):
    masks, read = many
    meas = np.maximum(read(range(8)) - 250, 0)
    assert said(take(ImportOptions(scale=255.0), meas=meas, masks=masks[:8]), "too much subtracted")


def test_white_and_dark_frames_among_the_masks_that_were_not_shown_are_left_out(many, take, said):
    masks, read = many
    frames = np.concatenate([np.ones_like(masks[:1]), masks[:6], np.zeros_like(masks[:1])])
    imported = take(ImportOptions(scale=255.0), meas=read(range(6)), masks=frames)
    assert said(imported, "masks 0, 7 are white and dark frames that were not shown")
    assert np.array_equal(imported.shots[0].masks, masks[:6])
    kept = take(ImportOptions(scale=255.0, views=8), meas=read(range(6)), masks=frames)
    assert np.array_equal(kept.shots[0].masks, frames)


def test_a_white_mask_that_was_shown_is_kept(many, take):
    masks, read = many
    frames = np.concatenate([np.ones_like(masks[:1]), masks[:6]])
    imported = take(ImportOptions(scale=255.0), meas=read(range(6)) + 128, masks=frames)
    assert np.array_equal(imported.shots[0].masks, frames)


def test_measurements_under_masks_of_their_own_are_refused_even_as_three_colours(many, take):
    masks, read = many
    meas = np.stack([read(range(5 * k, 5 * k + 5)) for k in range(3)])
    with pytest.raises(InputError, match="one measurement shows masks 5 to 9, plane 0 masks 0 to 4"):
        take(ImportOptions(scale=255.0), meas=meas, masks=masks[:15])
    with pytest.raises(InputError, match="one measurement shows masks 0 to 4, measurement 1 masks 5 to 9"):
        take(ImportOptions(scale=255.0, meas_layout="stack"), meas=meas, masks=masks[:15])


def test_pictures_of_bit_planes_are_named(many, take, said):
    masks, read = many
    planes = np.packbits(masks.astype(bool), axis=0)
    imported = take(ImportOptions(scale=255.0), meas=read(range(16)), masks=planes)
    assert said(imported, "is each bit a mask, as in the pictures of a modulator")


def test_a_picture_of_24_bit_planes_is_named_where_readings_look_curved(take, said):
    """TI's LightCrafter takes 24 patterns as the bits of one picture; of a still scene only "a logarithm" was told."""
    rng = np.random.default_rng(5)
    masks = rng.integers(0, 2, (24, 64, 80))
    meas = np.einsum("nhw,hw->hw", masks, 20 + 200 * rng.random((64, 80)))
    planes = np.packbits(masks.astype(bool).reshape(3, 8, 64, 80), axis=1)[:, 0]
    assert said(take(meas=meas, masks=planes), "is each bit a mask, as in the pictures of a modulator")
    assert not said(take(meas=np.log(1 + meas), masks=255 * masks[:3].astype(np.uint8)), "is each bit a mask")
