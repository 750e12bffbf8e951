"""All that is known before the race: the measurement as it is, its first look, and what its fits share.

    registration ─► hold out some pixels ─► first look (decode, geometry, brightness) (─► views that hardly join: longer
    decode, geometry) (─► order of depth) ─► moments within masks

Here: the order of these. Not here: any of them.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gs2ci.core.findings import Findings
from gs2ci.core.halt import Halt
from gs2ci.core.progress import Progress, said
from gs2ci.core.records import Shot
from gs2ci.reconstruct.first_look import FirstLook, look, look_closer
from gs2ci.reconstruct.fit.coarse.looks import Score
from gs2ci.reconstruct.fit.combining.refinement import Refinement
from gs2ci.reconstruct.fit.extensions import LastStage
from gs2ci.reconstruct.fit.scene.mask_moments import MaskMoments, needed
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.geometry.prior import GeometryPrior
from gs2ci.reconstruct.hypotheses.fitting import Fits
from gs2ci.reconstruct.hypotheses.hypothesis import OrderFound
from gs2ci.reconstruct.measurement.brightness import Brightness
from gs2ci.reconstruct.measurement.doubts import doubt_about_lamps, doubts_about
from gs2ci.reconstruct.measurement.faulty import close_faulty_pixels, fill_holes
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.lens import Lens, straightened
from gs2ci.reconstruct.registration.register import Registered, register
from gs2ci.reconstruct.settings import Settings
from gs2ci.reconstruct.stopwatch import Stopwatch
from gs2ci.render.backend import load_backend
from gs2ci.render.interface import Backend


@dataclass(frozen=True)
class Tools:
    """The parts that the settings name, loaded first, so that a wrong name is refused before any work is done."""

    backend: Backend
    fine: LastStage | None
    geometry_prior: GeometryPrior

    @classmethod
    def load(cls, settings: Settings) -> "Tools":
        """Load them.

        Raises:
            InputError: There is none of a name.
        """
        backend = load_backend(settings.backend, settings.raster)
        fine = None if settings.fine is None else settings.fine.load(settings.fit.loss, settings.seed)
        return cls(backend, fine, load_geometry_prior(settings.poses))


@dataclass(frozen=True)
class Observed:
    """What is known before anything is fitted.

    Args:
        registered: The measurement with corrected masks.
        doubts: About the measurement.
        first: Its decoded views, path, depth and brightness.
        order: What is known of the order of depth.
        fits: What all fits share.
    """

    registered: Registered
    doubts: Findings
    first: FirstLook
    order: OrderFound
    fits: Fits


@dataclass(frozen=True)
class KeptObservation:
    """What an observation has found, without what was given to it.

    Args:
        registered: As of `Observed`; likewise doubts, first and order.
        doubts: Likewise.
        first: Likewise.
        order: Likewise.
        mask_moments: The moments within each mask; None if one is enough.
        seconds: Of its stages.
    """

    registered: Registered
    doubts: Findings
    first: FirstLook
    order: OrderFound
    mask_moments: MaskMoments | None
    seconds: dict[str, float]

    @classmethod
    def of(cls, observed: Observed) -> Self:
        """Return what was found."""
        fits, first = observed.fits, observed.first
        found = (observed.registered, observed.doubts, first, observed.order)
        return cls(*found, fits.mask_moments, fits.clock.seconds())

    def observed(self, shot: Shot, settings: Settings, progress: Progress, score: Score | None) -> Observed:
        """Return the observation of a shot that found this; arguments as for `observe`, with which it was made."""
        settings = replace(settings, mask_moments=settings.mask_moments.of(shot))
        clock = Stopwatch.after(self.seconds)
        fits = _fits(self.first, Lens.of(shot), settings, progress, clock, score, Halt())
        fits = replace(fits, mask_moments=self.mask_moments)
        return Observed(self.registered, self.doubts, self.first, self.order, fits)


def observe(
    shot: Shot,
    settings: Settings,
    tools: Tools,
    progress: Progress,
    score: Score | None,
    halt: Halt,
    registered: Registered | None,
) -> Observed:
    """Observe a measurement; arguments and errors as for `pipeline.reconstruct`."""
    lens = Lens.of(shot.check())
    settings, clock = replace(settings, mask_moments=settings.mask_moments.of(shot)), Stopwatch()
    registered = registered or register(shot, settings.registration, progress, settings.seed)
    clock.lap("registration")
    # Dead lines and hot pixels are closed: their masks are set to zero.
    sound, faulty = close_faulty_pixels(registered.shot)
    doubts = said((*doubts_about(registered.shot), *doubt_about_lamps(sound), *faulty), progress)
    holdout = Holdout.of(sound, settings.fit.hold_out.share, settings.seed, registered.averaged)

    first = (look_closer if settings.may_look_again else look)(
        holdout, lens, tools.geometry_prior, settings, progress, clock.lap, registered.shot
    )
    fits = _fits(first, lens, settings, progress, clock, score, halt)
    first, order = fits.order_of(first)
    fits = replace(fits, mask_moments=_mask_moments(first, lens, settings, progress))
    return Observed(registered, doubts, first, order, fits)


def _fits(
    first: FirstLook,
    lens: Lens | None,
    settings: Settings,
    progress: Progress,
    clock: Stopwatch,
    score: Score | None,
    halt: Halt,
) -> Fits:
    """Return what all fits of a measurement share, but for the moments within its masks."""
    return Fits(
        holdout=first.holdout,
        fitted=Holdout(fill_holes(first.holdout.shot, first.decoded), first.holdout.pixels),
        lens=lens,
        settings=settings,
        refine=Refinement(first.holdout, settings.residual),
        progress=progress,
        clock=clock,
        score=as_shown(score, first.brightness),
        halt=halt,
    )


def as_shown(score: Score | None, light: Brightness) -> Score | None:
    """Return a score that gives evenly lit views the brightness of the delivered ones before it judges them."""
    return None if score is None else lambda views: score(light.shown(views))


def _mask_moments(first: FirstLook, lens: Lens | None, settings: Settings, progress: Progress) -> MaskMoments | None:
    """Return the moments within each mask that the first path requires, and report them; None if one is enough."""
    views, open_share = straightened(first.decoded, lens), np.clip(first.weights_given, 0, 1)
    found = needed(first.geometry, views, open_share, settings.mask_moments)
    if found is not None:
        progress.say(found.note.sentence)
    return found
