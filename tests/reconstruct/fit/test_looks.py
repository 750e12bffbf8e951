"""What a look at a running fit enters into its curve."""

import time

import numpy as np
import pytest

from gs2ci.core.records import Shot
from gs2ci.reconstruct.fit.looks import Looks, Monitoring
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
    looks = Looks(holdout, Monitoring(lambda coded: lacking, score=lambda given: float(given.mean())))
    heldout = looks.take(holdout.coded(views - lacking), lambda: views - lacking, 50, 0.25, 7)
    assert heldout == pytest.approx(0, abs=1e-6)
    (point,) = looks.curve
    assert (point.iteration, point.loss, point.gaussians, point.heldout) == (50, 0.25, 7, heldout)
    assert point.psnr_db == pytest.approx(float(views.mean()), rel=1e-5)


def test_without_held_out_pixels_and_a_truth_a_look_has_no_figures(known):
    views, shot = known
    holdout = Holdout.of(shot, 0.0, 0)
    looks = Looks(holdout, Monitoring())
    assert looks.take(holdout.coded(views), never, 10, 0.5, 3) is None
    assert (looks.curve[0].heldout, looks.curve[0].psnr_db) == (None, None)


def test_seconds_count_from_where_they_are_told_to(known):
    _, shot = known
    holdout, began_s = Holdout.of(shot, 0.0, 0), time.monotonic() - 1000
    since, now = (Looks(holdout, Monitoring(since_s=at)) for at in (began_s, None))
    for looks in (since, now):
        looks.take(shot.measurement, never, 1, 0.0, 1)
        looks.take(shot.measurement, never, 2, 0.0, 1)
    assert since.curve[0].seconds >= 1000 > now.curve[0].seconds >= 0
    assert since.curve[1].seconds >= since.curve[0].seconds
