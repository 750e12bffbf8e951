"""Several exposures written as one coded measurement: the sum of their readings, coded by all their masks.

The sum of Y = Σ wᵢ Mᵢ ⊙ Xᵢ over exposures is of the same form, with the masks and views of all of them. So whatever
reads a measurement, its truth and its result reads those of several exposures, with the views of one after the other.

Here: the sum, and the frame of exposures of one stage. Not here: how the exposures are reconstructed together
(`gs2ci.reconstruct.exposures`).
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


def in_one_frame(shots: Sequence[Shot]) -> Sequence[Shot]:
    """Return exposures of one camera with the poses of their stage in the frame of the first that has any.

    A capture's poses begin anew, with the identity in the middle of its travel. `provenance["telemetry"]["origin"]`
    states where the stage had the camera then, in the axes of the camera and the unit of the poses, [3]. Poses of
    exposures of which one states none are taken to be in one frame.

    Raises:
        InputError: They are not of one camera, or state something else.
    """
    check_alike(shots)
    staged = [shot for shot in shots if shot.telemetry_world_to_camera is not None]
    origins = [_origin(shot) for shot in staged]
    known = [one for one in origins if one is not None]
    if not staged or len(known) < len(staged):
        return shots
    found = {id(shot): _moved(shot, one - known[0], known[0]) for shot, one in zip(staged, known, strict=True)}
    return [found.get(id(shot), shot) for shot in shots]


def _origin(shot: Shot) -> F64 | None:
    telemetry = shot.provenance.get("telemetry")
    stated = telemetry.get("origin") if isinstance(telemetry, dict) else None
    if stated is None:
        return None
    try:
        found = np.array(stated, np.float64)
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.shape != (3,) or not np.isfinite(found).all():
        raise InputError(
            f"{shot.name} states an origin of {stated!r} for its telemetry", allowed="three finite numbers, or none"
        )
    return found


def _moved(shot: Shot, by: F64, origin: F64) -> Shot:
    """Return an exposure whose stage's frame begins elsewhere: its cameras lie displaced in the new one."""
    poses = shot.telemetry_world_to_camera
    if poses is None or not by.any():
        return shot
    poses = poses.copy()
    poses[:, :3, 3] -= poses[:, :3, :3] @ by
    telemetry = {**shot.provenance["telemetry"], "origin": origin.tolist()}
    return replace(shot, telemetry_world_to_camera=poses, provenance={**shot.provenance, "telemetry": telemetry})


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
