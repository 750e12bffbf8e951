"""The arithmetic of the term that draws light to surfaces: moments of parallax, distances, and their gradients.

The tests hold them to the same in torch, float64 (`tests/reconstruct/fit/surfaces/test_surfaces.py`). One thread, so
that sums have one order. Here: the kernels. Not here: the rendering between them, the term (`surfaces/surfaces.py`).
"""

import numpy as np

from gs2ci.core.kernels import f32_1, f32_2, f64, i64_1, kernel


@kernel(f32_2, f32_1, f64, f64, f64, f32_2)
def parallax_moments(means, ray, near, parallax_px, middle, out):
    """Store 1, p and p^2 of each Gaussian's parallax less the middle, [G, 3].

    Args:
        means: [G, 3].
        ray: The third row of the pose, which gives the depth, [4].
        near: The least depth.
        parallax_px: Parallax at an inverse depth of 1.
        middle: Subtracted from the parallaxes.
        out: [G, 3].
    """
    least, per, off = np.float32(near), np.float32(parallax_px), np.float32(middle)
    for g in range(len(means)):
        depth = means[g, 0] * ray[0] + means[g, 1] * ray[1] + means[g, 2] * ray[2] + ray[3]
        parallax = per / max(depth, least) - off
        out[g, 0] = 1
        out[g, 1] = parallax
        out[g, 2] = parallax * parallax


@kernel(f32_2, f32_1, f64, f64, f32_2, f32_2, f32_2)
def add_mean_gradient(means, ray, near, parallax_px, moments, by_moments, out):
    """Add to the means' gradient, [G, 3], the part that follows from that by their moments of parallax, [G, 3]."""
    least, per, two = np.float32(near), np.float32(parallax_px), np.float32(2)
    for g in range(len(means)):
        depth = means[g, 0] * ray[0] + means[g, 1] * ray[1] + means[g, 2] * ray[2] + ray[3]
        if depth >= least:
            by_parallax = by_moments[g, 1] + two * moments[g, 1] * by_moments[g, 2]
            by_depth = -by_parallax * per / (depth * depth)
            out[g, 0] += by_depth * ray[0]
            out[g, 1] += by_depth * ray[1]
            out[g, 2] += by_depth * ray[2]


@kernel(f32_2, i64_1, f32_1, f32_1, f64, f64, f64, f64, f32_2)
def distance_to_surface(image, pixels, inverse_depth, trust, parallax_px, middle, round_px, weight, gradient):
    """Return the mean distance of light from surfaces, px, and store `weight` times its gradient.

    For a pixel with moments s, m and q of the parallax of its light and the surface at p, the distance is
    sqrt(max(q - 2 p m + p^2 s, 0) + r^2) - r.

    Args:
        image: The moments, [H * W, 3].
        pixels: Pixels that the term uses, flat indices, [P].
        inverse_depth: Of the surfaces, [H * W].
        trust: Their weights, [H * W].
        parallax_px: Parallax at an inverse depth of 1.
        middle: Subtracted from all parallaxes.
        round_px: r.
        weight: Factor on the gradient.
        gradient: By the moments, [H * W, 3]; unchanged at other pixels.
    """
    all_trust = 0.0
    for i in range(len(pixels)):
        all_trust += trust[pixels[i]]
    share = weight / max(all_trust, 1.0)
    total, square_round = 0.0, round_px * round_px
    for i in range(len(pixels)):
        at = pixels[i]
        p = parallax_px * inverse_depth[at] - middle
        square = image[at, 2] - 2 * p * image[at, 1] + p * p * image[at, 0]
        root = np.sqrt(max(square, 0.0) + square_round)
        total += trust[at] * (root - round_px)
        slope = share * trust[at] / (2 * root) if square >= 0 else 0.0
        gradient[at, 0] = slope * p * p
        gradient[at, 1] = -2 * slope * p
        gradient[at, 2] = slope
    return total / max(all_trust, 1.0)
