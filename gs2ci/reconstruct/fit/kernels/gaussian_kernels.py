"""Operations of an iteration on every parameter of the Gaussians: Adam's step, the mean opacity and the mean size.

Each is one pass over memory, where torch makes several and a tensor for each. They run on one thread, so that results
do not depend on the number of threads. Here: the kernels. Not here: rates and moments (`optimiser/adam.py`), weights
(`losses/objective.py`).
"""

import numpy as np

from gs2ci.core.kernels import f32_1, f64, kernel
from gs2ci.reconstruct.fit.kernels.lane_sum import sum_in_lanes


@kernel(f32_1, f32_1, f32_1, f32_1, f32_1)
def adam_step(parameter, gradient, mean, square, constants):
    """Update the moments by a gradient, and step, in place; all but the last argument have the same length.

    Args:
        parameter: [P].
        gradient: By it.
        mean: First moment.
        square: Second moment.
        constants: [6]: one minus the decay of the mean; the decay of the squares; one minus it; the inverse root of the
            squares' bias correction; epsilon; the step with the mean's bias correction.
    """
    taken, decay, fresh = constants[0], constants[1], constants[2]
    scale, least, step = constants[3], constants[4], constants[5]
    for i in range(len(parameter)):
        g = gradient[i]
        m = mean[i] + taken * (g - mean[i])
        v = decay * square[i] + fresh * g * g
        mean[i] = m
        square[i] = v
        parameter[i] -= step * m / (np.sqrt(v) * scale + least)


@kernel(f32_1, f64, f32_1)
def add_opacity_gradient(logits, weight, gradient):
    """Return the mean of sigmoid(logits), [G], and add `weight` times its gradient to `gradient`, [G]."""
    count = len(logits)
    if count == 0:
        return 0.0
    opacities, share = np.empty(count, np.float32), np.float32(weight / count)
    one = np.float32(1)
    for i in range(count):
        opacity = one / (one + np.exp(-logits[i]))
        opacities[i] = opacity
        gradient[i] += share * opacity * (one - opacity)
    total: float = sum_in_lanes(opacities)
    return total / count


@kernel(f32_1, f64, f32_1)
def add_size_gradient(log_scales, weight, gradient):
    """Return the mean of exp(log_scales), [3 G], and add `weight` times its gradient to `gradient`, [3 G]."""
    count = len(log_scales)
    if count == 0:
        return 0.0
    sizes, share = np.empty(count, np.float32), np.float32(weight / count)
    for i in range(count):
        sizes[i] = np.exp(log_scales[i])
        gradient[i] += share * sizes[i]
    total: float = sum_in_lanes(sizes)
    return total / count
