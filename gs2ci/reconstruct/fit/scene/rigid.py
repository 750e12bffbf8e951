"""Rigid motions exp(xi) by numpy, and gradients by twists without a graph: of corrected poses, of poses within masks.

Gradients by twists e applied after a pose, T -> exp(e) T, follow from the left Jacobian J of exp and from Ad, both
power series of ad(rho, phi) = [[phi]x, [rho]x; 0, [phi]x] (Sola, Deray, Atchuthan 2018, eqs. 83, 144, 179). Their upper
left blocks are the rotation exp(phi) and the matrix V of its translation, V rho.

The poses at moments of masks are T_m = exp(d_m) T_n, where d_m = t v_n + t^2 c_n and the speed v_n and its change c_n
are linear in the steps s_k = log(T_k+1 T_k^-1) before and after mask n: quadratic in time through the poses before and
after; at both ends the acceleration is that of the next mask. With g_m the gradient by twists after them, that

    by d_m: J(d_m)^T g_m,    by e_n: Ad(exp d_m)^T g_m,    by e_k+1 and e_k: h = J(s_k)^-T g, -Ad(exp s_k)^T h.

The same by torch's graph took a sixth of a fit of small pictures; tests hold the two to each other. Here: that. Not
here: the moments (`mask_moments.py`), steps of poses (`optimiser.poses`).
"""

import math
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F32, F64, I64, Bool
from gs2ci.core.cameras import rigid

# Since a = ad(xi) of a turn by an angle t has a^5 = -2 t^2 a^3 - t^4 a, both series are sums of a to a^4 alone. These
# are their shares in the terms of (-t^2)^j, [j, 2 * 4]; of angles up to a radian the last is below 1e-18.
_SHARES: Final = np.array(
    [
        [(1 + j if k > 2 else 1 - j) / math.factorial(2 * j + k + more) for more in (1, 0) for k in range(1, 5)]
        for j in range(11)
    ]
)
_CROSSES: Final = np.cross(np.eye(3), np.eye(3)[:, None]).reshape(3, 9)
"""The cross-product matrix of each axis, row by row."""


class RigidMotions:
    """The rigid motions exp(xi) of twists.

    Args:
        twists: Translation first, [V, 6].

    Attributes:
        matrices: Of the motions, [V, 4, 4].
        jacobian: The left Jacobian of exp, [V, 6, 6].
        adjoint: Of the motions, [V, 6, 6].
    """

    def __init__(self, twists: F64) -> None:
        self.jacobian, self.adjoint = _series(twists)
        moved = self.jacobian[:, :3, :3] @ twists[:, :3, None]
        self.matrices = rigid(self.adjoint[:, :3, :3], moved[..., 0])

    def by_twists(self, poses: F64, gradient: F64) -> F64:
        """Return the gradient by the twists, [V, 6], given that by the poses that these motions lead to, [V, 4, 4]."""
        return _transposed(self.jacobian, _by_twists(poses, gradient))


class MomentsOfPath:
    """The poses at the moments of all masks.

    Args:
        world_to_camera: In the middle of each mask, [N, 4, 4], N at least 2.
        offsets: Times of the moments from the middle of the mask, in intervals between masks, [V].
        of_mask: The mask of each, [V].
        alone: Whether it is the only one of its mask, which keeps its pose to the bit, [V].

    Attributes:
        poses: [V, 4, 4] float32.
        exact: The same in float64, those of masks with one moment as well.
    """

    def __init__(self, world_to_camera: F32 | F64, offsets: F64, of_mask: I64, alone: Bool) -> None:
        self._path, self._of_mask = world_to_camera.astype(np.float64), of_mask
        self._steps = _log(self._path[1:] @ np.linalg.inv(self._path[:-1]))
        self._shares = _shares_of_steps(len(world_to_camera), offsets, of_mask)
        self._motions = RigidMotions(self._shares @ self._steps)
        self.exact = self._motions.matrices @ self._path[of_mask]
        self.poses = self.exact.astype(np.float32)
        self.poses[alone] = world_to_camera[of_mask[alone]]

    def by_path(self, by_moments: F32) -> F32:
        """Return the gradient by the masks' poses, [N, 4, 4]: its parts along rigid motions, which alone matter.

        Args:
            by_moments: The gradient by the poses at the moments, [V, 4, 4].
        """
        own = _by_twists(self.exact, by_moments.astype(np.float64))
        by_pose = np.zeros((len(self._path), 6))
        np.add.at(by_pose, self._of_mask, _transposed(self._motions.adjoint, own))
        by_steps = self._shares.T @ _transposed(self._motions.jacobian, own)
        jacobian, adjoint = _series(self._steps)
        by_steps[:] = np.linalg.solve(jacobian.swapaxes(1, 2), by_steps[..., None])[..., 0]
        by_pose[1:] += by_steps
        by_pose[:-1] -= _transposed(adjoint, by_steps)
        return _by_poses(self._path, by_pose)


