"""What is known of a path, as the standard errors of a run are asked for it."""

from types import SimpleNamespace

import pytest

from gs2ci.core.cameras import path_extent
from gs2ci.reconstruct.uncertainty import of_run
from tests.reconstruct.uncertainty.conftest import path


@pytest.mark.parametrize("given", [True, False])
def test_other_exposures_tell_of_depths_along_given_poses_alone(given):
    errors = SimpleNamespace(position=0.01, rotation=0.001) if given else None
    geometry = SimpleNamespace(
        has_path=True, known_at_rest=False, pose_errors=errors, unit=2.0, reference=3, path_error_expected=None
    )
    poses, others = path(6), path(2, (4.0, 0, 0))
    found = of_run._path(geometry, SimpleNamespace(best=SimpleNamespace(world_to_camera=poses)), others)
    assert found is not None
    assert found.others is (others if given else None)
    assert found.given == ((0.02, 0.001) if given else None)
    assert found.extent == pytest.approx(4.0 if given else path_extent(poses))
