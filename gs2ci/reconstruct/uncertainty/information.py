"""What coded readings tell about poses, depths being unknown: the normal matrix of Gauss-Newton, and its inverse.

Here: the derivatives of the readings by the depths of cells of the reference view and by all poses, and the poses'
covariance. Not here: what makes depths err (`depths`), standard errors of views (`views`).

A change of a camera's pose, or of a surface's depth along the ray of the reference view, moves what view n shows at a
pixel by a flow u_n, and the pixel's one reading by Σ_n w_n M_n ∇X_n · u_n: N views share the reading. What surfaces
look like is not known either, and a flow that all views of a surface point have in common only moves its texture; so
the mean over the views that see the point is subtracted. With the noise of each reading, these derivatives give the
normal matrix JᵀJ of depths and poses together; in its inverse, what they can do for one another is allowed for: a turn
of a camera for a part of its travel, a depth for both.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.ndimage import gaussian_filter
from scipy.sparse import coo_matrix, csr_matrix

from gs2ci.core.arrays import F32, F64, I64
from gs2ci.core.cameras import camera_centres, in_camera, in_world, path_extent
from gs2ci.reconstruct.fit.optimiser.poses import LEAST_EXTENT
from gs2ci.reconstruct.uncertainty.factors import factors

# Depths are asked for in so many cells of the reference view at most: the matrix is dense.
_MOST_CELLS: Final = 250
# And so many readings are looked at, on a lattice, which tell as much as all of them times their share.
_MOST_READINGS: Final = 3_000
# Gradients are those of views smoothed by so much, px: a single pixel's noise is no texture.
_SMOOTH_PX: Final = 0.7
_LEAST_SIDE_PX: Final = 3.0
# What is known beforehand: no depth of a scene errs by more than about half of it, no camera by more than the path is
# long, nor by more than a tenth of a radian (`factors`); the reference does not err at all, or by so much of that. Only
# directions that no reading shows at all meet these bounds.
_HELD: Final = 1e-3
# Points behind a camera's plane are put just before it.
_AHEAD: Final = 1e-9
# How far the picture moves between views is looked at in about so many places of each.
_PLACES: Final = 600


@dataclass(frozen=True, eq=False)
class ReadingsSeen:
    """What one exposure's views see, on the sensor's pixels.

    Args:
        views: [N, H, W, C].
        depth: Along the optical axis, [N, H, W]; 0 where there is none.
        spread: Of where along the ray a pixel's light is stopped, as a share of depth, [N, H, W] (`StoppedLight`).
        rays: Of the pixels, at z = 1, [H, W, 2].
        world_to_camera: [N, 4, 4].
        focal_px: Focal lengths, [2].
        transmissions: Masks times weights, [N, H, W].
        noise: Power of what a reading errs by, [H, W, C] as the measurement.
    """

    views: F32
    depth: F32
    spread: F32
    rays: F32
    world_to_camera: F64
    focal_px: F64
    transmissions: F32
    noise: F32


def information(seen: ReadingsSeen, reference: int, errors: tuple[float, float] | None = None) -> F64:
    """Return the covariance of poses' twists (translation first, in the cameras' axes), [6 N, 6 N], by the readings.

    Depths are unknown together with them.

    Args:
        seen: The exposure.
        reference: The view in whose cells depths are asked for; its pose is held.
        errors: Standard errors of given poses: position, in the unit of the path, and rotation, rad; None: not given.
    """
    count, height, width = seen.depth.shape
    rows, share = _lattice(height, width, _MOST_READINGS)
    cells, number = _cells(seen, reference, rows)
    by_pose, by_depth = _derivatives(seen, reference, cells, number, rows)
    extent = max(path_extent(seen.world_to_camera), LEAST_EXTENT * middle_depth(seen))
    position, turn = (extent, factors.turn_prior) if errors is None else errors
    prior = np.tile([position] * 3 + [turn] * 3, count)
    # The reference camera does not move: the world is its own.
    prior[6 * reference : 6 * reference + 6] *= _HELD
    # In units of what is known beforehand, so that the matrices are well conditioned.
    of_depths = share * factors.unknown_depth**2 * (by_depth.T @ by_depth).toarray() + np.eye(number)
    between = share * factors.unknown_depth * (by_depth.T @ by_pose) * prior
    follow = cho_solve(cho_factor(of_depths), between)
    of_poses = share * (by_pose.T @ by_pose) * np.outer(prior, prior) + np.eye(len(prior)) - between.T @ follow
    scaled: F64 = np.linalg.inv(of_poses)
    return scaled * np.outer(prior, prior)


def middle_depth(seen: ReadingsSeen) -> float:
    """Return the median depth; 1 if there is none."""
    known = seen.depth[seen.depth > 0]
    return float(np.median(known)) if known.size else 1.0


def _lattice(height: int, width: int, most: int) -> tuple[I64, float]:
    """Return the pixels whose readings are looked at, as flat indices, and how many each stands for."""
    step = max(1, int(np.ceil(np.sqrt(height * width / most))))
    rows, columns = np.mgrid[step // 2 : height : step, step // 2 : width : step]
    chosen = (rows * width + columns).ravel()
    return chosen, height * width / chosen.size


def _in_world(seen: ReadingsSeen, view: int, chosen: I64, depth: F32 | None = None) -> F64:
    """Return the points that chosen pixels of a view show, [P, 3]; at other depths than its own if they are given."""
    own = (seen.depth[view].reshape(-1)[chosen] if depth is None else depth).astype(np.float64)[:, None]
    return in_world(np.concatenate([seen.rays.reshape(-1, 2)[chosen] * own, own], axis=-1), seen.world_to_camera[view])


def flows_between(seen: ReadingsSeen) -> F64:
    """Return how far the picture of each view's surfaces moves to each other view, squared, [N, N, P] px^2.

    Where there is no depth, the median depth is taken.
    """
    count, height, width = seen.depth.shape
    chosen, _ = _lattice(height, width, _PLACES)
    depth = seen.depth.reshape(count, -1)[:, chosen]
    depth = np.where(depth > 0, depth, np.float32(middle_depth(seen)))
    found = np.zeros((count, count, len(chosen)))
    for view in range(count):
        points = _in_world(seen, view, chosen, depth[view])
        here = seen.rays.reshape(-1, 2)[chosen]
        for other in range(count):
            there = in_camera(points, seen.world_to_camera[other])
            slope = there[:, :2] / np.maximum(there[:, 2:], _AHEAD)
            found[view, other] = np.square((slope - here) * seen.focal_px).sum(axis=1)
    return found


def _cells(seen: ReadingsSeen, reference: int, chosen: I64) -> tuple[I64, int]:
    """Return which cell of the reference view, continued beyond its borders, chosen pixels show; how many there are.

    The cells are [N, P], -1 where a view shows nothing.
    """
    count, height, width = seen.depth.shape
    side = max(_LEAST_SIDE_PX, math.sqrt(height * width / _MOST_CELLS))
    # Points far outside are all in the outermost ring of cells.
    reach = np.array([width, height]) / side
    columns, rows = (int(2 * np.ceil(value)) + 3 for value in reach)
    found = np.empty((count, len(chosen)), np.int64)
    for view in range(count):
        there = in_camera(_in_world(seen, view, chosen), seen.world_to_camera[reference])
        usable = (seen.depth[view].reshape(-1)[chosen] > 0) & (there[:, 2] > 0)
        across = there[:, :2] / np.where(usable, there[:, 2], 1)[:, None] * (seen.focal_px / side)
        column, row = np.floor(across.clip(-reach, reach)).astype(np.int64).T
        found[view] = np.where(usable, (row + rows // 2) * columns + column + columns // 2, -1)
    present, numbers = np.unique(found, return_inverse=True)
    nothing = int(present[0] < 0)
    return numbers.reshape(found.shape) - nothing, len(present) - nothing


def _gradients(view: F32) -> F64:
    """Return the gradient of a view, [H, W, C], along x and y, [H * W, C, 2]."""
    smooth = gaussian_filter(view.astype(np.float64), (_SMOOTH_PX, _SMOOTH_PX, 0), mode="nearest")
    # Along a side of a single pixel nothing changes.
    along = [np.gradient(smooth, axis=side) if smooth.shape[side] > 1 else 0 * smooth for side in (1, 0)]
    return np.stack(along, axis=-1).reshape(-1, view.shape[2], 2)


def _flow(points: F64, focal_px: F64) -> F64:
    """Return how the places of points, [P, 3] in a camera's axes, move by its twist, [P, 2, 6], px."""
    ahead = np.maximum(points[:, 2], _AHEAD)
    x, y = points[:, 0] / ahead, points[:, 1] / ahead
    zero, one = np.zeros_like(x), np.ones_like(x)
    found = np.empty((len(points), 2, 6))
    found[:, 0] = np.stack([one / ahead, zero, -x / ahead, -x * y, 1 + x * x, -y], axis=-1)
    found[:, 1] = np.stack([zero, one / ahead, -y / ahead, -(1 + y * y), x * y, x], axis=-1)
    return found * focal_px[:, None]


