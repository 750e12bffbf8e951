"""Lengths in the unit of the poses that a stage or a file gave: millimetres, on a bench.

Here: the conversion from the scale of the stages of a reconstruction, in which the tracked points' median depth is 1
and for which all epsilons are chosen. Not here: that scale (`geometry.path.telemetry`).
"""

import math
from dataclasses import replace
from typing import Final

import numpy as np
import torch

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import camera_centres
from gs2ci.reconstruct.fit.combining.ensemble import Ensemble
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.render.conventions import LOG_SCALE_MAX
from gs2ci.render.gaussians import Gaussians

# The allowed unit, in which a median depth of 1 is then measured. If it is smaller, the renderer's near plane cuts into
# the scene (`NEAR` is 0.01); if it is larger, sixth powers of lengths, as in determinants of covariances, approach the
# limit of float32.
_RANGE: Final = (0.1, 1e5)
# In median depths: with a focal length of 1000 px, travel by one of them moves what lies beyond by less than 0.1 px.
_FAR: Final = 1e4


def in_given_unit(geometry: Geometry, ensemble: Ensemble) -> tuple[Geometry, Ensemble]:
    """Return geometry and best fit with lengths in the unit of the given poses.

    While a fit refines poses, path and scene may grow or shrink together, which no view shows; so they are scaled until
    the refined path is as long as the given one. Both are unchanged, with the geometry's `unit` None, if no poses were
    given or if their unit would put the scene beyond what can be rendered.
    """
    best = ensemble.best
    before, after = _spread(geometry.world_to_camera), _spread(best.world_to_camera)
    unit = geometry.unit
    if unit is None or after == 0 or not _RANGE[0] <= unit * before / after <= _RANGE[1]:
        return replace(geometry, unit=None), ensemble
    grown = unit * before / after
    nearer = _with_far_ones_nearer(best.scene, best.world_to_camera)
    motion = None if nearer.motion is None else nearer.motion * grown
    log_scales = nearer.log_scales + math.log(grown)
    scene = replace(nearer, means=nearer.means * grown, log_scales=log_scales, motion=motion)
    best = replace(best, scene=scene, world_to_camera=_scaled(best.world_to_camera, grown))
    poses, inverse_depth = _scaled(geometry.world_to_camera, unit), geometry.inverse_depth / unit
    return replace(geometry, world_to_camera=poses, inverse_depth=inverse_depth), replace(ensemble, best=best)


def _with_far_ones_nearer(scene: Gaussians, world_to_camera: F64) -> Gaussians:
    """Return a scene that looks the same, in which Gaussians deeper than `_FAR` stand nearer, in the same order.

    A fit drives some to 10¹² and beyond, as large as they are far. Renderers cut sizes at a fixed length
    (`LOG_SCALE_MAX`), so that in a larger unit these would be smaller in the picture.
    """
    middle = torch.from_numpy(world_to_camera[len(world_to_camera) // 2])
    centre = -middle[:3, :3].T @ middle[:3, 3]
    offset = scene.means.double() - centre
    depth = (offset @ middle[2, :3]).abs()[:, None]
    share = (_FAR * (1 + (depth / _FAR).log()) / depth).to(scene.means.dtype)
    far = depth > _FAR
    cut = scene.log_scales.clamp(max=LOG_SCALE_MAX) + share.log()
    return replace(
        scene,
        means=torch.where(far, (centre + share * offset).to(scene.means.dtype), scene.means),
        log_scales=torch.where(far, cut, scene.log_scales),
        motion=None if scene.motion is None else torch.where(far[..., None], share[..., None], 1.0) * scene.motion,
    )


def _spread(world_to_camera: F64) -> float:
    """Return the distance of the cameras from their mean, root mean square."""
    centres = camera_centres(world_to_camera)
    return float(np.sqrt(((centres - centres.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _scaled(world_to_camera: F64, unit: float) -> F64:
    scaled = world_to_camera.copy()
    scaled[:, :3, 3] *= unit
    return scaled
