"""What is known of a path, as the standard errors of a run are asked for it."""

from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci.reconstruct.geometry.path.halves import PathErrors
from gs2ci.reconstruct.geometry.path.telemetry import PoseErrors
from gs2ci.reconstruct.uncertainty import of_run
from gs2ci.reconstruct.uncertainty.factors import factors
from tests.reconstruct.uncertainty.conftest import path


def known(given=False, expected=None, poses=None, others=None, places=None):
    poses = path(6) if poses is None else poses
    geometry = SimpleNamespace(
        has_path=True,
        known_at_rest=False,
        pose_errors=PoseErrors(0.01, 0.001, turn=0.002) if given else None,
        unit=2.0,
        reference=3,
        path_errors=None if expected is None else PathErrors(expected, 0.01),
        followed=np.zeros((1, 6, 2)),
    )
    ensemble = SimpleNamespace(best=SimpleNamespace(world_to_camera=poses))
    found = of_run._path(geometry, ensemble, others, places)
    assert found.followed is geometry.followed
    told = 0.002 if given and found.errors.share != expected else 0.0 if expected is None else 0.01
    assert found.errors.turn == told
    assert found.places is places
    return found


@pytest.mark.parametrize("given", [True, False])
def test_other_exposures_tell_of_depths_along_given_poses_alone(given):
    others = path(2, (4.0, 0, 0))
    found = known(given, others=others, places=np.zeros((2, 3)))
    assert found.others is (others if given else None)
    assert found.given == ((0.02, 0.001) if given else None)
    assert found.errors.share == pytest.approx(0.02 / 4.0 if given else factors.path_not_judged)


@pytest.mark.parametrize(
    ("asked", "error"),
    [
        ({"expected": 0.05}, 0.05),
        ({}, factors.path_not_judged),
        ({"given": True}, 0.1),
        ({"given": True, "expected": 0.05, "poses": path(6, (0, 0, 0))}, 0.05),
    ],
)
def test_the_error_of_a_path_is_that_of_who_judged_it(asked, error):
    assert known(**asked).errors.share == pytest.approx(error)
