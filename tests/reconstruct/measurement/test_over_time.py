"""Where views err over time although their coded sum is right, found in the measurement alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci.core.records import Shot, Truth
from gs2ci.reconstruct.measurement import over_time
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.over_time import errs_over_time, followed_by_other_alone, replaced

SIZE, VIEWS = (64, 80), 8


def wall(seed=0, sigma_px=1.0):
    grey = gaussian_filter(np.random.default_rng(seed).random(SIZE), sigma_px)
    return (0.2 + 0.6 * (grey - grey.min()) / np.ptp(grey)).astype(np.float32)


def with_disc(step_px=6.0):
    """A bright disc that crosses a textured wall; its views, and where it was."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    inside = np.stack([np.hypot(rows - 30, columns - 18 - step_px * k) < 10 for k in range(VIEWS)])
    return np.where(inside, 0.9 * wall(5) + 0.4, wall())[..., None].astype(np.float32), inside.any(axis=0)


def masks_of(kind):
    draw = np.random.default_rng(2)
    if kind == "random":
        return (draw.random((VIEWS, *SIZE)) < 0.5).astype(np.float32)
    if kind == "coarse":
        coarse = draw.random((VIEWS, SIZE[0] // 4, SIZE[1] // 4)) < 0.5
        return np.kron(coarse, np.ones((1, 4, 4))).astype(np.float32)
    pattern = gaussian_filter((draw.random((SIZE[0] + VIEWS, SIZE[1])) < 0.5).astype(np.float32), 0.5)
    return np.stack([pattern[VIEWS - k : VIEWS - k + SIZE[0]] for k in range(VIEWS)])


def exposed(truth, kind="random", noise=0.01, weights=None):
    masks = masks_of(kind)
    given = np.ones(VIEWS, np.float32) if weights is None else np.asarray(weights, np.float32)
    light = np.einsum("n,nhw,nhwc->hwc", given, masks, truth)
    light += noise * np.random.default_rng(3).standard_normal(light.shape)
    shot = Shot(light.astype(np.float32), masks, np.ones(VIEWS, np.float32), truth=Truth(truth)).check()
    return Holdout.of(shot, 0.02, 0)


def explaining(holdout):
    """One picture for all views that gives the measurement exactly: what a scene at rest comes to."""
    shot = holdout.shot
    one = shot.measurement / np.maximum(shot.masks.sum(axis=0), 0.5)[..., None]
    return np.repeat(one[None], VIEWS, axis=0).astype(np.float32)


@pytest.mark.parametrize("kind", ["random", "one pattern"])
def test_one_picture_that_explains_the_measurement_errs_where_a_disc_moved(kind):
    truth, crossed = with_disc()
    holdout = exposed(truth, kind)
    fitted = explaining(holdout)
    assert np.abs(holdout.coded(fitted) - holdout.shot.measurement)[holdout.shot.usable].max() < 1e-3
    wrong = errs_over_time(holdout, fitted)
    assert wrong[crossed].mean() > 0.25
    far = gaussian_filter(crossed.astype(float), 8) < 1e-3
    assert wrong[far].mean() < 0.05


@pytest.mark.parametrize("kind", ["random", "coarse", "one pattern"])
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1])
def test_true_views_do_not_err(kind, noise):
    truth, _ = with_disc()
    assert errs_over_time(exposed(truth, kind, noise), truth).mean() < 0.02


@pytest.mark.parametrize("kind", ["random", "coarse", "one pattern"])
def test_views_that_lack_all_detail_do_not_err_over_time(kind):
    still = np.repeat(wall()[None, ..., None], VIEWS, axis=0)
    lacking = np.full_like(still, still.mean())
    assert not errs_over_time(exposed(still, kind), lacking).any()


def test_a_lamp_that_flickers_is_no_motion():
    still = np.repeat(wall()[None, ..., None], VIEWS, axis=0)
    assert not errs_over_time(exposed(still, weights=np.linspace(0.7, 1.3, VIEWS)), still).any()


