"""Exposures in common coordinates: paths, depths and first Gaussians brought there, and the tie by a stage.

Each exposure alone has the axes of its own reference view and the median depth of its own scene as its unit. The common
coordinates are those of the first exposure.

Here: a geometry and Gaussians brought into other coordinates, the similarities that a stage's poses give, and the first
Gaussians of all exposures together. Not here: similarities from matched features (`loops`), the fit (`joint`).
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F64, Bool
from gs2ci.core.records import Shot
from gs2ci.reconstruct.exposures.similarity import Similarity
from gs2ci.reconstruct.geometry.depth.view_depths import in_picture, project
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.kinds import PathSource
from gs2ci.render.gaussians import Gaussians, joined


def placed(geometry: Geometry, common_from_own: Similarity) -> Geometry:
    """Return a geometry in the common coordinates."""
    scale, errors = common_from_own.scale, geometry.pose_errors
    return replace(
        geometry,
        world_to_camera=common_from_own.poses(geometry.world_to_camera),
        inverse_depth=(geometry.inverse_depth / scale).astype(np.float32),
        view_depths=tuple(
            replace(one, inverse_depth=(one.inverse_depth / scale).astype(np.float32)) for one in geometry.view_depths
        ),
        unit=None if geometry.unit is None else geometry.unit / scale,
        pose_errors=None if errors is None else replace(errors, position=errors.position * scale),
        other_order=None,
    )


def by_stage(shots: Sequence[Shot], geometries: Sequence[Geometry]) -> dict[int, Similarity]:
    """Return common_from_own of the exposures whose paths a stage gave, by index.

    The common coordinates are those of the first of them. A stage reports all exposures of a session in one frame and
    one unit, and each single path was checked against its own views before it was taken (`geometry.choose`).
    """
    known = {
        number: (shot.telemetry_world_to_camera[geometry.reference], geometry.unit)
        for number, (shot, geometry) in enumerate(zip(shots, geometries, strict=True))
        if geometry.source == PathSource.STAGE
        and shot.telemetry_world_to_camera is not None
        and geometry.unit is not None
    }
    if not known:
        return {}
    first, unit = known[min(known)]
    found = {}
    for number, (pose, own) in known.items():
        between = first @ np.linalg.inv(pose)
        found[number] = Similarity(own / unit, between[:3, :3], between[:3, 3] / unit)
    return found


def first_of_all(starts: Sequence[Gaussians], geometries: Sequence[Geometry]) -> tuple[Gaussians, float]:
    """Join the first Gaussians of exposures; of each, those that no earlier exposure's reference view shows.

    Args:
        starts: Of each exposure, in common coordinates.
        geometries: Likewise.

    Returns:
        The Gaussians, and how many times as many there are as in the first exposure alone.
    """
    parts = []
    for number, scene in enumerate(starts):
        new = torch.from_numpy(~_shown(scene.means.double().numpy(), geometries[:number]))
        parts.append(scene.map(partial(_rows, chosen=new)))
    together = joined(parts)
    return together, len(together) / len(parts[0])


def _rows(tensor: Tensor, chosen: Tensor) -> Tensor:
    return tensor[chosen]


def moved(scene: Gaussians, common_from_own: Similarity) -> Gaussians:
    """Return round Gaussians in the common coordinates."""
    means = common_from_own.points(scene.means.double().numpy())
    log_scales = scene.log_scales + math.log(common_from_own.scale)
    return replace(scene, means=torch.from_numpy(means).float(), log_scales=log_scales)


def _shown(points: F64, geometries: Sequence[Geometry]) -> Bool:
    """Tell which points, [P, 3], the reference views of geometries show in their pictures."""
    found = np.zeros(len(points), bool)
    for one in geometries:
        pixels, _ = project(points, one.world_to_camera[one.reference], one.intrinsics)
        found |= in_picture(pixels, one.inverse_depth.shape)
    return found
