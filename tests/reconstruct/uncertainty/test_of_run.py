"""What is known of a path, as the standard errors of a run are asked for it."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.reconstruct.geometry.path.telemetry import PoseErrors
from gs2ci.reconstruct.uncertainty import of_run
from tests.reconstruct.uncertainty.conftest import path


def known(given=False, tracks=None, others=None, places=None, fits=()):
    poses = path(6)
    geometry = SimpleNamespace(
        has_path=True,
        known_at_rest=False,
        pose_errors=PoseErrors(0.01, 0.001, turn=0.002) if given else None,
        unit=2.0,
        reference=3,
        world_to_camera=poses if tracks is None else tracks,
        followed=np.zeros((1, 6, 2)),
    )
    fitted = [SimpleNamespace(world_to_camera=one) for one in (poses, *fits)]
    ensemble = SimpleNamespace(best=fitted[0], others=tuple(fitted[1:]))
    found = of_run._path(geometry, ensemble, others, places)
    assert found.followed is geometry.followed
    assert found.places is places
    return found


@pytest.mark.parametrize("given", [True, False])
def test_other_exposures_tell_of_depths_along_given_poses_alone(given):
    others = path(2, (4.0, 0, 0))
    found = known(given, others=others, places=np.zeros((2, 3)))
    assert found.others is (others if given else None)
    assert found.given == ((0.02, 0.001) if given else None)


@pytest.mark.parametrize(("given", "turn"), [(False, 0.0), (True, 0.002)])
def test_one_fit_on_the_path_of_the_tracks_shows_no_turn_beside_that_of_a_stage(given, turn):
    found = known(given)
    assert found.turn == pytest.approx(turn)
    assert found.spread == 0


def test_a_fit_that_turned_away_from_the_path_of_the_tracks_shows_by_how_much_it_errs():
    turned = path(6)
    turned[-1, :3, :3] = Rotation.from_rotvec([0, 0.03, 0]).as_matrix()
    far = 0.03 * np.sqrt(5) / 6
    assert known(tracks=turned).turn == pytest.approx(far, rel=1e-3)
    assert known(tracks=turned, fits=(path(6),)).turn == pytest.approx(far, rel=1e-3)
    assert known(tracks=turned, given=True).turn == 0.002


def test_of_several_fits_the_spread_tells():
    turned, bent = path(6), path(6)
    turned[-1, :3, :3] = Rotation.from_rotvec([0, 0.03, 0]).as_matrix()
    bent[:, 1, 3] += [0, 0.01, 0, -0.01, 0, 0.01]
    assert known(fits=(turned,)).turn == pytest.approx(0.03 * np.sqrt(5) / 6, rel=1e-3)
    found = known(fits=(bent,))
    assert found.turn == 0
    assert 0.003 < found.spread < 0.01
    assert known(given=True, fits=(bent,)).spread == 0
