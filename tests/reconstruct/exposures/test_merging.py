"""Standard errors of several exposures as those of one record."""

import numpy as np

from gs2ci.core.uncertainty import Uncertainty
from gs2ci.reconstruct.exposures.merging import _uncertainty


def errors(value, depth=True):
    views = np.full((2, 3, 4), value, np.float32)
    poses = np.full(2, value) if depth else None
    return Uncertainty(views, views * 2 if depth else None, poses, poses)


def test_standard_errors_of_all_exposures_follow_one_another():
    found = _uncertainty([errors(0.1), errors(0.2)])
    assert found.check((4, 3, 4)) is found
    assert found.views[:, 0, 0].tolist() == np.float32([0.1, 0.1, 0.2, 0.2]).tolist()
    assert found.depth[3, 0, 0] == np.float32(0.4)
    assert found.positions.tolist() == [0.1, 0.1, 0.2, 0.2]
    assert found.other_depth is None


def test_what_one_exposure_does_not_know_is_not_known_of_all():
    found = _uncertainty([errors(0.1), errors(0.2, depth=False)])
    assert (found.depth, found.positions) == (None, None)
    assert len(found.views) == 4
    assert _uncertainty([errors(0.1), None]) is None
