import cv2
import numpy as np
import pytest

from gs2ci.rig.live.looks import SHOWN_PX, encode_png, figures_of, picture_png, residual_of, sharpness_of


def scene(rng, blur=0.0, size=(120, 160)):
    blocks = rng.uniform(200, 2000, (size[0] // 8, size[1] // 8)).repeat(8, 0).repeat(8, 1)
    return np.maximum(cv2.GaussianBlur(blocks, (0, 0), blur) if blur else blocks, 0).astype(np.uint16)


def test_sharpness_falls_with_blur_and_hardly_changes_with_light_and_noise():
    rng = np.random.default_rng(0)
    sharp = scene(rng)
    values = [sharpness_of(scene(np.random.default_rng(0), blur), 0.0) for blur in (0, 1, 2, 4)]
    assert values == sorted(values, reverse=True)
    assert values[0] > 2 * values[2]
    assert sharpness_of(sharp // 2, 0.0) == pytest.approx(values[0], rel=0.02)
    noisy = np.clip(sharp + rng.normal(0, 20, sharp.shape), 0, 4095).astype(np.uint16)
    assert sharpness_of(noisy, 0.0) == pytest.approx(values[0], rel=0.05)


def test_sharpness_of_darkness_and_of_single_rows_is_none():
    assert sharpness_of(np.zeros((8, 8), np.uint16), 0.0) == 0.0
    assert sharpness_of(np.ones((1, 8), np.uint16), 0.0) == 0.0


def test_figures_count_what_is_saturated_and_every_pixel_once():
    pixels = np.full((10, 10), 100, np.uint16)
    pixels[0] = 4095
    figures = figures_of(pixels, 4095, 4000.0, 64.0)
    assert figures.saturated == pytest.approx(0.1)
    assert (figures.peak_dn, sum(figures.histogram), figures.histogram[-1]) == (4095, 100, 10)


@pytest.mark.parametrize(("down", "right"), [(0, 0), (3, -5), (-7, 2)])
def test_a_mask_is_found_where_it_lies(down, right):
    rng = np.random.default_rng(3)
    mask = (rng.random((200, 240)) < 0.5).astype(np.float64)
    light = cv2.GaussianBlur(rng.uniform(500, 2000, (200, 240)), (0, 0), 6)
    seen = (64 + np.roll(mask, (down, right), (0, 1)) * light).astype(np.uint16)
    residual = residual_of(seen, mask, 64.0)
    assert residual.found
    assert (residual.down_px, residual.right_px) == pytest.approx((down, right), abs=0.1)
    assert residual.rotation_deg == pytest.approx(0.0, abs=0.1)
    for _, _, arrow_down, arrow_right in residual.arrows:
        assert (arrow_down, arrow_right) == (down, right)


def test_an_enlarged_mask_has_arrows_that_point_outwards():
    rng = np.random.default_rng(4)
    mask = (rng.random((300, 300)) < 0.5).astype(np.float64)
    grown = cv2.warpAffine(mask, np.float64([[1.02, 0, -3.0], [0, 1.02, -3.0]]), (300, 300), flags=cv2.INTER_LINEAR)
    residual = residual_of((1000 * grown).astype(np.uint16), mask, 0.0)
    assert residual.found
    assert residual.scale == pytest.approx(0.02, abs=0.005)
    corner = min(residual.arrows, key=lambda arrow: arrow[0] + arrow[1])
    assert corner[2] < 0
    assert corner[3] < 0


def test_a_picture_without_the_mask_has_no_arrow():
    rng = np.random.default_rng(5)
    mask = (rng.random((200, 200)) < 0.5).astype(np.float64)
    residual = residual_of(rng.integers(0, 1000, (200, 200)).astype(np.uint16), mask, 0.0)
    assert residual.arrows == ()
    assert not residual.found


def test_a_picture_is_drawn_with_saturation_in_red_and_large_ones_are_made_smaller():
    pixels = np.full((4, 6), 64, np.uint16)
    pixels[0, 0] = 4095
    png, size = picture_png(pixels, 4095, 4000.0, 64.0)
    drawn = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert size == (4, 6)
    assert drawn[0, 0].tolist() == [255, 40, 40]
    assert drawn[1, 1].tolist() == [0, 0, 0]
    large = cv2.imdecode(np.frombuffer(encode_png(np.zeros((1, 2 * SHOWN_PX + 2), np.uint8)), np.uint8), 0)
    assert large.shape[1] <= SHOWN_PX
