"""Poses at moments and their gradient by a call, against the same by torch's graph; motions however large."""

import numpy as np
import pytest
import torch
from scipy.linalg import expm

from gs2ci.reconstruct.fit.scene.mask_moments import MaskMoments
from gs2ci.reconstruct.fit.scene.rigid import RigidMotions
from tests.render import se3


def _turning(masks, by):
    twists = by * torch.randn(masks, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    return se3.exp(torch.cumsum(twists, dim=0)).float()


def poses_of_the_graph(shared, path):
    """Return the pose at every moment, [V, 4, 4], from those in the middle of each mask, [N, 4, 4]; differentiable."""
    here, when = shared.of_mask, shared.offsets.to(path.dtype)[:, None]
    steps = se3.log(path[1:] @ se3.inverse(path[:-1]))
    if len(steps) == 1:
        before = after = steps.expand(2, 6)
    else:
        before = torch.cat([2 * steps[:1] - steps[1:2], steps])
        after = torch.cat([steps, 2 * steps[-1:] - steps[-2:-1]])
    speed, change = (after + before) / 2, (after - before) / 2
    moved = se3.exp(when * speed[here] + when**2 * change[here]) @ path[here]
    alone = torch.tensor(shared.moments)[here] == 1
    return torch.where(alone[:, None, None], path[here], moved)


@pytest.mark.parametrize(
    ("moments", "by"),
    [((3,) * 8, 0.05), ((1, 2, 3, 1, 4), 0.3), ((2, 2), 0.2), ((2, 3, 2), 0.8), ((1, 3), 0.0)],
    ids=["little", "some alone", "two masks", "much", "at rest"],
)
def test_poses_at_moments_and_their_gradient_are_those_of_the_graph(moments, by):
    path, shared = _turning(len(moments), by), MaskMoments(moments, (0.8,) * len(moments))
    found = shared.along(path)
    twists = torch.zeros(len(moments), 6, dtype=torch.float64, requires_grad=True)
    expected = poses_of_the_graph(shared, se3.exp(twists) @ path.double())
    torch.testing.assert_close(torch.from_numpy(found.poses), expected.detach().float(), rtol=0, atol=1e-6)
    weights = torch.randn(expected.shape, generator=torch.Generator().manual_seed(2))
    weights[:, 3] = 0
    wanted = torch.autograd.grad((expected * weights).sum(), twists)[0]
    by_path = torch.from_numpy(found.by_path(weights.numpy())).double()
    reached = torch.autograd.grad((se3.exp(twists) @ path.double() * by_path).sum(), twists)[0]
    torch.testing.assert_close(reached, wanted, rtol=1e-5, atol=1e-5)


def test_a_camera_that_makes_half_a_turn_between_masks_is_half_way_in_the_middle():
    path = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    path[1, :3, :3] = np.diag([-1, 1, -1])
    found = MaskMoments((2, 1), (1.0, 0.0)).along(torch.from_numpy(path)).exact
    # Moments lie a quarter of the interval before and after the middle: an eighth of a turn about the y axis.
    cosines = found[:2, 0, 0]
    np.testing.assert_allclose(cosines, np.cos(np.pi / 4), atol=1e-6)
    np.testing.assert_allclose(found[0, :3, :3] @ found[1, :3, :3], np.eye(3), atol=1e-6)


def test_a_mask_of_one_moment_keeps_its_pose_to_the_bit():
    path = _turning(3, 0.1)
    assert torch.equal(torch.from_numpy(MaskMoments((1, 2, 1), (0.8,) * 3).along(path).poses[[0, 3]]), path[[0, 2]])


def generator(twist):
    """Return the matrix, [4, 4], of which a rigid motion is the exponential."""
    x, y, z = twist[3:]
    return np.array([[0, -z, y, twist[0]], [z, 0, -x, twist[1]], [-y, x, 0, twist[2]], [0, 0, 0, 0]])


@pytest.mark.parametrize("by", [1e-9, 0.3, 1.0, 3.0, 40.0, 1e3])
def test_motions_however_large_are_the_exponentials_of_their_twists(by):
    # A step of the poses that explodes once is an error of the fit, which goes back, and none of Python.
    twists = by * np.array([[0.3, -0.5, 0.2, 0.4, 0.1, -0.6], [0.1, 0.2, 0.3, -0.2, 0.5, 0.1]])
    expected = np.stack([expm(generator(twist)) for twist in twists])
    found = RigidMotions(twists)
    assert found.matrices == pytest.approx(expected, rel=1e-9, abs=1e-9 * max(1.0, by))
    assert found.adjoint[:, 3:, 3:] == pytest.approx(expected[:, :3, :3], abs=1e-9)


def test_motions_of_twists_that_are_none_are_not_numbers():
    for wrong in (np.nan, np.inf):
        assert np.isnan(RigidMotions(np.full((2, 6), wrong)).adjoint).all()
