"""A test whether motion explains part of a still scene's residual, and where.

If something moves with velocity v, view i shows X displaced by v tᵢ, and to first order the residual of the still scene
is Σ wᵢ Mᵢ ⊙ (−tᵢ ∇X·v). So the residual is regressed, block by block, on the coded sums of tᵢ ∂X/∂x and tᵢ ∂X/∂y: two
numbers for a few hundred pixels. The rest of the residual (noise, missing detail) does not follow the times of the
masks, and the effect of the camera's motion has been fitted by the poses. The test costs two coded sums and no fit. If
things move farther than their detail is wide, the first order no longer holds, but its sign does, and only the presence
of motion is tested.

A residual is larger where the picture has detail, and the channels of a pixel err together. So standard errors are
those of a sandwich estimator with each pixel as a cluster (White 1980; Liang and Zeger 1986): as if all numbers were
independent and of one variance, many still photographs seem to move (docs/decisions/moving-scenes.md).

Here: the regression and its significance. Not here: what follows from it (`hypotheses.moving`).
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.measurement.blocks import CHANCE, LEAST_PIXELS, in_blocks, ridged
from gs2ci.reconstruct.measurement.holdout import Holdout


@dataclass(frozen=True)
class LeftByMotion:
    """The part of a still scene's residual that motion explains.

    Args:
        explained: Share of the residual's power that velocities of blocks explain, minus the share that as many numbers
            explain by chance; 0 if they explain no more.
        surely: Share of the blocks with a significant motion.
    """

    explained: float
    surely: float


def left_by_motion(holdout: Holdout, views: F32, times: F64) -> LeftByMotion:
    """Regress the residual of still views on motion.

    Args:
        holdout: The measurement.
        views: Of a still scene, not refined by its residual, [N, H, W, C].
        times: When each view was taken, [N], centred on 0.
    """
    shot = holdout.shot
    if min(shot.size) < 2:  # one row or column has no gradient across it
        return LeftByMotion(0.0, 0.0)
    asked = shot.usable[..., None]
    residual = in_blocks((shot.measurement - holdout.coded(views)) * asked)
    weighted = views * times.astype(np.float32)[:, None, None, None]
    # Central differences suffice, since the fit's detail is not finer than a pixel.
    along = [-holdout.coded(np.gradient(weighted, axis=axis).astype(np.float32)) for axis in (2, 1)]
    design = np.stack([in_blocks(part * asked) for part in along], axis=-1)
    pixels = in_blocks(asked.astype(np.float32)).sum(axis=(2, 3))
    power = (residual**2).sum(axis=(2, 3))
    testable = (pixels >= LEAST_PIXELS) & (power > 0)
    moment = np.einsum("abpci,abpc->abi", design, residual)
    gram = ridged(np.einsum("abpci,abpcj->abij", design, design))
    velocity = np.linalg.solve(gram, moment[..., None])[..., 0]
    if not testable.any():
        return LeftByMotion(0.0, 0.0)
    left = residual - np.einsum("abpci,abi->abpc", design, velocity)
    freedom = np.maximum(pixels - 2, 1)
    scores = np.einsum("abpci,abpc->abpi", design, left)
    spread = np.einsum("abpi,abpj->abij", scores, scores) * (pixels / freedom)[..., None, None]
    by_chance = np.trace(np.linalg.solve(gram, spread), axis1=2, axis2=3)
    gained = (velocity * moment).sum(axis=-1)
    ratio = (moment * np.linalg.solve(ridged(spread), moment[..., None])[..., 0]).sum(axis=-1) / 2
    sure = testable & (fdtrc(2, freedom, np.where(testable, ratio, 0)) < CHANCE)
    explained = (gained - by_chance)[testable].sum() / power[testable].sum()
    return LeftByMotion(max(float(explained), 0.0), float(sure.sum() / testable.sum()))