def _derivatives(seen: ReadingsSeen, reference: int, cells: I64, number: int, chosen: I64) -> tuple[F64, csr_matrix]:
    """Return derivatives of the chosen readings, in their standard deviations: by poses, [R C, 6 N]; by depths."""
    count, channels = len(seen.depth), seen.noise.shape[2]
    gradients = np.stack([_gradients(view)[chosen] for view in seen.views])
    if gradients.shape[2] != channels:  # behind a colour filter array, a pixel reads one of them
        gradients = gradients.mean(axis=2, keepdims=True)
    noise = np.maximum(seen.noise.reshape(-1, channels)[chosen].astype(np.float64), np.finfo(np.float32).tiny)
    weights = 1 / np.sqrt(noise)
    transmissions = seen.transmissions.reshape(count, -1)[:, chosen].astype(np.float64)
    by_pose = np.zeros((len(chosen), channels, count, 6))
    numbers = np.arange(len(chosen) * channels).reshape(len(chosen), channels)
    values, rows, columns = [], [], []
    for view in range(count):
        light = np.where(cells[view] >= 0, transmissions[view], 0.0)
        # A closed mask sends nothing of its view.
        lit = np.flatnonzero(light > 0)
        turns, apart = _moves(seen, reference, view, chosen[lit])
        steep = light[lit, None, None] * gradients[view, lit] * weights[lit, :, None]
        by_pose[lit] += np.einsum("pci,pnij->pcnj", steep, turns)
        values.append(np.einsum("pci,pi->pc", steep, apart).ravel())
        rows.append(numbers[lit].ravel())
        columns.append(np.repeat(cells[view, lit], channels))
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    by_depth = coo_matrix(entries, shape=(numbers.size, number)).tocsr()
    return by_pose.reshape(numbers.size, 6 * count), by_depth


