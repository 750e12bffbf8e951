"""The noise that a decode weighs, told by held-out pixels."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, decode_weighing, gap_tv
from gs2ci.reconstruct.measurement.holdout import Holdout

VIEWS, SIZE = 4, (40, 48)


def holdout_of(noise, seed):
    rng = np.random.default_rng(seed)
    picture = gaussian_filter(np.random.default_rng(0).random(SIZE), 3.0)
    views = np.repeat(((picture - picture.min()) / np.ptp(picture))[None, ..., None], VIEWS, axis=0)
    masks = (rng.random((VIEWS, *SIZE)) < 0.5).astype(np.float32)
    light = (masks[..., None] * views).sum(axis=0) + rng.normal(0, noise, (*SIZE, 1))
    return Holdout.of(Shot(light.astype(np.float32), masks).check(), 0.1, 0)


@pytest.mark.parametrize("noise", [0.05, 0.2])
def test_it_is_found_within_a_step_from_too_much(noise):
    holdouts = [holdout_of(noise, 1), holdout_of(noise, 2)]
    most = np.ones((*SIZE, 1), np.float32)
    views, weighed = decode_weighing(holdouts, GapTvSettings(), most)
    assert noise**2 / 8 < float(weighed.mean()) < 8 * noise**2
    plain = gap_tv([one.seen for one in holdouts], GapTvSettings())
    assert holdouts[0].residual_rms(views) < holdouts[0].residual_rms(plain)


def test_what_is_there_at_most_is_weighed_where_less_leaves_more():
    holdout = holdout_of(0.2, 1)
    most = np.full((*SIZE, 1), 0.02, np.float32)
    _, weighed = decode_weighing([holdout], GapTvSettings(), most)
    np.testing.assert_array_equal(weighed, most)
