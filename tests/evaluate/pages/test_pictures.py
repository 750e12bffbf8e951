import base64

import cv2
import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.evaluate.pages import pictures
from gs2ci.evaluate.pages.pictures import colour, encode, encode_all, media_type, scale_strip, to_eight_bit


def noise(count, height, width):
    rng = np.random.default_rng(0)
    return [rng.integers(0, 256, (height, width, 3), dtype=np.uint8) for _ in range(count)]


def read(picture):
    return cv2.imdecode(np.frombuffer(picture.content, np.uint8), cv2.IMREAD_UNCHANGED)


def weight(found):
    return sum(len(base64.b64encode(picture.content)) for stack in found.values() for picture in stack)


def test_eight_bits_are_rounded_clamped_and_finite():
    assert to_eight_bit(np.array([-1, 0, 0.5, 1, 7, np.nan, np.inf])).tolist() == [0, 0, 128, 255, 255, 0, 255]


def test_small_pictures_are_lossless_and_in_red_green_blue():
    (image,) = noise(1, 30, 40)
    picture = encode_all({"a": [image]})["a"][0]
    assert (picture.kind, picture.width, picture.height) == ("image/png", 40, 30)
    np.testing.assert_array_equal(read(picture)[..., ::-1], image)


def test_one_channel_stays_one():
    picture = encode(noise(1, 8, 8)[0][..., :1], quality=None)
    assert read(picture).ndim == 2


def test_large_pictures_shrink_until_they_fit_the_budget():
    stacks = {"a": noise(1, 700, 1000), "b": noise(1, 700, 1000)}
    found = encode_all(stacks, budget_bytes=100_000)
    assert weight(found) <= 100_000
    assert {picture.kind for stack in found.values() for picture in stack} == {"image/webp"}
    assert found["a"][0].width > found["a"][0].height >= 60


def test_a_budget_for_not_even_thumbnails_is_refused():
    with pytest.raises(InputError, match="pictures of"):
        encode_all({"a": noise(4, 300, 300)}, budget_bytes=1000)


def test_lossless_pictures_over_the_budget_become_lossy():
    found = encode_all({"a": noise(8, 150, 150)}, budget_bytes=300_000)
    assert weight(found) <= 300_000
    assert found["a"][0].kind == "image/webp"


def test_nothing_to_encode_is_nothing():
    assert encode_all({}) == {}


def test_pictures_that_no_format_holds_are_refused():
    with pytest.raises(InputError, match="cannot be encoded"):
        encode(np.zeros((1, 17_000, 3), np.uint8), quality=80)


def test_colours_run_from_the_first_limit_to_the_second_and_empty_pixels_are_grey():
    values, empty = np.array([[0.0, 5.0, 10.0, np.nan]]), np.array([[False, False, False, True]])
    (first, middle, last, none) = colour(values, (0, 10), "depth", empty=empty)[0].astype(int)
    table = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], pictures.COLORMAPS["depth"])[:, 0, ::-1]
    assert first.tolist() == table[0].tolist()
    assert middle.tolist() == table[128].tolist()
    assert last.tolist() == table[255].tolist()
    assert none.tolist() == [128, 128, 128]


def test_limits_that_are_one_colour_everything_alike():
    assert len(np.unique(colour(np.ones((3, 3)), (1, 1), "error", empty=np.zeros((3, 3), bool)))) <= 3


def test_a_scale_is_small():
    assert len(scale_strip("error").content) < 2000


def test_other_bytes_are_no_picture():
    assert media_type(b"") is None
    assert media_type(b"RIFF....AVI ") is None
