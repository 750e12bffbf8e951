"""A decode that is watched ends where the held-out pixels say so, and hands over the best it came by."""

from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.decode.patches import decoder as watched
from gs2ci.reconstruct.decode.patches.decoder import (
    PatchSettings,
    decode_until_settled,
    patch_decode_from,
    seen_to_the_end,
)
from gs2ci.reconstruct.measurement.holdout import Holdout

LONG = PatchSettings(iterations=40, first_sigma=0.1, last_sigma=0.02)
PIXEL = np.ones((1, 1, 1, 1), np.float32)


def told(left):
    """A holdout that finds these residuals, one at each look."""
    said = iter(left)
    return SimpleNamespace(residual_rms=lambda views: next(said))


def looks_until_enough(left, least_gain):
    watch = watched._Watch(told(left), LONG, least_gain)
    steps = next(step for step in range(1, 4 * len(left) + 2) if step > 4 * len(left) or watch(step * 1e-3 * PIXEL))
    return steps, watch.best


@pytest.mark.parametrize(
    ("left", "least_gain", "steps", "best"),
    [
        ([1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4], 0.02, 29, 28),  # gains to the end: nobody stops it
        ([1.0, 0.9, 0.8, 0.79, 0.785, 0.784, 0.783], 0.02, 28, 28),  # a round gains 21, 13, 2.0 and then 0.9 %
        ([1.0, 0.7, 0.8, 0.9, 0.95], 0.02, 20, 8),  # gets worse: what was best is kept
        ([1.0, 1.2, 1.0, 0.9, 0.8, 0.7, 0.6], 0.02, 29, 28),  # a bad beginning is forgiven within a round
        ([1.0, 0.9, 0.8, 0.79, 0.785, 0.784, 0.783], None, 29, 28),  # little gain is no reason
        ([1.0, 0.7, 0.72, 0.71, 0.8, 0.72, 0.8, 0.8], None, 33, 24),  # the latest of those that are alike
        ([1.0, 0.7, 0.8, 0.8, 0.8, 0.8], None, 20, 8),  # a whole round is clearly worse
    ],
)
def test_it_goes_on_as_long_as_a_round_gains(left, least_gain, steps, best):
    found, (at, views) = looks_until_enough(left, least_gain)
    assert (found, at) == (steps, best)
    np.testing.assert_allclose(views, best * 1e-3)


def test_a_watched_decode_of_noise_is_as_good_as_the_whole_schedule_and_ends_before_it(make_shot):
    shot = make_shot(slide=0.4, noise=0.1)
    holdout = Holdout.of(shot, 0.1, 0)
    start = gap_tv(holdout.seen)
    settled, whole = decode_until_settled(holdout, start, LONG), patch_decode_from(holdout.seen, start, LONG)
    assert settled.steps < LONG.iterations
    assert settled.sigma in LONG.sigmas
    assert holdout.residual_rms(settled.views) <= 1.06 * holdout.residual_rms(whole)
    by_watch, by_schedule = (np.mean(psnr_per_view(views, shot.truth.views)) for views in (settled.views, whole))
    assert by_watch > by_schedule - 0.5


def test_without_held_out_pixels_the_schedule_is_gone_through(make_shot):
    shot = make_shot(slide=0.4)
    brief = PatchSettings(iterations=5, first_sigma=0.1, last_sigma=0.05)
    settled = decode_until_settled(Holdout.of(shot, 0.0, 0), gap_tv(shot), brief)
    np.testing.assert_array_equal(settled.views, patch_decode_from(shot, gap_tv(shot), brief))
    assert (settled.steps, settled.sigma) == (5, brief.last_sigma)


def test_last_steps_take_in_the_pixels_that_were_held_out(make_shot):
    holdout = Holdout.of(make_shot(slide=0.4), 0.1, 0)
    blind = gap_tv(holdout.seen)
    assert holdout.residual_rms(seen_to_the_end(holdout, blind, 0.03)) < 0.7 * holdout.residual_rms(blind)


def test_a_schedule_is_entered_where_its_noise_has_fallen_so_far():
    rest = LONG.entered_at(0.05)
    assert rest.sigmas == pytest.approx([level for level in LONG.sigmas if level <= 0.05])
    assert LONG.entered_at(0.2) is LONG
    assert LONG.entered_at(0.001) is LONG
