"""How bright each view really was, where the measurement tells that the weights are not those of its exposure.

A lamp on mains flickers between masks, one that warms up drifts, a trigger shortens an interval. The middle view,
carried along the path through its depth, shows what every view should look like. Coded, y = Σᵢ gᵢ wᵢ Mᵢ ⊙ Xᵢ is linear
in the views' brightness g: least squares over all pixels find it, and pixels held out of that tell whether to believe
it. Here: that. Not here: the carrying (`geometry.evidence`), its rounds (`first_look`), the word about uneven
brightness before anything is decoded (`doubts`). For `gs2ci.reconstruct`.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch

from gs2ci.core.errors import InputError
from gs2ci.core.records import F32, F64, Shot
from gs2ci.reconstruct.coding import Coding
from gs2ci.reconstruct.fit.ensemble import surely_larger
from gs2ci.reconstruct.fit.stopping import Jury

# Masks that are this nearly alike do not tell their views' brightness apart.
_CONDITION: Final = 1e8
# No lamp that anything can be seen by does more between two masks of an exposure.
_RANGE: Final = (0.1, 10.0)


@dataclass(frozen=True)
class BrightnessSettings:
    """How brightness is found.

    Args:
        rounds: At most so often; 0 takes the weights as they are. Better weights give better views to find it from.
        least_gain: Share by which the residual on the held-out pixels must fall for a round to count, beside being
            surely smaller. Where all weights were right it fell by up to 0.2 %, where they were 10 % off, by 3 to 5.
    """

    rounds: int = 3
    least_gain: float = 0.01

    def check(self) -> "BrightnessSettings":
        """Return self if the numbers make sense.

        Raises:
            InputError: Negative rounds, or a gain outside [0, 1].
        """
        if self.rounds < 0 or not 0 <= self.least_gain <= 1:
            raise InputError(
                f"{self.rounds} rounds for brightness, a least gain of {self.least_gain}",
                allowed="rounds >= 0 and a gain in [0, 1]",
            )
        return self


def relit(jury: Jury, carried: F32, least_gain: float) -> Jury | None:
    """Correct the weights by the brightness that the measurement shows, if pixels that were not asked agree.

    Args:
        jury: The measurement, and its held-out pixels.
        carried: What every view should look like, [N, H, W, C], all as bright as one of them.
        least_gain: See `BrightnessSettings`.

    Returns:
        The measurement with other weights, of the same mean over its masks' light; None where nothing is to be
        corrected, or nothing tells.
    """
    if not jury.heldout.any():  # nobody to agree
        return None
    brightness = view_brightness(jury.seen, carried)
    if brightness is None:
        return None
    weights = (jury.shot.weights * brightness).astype(np.float32)
    corrected = Jury(replace(jury.shot, weights=weights), jury.heldout)
    before, after = jury.squared_residuals(carried), corrected.squared_residuals(carried)
    gains = np.sqrt(after.mean()) < (1 - least_gain) * np.sqrt(before.mean())
    return corrected if gains and surely_larger(before, after) else None


def view_brightness(shot: Shot, views: F32) -> F64 | None:
    """Fit the brightness of each view to the measurement.

    Args:
        shot: The measurement as far as it may be seen; saturated pixels do not count.
        views: [N, H, W, C].

    Returns:
        Factors, [N], of mean 1 over the light that the masks let through; 1 for views that no light reached. None where
        the masks do not tell the views apart, or a factor is beyond what a lamp does.
    """
    lit = (shot.weights[:, None, None] * shot.masks).any(axis=(1, 2))
    if lit.sum() < 2:
        return None
    coding = Coding.of(shot)
    counted = np.ones(shot.size, bool) if shot.saturated is None else ~shot.saturated
    system = np.stack([_part(coding, views, int(i))[counted].ravel() for i in np.flatnonzero(lit)], axis=1)
    readings = shot.measurement[counted].astype(np.float64).ravel()
    normal = system.T @ system
    if not np.isfinite(normal).all() or np.linalg.cond(normal) > _CONDITION:
        return None
    found = np.linalg.solve(normal, system.T @ readings)
    light = shot.weights[lit] * shot.masks[lit].sum(axis=(1, 2), dtype=np.float64)
    mean = float((found * light).sum() / light.sum())
    if mean <= 0 or not _RANGE[0] * mean <= found.min() <= found.max() <= _RANGE[1] * mean:
        return None
    brightness = np.ones(shot.views)
    brightness[lit] = found / mean
    return brightness


def _part(coding: Coding, views: F32, view: int) -> F64:
    """Return what one view adds to the measurement, [H, W, C]."""
    alone = Coding(coding.transmissions[view : view + 1], coding.channels)
    part: F64 = alone.forward(torch.from_numpy(views[view : view + 1])).numpy().astype(np.float64)
    return part
