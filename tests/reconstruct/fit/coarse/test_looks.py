"""What a look at a running fit enters into its curve."""

import time

import numpy as np
import pytest

from gs2ci.core.records import Shot
from gs2ci.reconstruct.fit.coarse.looks import LookedAt, Looks, nothing
from gs2ci.reconstruct.measurement.holdout import Holdout


@pytest.fixture
def known():
    rng = np.random.default_rng(0)
    views = rng.random((3, 12, 16, 3), dtype=np.float32)
    masks = (rng.random((3, 12, 16)) < 0.5).astype(np.float32)
    return views, Shot(np.einsum("nhw,nhwc->hwc", masks, views), masks, np.ones(3, np.float32)).check()


def never():
    pytest.fail("views are rendered only to be scored")


def test_refined_views_are_judged_and_scored(known):
    views, shot = known
    holdout, lacking = Holdout.of(shot, 0.2, 0), np.full_like(views, 0.1)
    looks = Looks()
    seen = LookedAt(
        holdout,
        lambda coded: lacking,
        holdout.coded(views - lacking),
        lambda: views - lacking,
        lambda given: float(given.mean()),
    )
    heldout = looks.take([seen], 50, 0.25, 7)
    assert heldout == pytest.approx(0, abs=1e-6)
    (point,) = looks.curve
    assert (point.iteration, point.loss, point.gaussians, point.heldout) == (50, 0.25, 7, heldout)
    assert point.psnr_db == pytest.approx(float(views.mean()), rel=1e-5)


def test_without_held_out_pixels_and_a_truth_a_look_has_no_figures(known):
    views, shot = known
    holdout = Holdout.of(shot, 0.0, 0)
    looks = Looks()
    assert looks.take([LookedAt(holdout, nothing, holdout.coded(views), never)], 10, 0.5, 3) is None
    assert (looks.curve[0].heldout, looks.curve[0].psnr_db) == (None, None)


def test_seconds_count_from_where_they_are_told_to(known):
    _, shot = known
    holdout, began_s = Holdout.of(shot, 0.0, 0), time.monotonic() - 1000
    since, now = (Looks(at) for at in (began_s, None))
    seen = LookedAt(holdout, nothing, shot.measurement, never)
    for looks in (since, now):
        looks.take([seen], 1, 0.0, 1)
        looks.take([seen], 2, 0.0, 1)
    assert since.curve[0].seconds >= 1000 > now.curve[0].seconds >= 0
    assert since.curve[1].seconds >= since.curve[0].seconds


def test_several_exposures_are_judged_together_by_those_that_hold_pixels_out(known):
    views, shot = known
    held, unheld = Holdout.of(shot, 0.2, 0), Holdout.of(shot, 0.0, 0)
    off = [views + error for error in (np.float32(0.1), np.float32(0.3))]
    alone = [held.residual_rms(one) for one in off]
    scored = [lambda given, one=one: one for one in (20.0, 30.0)]
    looks = Looks()
    seen = [
        LookedAt(held, nothing, held.coded(one), lambda one=one: one, score)
        for one, score in zip(off, scored, strict=True)
    ]
    heldout = looks.take([*seen, LookedAt(unheld, nothing, unheld.coded(views), never)], 10, 0.5, 3)
    assert heldout == pytest.approx(np.sqrt(np.mean(np.square(alone))))
    assert looks.curve[0].psnr_db == 25.0