def _moves(seen: ReadingsSeen, reference: int, view: int, chosen: I64) -> tuple[F64, F64]:
    """Return how the picture of a view moves at chosen pixels beyond the mean over the views that see the same points.

    Returns:
        By the twist of each camera, [P, N, 2, 6], and by the relative depth along the reference view's ray, [P, 2]; px.
    """
    count, height, width = seen.depth.shape
    points = _in_world(seen, view, chosen)
    along = points - camera_centres(seen.world_to_camera[reference : reference + 1])[0]
    flows, moves, sees = [], [], []
    for other in range(count):
        there = in_camera(points, seen.world_to_camera[other])
        flow = _flow(there, seen.focal_px)
        flows.append(flow)
        moves.append(np.einsum("pij,pj->pi", flow[:, :, :3], along @ seen.world_to_camera[other, :3, :3].T))
        off = np.abs(there[:, :2] / np.maximum(there[:, 2:], _AHEAD)) * seen.focal_px
        sees.append((there[:, 2] > 0) & (2 * off <= (width, height)).all(axis=1))
    shares = np.array(sees, dtype=np.float64)
    shares[view] = 1.0
    shares /= shares.sum(axis=0)
    turns = -shares.T[:, :, None, None] * np.stack(flows, axis=1)
    turns[:, view] += flows[view]
    return turns, moves[view] - np.einsum("np,npi->pi", shares, np.array(moves))
