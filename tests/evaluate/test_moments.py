import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.evaluate.moments import moments, poses_at


def test_moments_reach_from_the_first_mask_to_the_last():
    np.testing.assert_array_equal(moments(np.int64(3)), [-1, 0, 1])


@pytest.mark.parametrize("count", [1, 0, -3, 10**6, 2.0, 2.5, "5", None])
def test_a_number_of_moments_that_is_none_is_refused(count):
    with pytest.raises(InputError, match=f"{count} moments; allowed: a whole number from 2 to"):
        moments(count)


def test_poses_between_masks_lie_half_way_and_at_masks_are_theirs():
    turn = np.radians(20)
    known = np.tile(np.eye(4), (3, 1, 1))
    for i, angle in enumerate((0.0, turn, 2 * turn)):
        known[i, :3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        known[i, :3, 3] = -known[i, :3, :3] @ [0.3 * i, 0, 0.1 * i]
    found = poses_at(known, np.array([-1, -0.5, 0, 1]))
    np.testing.assert_allclose(found[[0, 2, 3]], known, atol=1e-12)
    half = turn / 2
    np.testing.assert_allclose(found[1, 0, :3], [np.cos(half), 0, np.sin(half)], atol=1e-12)
    np.testing.assert_allclose(-found[1, :3, :3].T @ found[1, :3, 3], [0.15, 0, 0.05], atol=1e-12)
    np.testing.assert_array_equal(poses_at(known[:1], np.array([-1, 1])), known[[0, 0]])
