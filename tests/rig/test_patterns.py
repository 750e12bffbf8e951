import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.rig.config import CaptureTable, RegistrationTable
from gs2ci.rig.patterns import draw_codes, on_modulator, origin


def test_random_codes_have_their_density_and_depend_on_the_seed_alone(tmp_path):
    table = CaptureTable(masks=4, density=0.25, seed=3)
    codes = draw_codes(table, (100, 120), tmp_path)
    assert codes.shape == (4, 100, 120)
    assert codes.mean() == pytest.approx(0.25, abs=0.01)
    assert np.array_equal(codes, draw_codes(table, (100, 120), tmp_path))
    assert not np.array_equal(codes, draw_codes(CaptureTable(masks=4, seed=4), (100, 120), tmp_path))


def _drawn(masks, density, size):
    return np.random.default_rng(np.random.SeedSequence(5)).random((masks, *size)) < density


def _beside(codes):
    """Return the share of open elements among the eight neighbours of an open one."""
    near = sum(np.roll(codes, (y, x), axis=(1, 2)) for y in (-1, 0, 1) for x in (-1, 0, 1)) - codes.astype(float)
    return float(near[codes > 0].mean()) / 8


@pytest.mark.parametrize(("masks", "density", "element"), [(8, 0.25, 1), (8, 0.25, 3), (16, 0.5, 1), (4, 0.5, 1)])
def test_each_element_is_open_in_one_mask_at_least_and_masks_let_as_much_light_through(
    tmp_path, masks, density, element
):
    table = CaptureTable(masks=masks, density=density, element=element, seed=5)
    codes = draw_codes(table, (60, 72), tmp_path)
    small = codes[:, ::element, ::element]
    drawn = _drawn(masks, density, small.shape[1:])
    assert codes.any(axis=0).all()
    assert not drawn.any(axis=0).all() or masks == 16
    assert small.sum() == drawn.sum()
    assert small.mean(axis=(1, 2)) == pytest.approx(drawn.mean(), abs=0.02)
    assert np.array_equal(codes, small.repeat(element, 1).repeat(element, 2))
    # Their sum keeps a pattern by which they are found.
    assert codes.sum(axis=0).std() > 0.4 * np.sqrt(masks * density)


@pytest.mark.parametrize(("masks", "density"), [(8, 0.25), (12, 0.5), (4, 0.25)])
def test_open_elements_of_a_mask_lie_evenly(tmp_path, masks, density):
    codes = draw_codes(CaptureTable(masks=masks, density=density, seed=5), (60, 72), tmp_path)
    drawn = _drawn(masks, density, (60, 72))
    assert _beside(drawn) == pytest.approx(density, abs=0.02)
    assert _beside(codes) < 0.9 * density
    # And so do those that one colour of a mosaic sees.
    assert _beside(drawn[:, ::2, 1::2]) == pytest.approx(density, abs=0.03)
    assert _beside(codes[:, ::2, 1::2]) < 0.9 * density
    if masks * density < 2:
        # Elements are opened as often as they are drawn: the sum is the same.
        assert np.array_equal(codes.sum(axis=0), drawn.sum(axis=0))


def test_masks_are_independent_draws_if_asked(tmp_path):
    codes = draw_codes(CaptureTable(masks=8, seed=5, even_masks=False), (60, 72), tmp_path)
    assert np.array_equal(codes, _drawn(8, 0.25, (60, 72)))


def test_grey_codes_use_the_whole_depth(tmp_path):
    assert set(np.unique(draw_codes(CaptureTable(bit_depth=8), (20, 20), tmp_path))) == {0, 255}