def test_errors_too_small_to_see_do_not_count():
    truth, _ = with_disc()
    still = truth.mean(axis=0, keepdims=True)
    faint = still + 0.02 * (truth - still)
    assert not errs_over_time(exposed(faint, noise=0.0), np.repeat(still, VIEWS, axis=0)).any()


def test_held_out_pixels_are_not_read():
    truth, _ = with_disc()
    holdout = exposed(truth)
    fitted, other = explaining(holdout), holdout.shot.measurement.copy()
    other[holdout.pixels] += 5
    changed = Holdout(replace(holdout.shot, measurement=other), holdout.pixels)
    assert np.array_equal(errs_over_time(changed, fitted), errs_over_time(holdout, fitted))


def test_only_where_the_other_views_are_right_are_they_put_in_place():
    truth, crossed = with_disc()
    holdout = exposed(truth)
    fitted = explaining(holdout)
    assert not followed_by_other_alone(holdout, truth, fitted).any()
    assert not followed_by_other_alone(holdout, fitted, fitted).any()
    where = followed_by_other_alone(holdout, fitted, truth)
    assert where.dtype == np.float32
    assert where.min() >= 0
    assert where.max() <= 1
    better = replaced(fitted, truth, where)
    assert better.dtype == np.float32
    errors = [np.mean((views - truth)[:, crossed] ** 2) for views in (fitted, better)]
    assert errors[1] < 0.4 * errors[0]
    untouched = where == 0
    assert np.array_equal(better[:, untouched], fitted[:, untouched])


def test_less_than_a_hundredth_of_the_picture_is_left_alone(monkeypatch):
    truth, _ = with_disc()
    holdout = exposed(truth)
    wrong = np.zeros(SIZE, np.float32)
    wrong[0, :50] = 100
    monkeypatch.setattr(over_time, "errors_over_time", lambda _, views: wrong * (views is not truth))
    assert not followed_by_other_alone(holdout, truth + 0.1, truth).any()
    wrong[0, :60] = 100
    assert followed_by_other_alone(holdout, truth + 0.1, truth).any()


@pytest.mark.parametrize("size", [(1, 1), (4, 80), (64, 5), (8, 8), (17, 33)])
@pytest.mark.parametrize("views", [1, 2, 40])
def test_small_pictures_and_few_views_are_tested_or_left_alone(size, views):
    draw = np.random.default_rng(0)
    masks = (draw.random((views, *size)) < 0.5).astype(np.float32)
    shown = draw.random((views, *size, 3)).astype(np.float32)
    light = np.einsum("nhw,nhwc->hwc", masks, shown)
    holdout = Holdout.of(Shot(light.astype(np.float32), masks, np.ones(views, np.float32)), 0.02, 0)
    with np.errstate(all="raise"):
        found = errs_over_time(holdout, shown)
    assert found.shape == size


@pytest.mark.parametrize("spoil", ["dark", "closed", "alike", "not finite"])
def test_measurements_that_say_nothing_find_nothing(spoil):
    truth, _ = with_disc()
    holdout = exposed(truth)
    shot, views = holdout.shot, explaining(holdout)
    if spoil == "dark":
        shot, views = replace(shot, measurement=np.zeros_like(shot.measurement)), np.zeros_like(views)
    elif spoil == "closed":
        shot = replace(shot, masks=np.zeros_like(shot.masks))
    elif spoil == "alike":
        shot = replace(shot, masks=np.ones_like(shot.masks))
    else:
        views = np.full_like(views, np.nan)
    with np.errstate(all="raise"):
        assert not errs_over_time(Holdout(shot, holdout.pixels), views).any()


def test_a_mosaic_is_tested_like_any_other():
    truth, crossed = with_disc()
    colour = np.repeat(truth, 3, axis=3)
    plain = exposed(truth)
    shot = replace(plain.shot, cfa="RGGB", truth=Truth(colour)).check()
    holdout = Holdout(shot, plain.pixels)
    fitted = np.repeat(explaining(plain), 3, axis=3)
    assert errs_over_time(holdout, colour).mean() < 0.02
    assert errs_over_time(holdout, fitted)[crossed].mean() > 0.25
