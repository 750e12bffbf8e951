"""Solids of known size: their true depth is where their geometry says."""

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.scenes.stage import SuggestedCamera
from tests.sims.scenes.solids import SOLIDS, solid, staircase

FRAME = SuggestedCamera((48, 64), 45.0)


def depth_of(which, seed=0):
    return solid(which, np.random.default_rng(seed), FRAME, backdrop=6.0).depth


def test_a_ball_is_nearest_in_its_middle_by_its_radius():
    depth, radius = depth_of("ball"), 0.7 * 0.7 * 6.0 * FRAME.half.min()
    assert depth[23:25, 31:33].mean() == pytest.approx(0.7 * 6.0 - radius, rel=0.005)
    assert depth[0, 0] == pytest.approx(6.0, rel=1e-6)


def test_a_panel_is_one_plane():
    depth = depth_of("plane")
    rows, columns = np.nonzero(depth < 5.8)
    rays = np.stack([columns, rows, np.ones(len(rows))], axis=1)
    # Inverse depth is linear in the pixel.
    fitted = rays @ np.linalg.lstsq(rays, 1 / depth[rows, columns], rcond=None)[0]
    np.testing.assert_allclose(fitted, 1 / depth[rows, columns], rtol=1e-9)
    assert len(rows) > 300


def test_a_staircase_climbs_in_equal_steps():
    faces = staircase(2.0, 1.6, 0.8, steps=4)
    risers, treads = faces[::2], faces[1::2]
    np.testing.assert_allclose(np.diff([face.centre[2] for face in risers]), 0.2)
    np.testing.assert_allclose(np.diff([face.centre[1] for face in treads]), -0.4)
    assert len(np.unique(np.round(1 / depth_of("staircase", 1)[:, 32], 3))) > 4


@pytest.mark.parametrize(("which", "backdrop"), [("cube", 6.0), (SOLIDS[0], 0.0), (SOLIDS[1], float("inf"))])
def test_what_is_no_solid_or_stands_nowhere_is_refused(which, backdrop):
    with pytest.raises(InputError, match="plane, ball, staircase; a depth above 0"):
        solid(which, np.random.default_rng(0), FRAME, backdrop=backdrop)
