"""The scene and its cameras in three dimensions, inside a page that needs nothing else.

Here: which Gaussians are shown, and their numbers as the page's own program (`templates/scene.js`) reads them: of each
nine half-precision numbers (place, upper triangle of 10⁴ times the covariance) and four bytes (colour, from -0.5 to
1.5, and opacity); and the cameras as lines. Everything is in the middle camera's axes, in distances of that camera from
what it looks at, which is the origin. Not here: drawing.
"""

import base64
from itertools import pairwise
from typing import Any, Final

import numpy as np
import torch
from markupsafe import Markup
from numpy.typing import NDArray

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import in_camera
from gs2ci.evaluate.pages.frame import piece
from gs2ci.evaluate.pages.pictures import Picture
from gs2ci.render.conventions import DILATION_PX2
from gs2ci.render.gaussians import Gaussians, rotation_matrices
from gs2ci.render.harmonics import colours_from

# 29 characters of the page each: about two megabytes.
MOST_SHOWN: Final = 64_000
COVARIANCE_SCALE: Final = 1e4
# Positions beyond this lose precision as half-precision numbers; objects so far away are tiny anyway.
_FARTHEST: Final = 60.0
_LARGEST: Final = 60_000.0
LEAST_OPACITY: Final = 0.01
# A camera's symbol, as a share of the distance looked at, and of the way between neighbours.
_SYMBOL, _SYMBOL_OF_STEP = 0.03, 0.6


def scene_view(
    scene: Gaussians,
    world_to_camera: F64,
    intrinsics: F64,
    size: tuple[int, int],
    still: Picture | None = None,
) -> Markup:
    """Build the box of a scene; empty where no Gaussian can be seen.

    Args:
        scene: The Gaussians; moving ones are shown at the middle of the exposure, colours that depend on the viewing
            direction as the middle camera sees them.
        world_to_camera: [N, 4, 4].
        intrinsics: [3, 3], px.
        size: Height and width of the views, px.
        still: What stands there on paper, and where no script runs; None leaves it out.
    """
    middle = world_to_camera[len(world_to_camera) // 2]
    own = scene.detach().map(lambda tensor: tensor.double())
    opacity = torch.sigmoid(own.opacity_logits).numpy()
    places = in_camera(own.means.numpy(), middle)
    axes = middle[:3, :3] @ rotation_matrices(own.quaternions).numpy() * own.log_scales.exp().numpy()[:, None, :]
    seen = (opacity >= LEAST_OPACITY) & (places[:, 2] > 0) & np.isfinite(places).all(axis=1)
    if not seen.any():
        return Markup()
    away = float(np.median(places[seen, 2]))
    places = (places - (0, 0, away)) / away
    covariances = COVARIANCE_SCALE * (axes @ axes.transpose(0, 2, 1)) / away**2
    seen &= np.abs(places).max(axis=1) < _FARTHEST
    # Gaussians that cover the largest areas come first; without the others, detail is missing.
    weight = opacity * np.sqrt(np.maximum(np.linalg.eigvalsh(covariances)[:, 1:].prod(axis=1), 0))
    chosen = np.flatnonzero(seen)
    chosen = np.sort(chosen[np.argsort(-weight[chosen], kind="stable")[:MOST_SHOWN]])
    upper = covariances[chosen][:, (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)]
    shapes = np.concatenate([places[chosen], np.clip(upper, -_LARGEST, _LARGEST)], axis=1).astype("<f2")
    shades = np.concatenate([colours_from(own, torch.from_numpy(middle)).numpy(), opacity[:, None]], axis=1)[chosen]
    shades[:, :3] = 0.5 * shades[:, :3] + 0.25  # fitted colours lie beyond 0 to 1, too
    colours = np.round(255 * np.clip(np.nan_to_num(shades), 0, 1)).astype(np.uint8)
    height, width = size
    return piece(
        "scene_view",
        still=still,
        shapes=_text(shapes),
        colours=_text(colours),
        cameras=_text(_camera_lines(world_to_camera, middle, away, intrinsics, size).astype("<f4")),
        lens=(*intrinsics.diagonal()[:2].tolist(), *intrinsics[:2, 2].tolist()),
        size=(width, height),
        widened=DILATION_PX2,
        shown=len(chosen),
        total=len(scene),
    )


def _camera_lines(world_to_camera: F64, middle: F64, away: float, intrinsics: F64, size: tuple[int, int]) -> F64:
    """Return the cameras as pyramids, and the path through them, as ends of lines, [2 L, 3]."""
    to_middle = middle @ np.linalg.inv(world_to_camera)
    to_middle[:, :3, 3] = (to_middle[:, :3, 3] - (0, 0, away)) / away
    centres = to_middle[:, :3, 3]
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    side = float(np.clip(_SYMBOL_OF_STEP * steps.mean(), 0.2 * _SYMBOL, _SYMBOL)) if len(steps) else _SYMBOL
    height, width = size
    corners_px = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1.0]])
    corners = side * corners_px @ np.linalg.inv(intrinsics).T
    lines: list[F64] = []
    for pose in to_middle:
        rim = in_camera(corners, pose)
        for k in range(4):
            lines += [pose[:3, 3], rim[k], rim[k], rim[(k + 1) % 4]]
    for one, other in pairwise(centres):
        lines += [one, other]
    return np.stack(lines)


def _text(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
