"""GAP-TV against its plain statement in numpy float64, and on the measurements that break decoders."""

from dataclasses import replace

import numba
import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.core.progress import Silent
from gs2ci.core.records import CFA_PATTERNS, Shot
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, decode_signed, gap_tv
from gs2ci.reconstruct.decode.kernels import denoise_planes
from gs2ci.reconstruct.measurement.coding import Coding


def divergence(dual_y, dual_x):
    div = dual_y + dual_x
    div[..., 1:, :] -= dual_y[..., :-1, :]
    div[..., :, 1:] -= dual_x[..., :, :-1]
    return div


def denoise_reference(x, weight, inner):
    """Chambolle's dual projected gradient, [..., H, W]."""
    dual_y, dual_x = np.zeros_like(x), np.zeros_like(x)
    for _ in range(inner):
        u = x + weight * divergence(dual_y, dual_x)
        dual_y[..., :-1, :] += (u[..., 1:, :] - u[..., :-1, :]) / (8 * weight)
        dual_x[..., :, :-1] += (u[..., :, 1:] - u[..., :, :-1]) / (8 * weight)
        length = np.maximum(1, np.hypot(dual_y, dual_x))
        dual_y, dual_x = dual_y / length, dual_x / length
    return x + weight * divergence(dual_y, dual_x)


def gap_tv_reference(measurement, masks, iterations, weight, inner):
    """Accelerated GAP (Yuan 2016): measurement [H, W, C], masks [N, H, W] that open every pixel."""
    y, m = measurement.transpose(2, 0, 1)[None], masks[:, None]
    energy = (m**2).sum(0)
    views = np.repeat(y / m.sum(0), len(masks), axis=0)
    y1 = np.zeros_like(y)
    for _ in range(iterations):
        predicted = (m * views).sum(0)
        y1 = y1 + (y - predicted)
        views = denoise_reference(views + m * (y1 - predicted) / energy, weight, inner)
    return np.clip(views, 0, 1).transpose(0, 2, 3, 1)


def smooth_views(n, height, width, channels, seed=0):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width] / 8
    phase = rng.uniform(0, 6, (n, 1, 1, channels))
    views = 0.5 + 0.4 * np.sin(x[None, ..., None] + phase) * np.cos(y[None, ..., None] - phase)
    return views.astype(np.float32)


def random_masks(n, height, width, seed=1, grey=False):
    rng = np.random.default_rng(seed)
    masks = rng.random((n, height, width)) if grey else rng.random((n, height, width)) < 0.5
    masks = masks.astype(np.float32)
    masks[0][masks.sum(0) == 0] = 1
    return masks


def shot_of(views, masks, cfa=None, **more):
    blank = np.zeros((*masks.shape[1:], 1 if cfa else views.shape[3]), np.float32)
    weights = more.pop("weights", np.ones(len(masks), np.float32))
    shot = Shot(blank, masks, weights, cfa=cfa, **more)
    measurement = Coding.of(shot).forward(torch.from_numpy(views)).numpy()
    return Shot(measurement, masks, weights, cfa=cfa, **more).check()


def psnr(a, b):
    return -10 * np.log10(np.mean((a.astype(np.float64) - b) ** 2))


@pytest.mark.parametrize("shape", [(3, 12, 17), (1, 1, 9), (2, 9, 1), (1, 1, 1), (2, 2, 2)])
def test_denoiser_agrees_with_its_reference(shape):
    image = np.random.default_rng(0).random(shape).astype(np.float32)
    expected = denoise_reference(image.astype(np.float64), 0.1, 7)
    denoise_planes(image, 0.1, 7)
    np.testing.assert_allclose(image, expected, atol=2e-6)


