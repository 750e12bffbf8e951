"""What is estimated before anything is fitted: decoded views, camera path and depth, and how bright each view was.

    decode ─► geometry ─► brightness of the views ─► (if the weights were wrong: all of it again)

Here: the order of these stages. Not here: the stages themselves; all settings
together (`settings`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.progress import Progress, said
from gs2ci.core.records import Shot
from gs2ci.reconstruct.choices import Decoder, FirstLookName
from gs2ci.reconstruct.decode.by_name import decode_by_name, last_sigma
from gs2ci.reconstruct.decode.patches.decoder import LEAST_GAIN, PatchSettings, decode_until_settled
from gs2ci.reconstruct.geometry.evidence import carried_views
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.kinds import PathSource, Verdict
from gs2ci.reconstruct.geometry.prior import GeometryPrior, Request, find_geometry
from gs2ci.reconstruct.measurement.brightness import Brightness, estimate, relit
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.lens import Lens, straightened
from gs2ci.reconstruct.paper_parts import PaperPart, paper_part
from gs2ci.reconstruct.settings import Settings


@dataclass(frozen=True)
class FirstLook:
    """The estimates.

    Args:
        holdout: The measurement with corrected weights, and its held-out pixels.
        decoded: Its views, [N, H, W, C].
        geometry: Its camera path and depth; with a lens, on the canvas of straightened views.
        brightness: The estimated brightness of the views and the corrections that follow.
        proxy_notes: Findings about the views from which the geometry was estimated.
        decoder: The name of the decoder.
        sigma: The noise level at which a decode by patches ended, full scale 1; None for another decoder.
        brief_rms: The held-out residual of the brief decode that a longer one began with; None if there is no longer
            one, or if no pixels are held out.
        noise: Power of the noise in each reading that a decode of repeats weighed, [H, W, C]; None: of one measurement.
    """

    holdout: Holdout
    decoded: F32
    geometry: Geometry
    brightness: Brightness
    proxy_notes: Findings = ()
    decoder: FirstLookName = "gap-tv"
    sigma: float | None = None
    brief_rms: float | None = None
    noise: F32 | None = None

    def decoded_longer(
        self, settings: PatchSettings, progress: Progress | None = None, *, hurried: bool = False
    ) -> "FirstLook":
        """Return the same estimates with views that a decode by patches reaches from the present ones.

        Views of the brief decode by patches enter the schedule at the noise level at which the brief decode began.

        Args:
            settings: Its whole schedule.
            progress: Receives each step.
            hurried: Whether it ends as soon as steps gain little.
        """
        rest = settings if self.sigma is None else settings.entered_at(PatchSettings.quick().first_sigma)
        settled = decode_until_settled(self.holdout, self.decoded, rest, progress, LEAST_GAIN if hurried else None)
        brief_rms = self.holdout.residual_rms(self.decoded) if self.brief_rms is None else self.brief_rms
        return replace(self, decoded=settled.views, decoder="patches", sigma=settled.sigma, brief_rms=brief_rms)

    def with_decode_of(self, other: "FirstLook") -> "FirstLook":
        """Return the same estimates with the decoded views of another look."""
        return replace(self, decoded=other.decoded, decoder=other.decoder, sigma=other.sigma, brief_rms=other.brief_rms)

    @property
    def is_decoded_at_length(self) -> bool:
        """Get whether the views are those of a whole decode by similar patches."""
        return Decoder(self.decoder) == Decoder.PATCHES

    @property
    def is_decoded_briefly(self) -> bool:
        """Get whether the views are those of a brief decode by similar patches."""
        return Decoder(self.decoder) == Decoder.PATCHES_QUICK

    @property
    def weights_given(self) -> F64:
        """Get the weights of the masks, [N], before the views' brightness corrected them."""
        factors = self.brightness.factors
        weights = self.holdout.shot.weights.astype(np.float64)
        return weights if factors is None else weights / factors

    @property
    def notes(self) -> Findings:
        """Get the findings about the proxies and the brightness."""
        factors = self.brightness.factors
        if factors is None:
            return self.proxy_notes
        code = Code.LIGHT_AS_SEEN if self.brightness.as_seen else Code.WEIGHTS_CORRECTED
        return (*self.proxy_notes, finding(code, least=float(factors.min()), most=float(factors.max())))


