"""Colours seen from each view, and their gradients: `gs2ci.render.harmonics.colours_seen` in float32.

Sixteen Gaussians at a time, all views in the inner loop, so that coefficients are read once. Where the cameras stand is
given, so that the poses' gradients are torch's. The harmonics are taken as polynomials of the direction; their slopes
are those polynomials' own, of which the part along the line of sight is taken out at the end.

Here: the kernels and their torch function. Not here: blending.
"""

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.kernels import b1, f32_1, f64_2, helper, i64, in_parts, kernel
from gs2ci.render.conventions import SIGHT_MIN
from gs2ci.render.cpu.function import as_float32
from gs2ci.render.cpu.project import BLOCKS_PER_TASK
from gs2ci.render.cpu.project_backward import tasks_for
from gs2ci.render.cpu.projection import SCRATCH, load_triples
from gs2ci.render.cpu.shape_gradient import store_triples
from gs2ci.render.gaussians import HARMONICS, Gaussians
from gs2ci.render.simd.vector import LANES, broadcast, get, load, maximum, put, square_root, store, where_ge

_DEGREE_1 = HARMONICS[1]
_DEGREE_2 = HARMONICS[2]
_MOST = HARMONICS[3]

_ZERO = np.float32(0)
_ONE = np.float32(1)
_TWO = np.float32(2)
_THREE = np.float32(3)
_FOUR = np.float32(4)
_SIX = np.float32(6)
_SIGHT_MIN2 = np.float32(SIGHT_MIN**2)
# The factors of `gs2ci.render.harmonics.basis`.
_A = np.float32(math.sqrt(3 / (4 * math.pi)))
_B0, _B1, _B2 = (np.float32(math.sqrt(n / math.pi)) for n in (15 / 4, 5 / 16, 15 / 16))
_C0, _C1, _C2, _C3, _C4 = (np.float32(math.sqrt(n / math.pi)) for n in (35 / 32, 105 / 4, 21 / 32, 7 / 16, 105 / 16))


@helper()
def _load_coefficients(harmonics, terms, first, present, coefficients):
    """Turn rows first ... first + present of [G * K * 3] into K * 3 vectors; spare lanes repeat the last row."""
    columns = 3 * terms
    for lane in range(LANES):
        row = columns * (first + min(lane, present - 1))
        for k in range(columns):
            put(coefficients, k * LANES + lane, get(harmonics, row + k))


@helper()
def _sight(mean, centres, view):
    """Return the direction from a camera to Gaussians, and one over their distance."""
    x = mean[0] - centres[3 * view]
    y = mean[1] - centres[3 * view + 1]
    z = mean[2] - centres[3 * view + 2]
    inverse = _ONE / square_root(maximum(x * x + y * y + z * z, _SIGHT_MIN2))
    return x * inverse, y * inverse, z * inverse, inverse


@helper()
def _store_basis(x, y, z, terms, shape):
    """Write the harmonics in a direction, [K * 16]."""
    store(shape, 0, -_A * y)
    store(shape, LANES, _A * z)
    store(shape, 2 * LANES, -_A * x)
    if terms > _DEGREE_1:
        xx, yy, zz = x * x, y * y, z * z
        store(shape, 3 * LANES, _B0 * x * y)
        store(shape, 4 * LANES, -_B0 * y * z)
        store(shape, 5 * LANES, _B1 * (_TWO * zz - xx - yy))
        store(shape, 6 * LANES, -_B0 * x * z)
        store(shape, 7 * LANES, _B2 * (xx - yy))
        if terms > _DEGREE_2:
            store(shape, 8 * LANES, -_C0 * y * (_THREE * xx - yy))
            store(shape, 9 * LANES, _C1 * x * y * z)
            store(shape, 10 * LANES, -_C2 * y * (_FOUR * zz - xx - yy))
            store(shape, 11 * LANES, _C3 * z * (_TWO * zz - _THREE * xx - _THREE * yy))
            store(shape, 12 * LANES, -_C2 * x * (_FOUR * zz - xx - yy))
            store(shape, 13 * LANES, _C4 * z * (xx - yy))
            store(shape, 14 * LANES, -_C0 * x * (xx - _THREE * yy))