def test_denoiser_leaves_a_constant_alone_and_keeps_the_mean():
    flat = np.full((1, 8, 8), 0.3, np.float32)
    denoise_planes(flat, 0.5, 20)
    np.testing.assert_allclose(flat, 0.3, rtol=1e-6)
    noisy = np.random.default_rng(0).random((1, 16, 16)).astype(np.float32)
    mean, spread = noisy.mean(), noisy.std()
    denoise_planes(noisy, 0.5, 20)
    assert noisy.mean() == pytest.approx(mean, rel=1e-5)
    assert noisy.std() < spread / 2


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("grey", [False, True])
def test_gap_tv_agrees_with_its_reference(channels, grey):
    views, masks = smooth_views(4, 20, 23, channels), random_masks(4, 20, 23, grey=grey)
    masks = np.maximum(masks, 0.2) if grey else masks  # the reference does not damp
    shot = shot_of(views, masks)
    expected = gap_tv_reference(shot.measurement.astype(np.float64), masks.astype(np.float64), 12, 0.07, 5)
    got = gap_tv(shot, GapTvSettings(iterations=12))
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, expected, atol=2e-5)


def test_gap_tv_recovers_smooth_views():
    views, masks = smooth_views(4, 40, 40, 3), random_masks(4, 40, 40)
    shot = shot_of(views, masks)
    start = np.repeat((shot.measurement / masks.sum(0)[..., None])[None], 4, axis=0)
    assert psnr(gap_tv(shot), views) > psnr(start, views) + 8


def test_weights_count_like_fainter_masks():
    views, masks = smooth_views(3, 16, 16, 1), random_masks(3, 16, 16)
    weights = np.array([0.5, 1.0, 0.8], np.float32)
    weighted = gap_tv(shot_of(views, masks, weights=weights))
    np.testing.assert_allclose(weighted, gap_tv(shot_of(views, masks * weights[:, None, None])), atol=1e-6)


@pytest.mark.parametrize("cfa", ["RGGB", "GBRG"])
def test_a_mosaic_is_decoded_to_colour(cfa):
    views = smooth_views(3, 40, 41, 3)
    got = gap_tv(shot_of(views, random_masks(3, 40, 41), cfa=cfa))
    assert got.shape == views.shape
    assert psnr(got, views) > 20


def test_result_is_bitwise_the_same_for_one_and_two_threads():
    shot = shot_of(smooth_views(4, 33, 35, 3), random_masks(4, 33, 35))
    before = numba.get_num_threads()
    results = []
    try:
        for threads in (1, min(2, before)):
            numba.set_num_threads(threads)
            results.append(gap_tv(shot, GapTvSettings(iterations=5)))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(*results)


def unopened(masks):
    masks[:, 3:6, 4:8] = 0
    masks[:, 10] = 0


def all_ones(masks):
    masks[:] = 1


def identical(masks):
    masks[:] = masks[0]


def one_empty(masks):
    masks[1] = 0


def nearly_dark(masks):
    masks[:, 5, 5] = 1e-6


@pytest.mark.parametrize("spoil", [unopened, all_ones, identical, one_empty, nearly_dark])
@pytest.mark.parametrize("cfa", [None, "RGGB"])
def test_hard_masks_give_finite_views_in_range(spoil, cfa):
    views, masks = smooth_views(3, 16, 16, 3), random_masks(3, 16, 16)
    spoil(masks)
    got = gap_tv(shot_of(views, masks, cfa=cfa))
    assert np.isfinite(got).all()
    assert got.min() >= 0
    assert got.max() <= 1


def test_pixels_that_no_mask_opens_are_filled_from_their_surroundings():
    views, masks = smooth_views(2, 24, 24, 1), random_masks(2, 24, 24)
    masks[:, 10:12, 10:12] = 0
    got = gap_tv(shot_of(views, masks))
    assert np.abs(got[:, 10:12, 10:12] - views[:, 10:12, 10:12]).max() < 0.25


@pytest.mark.parametrize("cfa", [None, *CFA_PATTERNS])
def test_pixels_without_a_reading_take_the_colour_of_their_surroundings(cfa):
    red = np.broadcast_to(np.array([0.9, 0.3, 0.1], np.float32), (4, 35, 48, 3)).copy()
    masks = random_masks(4, 35, 48)
    unread = np.random.default_rng(0).random((35, 48)) < 0.05
    unread[12:24, 20:32] = True
    got = gap_tv(shot_of(red, masks * ~unread, cfa=cfa))
    assert np.abs(got - red)[:, unread].max() < 0.03


