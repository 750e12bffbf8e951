"""How sure a finished run is: its results, as `estimate` asks for them.

Here: which parts of a run are asked. Not here: any standard error (`estimate`).
"""

from dataclasses import replace

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import camera_centres
from gs2ci.core.uncertainty import Uncertainty
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.fit.combining.ensemble import Ensemble
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fusion import Recovered
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.path.halves import squared_distance, squared_turn
from gs2ci.reconstruct.uncertainty.estimate import ExposureFound, PathKnown, standard_errors
from gs2ci.reconstruct.uncertainty.views import ViewsMade
from gs2ci.render.stopping import StoppedLight


def how_sure(
    look: FirstLook,
    geometry: Geometry,
    ensemble: Ensemble,
    recovered: Recovered,
    renderer: ShotRenderer,
    light: StoppedLight,
    others: F64 | None = None,
    places: F64 | None = None,
) -> Uncertainty:
    """Return the standard errors of a run's results.

    Args:
        look: The measurement with its held-out pixels, the decode and the brightness that are recorded.
        geometry: In the unit of the result, as the fits.
        ensemble: The fits.
        recovered: The views to be delivered.
        renderer: Of the exposure.
        light: Where the light of its pixels is stopped.
        others: Given poses of cameras of other exposures that share the scene, [K, 4, 4].
        places: Of the cameras of all these exposures, [K, 3].
    """
    best = ensemble.best
    delivered = recovered.views if recovered.exposed is None else recovered.exposed
    views = ViewsMade(delivered, ensemble.views, ensemble.disagreement)
    exposed = ExposureFound(look.holdout, renderer, views, best.world_to_camera, light)
    moving = any(fit.scene.motion is not None for fit in (best, *ensemble.others))
    path = None if moving else _path(geometry, ensemble, others, places)
    found = standard_errors(exposed, path)
    return replace(found, views=look.brightness.shown(found.views[..., None])[..., 0])


def _path(geometry: Geometry, ensemble: Ensemble, others: F64 | None, places: F64 | None) -> PathKnown | None:
    """Return what is known of the path; None if there is none, or the camera is known to have been at rest."""
    if not geometry.has_path or geometry.known_at_rest:
        return None
    errors, unit, poses = geometry.pose_errors, geometry.unit or 1.0, ensemble.best.world_to_camera
    given = None if errors is None else (errors.position * unit, errors.rotation)
    # Paths that nothing gave err together by more than information that adds up says.
    others = None if given is None else others
    if errors is not None:
        return PathKnown(geometry.reference, errors.turn, given, others, geometry.followed, places)
    # Fits have left the path of the tracks, and differ by about as much as each errs; one tells by how far it left.
    found = [fit.world_to_camera for fit in ensemble.others]
    turns, spread = [squared_turn(geometry.world_to_camera, poses)], 0.0
    if found:
        turns.append(float(np.mean([squared_turn(one, poses) for one in found])))
        apart = [squared_distance(camera_centres(one), camera_centres(poses)) for one in found]
        spread = float(np.sqrt(np.mean(apart)))
    return PathKnown(geometry.reference, max(turns) ** 0.5, given, others, geometry.followed, places, spread)
