"""A shot in the form that the proxies use: one coded plane for each set of pixels that share their masks.

Here: the split of a measurement by colour, and the pixels that do not count. Not here: any estimate.
"""

from dataclasses import dataclass

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import cfa_channels


@dataclass(frozen=True)
class CodedPlane:
    """Some channels of a measurement, with the transmissions under which they were measured.

    Args:
        transmissions: wᵢ Mᵢ, [N, H, W]; 0 at every pixel that does not measure these channels.
        measured: [H, W, C'].
        channels: Which channels of a view these are.
    """

    transmissions: F64
    measured: F64
    channels: slice


def coded_planes(shot: Shot) -> list[CodedPlane]:
    """Split a shot into planes in which every pixel has one set of transmissions.

    RGB and mono shots are one plane. Each colour of a mosaic is a measurement of its own, through masks that are also
    closed wherever the filter array passes another colour. Masks are closed at saturated pixels.

    Args:
        shot: A checked shot.
    """
    transmissions = shot.masks.astype(np.float64) * shot.weights.astype(np.float64)[:, None, None]
    if shot.saturated is not None:
        transmissions *= ~shot.saturated
    measured = shot.measurement.astype(np.float64)
    if shot.cfa is None:
        return [CodedPlane(transmissions, measured, slice(0, measured.shape[2]))]
    colours = cfa_channels(shot.cfa, shot.size).numpy()
    return [CodedPlane(transmissions * (colours == c), measured, slice(c, c + 1)) for c in range(3)]