@helper()
def _unclamped(colour, coefficients, terms, shape):
    """Return the colours before those below zero are cut."""
    red, green, blue = colour
    for k in range(terms):
        value = load(shape, k * LANES)
        red = red + value * load(coefficients, 3 * k * LANES)
        green = green + value * load(coefficients, (3 * k + 1) * LANES)
        blue = blue + value * load(coefficients, (3 * k + 2) * LANES)
    return red, green, blue


@helper()
def _differentiate_sums(coefficients, terms, shape, given, d_coefficients, weights):
    """Add to the coefficients' gradients, and write each harmonic's own, [K * 16], for gradients of the colours."""
    red, green, blue = given
    for k in range(terms):
        value, at = load(shape, k * LANES), 3 * k * LANES
        store(d_coefficients, at, load(d_coefficients, at) + value * red)
        store(d_coefficients, at + LANES, load(d_coefficients, at + LANES) + value * green)
        store(d_coefficients, at + 2 * LANES, load(d_coefficients, at + 2 * LANES) + value * blue)
        by_green, by_blue = load(coefficients, at + LANES), load(coefficients, at + 2 * LANES)
        store(weights, k * LANES, load(coefficients, at) * red + by_green * green + by_blue * blue)


@helper()
def _take_from(parts, task, first, triple, present, scratch):
    """Subtract the sums of three vectors' lanes, but for spare ones."""
    for axis in range(3):
        store(scratch, axis * LANES, triple[axis])
        for lane in range(present):
            parts[task, first + axis] -= np.float64(scratch[axis * LANES + lane])


@helper()
def _slopes(x, y, z, terms, w):
    """Return sum_k w_k dY_k / d(x, y, z) for weights `w`, [K * 16]."""
    dx = -_A * load(w, 2 * LANES)
    dy = -_A * load(w, 0)
    dz = _A * load(w, LANES)
    if terms > _DEGREE_1:
        w3, w4, w5 = load(w, 3 * LANES), load(w, 4 * LANES), load(w, 5 * LANES)
        w6, w7 = load(w, 6 * LANES), load(w, 7 * LANES)
        dx = dx + _B0 * (y * w3 - z * w6) - _TWO * _B1 * x * w5 + _TWO * _B2 * x * w7
        dy = dy + _B0 * (x * w3 - z * w4) - _TWO * _B1 * y * w5 - _TWO * _B2 * y * w7
        dz = dz - _B0 * (y * w4 + x * w6) + _FOUR * _B1 * z * w5
    if terms > _DEGREE_2:
        xx, yy, zz = x * x, y * y, z * z
        w8, w9, w10, w11 = load(w, 8 * LANES), load(w, 9 * LANES), load(w, 10 * LANES), load(w, 11 * LANES)
        w12, w13, w14 = load(w, 12 * LANES), load(w, 13 * LANES), load(w, 14 * LANES)
        across = _THREE * (xx - yy)
        dx = dx - _SIX * _C0 * x * y * w8 + _C1 * y * z * w9 + _TWO * _C2 * x * y * w10 - _SIX * _C3 * x * z * w11
        dx = dx - _C2 * (_FOUR * zz - _THREE * xx - yy) * w12 + _TWO * _C4 * x * z * w13 - _C0 * across * w14
        dy = dy - _C0 * across * w8 + _C1 * x * z * w9 - _C2 * (_FOUR * zz - xx - _THREE * yy) * w10
        dy = dy - _SIX * _C3 * y * z * w11 + _TWO * _C2 * x * y * w12 - _TWO * _C4 * y * z * w13
        dy = dy + _SIX * _C0 * x * y * w14
        dz = dz + _C1 * x * y * w9 - _TWO * _FOUR * _C2 * z * (y * w10 + x * w12)
        dz = dz + _C3 * (_SIX * zz - _THREE * xx - _THREE * yy) * w11 + _C4 * (xx - yy) * w13
    return dx, dy, dz