def test_codes_from_a_file_are_scaled_to_levels(tmp_path):
    np.save(tmp_path / "codes.npy", np.linspace(0, 1, 2 * 4 * 4).reshape(2, 4, 4))
    table = CaptureTable(pattern_file="codes.npy", bit_depth=8)
    codes = draw_codes(table, (4, 4), tmp_path)
    assert (codes.min(), codes.max(), codes.dtype) == (0, 255, np.uint16)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (np.zeros((2, 5, 5)), "shape"),
        (np.full((2, 4, 4), 1.5), r"outside \[0, 1\]"),
        (np.full((2, 4, 4), np.nan), r"outside \[0, 1\]"),
        (np.full((2, 4, 4), "a"), "array of numbers"),
        (np.zeros((0, 4, 4)), "N of 1 or more"),
        (b"", "empty"),
        (None, "pattern_file .*codes.npy: no such file"),
    ],
)
def test_pattern_files_that_cannot_be_used_are_refused(tmp_path, content, complaint):
    if isinstance(content, bytes):
        (tmp_path / "codes.npy").write_bytes(content)
    elif content is not None:
        np.save(tmp_path / "codes.npy", content)
    with pytest.raises(InputError, match=complaint):
        draw_codes(CaptureTable(pattern_file="codes.npy"), (4, 4), tmp_path)


@pytest.mark.parametrize("bit_depth", [1, 2, 3, 4, 8])
def test_grey_codes_are_shown_as_they_are_or_refused(tmp_path, bit_depth):
    """With one bit, the default, grey masks would silently become binary ones."""
    top = 2**bit_depth - 1
    table = CaptureTable(pattern_file="codes.npy", bit_depth=bit_depth)
    levels = np.random.default_rng(0).integers(0, top + 1, (2, 4, 4))
    np.save(tmp_path / "codes.npy", levels / top)
    assert np.array_equal(draw_codes(table, (4, 4), tmp_path), levels)
    grey = np.random.default_rng(1).random((2, 40, 40))
    np.save(tmp_path / "codes.npy", grey)
    if 0.5 / top <= 0.05:
        assert np.abs(draw_codes(table, (40, 40), tmp_path) / top - grey).max() <= 0.05
    else:
        with pytest.raises(InputError, match=rf"bit_depth = {bit_depth} in \[capture\] cannot show.*set bit_depth = 8"):
            draw_codes(table, (40, 40), tmp_path)


def test_masks_are_centred_with_their_superpixels_and_closed_around(tmp_path):
    codes = draw_codes(CaptureTable(masks=2, density=0.9), (10, 20), tmp_path)
    laid = on_modulator(codes, RegistrationTable(superpixel=3), (60, 100))
    assert laid.shape == (2, 60, 100)
    assert laid.dtype == np.uint8
    assert origin(RegistrationTable(superpixel=3), (10, 20), (60, 100)) == (15, 20)
    assert np.array_equal(laid[:, 15:45:3, 20:80:3], codes)
    assert np.array_equal(laid[:, 17:45:3, 22:80:3], codes)
    assert laid.sum() == 9 * codes.sum()


@pytest.mark.parametrize("table", [RegistrationTable(superpixel=7), RegistrationTable(superpixel=3, row=31)])
def test_masks_that_do_not_fit_on_the_modulator_are_refused(tmp_path, table):
    codes = draw_codes(CaptureTable(masks=2), (10, 20), tmp_path)
    with pytest.raises(InputError, match="do not fit"):
        on_modulator(codes, table, (60, 100))


def test_codes_may_be_flags_and_lie_in_an_archive(tmp_path):
    wanted = np.random.default_rng(0).random((2, 4, 4)) < 0.5
    np.savez(tmp_path / "codes.npz", masks=wanted)
    assert np.array_equal(draw_codes(CaptureTable(pattern_file="codes.npz"), (4, 4), tmp_path), wanted)


def test_elements_of_several_pixels_are_drawn_once_each(tmp_path):
    codes = draw_codes(CaptureTable(masks=2, density=0.5, element=3), (7, 8), tmp_path)
    assert codes.shape == (2, 7, 8)
    blocks = codes[:, :6, :6].reshape(2, 2, 3, 2, 3)
    assert (blocks == blocks[:, :, :1, :, :1]).all()
    assert codes.min() == 0
    assert codes.max() == 1