def _log(motions: F64) -> F64:
    """Return the twists of rigid motions, [K, 4, 4], [K, 6]."""
    turns = np.zeros((len(motions), 6))
    turns[:, 3:] = Rotation.from_matrix(motions[:, :3, :3]).as_rotvec()
    turns[:, :3] = np.linalg.solve(_series(turns)[0][:, :3, :3], motions[:, :3, 3:])[..., 0]
    return turns


def _shares_of_steps(count: int, offsets: F64, of_mask: I64) -> F64:
    """Return how much of each step between masks is in the twist of each moment, [V, count - 1].

    At both ends the missing step continues the acceleration of the next mask.
    """
    each, when = np.eye(count - 1), offsets[:, None]
    before = np.vstack([2 * each[0] - each[:2][-1], each])
    after = before[::-1, ::-1]
    return when / 2 * ((1 + when) * after[of_mask] + (1 - when) * before[of_mask])


def _by_twists(poses: F64, gradient: F64) -> F64:
    """Return the gradient by twists after poses, [V, 6], given that by the poses, [V, 4, 4]."""
    # The sum of the columns' cross products.
    products = poses[:, :3] @ gradient[:, :3].transpose(0, 2, 1)
    turning = (products - products.transpose(0, 2, 1))[:, (1, 2, 0), (2, 0, 1)]
    return np.concatenate([gradient[:, :3, 3], turning], axis=1)


def _by_poses(poses: F64, by_twists: F64) -> F32:
    """Return a gradient by poses, [N, 4, 4], that has given ones by twists after them, [N, 6]."""
    found = np.zeros(poses.shape, np.float32)
    found[:, :3, 3] = by_twists[:, :3]
    turning = by_twists[:, 3:] - (_crosses(poses[:, :3, 3]) @ by_twists[:, :3, None])[..., 0]
    found[:, :3, :3] = 0.5 * _crosses(turning) @ poses[:, :3, :3]
    return found


def _crosses(vectors: F64) -> F64:
    """Return the cross-product matrices of vectors, [V, 3], [V, 3, 3]."""
    return (vectors @ _CROSSES).reshape(-1, 3, 3)


def _series(twists: F64) -> tuple[F64, F64]:
    """Return the left Jacobian of exp at twists, and the adjoint of exp, [V, 6, 6] each; NaN where a twist is none.

    Of turns beyond a radian, which no fit takes on purpose, those of a small part are doubled until they are whole.
    """
    if not np.isfinite(twists).all():
        return (np.full((len(twists), 6, 6), np.nan),) * 2
    angles = np.linalg.norm(twists[:, 3:], axis=1)
    doublings = max(0, math.frexp(float(angles.max()))[1])
    powers = np.zeros((len(twists), 4, 6, 6))
    first, second, third, fourth = powers.swapaxes(0, 1)
    first[:, :3, :3] = first[:, 3:, 3:] = _crosses(twists[:, 3:] / 2**doublings)
    first[:, :3, 3:] = _crosses(twists[:, :3] / 2**doublings)
    second[:] = first @ first
    third[:], fourth[:] = second @ first, second @ second
    shares = np.vander(-np.square(angles / 2**doublings), len(_SHARES), increasing=True) @ _SHARES
    sums = shares.reshape(-1, 2, 4) @ powers.reshape(-1, 4, 36)
    jacobian, adjoint = np.eye(6) + sums.reshape(-1, 2, 6, 6).swapaxes(0, 1)
    for _ in range(doublings):
        jacobian, adjoint = (jacobian + adjoint @ jacobian) / 2, adjoint @ adjoint
    return jacobian, adjoint


def _transposed(matrices: F64, vectors: F64) -> F64:
    """Return the products of transposed matrices, [V, 6, 6], and vectors, [V, 6]."""
    return (vectors[:, None] @ matrices)[:, 0]
