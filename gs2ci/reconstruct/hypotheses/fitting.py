"""The fits of one reconstruction: what they share, and all that is done with them.

Here: `Fits`: where they start, a hypothesis entered as a fit that can be paused, several continued side by side, their
mean, fits within a budget, the fine stage. Not here: the order of these steps (`pipeline`), which hypotheses there are
and which go on (`race`), what a fit is (`fit/coarse/stage.py`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from gs2ci.core.arrays import F32
from gs2ci.core.findings import Finding
from gs2ci.core.halt import Halt
from gs2ci.core.progress import Progress, Silent, said
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.fit.coarse.exposure import FittedExposure
from gs2ci.reconstruct.fit.coarse.looks import Monitoring, Score
from gs2ci.reconstruct.fit.coarse.pace import Pace, Timed
from gs2ci.reconstruct.fit.coarse.stage import CoarseFit, CoarseRun
from gs2ci.reconstruct.fit.combining.ensemble import Ensemble, Member, advance_together, combined, members
from gs2ci.reconstruct.fit.combining.refinement import Refinement
from gs2ci.reconstruct.fit.extensions import LastStage
from gs2ci.reconstruct.fit.scene.mask_moments import MaskMoments
from gs2ci.reconstruct.fit.scene.motion import of_degree, set_moving
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fit.scene.start import first_gaussians
from gs2ci.reconstruct.fusion import polish_seconds
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.points import seed_points
from gs2ci.reconstruct.hypotheses.hypothesis import Hypothesis, OrderFound
from gs2ci.reconstruct.hypotheses.order import in_likelier_order, is_open
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.lens import Lens, straightened
from gs2ci.reconstruct.presets.budget import Budget
from gs2ci.reconstruct.settings import Settings
from gs2ci.reconstruct.stopwatch import Stopwatch
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians

# So many iterations, and one look at the held-out pixels, are timed to foresee what fits cost.
_TIMED_ITERATIONS: Final = 6


@dataclass(frozen=True, eq=False)
class Entrant:
    """A hypothesis in the race.

    Args:
        number: In the order of entering.
        of: The number of the hypothesis whose fit this is another member of; its own if there is none.
        hypothesis: What is tried.
        geometry: Path and depth at the start, in pixels of the sensor.
        run: Its fit, which can be paused.
        schedule: Iterations of a whole fit.
        began: Iterations that all fits had made when it entered.
    """

    number: int
    of: int
    hypothesis: Hypothesis
    geometry: Geometry
    run: CoarseRun
    schedule: int
    began: int = 0

    def heldout_at(self, iteration: int) -> float:
        """Return the held-out residual of the last look up to an iteration; infinite if there was none."""
        known = [
            point.heldout for point in self.run.curve if point.iteration <= iteration and point.heldout is not None
        ]
        return known[-1] if known and math.isfinite(known[-1]) else math.inf


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

    def order_of(self, first: FirstLook) -> tuple[FirstLook, OrderFound]:
        """Return a first look in the likelier order of depth if its order is open, and what is known of it.

        Given poses settle the sign themselves.
        """
        geometry = first.geometry
        if self.settings.withheld is not None or not is_open(geometry, self.settings.geometry.criteria):
            return first, OrderFound()
        likelier = in_likelier_order(geometry)
        return replace(first, geometry=likelier), OrderFound(likelier.order_errors)

    def timed(self, first: FirstLook) -> Timed:
        """Time a few iterations of a fit from a first look, and a look at the held-out pixels."""
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
        member = Member(start, fit.density, self.settings.seed)
        # Neither scored nor ended early.
        trial = replace(self, settings=replace(self.settings, fit=brief), score=None, halt=Halt())
        trial.run_of(geometry, member, Silent(), timed).advance()
        self.clock.lap("fit")
        return timed

    def within(self, budget: Budget | None, first: FirstLook) -> tuple["Fits", tuple[Finding, ...]]:
        """Return the same with the fits that a budget allows, and what it allows.

        A few iterations are timed, and a step of polishing.

        Without a budget nothing is changed.
        """
        if budget is None:
            return self, ()
        timed, polish = self.timed(first), self.settings.polish
        polish_s = 0.0 if polish is None else polish_seconds(self.holdout, first.decoded, polish)
        settings, pace, note = budget.fit(self.settings, timed, self.clock.seconds().get("decode", 0.0), polish_s)
        self.clock.lap("fit")
        return replace(self, settings=settings, pace=pace), said((note,), self.progress)

    def enter(self, hypothesis: Hypothesis, number: int = 0, of: int = 0, began: int = 0) -> Entrant:
        """Return a hypothesis as a fit that has not begun."""
        settings, seed = self.settings, self.settings.seed
        geometry, start = self.beginning(hypothesis.look, hypothesis.views, moving=hypothesis.moves)
        self.clock.lap("geometry")
        member = members(start, settings.density_rules, hypothesis.member + 1, seed)[hypothesis.member]
        member = replace(member, start=of_degree(member.start, hypothesis.member))
        pace = None if self.pace is None or not number else self.pace.beside()
        run = self.run_of(geometry, member, self.progress, pace or self.pace)
        return Entrant(number, of, hypothesis, geometry, run, settings.fit.iterations, began)

    def advance(self, entrants: Sequence[Entrant], share: float) -> tuple[Entrant, ...]:
        """Continue fits side by side; return those whose numbers are finite.

        Raises:
            NumericsError: The first one is not finite from its first iteration on.
        """
        runs = [one.run for one in entrants]
        sound = advance_together(runs, share, self.progress)
        self.clock.lap("fit")
        return tuple(one for one in entrants if one.run in sound)

    def mean(self, fits: tuple[CoarseFit, ...], stage: str = "fit") -> Ensemble:
        """Return the mean of fits, which ends a stage."""
        ensemble = combined(fits, self.holdout, self.refine)
        self.clock.lap(stage)
        return ensemble

    def fine(self, ensemble: Ensemble, renderer: ShotRenderer, fine: LastStage) -> Ensemble:
        """Take the best of several fits through the fine stage; return the mean of all."""
        fined = fine.fit(
            self.fitted,
            ensemble.best,
            renderer,
            self.settings.seed,
            self._monitoring(self.progress),
            self.refine.decode,
            self.score,
        )
        return self.mean((fined, *ensemble.others), "fine")

    def beginning(self, look: FirstLook, views: F32, *, moving: bool = False) -> tuple[Geometry, Gaussians]:
        """Return the poses and the Gaussians to start from, without what the settings withhold.

        Args:
            look: The first look.
            views: They give the Gaussians their colours, [N, H, W, C].
            moving: Whether the Gaussians start with the motion that the views show.
        """
        settings, lens = self.settings, self.lens
        geometry, views, withheld = look.geometry, straightened(views, lens), settings.withheld
        if withheld is None:
            seeds = seed_points(geometry, views, settings.stride_px)
        else:
            geometry = withheld.first_poses(geometry)
            seeds = withheld.first_points(geometry, views, settings.stride_px, settings.seed)
        start = first_gaussians(seeds)
        if moving:
            start = set_moving(start, geometry, views, settings.fit.motion)
        # From here on intrinsics are in pixels of the sensor, no longer of the canvas of straightened views.
        return (geometry if lens is None else replace(geometry, intrinsics=lens.intrinsics)), start

    def run_of(self, geometry: Geometry, member: Member, progress: Progress, pace: Pace | None = None) -> CoarseRun:
        """Return one fit of the ensemble that has not begun."""
        # Each fit needs a backend of its own: its buffers serve one fit at a time.
        backend = load_backend(self.settings.backend, self.settings.raster)
        one_picture = geometry.known_at_rest and member.start.motion is None
        renderer = ShotRenderer(
            self.fitted.shot, geometry.intrinsics, backend, self.lens, self.mask_moments, one_picture=one_picture
        )
        return CoarseRun(
            exposures=[FittedExposure(self.fitted, renderer, geometry, self.refine.decode, self.score)],
            start=member.start,
            settings=replace(self.settings.fit, density=member.density),
            seed=member.seed,
            monitoring=self._monitoring(progress),
            pace=pace,
            outside=member.outside,
        )

    def _monitoring(self, progress: Progress) -> Monitoring:
        return Monitoring(progress, self.clock.began_s, self.halt)