@kernel(i64, i64, f32_1, b1, f32_1, f32_1, i64, f32_1, f32_1)
def see_colours(from_task, to_task, means, means_differ, colours, harmonics, terms, centres, seen):
    """Evaluate the colours of G Gaussians from V cameras.

    Args:
        from_task: The first task of this part.
        to_task: The end of them.
        means: [G * 3] float32, or [V * G * 3] if `means_differ` between the views.
        means_differ: See `means`.
        colours: The constant part, [G * 3].
        harmonics: [G * K * 3].
        terms: K, 3, 8 or 15.
        centres: Of the cameras, [V * 3].
        seen: Written: [V * G * 3].
    """
    count, views = colours.shape[0] // 3, centres.shape[0] // 3
    blocks = (count + LANES - 1) // LANES
    for task in range(from_task, to_task):
        scratch = np.empty(SCRATCH, np.float32)
        shape = np.empty(_MOST * LANES, np.float32)
        coefficients = np.empty(3 * _MOST * LANES, np.float32)
        zero = broadcast(_ZERO)
        for block in range(task * BLOCKS_PER_TASK, min(blocks, (task + 1) * BLOCKS_PER_TASK)):
            first = block * LANES
            present = min(LANES, count - first)
            _load_coefficients(harmonics, terms, first, present, coefficients)
            colour = load_triples(colours, first, present, scratch)
            mean = load_triples(means, first, present, scratch)
            for view in range(views):
                if means_differ:
                    mean = load_triples(means, view * count + first, present, scratch)
                x, y, z, _ = _sight(mean, centres, view)
                _store_basis(x, y, z, terms, shape)
                red, green, blue = _unclamped(colour, coefficients, terms, shape)
                found = (maximum(red, zero), maximum(green, zero), maximum(blue, zero))
                store_triples(seen, view * count + first, present, found, scratch)


@kernel(i64, i64, f32_1, b1, f32_1, f32_1, i64, f32_1, f32_1, f32_1, f32_1, f32_1, f64_2)
def differentiate_colours(
    from_task,
    to_task,
    means,
    means_differ,
    colours,
    harmonics,
    terms,
    centres,
    d_seen,
    d_means,
    d_colours,
    d_harmonics,
    centre_parts,
):
    """Carry the gradients of colours seen to all that they come from.

    Args:
        from_task: The first task of this part.
        to_task: The end of them.
        means: As for `see_colours`; likewise up to `centres`.
        means_differ: See `means`.
        colours: See `means`.
        harmonics: See `means`.
        terms: See `means`.
        centres: See `means`.
        d_seen: [V * G * 3].
        d_means: Written: shaped like `means`.
        d_colours: Written: [G * 3].
        d_harmonics: Written: [G * K * 3].
        centre_parts: Written: [tasks, V * 3] float64, whose sum in order does not depend on the number of threads.
    """
    count, views = colours.shape[0] // 3, centres.shape[0] // 3
    blocks = (count + LANES - 1) // LANES
    for task in range(from_task, to_task):
        scratch = np.empty(SCRATCH, np.float32)
        shape, weights = np.empty(_MOST * LANES, np.float32), np.empty(_MOST * LANES, np.float32)
        coefficients = np.empty(3 * _MOST * LANES, np.float32)
        d_coefficients = np.empty(3 * _MOST * LANES, np.float32)
        for entry in range(3 * views):
            centre_parts[task, entry] = 0.0
        zero = broadcast(_ZERO)
        for block in range(task * BLOCKS_PER_TASK, min(blocks, (task + 1) * BLOCKS_PER_TASK)):
            first = block * LANES
            present = min(LANES, count - first)
            _load_coefficients(harmonics, terms, first, present, coefficients)
            for k in range(3 * terms):
                store(d_coefficients, k * LANES, zero)
            colour = load_triples(colours, first, present, scratch)
            mean = load_triples(means, first, present, scratch)
            d_colour, d_mean = (zero, zero, zero), (zero, zero, zero)
            for view in range(views):
                if means_differ:
                    mean = load_triples(means, view * count + first, present, scratch)
                x, y, z, inverse = _sight(mean, centres, view)
                _store_basis(x, y, z, terms, shape)
                value = _unclamped(colour, coefficients, terms, shape)
                given = load_triples(d_seen, view * count + first, present, scratch)
                red = where_ge(value[0], zero, given[0], zero)
                green = where_ge(value[1], zero, given[1], zero)
                blue = where_ge(value[2], zero, given[2], zero)
                d_colour = (d_colour[0] + red, d_colour[1] + green, d_colour[2] + blue)
                _differentiate_sums(coefficients, terms, shape, (red, green, blue), d_coefficients, weights)
                dx, dy, dz = _slopes(x, y, z, terms, weights)
                along = dx * x + dy * y + dz * z
                part = (inverse * (dx - along * x), inverse * (dy - along * y), inverse * (dz - along * z))
                if means_differ:
                    store_triples(d_means, view * count + first, present, part, scratch)
                d_mean = (d_mean[0] + part[0], d_mean[1] + part[1], d_mean[2] + part[2])
                _take_from(centre_parts, task, 3 * view, part, present, scratch)
            store_triples(d_colours, first, present, d_colour, scratch)
            if not means_differ:
                store_triples(d_means, first, present, d_mean, scratch)
            for lane in range(present):
                for k in range(3 * terms):
                    put(d_harmonics, 3 * terms * (first + lane) + k, get(d_coefficients, k * LANES + lane))


