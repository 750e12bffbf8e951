"""Colours seen from each view, and their gradients: `gs2ci.render.harmonics.colours_seen` in float32.

Sixteen Gaussians at a time, all views in the inner loop, so that coefficients are read once. Where the cameras stand is
given, so that the poses' gradients are torch's. The harmonics are taken as polynomials of the direction; their slopes
are those polynomials' own, of which the part along the line of sight is taken out at the end.

Here: the kernels and their torch function. Not here: blending.
"""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F64
from gs2ci.core.kernels import b1, f32_1, f64_2, helper, i64, in_parts, kernel
from gs2ci.render.conventions import SIGHT_MIN
from gs2ci.render.cpu.function import as_float32
from gs2ci.render.cpu.project import BLOCKS_PER_TASK
from gs2ci.render.cpu.project_backward import tasks_for
from gs2ci.render.cpu.projection import SCRATCH, load_triples
from gs2ci.render.cpu.shape_gradient import store_triples
from gs2ci.render.gaussians import HARMONICS, Gaussians
from gs2ci.render.harmonics import basis, spread_directions
from gs2ci.render.simd.vector import LANES, broadcast, get, load, maximum, put, square_root, store, where_ge

_MOST = HARMONICS[3]

_ZERO = np.float32(0)
_ONE = np.float32(1)
_SIGHT_MIN2 = np.float32(SIGHT_MIN**2)


def _slopes_of_basis() -> tuple[Any, F64]:
    """Write the slopes of each harmonic, as a polynomial, as sums of those one degree lower.

    Solved for at as many directions as there are unknowns and more, from slopes that are exact for cubic polynomials.
    The harmonic is itself the sum of its slopes times x, y, z over its degree (Euler's theorem).

    Returns:
        Which harmonic (1 to 15), which lower one (0 is constant: 1) and which axis, in the order of the first; and the
        factors, with and without division by the degree, [entries, 2].
    """
    at, step = spread_directions(64), torch.eye(3, dtype=torch.float64)[:, None]
    near, far = (basis(at + each) - basis(at - each) for each in (step, 2 * step))
    known = torch.cat([torch.ones_like(at[:, :1]), basis(at)], dim=1).expand(3, -1, -1)
    found = torch.linalg.lstsq(known, (8 * near - far) / 12).solution.numpy().transpose(2, 1, 0)
    places = np.argwhere(np.abs(found) > 1e-9)
    factors = found[tuple(places.T)]
    places[:, 0] += 1
    return places, np.stack([factors, factors / np.searchsorted(HARMONICS, places[:, 0])], axis=1)


_PLACES, _FACTORS = _slopes_of_basis()
_OF, _LOWER, _AXIS = (np.ascontiguousarray(column * LANES) for column in _PLACES.T)
_SLOPE, _SHARE = (np.ascontiguousarray(column, np.float32) for column in _FACTORS.T)
_END = tuple(int((_PLACES[:, 0] <= terms).sum()) for terms in range(_MOST + 1))


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
def _store_basis(x, y, z, terms, sight, shape):
    """Write a direction, [3 * 16], and the constant 1 and the harmonics in it, [(1 + K) * 16]."""
    store(sight, 0, x)
    store(sight, LANES, y)
    store(sight, 2 * LANES, z)
    store(shape, 0, broadcast(_ONE))
    for k in range(1, terms + 1):
        store(shape, k * LANES, broadcast(_ZERO))
    for entry in range(_END[terms]):
        of = get(_OF, entry)
        part = get(_SHARE, entry) * load(sight, get(_AXIS, entry)) * load(shape, get(_LOWER, entry))
        store(shape, of, load(shape, of) + part)


@helper()
def _unclamped(colour, coefficients, terms, shape):
    """Return the colours before those below zero are cut."""
    red, green, blue = colour
    for k in range(terms):
        value = load(shape, (k + 1) * LANES)
        red = red + value * load(coefficients, 3 * k * LANES)
        green = green + value * load(coefficients, (3 * k + 1) * LANES)
        blue = blue + value * load(coefficients, (3 * k + 2) * LANES)
    return red, green, blue


@helper()
def _differentiate_sums(coefficients, terms, shape, given, d_coefficients, weights):
    """Add to the coefficients' gradients, and write each harmonic's own, [K * 16], for gradients of the colours."""
    red, green, blue = given
    for k in range(terms):
        value, at = load(shape, (k + 1) * LANES), 3 * k * LANES
        store(d_coefficients, at, load(d_coefficients, at) + value * red)
        store(d_coefficients, at + LANES, load(d_coefficients, at + LANES) + value * green)
        store(d_coefficients, at + 2 * LANES, load(d_coefficients, at + 2 * LANES) + value * blue)
        by_green, by_blue = load(coefficients, at + LANES), load(coefficients, at + 2 * LANES)
        store(weights, (k + 1) * LANES, load(coefficients, at) * red + by_green * green + by_blue * blue)


@helper()
def _take_from(parts, task, first, triple, present, scratch):
    """Subtract the sums of three vectors' lanes, but for spare ones."""
    for axis in range(3):
        store(scratch, axis * LANES, triple[axis])
        for lane in range(present):
            parts[task, first + axis] -= np.float64(scratch[axis * LANES + lane])


@helper()
def _slopes(terms, shape, weights, slopes):
    """Return sum_k w_k dY_k / d(x, y, z) for weights as `shape` lies, by way of `slopes`, [3 * 16]."""
    for axis in range(3):
        store(slopes, axis * LANES, broadcast(_ZERO))
    for entry in range(_END[terms]):
        part = get(_SLOPE, entry) * load(weights, get(_OF, entry)) * load(shape, get(_LOWER, entry))
        store(slopes, get(_AXIS, entry), load(slopes, get(_AXIS, entry)) + part)
    return load(slopes, 0), load(slopes, LANES), load(slopes, 2 * LANES)


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
        sight, shape = np.empty(3 * LANES, np.float32), np.empty((1 + _MOST) * LANES, np.float32)
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
                _store_basis(x, y, z, terms, sight, shape)
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
        sight, shape = np.empty(3 * LANES, np.float32), np.empty((1 + _MOST) * LANES, np.float32)
        weights = np.empty_like(shape)
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
                _store_basis(x, y, z, terms, sight, shape)
                value = _unclamped(colour, coefficients, terms, shape)
                given = load_triples(d_seen, view * count + first, present, scratch)
                red = where_ge(value[0], zero, given[0], zero)
                green = where_ge(value[1], zero, given[1], zero)
                blue = where_ge(value[2], zero, given[2], zero)
                d_colour = (d_colour[0] + red, d_colour[1] + green, d_colour[2] + blue)
                _differentiate_sums(coefficients, terms, shape, (red, green, blue), d_coefficients, weights)
                dx, dy, dz = _slopes(terms, shape, weights, sight)
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