def look(
    holdout: Holdout,
    lens: Lens | None,
    prior: GeometryPrior,
    settings: Settings,
    progress: Progress,
    lap: Callable[[str], None],
    masks_of: Shot | None = None,
) -> FirstLook:
    """Decode a measurement and estimate its geometry; correct its weights as long as that explains more of it.

    Args:
        holdout: The measurement, and its held-out pixels.
        lens: Through which it was taken, unless it is a pinhole.
        prior: Where the geometry comes from.
        settings: Of all stages.
        progress: Receives every stage and step.
        lap: Called with a stage's name when it ends.
        masks_of: The measurement with its calibrated masks, before pixels were closed; None: the shot of `holdout`.

    Raises:
        Gs2ciError: A stage fails.
    """
    weights, first, corrected = holdout.shot.weights, None, False
    for rounds_left in range(settings.brightness.rounds, -1, -1):
        decoded = decode_by_name(holdout.seen, settings.first_look, settings.decode, progress)
        lap("decode")
        views, proxy_notes = decoded, ()
        if settings.proxy != "gap-tv":
            proxies = paper_part(PaperPart.GEOMETRY_VIEWS)
            views, proxy_notes = proxies(holdout.seen, settings.proxy, masks_of or holdout.shot)
        geometry = find_geometry(prior, Request.of(holdout.seen, views, settings.geometry, lens), progress)
        light = estimate(holdout, carried_views(straightened(decoded, lens), geometry, lens)) if rounds_left else None
        lap("geometry")
        first = first or light
        if light is None or not (light.gain > 0 if corrected else light.is_sure(settings.brightness)):
            break
        holdout, corrected = relit(holdout, light), True
    factors = _ratio(holdout.shot.weights, weights) if corrected else None
    brightness = Brightness(first, factors, settings.brightness.shows_as_seen(weights))
    sigma = last_sigma(settings.first_look)
    found = FirstLook(holdout, decoded, geometry, brightness, proxy_notes, settings.first_look, sigma)
    said(found.notes, progress)
    return found


def look_closer(
    holdout: Holdout,
    lens: Lens | None,
    prior: GeometryPrior,
    settings: Settings,
    progress: Progress,
    lap: Callable[[str], None],
    masks_of: Shot | None = None,
) -> FirstLook:
    """Look, and look again in views decoded by similar patches if those of GAP-TV show only a rotation.

    Arguments and errors as for `look`. The second look is returned if it finds a path, otherwise the first.
    """
    first = look(holdout, lens, prior, settings, progress, lap, masks_of)
    if not _may_look_closer(first, settings):
        return first
    progress.say("The camera seems only to have turned: its path is estimated again from a decode by similar patches.")
    closer = look(holdout, lens, prior, replace(settings, first_look="patches-quick"), progress, lap, masks_of)
    return closer if closer.geometry.has_path else first


def _may_look_closer(first: FirstLook, settings: Settings) -> bool:
    """Tell whether another decode may show a path: tracks in GAP-TV's views, which hide points, showed a rotation."""
    geometry = first.geometry
    by_tracks = geometry.source == PathSource.TRACKS and settings.proxy == "gap-tv"
    return by_tracks and Decoder(settings.first_look) == Decoder.GAP_TV and geometry.verdict == Verdict.ROTATION_ONLY


def _ratio(weights: F32, before: F32) -> F64:
    lit = before > 0
    return np.where(lit, weights.astype(np.float64) / np.where(lit, before, 1.0), 1.0)
