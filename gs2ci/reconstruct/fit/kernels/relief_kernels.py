"""The effect of an exchange of turning for travel on each Gaussian, and the derivative along it, in two passes.

Here: the kernels, which take float32 and float64. Not here: the direction of the cameras, its steps
(`optimiser/relief.py`), the bounds on a step (`distances.py`).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64
from gs2ci.core.kernels import f32, f32_1, f32_2, f64, f64_1, f64_2, helper, kernel
from gs2ci.reconstruct.fit.kernels.distances import bounded

Numbers = NDArray[Any]


def step_of_gaussians(
    means: Numbers, pose: F64, bend: F64, near: float, widest: float, by_means: Numbers, by_sizes: Numbers
) -> float:
    """Store the derivatives by beta of all means, [G, 3], and log sizes, [G]; return the median of z (1 + (u . e)^2).

    Args:
        means: [G, 3].
        pose: Of the reference view, [4, 4].
        bend: e, [2].
        near: The least depth.
        widest: Bound on u . e.
        by_means: [G, 3].
        by_sizes: [G].
    """
    _find_distances(means, pose, bend, near, widest, by_sizes)
    # The lower of the two middle values, as in torch.
    middle = (len(means) - 1) // 2
    shrink = np.partition(by_sizes, middle)[middle]
    _differentiate_step(means, pose, shrink, by_means, by_sizes)
    return float(shrink)


@kernel(f32_2, f64_2, f64_1, f64, f64, f32_1)
def _find_distances(means, pose, bend, near, widest, nearer):
    for g in range(len(means)):
        x, y, z = seen_from(means, pose, g)
        depth = max(z, near)
        slant = min(max((x * bend[0] + y * bend[1]) / depth, -widest), widest)
        nearer[g] = depth * (1 + slant * slant)


@kernel(f32_2, f64_2, f32, f32_2, f32_1)
def _differentiate_step(means, pose, shrink, by_means, by_sizes):
    """Turn distances in `by_sizes` into derivatives."""
    for g in range(len(means)):
        growth = shrink - by_sizes[g]
        x, y, z = seen_from(means, pose, g)
        for j in range(3):
            by_means[g, j] = growth * (x * pose[0, j] + y * pose[1, j] + z * pose[2, j])
        by_sizes[g] = growth


@helper()
def turned(vectors: Numbers, pose: F64, g: int) -> tuple[float, float, float]:
    """Return a row of vectors, [G, 3], in the axes of a camera, [4, 4]."""
    x, y, z = vectors[g, 0], vectors[g, 1], vectors[g, 2]
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z,
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z,
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z,
    )


@helper()
def seen_from(means: Numbers, pose: F64, g: int) -> tuple[float, float, float]:
    """Return the camera coordinates of a Gaussian's centre; means: [G, 3], pose: [4, 4]."""
    x, y, z = turned(means, pose, g)
    return x + pose[0, 3], y + pose[1, 3], z + pose[2, 3]


@kernel(f32_2, f32_2)
def derivative_along(gradient, step):
    """Return the sum over products of gradients and steps, [G, K]; a step [G, 1] counts for every column."""
    total = 0.0
    columns = gradient.shape[1]
    for g in range(len(gradient)):
        one = 0.0
        for j in range(columns):
            one += np.float64(gradient[g, j]) * step[g, j if step.shape[1] > 1 else 0]
        total += one
    return total


@kernel(f32_2, f32_2, f32_2, f32_1, f64)
def take_step(means, log_scales, by_means, by_sizes, beta):
    """Move Gaussians by `beta`, in place, within the bounds of `distances`.

    Args:
        means: [G, 3].
        log_scales: [G, 3].
        by_means: Derivatives by beta, [G, 3].
        by_sizes: Of the log sizes, [G].
        beta: The step.
    """
    for g in range(len(means)):
        if by_sizes[g] == 0:
            continue
        # A mean moves along its line of sight, in proportion to its distance; in float64, since squares leave float32.
        square = 0.0
        for j in range(3):
            square += np.float64(by_means[g, j]) ** 2
        growth = bounded(beta * by_sizes[g], np.sqrt(square) / abs(by_sizes[g]))
        share = growth / by_sizes[g]
        for j in range(3):
            means[g, j] += share * by_means[g, j]
            log_scales[g, j] += growth
