"""How sure a finished run is: its results, as `estimate` asks for them.

Here: which parts of a run are asked. Not here: any standard error (`estimate`).
"""

from dataclasses import replace

from gs2ci.core.cameras import path_extent
from gs2ci.core.uncertainty import Uncertainty
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.fit.combining.ensemble import Ensemble
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fusion import Recovered
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.uncertainty.estimate import ExposureFound, PathKnown, in_other_order, standard_errors
from gs2ci.reconstruct.uncertainty.views import ViewsMade
from gs2ci.render.stopping import StoppedLight


def how_sure(
    look: FirstLook,
    geometry: Geometry,
    ensemble: Ensemble,
    recovered: Recovered,
    renderer: ShotRenderer,
    light: StoppedLight,
) -> Uncertainty:
    """Return the standard errors of a run's results.

    Args:
        look: The measurement with its held-out pixels, the decode and the brightness that are recorded.
        geometry: In the unit of the result, as the fits.
        ensemble: The fits.
        recovered: The views to be delivered.
        renderer: Of the exposure.
        light: Where the light of its pixels is stopped.
    """
    best = ensemble.best
    delivered = recovered.views if recovered.exposed is None else recovered.exposed
    views = ViewsMade(delivered, ensemble.views, look.decoded, ensemble.disagreement)
    exposed = ExposureFound(look.holdout, renderer, views, best.world_to_camera, light)
    moving = any(fit.scene.motion is not None for fit in (best, *ensemble.others))
    path = None if moving else _path(geometry, ensemble)
    found = standard_errors(exposed, path)
    if path is not None:
        others = [(fit.scene, fit.world_to_camera) for fit in ensemble.others]
        depth = light.surface().numpy()
        found = replace(found, other_depth=in_other_order(depth, geometry.reference, renderer, others))
    return replace(found, views=look.brightness.shown(found.views[..., None])[..., 0])


def _path(geometry: Geometry, ensemble: Ensemble) -> PathKnown | None:
    """Return what is known of the path; None if there is none, or the camera is known to have been at rest."""
    if not geometry.has_path or geometry.known_at_rest:
        return None
    errors, unit, extent = geometry.pose_errors, geometry.unit or 1.0, path_extent(ensemble.best.world_to_camera)
    given = None if errors is None else (errors.position * unit, errors.rotation)
    return PathKnown(geometry.reference, geometry.path_error_expected, given, extent)
