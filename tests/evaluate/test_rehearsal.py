import numpy as np
import pytest

from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.rehearsal import report_seconds


@pytest.mark.parametrize("cfa", [None, "GRBG"])
@pytest.mark.parametrize("known", [True, False])
def test_a_report_takes_some_time_whatever_the_shot_knows(cfa, known):
    rng = np.random.default_rng(0)
    views = rng.random((2, 20, 30, 3)).astype(np.float32)
    shot = Shot(
        measurement=rng.random((20, 30, 1 if cfa else 3)).astype(np.float32),
        masks=np.ones((2, 20, 30), np.float32),
        weights=np.ones(2, np.float32),
        cfa=cfa,
        saturated=np.zeros((20, 30), bool),
        truth=Truth(views, np.tile(np.eye(4), (2, 1, 1))) if known else Truth(),
    ).check()
    assert 0 < report_seconds(shot) < 600
