"""The pixels that no stage sees: which they are, and how they judge."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import RESIDUAL, GapTvSettings, decode_residual, gap_tv
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.reconstruct.measurement.holdout import Holdout, choose_heldout, surely_larger


@pytest.fixture
def shot():
    rng = np.random.default_rng(0)
    masks = (rng.random((4, 30, 40)) < 0.3).astype(np.float32)
    views = rng.random((4, 30, 40, 3)).astype(np.float32)
    return Shot(measurement=(masks[..., None] * views).sum(axis=0), masks=masks, weights=np.ones(4, np.float32)).check()


@pytest.mark.parametrize("share", [0.02, 0.1, 0.5])
def test_the_share_is_of_the_pixels_that_can_judge(shot, share):
    coded = int(shot.masks.any(axis=0).sum())
    assert choose_heldout(shot, share, seed=0).sum() == round(share * coded)


def test_pixels_without_light_or_with_clipped_light_never_judge(shot):
    rng = np.random.default_rng(1)
    saturated = rng.random(shot.size) < 0.3
    masks = shot.masks.copy()
    masks[:, :10] = 0
    chosen = choose_heldout(replace(shot, masks=masks, saturated=saturated), 0.5, seed=0)
    assert chosen.sum() > 100
    assert not chosen[:10].any()
    assert not (chosen & saturated).any()


def test_hot_pixels_never_judge(shot):
    hot = np.random.default_rng(3).random(shot.size) < 0.03
    measurement = np.where(hot[..., None], np.float32(9), shot.measurement)
    chosen = choose_heldout(replace(shot, measurement=measurement), 0.5, seed=0)
    assert chosen.sum() > 100
    assert not (chosen & hot).any()


def test_all_pixels_judge_where_the_unit_is_wrong(shot):
    measurement = np.float32(100) * shot.measurement
    np.testing.assert_array_equal(
        choose_heldout(replace(shot, measurement=measurement), 0.2, seed=0), choose_heldout(shot, 0.2, seed=0)
    )


def test_a_mask_of_no_weight_lets_no_light_through(shot):
    masks = np.zeros_like(shot.masks)
    masks[0], masks[1, :, :20] = 1, 1
    weights = np.array([0, 1, 1, 1], np.float32)
    chosen = choose_heldout(replace(shot, masks=masks, weights=weights), 0.2, seed=0)
    assert chosen[:, :20].any()
    assert not chosen[:, 20:].any()


def test_averages_of_readings_do_not_judge(shot):
    averaged = np.zeros(shot.size, bool)
    averaged[:, :9] = True
    chosen = choose_heldout(shot, 0.2, seed=0, averaged=averaged)
    assert not chosen[averaged].any()
    assert chosen.sum() == round(0.2 * (shot.usable & ~averaged).sum())


def test_the_seed_alone_decides_which(shot):
    first, again, other = (choose_heldout(shot, 0.1, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_a_share_of_zero_holds_nothing_out(shot):
    assert not choose_heldout(shot, 0.0, seed=0).any()


@pytest.mark.parametrize(("coded", "expected"), [(0, 0), (1, 0), (2, 1), (3, 1), (10, 1)])
def test_of_few_coded_pixels_one_judges_and_the_others_stay_visible(shot, coded, expected):
    masks = np.zeros_like(shot.masks)
    masks[0].reshape(-1)[:coded] = 1
    assert choose_heldout(replace(shot, masks=masks), 0.02, seed=0).sum() == expected


def test_what_is_seen_is_a_valid_shot_closed_over_the_held_out_pixels(shot):
    heldout = choose_heldout(shot, 0.1, seed=0)
    seen = Holdout(shot, heldout).seen.check()
    assert (seen.masks[:, heldout] == 0).all()
    assert (seen.measurement[heldout] == 0).all()
    np.testing.assert_array_equal(seen.masks[:, ~heldout], shot.masks[:, ~heldout])
    np.testing.assert_array_equal(seen.measurement[~heldout], shot.measurement[~heldout])


def test_without_held_out_pixels_everything_is_seen(shot):
    holdout = Holdout(shot, np.zeros(shot.size, bool))
    assert holdout.seen is shot
    assert holdout.residual_rms(np.zeros((4, 30, 40, 3), np.float32)) is None


def test_what_was_measured_on_held_out_pixels_changes_no_bit_of_decode_and_residual(shot):
    heldout = choose_heldout(shot, 0.1, seed=0)
    other = shot.measurement.copy()
    other[heldout] += 7
    scene_views = np.full((4, 30, 40, 3), 0.4, np.float32)
    results = []
    for measurement in (shot.measurement, other):
        seen = Holdout(replace(shot, measurement=measurement), heldout).seen
        results.append((gap_tv(seen, GapTvSettings(iterations=5)), decode_residual(seen, scene_views, RESIDUAL)))
    for first, second in zip(*results, strict=True):
        np.testing.assert_array_equal(first, second)


def test_views_are_judged_by_their_residual_on_the_held_out_pixels_alone(shot):
    heldout = choose_heldout(shot, 0.1, seed=0)
    views = np.random.default_rng(2).random((4, 30, 40, 3)).astype(np.float32)
    predicted = (shot.masks[..., None].astype(np.float64) * views).sum(axis=0)
    expected = np.sqrt(np.mean((predicted - shot.measurement)[heldout] ** 2))
    holdout = Holdout(shot, heldout)
    assert holdout.residual_rms(views) == pytest.approx(expected, rel=1e-6)
    views[:, ~heldout] = 1e6
    assert holdout.residual_rms(views) == pytest.approx(expected, rel=1e-6)


def test_the_true_views_have_no_residual(shot):
    rng = np.random.default_rng(0)
    rng.random((4, 30, 40))
    truth = rng.random((4, 30, 40, 3)).astype(np.float32)
    assert Holdout.of(shot, 0.1, 0).residual_rms(truth) == pytest.approx(0, abs=1e-6)


def test_views_behind_a_colour_filter_array_are_judged_on_the_mosaic(shot):
    mosaic = replace(shot, measurement=shot.measurement[..., :1], cfa="RGGB")
    views = np.random.default_rng(2).random((4, 30, 40, 3)).astype(np.float32)
    holdout = Holdout.of(mosaic, 0.1, 0)
    predicted = Coding.of(mosaic).forward(torch.from_numpy(views)).numpy()
    expected = np.sqrt(np.mean((predicted - mosaic.measurement)[holdout.pixels].astype(np.float64) ** 2))
    assert holdout.residual_rms(views) == pytest.approx(expected, rel=1e-6)


def test_views_that_are_not_finite_have_an_infinite_residual(shot):
    views = np.full((4, 30, 40, 3), np.nan, np.float32)
    assert Holdout.of(shot, 0.1, 0).residual_rms(views) == float("inf")


def test_luck_on_few_pixels_is_not_taken_for_being_better():
    rng = np.random.default_rng(1)
    squares = rng.chisquare(1, 400)
    assert not surely_larger(squares, squares)
    assert not surely_larger(squares + 0.02 * rng.standard_normal(400), squares)
    assert surely_larger(squares + 0.01, squares)
    assert not surely_larger(squares, squares + 0.01)
    assert not surely_larger(np.array([2.0]), np.array([1.0]))
