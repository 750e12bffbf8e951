import numpy as np
import pytest

from gs2ci.commands.demo import simulate
from gs2ci.core.progress import Silent


@pytest.fixture(scope="module")
def shot():
    return simulate(views=4, size=(68, 100), parallax_px=3.0, seed=0, progress=Silent())


def test_the_demonstrations_exposure_is_complete_and_uses_the_wells_range(shot):
    assert shot.measurement.shape == (68, 100, 3)
    assert shot.masks.mean() == pytest.approx(0.25, abs=0.02)
    assert shot.truth.views.shape == (4, 68, 100, 3)
    assert shot.provenance["covered_share"] > 0.995
    assert shot.saturated.mean() < 0.01
    assert shot.measurement.max() > 1.5


def test_the_demonstration_has_realistic_noise_and_blur(shot):
    coded = (shot.masks[..., None] * shot.truth.views).sum(axis=0)
    error = (shot.measurement - coded).std()
    assert 0.005 < error < 0.1


def test_near_and_far_move_against_each_other_as_asked(shot):
    centres = np.linalg.inv(shot.truth.world_to_camera)[:, :3, 3]
    steps = np.diff(centres, axis=0)
    np.testing.assert_allclose(steps, np.tile(steps[0], (3, 1)), atol=1e-12)
    assert np.linalg.norm(centres[-1] - centres[0]) > 0.01
