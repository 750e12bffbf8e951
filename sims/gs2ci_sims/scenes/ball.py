"""A shiny ball on a floor: a procedural scene whose colours depend on the direction of view.

Here: the ball, its discs and its highlight as spherical harmonics. Not here: the harmonics (`gs2ci.render.harmonics`),
floor and wall (`stage`).
"""

from dataclasses import replace
from typing import Final

import numpy as np
import torch
from scipy.special import eval_legendre

from gs2ci.core.arrays import F64, Rng
from gs2ci.core.errors import InputError
from gs2ci.core.lens import pixel_centres, rays_of
from gs2ci.render.harmonics import DEGREE_MAX, basis
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.rectangles import SPACING_PX, TOWARDS_LIGHT, depth_of
from gs2ci_sims.scenes.stage import SuggestedCamera, floor_y, room
from gs2ci_sims.scenes.surfels import Surfels, from_tangents, gaussians_from_surfels, join

LIGHT: Final = TOWARDS_LIGHT / np.linalg.norm(TOWARDS_LIGHT)
AMBIENT: Final = 0.25
# The ball's surface continues on its far side up to this cosine of the angle to the line of sight.
BACK: Final = 0.35


def ball(
    rng: Rng,
    frame: SuggestedCamera,
    *,
    radius: float = 0.75,
    depth: float = 4.0,
    shine: float = 0.8,
    exponent: float = 8.0,
    backdrop: float = 6.0,
) -> Scene:
    """Build a ball with a Phong highlight on a floor in front of a wall.

    Args:
        rng: Generator of the textures.
        frame: The camera.
        radius: Radius of the ball.
        depth: Depth of its centre.
        shine: Peak radiance of the highlight, at least 0, before its approximation by harmonics of degree 3.
        exponent: Exponent of Phong's cosine (Communications of the ACM 18 (1975)), at least 1.
        backdrop: Depth of the wall.

    Raises:
        InputError: The ball reaches behind the camera or into the wall, or the highlight's figures are out of range.
    """
    if not 0 < radius < depth or depth + radius >= backdrop or shine < 0 or not 1 <= exponent < np.inf:
        raise InputError(
            f"a ball of radius {radius} at {depth} before a wall at {backdrop}, shine {shine}, exponent {exponent}",
            allowed="0 < radius < depth, depth + radius < backdrop, shine >= 0, exponent >= 1",
        )
    faces, surfels = room(rng, frame, backdrop)
    centre = np.array([0.0, floor_y(frame, backdrop) - radius, depth])
    skin, normals = _sphere_surfels(centre, radius, SPACING_PX * (depth - radius) / frame.focal)
    constant, rest = highlight(normals, shine, exponent)
    skin.radiances[:] += constant[:, None]
    everything = join([*surfels, skin])
    harmonics = torch.zeros(len(everything), (DEGREE_MAX + 1) ** 2 - 1, 3)
    harmonics[-len(skin) :] = torch.tensor(rest, dtype=torch.float32)[..., None]
    seen = depth_of(faces, frame.intrinsics, frame.size)
    return Scene(
        "ball",
        replace(gaussians_from_surfels(everything), harmonics=harmonics),
        frame.intrinsics,
        frame.size,
        np.fmin(seen, sphere_depth(centre, radius, frame)),
    )


def highlight(normals: F64, shine: float, exponent: float) -> tuple[F64, F64]:
    """Project Phong's lobe shine max(0, r . light)^exponent on harmonics of the direction of sight, d.

    With r = d - 2 (d . n) n, r . light = d . a for a = light - 2 (n . light) n: for each point the lobe is a function
    of the angle to a alone. By Funk and Hecke's theorem its coefficients are lambda_l Y_lm(a), with
    lambda_l = 2 pi integral f(t) P_l(t) dt (Basri and Jacobs, IEEE Trans. PAMI 25 (2003)). Points that face
    away from the light have no highlight.

    Args:
        normals: Outward unit normals, [n, 3].
        shine: Peak of the lobe.
        exponent: Exponent of the cosine.

    Returns:
        The constant part of the radiance [n], and the coefficients of degrees 1 to 3, [n, 15].
    """
    nodes, weights = np.polynomial.legendre.leggauss(64)
    t, w = 0.5 * (nodes + 1), 0.5 * weights  # the lobe ends at t = 0
    scale = [2 * np.pi * shine * float(w @ (t**exponent * eval_legendre(l, t))) for l in range(DEGREE_MAX + 1)]  # noqa: E741
    facing = normals @ LIGHT
    axis = LIGHT - 2 * facing[:, None] * normals
    lit = np.clip(4 * facing, 0.0, 1.0)  # fades out towards the terminator
    degrees = np.repeat([1, 2, 3], [3, 5, 7])
    rest = np.array(scale)[degrees] * basis(torch.tensor(axis)).numpy()
    return lit * scale[0] / (4 * np.pi), lit[:, None] * rest


def sphere_depth(centre: F64, radius: float, frame: SuggestedCamera) -> F64:
    """Return the depth at which every pixel's ray meets a sphere, [H, W]; NaN for rays that miss it."""
    directions = rays_of(pixel_centres(frame.size), frame.intrinsics)
    along, square = directions @ centre, np.sum(directions**2, axis=-1)
    root = along**2 - square * (centre @ centre - radius**2)
    return np.where(root >= 0, (along - np.sqrt(np.maximum(root, 0.0))) / square, np.nan)


def _sphere_surfels(centre: F64, radius: float, spacing: float) -> tuple[Surfels, F64]:
    """Cover the sphere with discs on rings around the vertical axis, coloured in bands; return discs and normals."""
    rings = max(4, int(np.ceil(np.pi * radius / spacing)))
    polar = (np.arange(rings) + 0.5) / rings * np.pi
    counts = np.maximum(4, np.ceil(2 * np.pi * radius * np.sin(polar) / spacing)).astype(int)
    theta = polar.repeat(counts)
    turn = np.concatenate([(np.arange(count) + 0.5) / count * 2 * np.pi for count in counts])
    sin, cos = np.sin(theta), np.cos(theta)
    normals = np.stack([sin * np.sin(turn), -cos, -sin * np.cos(turn)], axis=1)
    front = normals @ centre < BACK * np.linalg.norm(centre)
    theta, turn, sin, cos, normals = theta[front], turn[front], sin[front], cos[front], normals[front]
    east = np.stack([np.cos(turn), np.zeros_like(turn), np.sin(turn)], axis=1)
    south = np.stack([cos * np.sin(turn), sin, -cos * np.cos(turn)], axis=1)
    u = east * (2 * np.pi * radius * sin / counts.repeat(counts)[front])[:, None]
    v = south * (np.pi * radius / rings)
    bands = np.sign(np.sin(8 * theta)) * np.sign(np.sin(6 * turn))
    paint = np.where(bands[:, None] > 0, [0.55, 0.12, 0.1], [0.75, 0.7, 0.6])
    light = AMBIENT + (1 - AMBIENT) * np.clip(normals @ LIGHT, 0.0, 1.0)
    return from_tangents(centre + radius * normals, u, v, light[:, None] * paint), normals
