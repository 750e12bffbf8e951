"""The standard errors of one exposure's views, depths and poses, put together.

Here: what is asked of which part. Not here: the parts (`views`, `information`, `poses`, `depths`), the record
(`gs2ci.core.uncertainty`), files (`gs2ci.evaluate`). Several exposures of one scene are asked one by one.
"""

from dataclasses import dataclass, replace

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.uncertainty import Uncertainty
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fit.surfaces.surfaces import pixel_rays
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.noise import noise_of_readings
from gs2ci.reconstruct.uncertainty.depths import error_of_places, errors_of_depths
from gs2ci.reconstruct.uncertainty.factors import factors
from gs2ci.reconstruct.uncertainty.information import ReadingsSeen, flows_between, information, middle_depth
from gs2ci.reconstruct.uncertainty.poses import errors_of_poses, unseen_turn
from gs2ci.reconstruct.uncertainty.views import ViewsMade, errors_alike, errors_of_views
from gs2ci.render.stopping import StoppedLight


@dataclass(frozen=True, eq=False)
class ExposureFound:
    """What was found of one exposure.

    Args:
        holdout: The measurement, and its held-out pixels.
        renderer: Of this exposure.
        views: Its views.
        world_to_camera: Its poses, [N, 4, 4].
        light: Where the light of its pixels is stopped.
    """

    holdout: Holdout
    renderer: ShotRenderer
    views: ViewsMade
    world_to_camera: F64
    light: StoppedLight


@dataclass(frozen=True)
class PathKnown:
    """What is known of the path of an exposure.

    Args:
        reference: The view whose pose is held.
        turn: By which the paths that were found of it differ, or that is stated of given poses, rad.
        given: Standard errors of given poses that nothing contradicts: position, in the unit of the path, and rotation,
            rad; None if a reconstruction found the path.
        others: Given poses of cameras of other exposures that share the scene, [K, 4, 4].
        followed: Slopes of tracked points in each view, [P, N, 2], NaN where one is not seen; None without tracks.
        places: Of the cameras of all exposures that share the scene, [K, 3]; None if there are no others.
        spread: By how much the places of cameras differ in several fits, in the unit of the path.
    """

    reference: int
    turn: float
    given: tuple[float, float] | None
    others: F64 | None = None
    followed: F64 | None = None
    places: F64 | None = None
    spread: float = 0.0


def standard_errors(of: ExposureFound, path: PathKnown | None) -> Uncertainty:
    """Return the standard errors of an exposure's views, depths and poses.

    Args:
        of: The exposure.
        path: What is known of its path; None if there is none, or if things move: then only of the views.
    """
    seen = ReadingsSeen(
        views=of.views.delivered,
        depth=of.light.surface().numpy(),
        spread=of.light.spread.numpy(),
        rays=pixel_rays(of.renderer),
        world_to_camera=of.world_to_camera,
        focal_px=of.renderer.intrinsics.double().numpy().diagonal()[:2],
        transmissions=of.holdout.shot.transmissions,
        noise=noise_of_readings(of.holdout, of.views.scene),
    )
    views = errors_of_views(of.holdout, of.views, errors_alike(flows_between(seen)), seen.noise)
    if path is None:
        return Uncertainty(views)
    given = path.given is not None
    if given:  # so that the readings do not seem to make given poses surer than they do
        seen = replace(seen, noise=seen.noise * np.float32(factors.position**2))
    covariance = information(seen, path.reference, path.given)
    turn = unseen_turn(seen.rays, seen.focal_px, None if path.given is None else path.given[1])
    places = of.world_to_camera, middle_depth(seen), (turn, path.turn)
    positions, rotations = errors_of_poses(covariance, *places, spread=path.spread, given=given, everywhere=path.places)
    place_px = error_of_places(seen, path.reference, path.followed)
    turn, shifted = (turn, path.turn) if given else (max(turn, path.turn), 0.0)
    depths = errors_of_depths(seen, place_px, turn, path.others, shifted)
    return Uncertainty(views, depths, positions, rotations)
