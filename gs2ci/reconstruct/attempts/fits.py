"""The fits of one reconstruction: what they share, and all that is done with them.

Here: `Fits`: where they start, one fit, an attempt's fits and their mean, still fits continued with motion, fits that
settle the order of depth, fits within a budget, the fine stage. Not here: the order of these steps (`pipeline`), which
attempts are made and chosen (`choice.py`), what a fit is (`fit/coarse.py`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import NumericsError
from gs2ci.core.findings import Code, finding
from gs2ci.core.halt import Halt
from gs2ci.core.progress import Progress, Silent
from gs2ci.reconstruct.attempts.attempt import Attempt, How
from gs2ci.reconstruct.attempts.order import LEAST_SCHEDULE, is_open, may_be_reversed, settle, unsettled
from gs2ci.reconstruct.attempts.order_fits import OrderFits
from gs2ci.reconstruct.choices import LeftOut
from gs2ci.reconstruct.decode.residual import ResidualSettings
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.fit.coarse import CoarseFit, fit_coarse
from gs2ci.reconstruct.fit.coarse_settings import CoarseSettings
from gs2ci.reconstruct.fit.ensemble import Ensemble, FitOne, Member, combined, fit_together, member_seed, members
from gs2ci.reconstruct.fit.fine import Fine, fit_fine
from gs2ci.reconstruct.fit.looks import Monitoring, Score
from gs2ci.reconstruct.fit.mask_moments import MaskMoments
from gs2ci.reconstruct.fit.motion import at_rest_until_moved, of_degree, set_moving
from gs2ci.reconstruct.fit.pace import Pace, Timed
from gs2ci.reconstruct.fit.refinement import Refinement
from gs2ci.reconstruct.fit.rendering import ShotRenderer
from gs2ci.reconstruct.fit.start import first_gaussians
from gs2ci.reconstruct.fit.stopping import Rival
from gs2ci.reconstruct.fit.withheld import Withheld, first_points, first_poses
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.occlusion import Occlusion, occlusion
from gs2ci.reconstruct.geometry.sources import ESTIMATED
from gs2ci.reconstruct.handing_over import polish_seconds
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.lens import Lens, straightened
from gs2ci.reconstruct.moving import released
from gs2ci.reconstruct.presets.budget import Budget
from gs2ci.reconstruct.settings import Settings
from gs2ci.reconstruct.stopwatch import Stopwatch
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians

# So many iterations, and one look at the held-out pixels, are timed to choose the fits that a budget allows.
_TIMED_ITERATIONS: Final = 6


@dataclass(frozen=True)
class Fits:
    """What all fits of one reconstruction share.

    Args:
        holdout: The measurement, and its held-out pixels.
        fitted: The same with its holes filled, to which scenes are fitted.
        lens: Through which it was taken, unless it is a pinhole.
        settings: Of every stage.
        refine: Adds the decoded residual to the views of fits.
        progress: Receives every stage and step.
        clock: Of the stages.
        score: Of views, for the curve.
        halt: A request to end early, which stops the fits.
        mask_moments: The moments within masks; None if one moment for each mask is enough.
        pace: Ends the fits within a budget; None: they run for their settings' number of iterations.
    """

    holdout: Holdout
    fitted: Holdout
    lens: Lens | None
    settings: Settings
    refine: Refinement
    progress: Progress
    clock: Stopwatch
    score: Score | None = None
    halt: Halt = field(default_factory=Halt)
    mask_moments: MaskMoments | None = None
    pace: Pace | None = None

    def settle_order(self, first: FirstLook, *, hurried: bool) -> FirstLook:
        """Settle the order of depth by short fits if the first look leaves it open.

        If hurried, or if the settings say not to try both orders, the doubt is only reported. Poses given by a stage
        are not tested. Poses from a file settle the sign themselves, so no doubt is reported. Short fits never reverse
        a path that no tracks confirm; so they wait until it is known whether its scene is taken (`with_order`).
        """
        geometry = first.geometry
        if not self._is_order_open(geometry):
            return first
        if LeftOut.SHORT_FITS_OF_BOTH_ORDERS in self.settings.left_out:
            said = finding(Code.DEPTH_ORDER_OPEN, errors=abs(geometry.order_errors or 0.0))
            geometry = replace(geometry, notes=(*geometry.notes, said))
        elif self._tries_orders and not hurried:
            if not may_be_reversed(geometry):
                return first
            geometry = self._compared_orders(first)
        elif geometry.source in ESTIMATED:
            geometry = unsettled(geometry)
        self._say_beyond(first.geometry, geometry)
        return replace(first, geometry=geometry)

    def with_order(self, first: FirstLook, tried: Attempt) -> Attempt:
        """Return the attempt that is taken, with what short fits say of the order of depth if they were not made yet.

        Args:
            first: The first look. An attempt along a path that no tracks confirm is along that of the first look, or
                along one that was found in views of a scene along it.
            tried: The attempt.
        """
        geometry, began = tried.geometry, first.geometry
        if may_be_reversed(geometry) or not self.is_order_open(geometry):
            return tried
        told = unsettled(began) if self.halt.asked else self._compared_orders(first)
        self._say_beyond(began, told)
        notes = (*geometry.notes, *told.notes[len(began.notes) :])
        return replace(tried, geometry=replace(geometry, order_errors=told.order_errors, notes=notes))

    def is_order_open(self, geometry: Geometry) -> bool:
        """Tell whether both orders of depth may be tried, and what was tried so far leaves them open."""
        if not (self._tries_orders and self._is_order_open(geometry)):
            return False
        codes = {note.code for note in geometry.notes}
        if not may_be_reversed(geometry):
            return Code.DEPTH_ORDER_SHOWN not in codes
        return Code.DEPTH_ORDER_OPEN in codes

    def occlusion(self, tried: Attempt, views: F32) -> Occlusion:
        """Find what views, [N, H, W, C], show where surfaces of an attempt's leader hide one another."""
        fit, shot = tried.fits[0], self.fitted.shot
        backend = load_backend(self.settings.backend, self.settings.raster)
        renderer = ShotRenderer(shot, fit.intrinsics, backend, self.lens, self.mask_moments)
        depth = renderer.depths(fit.scene, fit.world_to_camera)
        distortion = None if self.lens is None else shot.distortion
        return occlusion(views, depth, fit.world_to_camera, fit.intrinsics, distortion)

    @property
    def _tries_orders(self) -> bool:
        return self.settings.try_orders and self.settings.fit.iterations >= LEAST_SCHEDULE

    def _is_order_open(self, geometry: Geometry) -> bool:
        return self.settings.withheld == Withheld() and is_open(geometry, self.settings.geometry.criteria)

    def _compared_orders(self, first: FirstLook) -> Geometry:
        """Return the geometry of a look in the order of depth that short fits prefer, with what they say of it."""

        def begin(began: Geometry) -> tuple[Geometry, Gaussians]:
            # Depths of further views belong to one order only.
            return self.beginning(replace(first, geometry=replace(began, view_depths=())), first.decoded)

        def fit_one(at: Geometry, how: CoarseSettings) -> FitOne:
            return replace(self._trying(how), mask_moments=None).fit_one(at)

        fits = OrderFits(self.fitted, self.settings, begin, fit_one)
        given = first.geometry.source not in ESTIMATED
        return settle(first.geometry, fits.brief, self.progress, given=given)

    def _say_beyond(self, before: Geometry, geometry: Geometry) -> None:
        """Report the notes that a geometry has beyond those that it had before, and end the fits' lap."""
        for note in geometry.notes:
            if note not in before.notes:
                self.progress.say(note.sentence)
        self.clock.lap("fit")

    def within(self, budget: Budget | None, first: FirstLook) -> "Fits":
        """Return the same with the fits that a budget allows: a few iterations are timed, and a step of polishing.

        Without a budget nothing is changed.
        """
        if budget is None:
            return self
        fit = self.settings.fit
        looking = fit.hold_out.looking(_TIMED_ITERATIONS)
        brief = replace(
            fit,
            iterations=_TIMED_ITERATIONS,
            densify_from=1.0,
            mask_moments_from=0.0,
            surfaces=None,
            hold_out=looking,
        )
        geometry, start = self.beginning(first, first.decoded)
        timed = Timed(_TIMED_ITERATIONS, 1.0 if self.mask_moments is None else self.mask_moments.per_mask)
        self._trying(brief).fit_one(geometry)(Member(start, fit.density, self.settings.seed), Silent(), timed)
        polish = self.settings.polish
        polish_s = 0.0 if polish is None else polish_seconds(self.holdout, first.decoded, polish)
        settings, pace, said = budget.fit(self.settings, timed, self.clock.seconds().get("decode", 0.0), polish_s)
        self.progress.say(said)
        self.clock.lap("fit")
        return replace(self, settings=settings, pace=pace)

    def attempt(self, look: FirstLook, views: F32, how: How) -> Attempt:
        """Fit from the geometry of a look; the first colours and motion come from views, [N, H, W, C]."""
        settings, moving = self.settings, how.moving
        geometry, start = self.beginning(look, views, moving=moving)
        self.clock.lap("geometry")
        team = members(start, settings.density_rules, settings.fits, settings.seed)
        team = tuple(replace(one, start=of_degree(one.start, number)) for number, one in enumerate(team))
        now, later = (team[:1], team[1:]) if how.alone else (team, ())
        fits = fit_together(self.fit_one(geometry, how.rival), now, self.progress, self.pace, self.halt)
        return Attempt(look, geometry, fits, self._mean(fits, "fit"), later)

    def completed(self, tried: Attempt, beside: Sequence[CoarseFit] = (), left: float | None = None) -> Attempt:
        """Make the fits of an attempt that have not been made yet.

        Args:
            tried: The attempt.
            beside: Fits of other attempts, the best first. Each is added to the attempt's, and replaces a companion,
                unless their mean has a larger held-out residual than the attempt's own views.
            left: The held-out residual of the mean of the attempt's fits after its refinement; None: not known yet.
        """
        if self.mask_moments is not None:
            # Views at the middle of the masks are rendered anew from all fits, with the camera matrix of the best.
            beside = tuple(fit for fit in beside if np.array_equal(fit.intrinsics, tried.geometry.intrinsics))
        if self.halt.asked or not (tried.later or beside):
            return tried
        if beside and left is None:
            left = self._left(tried.fits)
        while beside and left is not None and self._left((*tried.fits, *beside)) > left:
            beside = beside[:-1]
        later = tried.later[: max(0, len(tried.later) - len(beside))]
        fits = (*tried.fits, *beside, *(self._companions(tried.geometry, later) if later else ()))
        return replace(tried, fits=fits, ensemble=self._mean(fits, "fit"), later=())

    def _left(self, fits: Sequence[CoarseFit]) -> float:
        """Return the held-out residual of the mean of fits after its refinement."""
        together = fits[0].views.copy()
        for fit in fits[1:]:
            together += fit.views
        together /= np.float32(len(fits))
        return self.holdout.residual_rms(self.refine(together)) or 0.0

    def _companions(self, geometry: Geometry, team: tuple[Member, ...]) -> tuple[CoarseFit, ...]:
        """Fit members whose leader has ended; none if they diverge."""
        try:
            return fit_together(self.fit_one(geometry), team, self.progress, None, self.halt)
        except NumericsError as error:
            self.progress.say(f"One of the further fits failed and is left out: {error.problem}.")
            return ()

    def release(self, still: Attempt) -> Attempt:
        """Continue the fits of a still scene with motion allowed."""
        freed = replace(self, settings=replace(self.settings, fit=released(self.settings.fit)))
        team, paths = [], {}
        # Fits along another doubtful path may have another camera matrix than the attempt.
        intrinsics = still.geometry.intrinsics
        alike = [fit for fit in still.fits if not fit.beside and np.array_equal(fit.intrinsics, intrinsics)]
        for number, fit in enumerate(alike):
            start = of_degree(at_rest_until_moved(fit.scene, freed.settings.fit.motion), number)
            seed = member_seed(self.settings.seed, number)
            team.append(Member(start, freed.settings.fit.density, seed, fit.outside))
            paths[seed] = replace(still.geometry, world_to_camera=fit.world_to_camera)

        def fit_one(member: Member, progress: Progress, pace: Pace | None) -> CoarseFit:
            return freed.fit_one(paths[member.seed])(member, progress, pace)

        fits = fit_together(fit_one, tuple(team), self.progress, None, self.halt)
        return replace(still, fits=fits, ensemble=self._mean(fits, "fit"))

    def fine(self, tried: Attempt, renderer: ShotRenderer, fine: Fine) -> Ensemble:
        """Take the best of an attempt's fits through the fine stage."""
        best = tried.ensemble.best
        detailed = Refinement(self.holdout, self.settings.residual or ResidualSettings()).decode
        fined = fit_fine(
            self.fitted,
            best,
            renderer,
            fine,
            self.settings.seed,
            self._monitoring(self.progress),
            detailed,
        )
        return self._mean(tuple(fined if fit is best else fit for fit in tried.fits), "fine")

    def beginning(self, look: FirstLook, views: F32, *, moving: bool = False) -> tuple[Geometry, Gaussians]:
        """Return the poses and the Gaussians to start from, without what the settings withhold.

        Args:
            look: The first look.
            views: They give the Gaussians their colours, [N, H, W, C].
            moving: Whether the Gaussians start with the motion that the views show.
        """
        settings, lens = self.settings, self.lens
        geometry, views = first_poses(look.geometry, settings.withheld), straightened(views, lens)
        start = first_gaussians(first_points(geometry, views, settings.stride_px, settings.withheld, settings.seed))
        if moving:
            start = set_moving(start, geometry, views, settings.fit.motion)
        # From here on intrinsics are in pixels of the sensor, no longer of the canvas of straightened views.
        return (geometry if lens is None else replace(geometry, intrinsics=lens.intrinsics)), start

    def fit_one(self, geometry: Geometry, rival: Rival | None = None) -> FitOne:
        """Return the function that makes one fit of the ensemble; the fit stops if it falls far behind its rival."""

        def fit(member: Member, progress: Progress, pace: Pace | None) -> CoarseFit:
            # Each fit needs a backend of its own: its buffers serve one fit at a time.
            backend = load_backend(self.settings.backend, self.settings.raster)
            one_picture = geometry.known_at_rest and member.start.motion is None
            renderer = ShotRenderer(
                self.fitted.shot,
                geometry.intrinsics,
                backend,
                self.lens,
                self.mask_moments,
                one_picture=one_picture,
            )
            return fit_coarse(
                holdout=self.fitted,
                renderer=renderer,
                start=member.start,
                geometry=geometry,
                settings=replace(self.settings.fit, density=member.density),
                seed=member.seed,
                monitoring=self._monitoring(progress),
                pace=pace,
                rival=rival,
                outside=member.outside,
            )

        return fit

    def _monitoring(self, progress: Progress) -> Monitoring:
        return Monitoring(self.refine.decode, progress, self.score, self.clock.began_s, self.halt)

    def _trying(self, fit: CoarseSettings) -> "Fits":
        """Return the same for auxiliary fits: they are neither scored nor ended early."""
        return replace(self, settings=replace(self.settings, fit=fit), score=None, halt=Halt())

    def _mean(self, fits: tuple[CoarseFit, ...], stage: str) -> Ensemble:
        """Return the mean of fits, which ends a stage."""
        ensemble = combined(fits, self.holdout, self.refine)
        self.clock.lap(stage)
        return ensemble
