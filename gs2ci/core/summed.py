"""Several exposures written as one coded measurement: the sum of their readings, coded by all their masks.

The sum of Y = Σ wᵢ Mᵢ ⊙ Xᵢ over exposures is of the same form, with the masks and views of all of them. So whatever
reads a measurement, its truth and its result reads those of several exposures, with the views of one after the other.

Here: the sum. Not here: how the exposures are reconstructed together (`gs2ci.reconstruct.exposures`).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot, Truth


def check_alike(shots: Sequence[Shot]) -> None:
    """Check that exposures come from one camera.

    Raises:
        InputError: There are none, or sizes, colours, camera matrices or distortions differ.
    """
    if not shots:
        raise InputError("no exposures to reconstruct together", allowed="one or more")
    first = shots[0]
    for shot in shots[1:]:
        for what, one, other in (
            ("size", first.size, shot.size),
            ("number of colour channels", first.channels, shot.channels),
            ("colour filter array", first.cfa, shot.cfa),
            ("camera matrix", _listed(first.intrinsics), _listed(shot.intrinsics)),
            ("distortion", _listed(first.distortion), _listed(shot.distortion)),
        ):
            if one != other:
                raise InputError(
                    f"{shot.name} has the {what} {other}, and {first.name} {one}",
                    allowed="exposures of one camera",
                    remedy="reconstruct those of each camera by themselves",
                )


def summed(shots: Sequence[Shot], name: str) -> Shot:
    """Return the sum of exposures of one camera; the truth, and a stage's poses, only if all have them.

    Args:
        shots: In the order in which their views follow one another.
        name: Of the sum.

    Raises:
        InputError: They are not of one camera.
    """
    check_alike(shots)
    if len(shots) == 1:
        return replace(shots[0], name=name)
    truths = [shot.truth for shot in shots]
    masks_of_saturated = [shot.saturated for shot in shots if shot.saturated is not None]
    return Shot(
        measurement=np.sum([shot.measurement for shot in shots], axis=0),
        masks=np.concatenate([shot.masks for shot in shots]),
        weights=np.concatenate([shot.weights for shot in shots]),
        cfa=shots[0].cfa,
        intrinsics=shots[0].intrinsics,
        distortion=shots[0].distortion,
        truth=Truth(
            views=_all([one.views for one in truths]),
            world_to_camera=_all([one.world_to_camera for one in truths]),
            depth=_all([one.depth for one in truths]),
        ),
        telemetry_world_to_camera=_all([shot.telemetry_world_to_camera for shot in shots]),
        saturated=np.any(masks_of_saturated, axis=0) if masks_of_saturated else None,
        name=name,
        provenance={"source": shots[0].provenance.get("source", ""), "exposures": [shot.name for shot in shots]},
    )


def _all(parts: "Sequence[np.ndarray | None]") -> "np.ndarray | None":
    known = [part for part in parts if part is not None]
    return np.concatenate(known) if len(known) == len(parts) else None


def _listed(matrix: F64 | None) -> object:
    return None if matrix is None else matrix.tolist()