class _Seen(torch.autograd.Function):
    """Colours [V, G, 3] of means [G, 3] or [V, G, 3], colours [G, 3], harmonics [G, K, 3], centres [V, 3]; float32."""

    @staticmethod
    def forward(ctx: Any, *given: Tensor) -> Tensor:
        means, colours, harmonics, centres = (as_float32(tensor) for tensor in given)
        seen = np.empty((len(centres), *colours.shape), np.float32)
        tasks = tasks_for(-(-len(colours) // LANES))
        flat = (means.reshape(-1), means.ndim == 3, colours.reshape(-1), harmonics.reshape(-1), harmonics.shape[1])
        in_parts(see_colours, tasks, *flat, centres.reshape(-1), seen.reshape(-1))
        ctx.save_for_backward(*given)
        return torch.from_numpy(seen)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, ...]:
        means, colours, harmonics, centres = (as_float32(tensor) for tensor in ctx.saved_tensors)
        d_means, d_colours, d_harmonics = (np.empty_like(array) for array in (means, colours, harmonics))
        parts = np.empty((tasks_for(-(-len(colours) // LANES)), 3 * len(centres)), np.float64)
        in_parts(
            differentiate_colours,
            len(parts),
            *(means.reshape(-1), means.ndim == 3, colours.reshape(-1), harmonics.reshape(-1), harmonics.shape[1]),
            centres.reshape(-1),
            as_float32(gradients[0]).reshape(-1),
            *(array.reshape(-1) for array in (d_means, d_colours, d_harmonics)),
            parts,
        )
        d_centres = parts.sum(axis=0).reshape(-1, 3).astype(np.float32)
        return tuple(torch.from_numpy(array) for array in (d_means, d_colours, d_harmonics, d_centres))


def colours_of(scene: Gaussians, world_to_camera: Tensor, times: Tensor | None) -> Tensor:
    """Return the colours, [G, 3], or in each view, [V, G, 3], where they change with the direction of sight."""
    if scene.harmonics is None:
        return scene.colours
    means = scene.means if times is None else scene.means_at(times)
    rotation, translation = world_to_camera[:, :3, :3], world_to_camera[:, :3, 3:]
    centres = -(rotation.transpose(1, 2) @ translation)[..., 0]
    given = (means, scene.colours, scene.harmonics, centres)
    seen: Tensor = _Seen.apply(*(tensor.to(torch.float32) for tensor in given))
    return seen