@pytest.mark.parametrize("value", [0.0, 1.0, 1e3])
def test_constant_measurements_give_finite_views_in_range(value):
    masks = random_masks(3, 12, 12)
    shot = Shot(np.full((12, 12, 1), value, np.float32), masks, np.ones(3, np.float32)).check()
    got = gap_tv(shot)
    assert np.isfinite(got).all()
    assert got.min() >= 0
    assert got.max() <= 1


@pytest.mark.parametrize("weighed", [False, True], ids=["exact", "noise weighed"])
@pytest.mark.parametrize("several", [False, True], ids=["a shot", "a list of one"])
def test_channels_of_a_large_shot_are_decoded_one_by_one_to_the_same_bits(monkeypatch, weighed, several):
    shot = shot_of(smooth_views(3, 20, 23, 3), random_masks(3, 20, 23))
    noise = np.full(shot.measurement.shape, 1e-3, np.float32) if weighed else None
    together = decode_signed(shot, noise=noise)
    monkeypatch.setattr("gs2ci.reconstruct.decode.gap_tv._LARGE_BYTES", 0)
    np.testing.assert_array_equal(decode_signed([shot] if several else shot, noise=noise), together)


def test_saturated_pixels_count_for_nothing():
    views, masks = smooth_views(3, 24, 24, 1), random_masks(3, 24, 24)
    clean = shot_of(views, masks)
    saturated = np.zeros((24, 24), bool)
    saturated[5:7, 5:7] = True
    wrong = clean.measurement.copy()
    wrong[saturated] = 50.0
    marked = Shot(wrong, masks, clean.weights, saturated=saturated).check()
    assert np.abs(gap_tv(marked) - gap_tv(clean)).max() < 0.1
    assert np.abs(gap_tv(Shot(wrong, masks, clean.weights).check()) - gap_tv(clean)).max() > 0.3


def test_tiny_images_are_decoded():
    masks = random_masks(2, 1, 2)
    assert gap_tv(shot_of(np.full((2, 1, 2, 3), 0.5, np.float32), masks, cfa="RGGB")).shape == (2, 1, 2, 3)


def test_progress_hears_of_every_iteration_and_its_relative_residual():
    class Listener(Silent):
        def __init__(self):
            super().__init__()
            self.residuals = []

        def step(self, done, **figures):
            self.residuals.append(figures["residual"])

    listener = Listener()
    gap_tv(shot_of(smooth_views(3, 16, 16, 1), random_masks(3, 16, 16)), GapTvSettings(iterations=9), listener)
    assert len(listener.residuals) == 9
    assert listener.residuals[0] < 1e-6  # the mean exposure explains the measurement, and no single view
    assert listener.residuals[-1] < 0.1


@pytest.mark.parametrize("wrong", [{"iterations": 0}, {"inner": 0}, {"weight": 0.0}, {"weight": float("nan")}])
def test_senseless_settings_are_refused(wrong):
    with pytest.raises(InputError, match=f"{next(iter(wrong))} = .* in GapTvSettings"):
        GapTvSettings(**wrong).check()


def test_steps_that_keep_to_black_and_white_come_closer_to_a_picture_of_both(make_shot):
    shot = make_shot()
    truth = (shot.truth.views > np.median(shot.truth.views)).astype(np.float32)
    measured = (shot.masks[..., None] * shot.weights[:, None, None, None] * truth).sum(axis=0)
    bright = replace(shot, measurement=measured)
    free, clamped = (decode_signed(bright, GapTvSettings(weight=0.3, clamped=one)) for one in (False, True))
    assert free.min() < 0
    assert clamped.min() >= 0
    assert clamped.max() <= 1
    assert np.square(clamped - truth).mean() < 0.95 * np.square(np.clip(free, 0, 1) - truth).mean()
