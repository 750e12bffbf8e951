"""The coarse stage: Gaussians and poses are fitted to the measurement together (paper, sections III-C and III-E).

A fit can be paused and continued: a race compares several before it lets any of them end (`hypotheses.race`).

Here: the loop, its bookkeeping, and the return to the last good state. Not here: what an iteration changes
(`state.py`), the settings (`settings.py`), the initial scene (`reconstruct.geometry`).
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from torch import Tensor

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import NumericsError
from gs2ci.core.findings import Code, Finding, Findings, finding
from gs2ci.core.progress import Progress
from gs2ci.core.run_figures import CurvePoint
from gs2ci.reconstruct.fit.coarse.exposure import FittedExposure
from gs2ci.reconstruct.fit.coarse.keeping import Keeper, KeptFit
from gs2ci.reconstruct.fit.coarse.looks import Looks, Monitoring
from gs2ci.reconstruct.fit.coarse.pace import Pace
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.state import FitState
from gs2ci.reconstruct.fit.coarse.stopping import Watch
from gs2ci.render.gaussians import Gaussians


@dataclass(frozen=True)
class CoarseFit:
    """The result of the coarse stage.

    Args:
        scene: The Gaussians.
        world_to_camera: Refined poses, [N, 4, 4].
        views: The scene as each mask saw it while it was displayed, [N, H, W, C] float32, not clamped.
        curve: The looks at the fit while it ran.
        stopped: Why it ended.
        notes: Other findings: each time that the fit diverged and was set back.
        intrinsics: The camera matrix of the fit, [3, 3].
        outside: Which Gaussians continue the scene beyond the borders of all views, [G] bool; None: none.
        beside: Whether its views only count in the mean with others, because its path or order of depth is another.
    """

    scene: Gaussians
    world_to_camera: F64
    views: F32
    curve: tuple[CurvePoint, ...]
    stopped: Finding
    notes: Findings
    intrinsics: F64
    outside: Tensor | None = None
    beside: bool = False


# Each rollback halves the step. A fit that still diverges with an eighth of the step does not do so because of its
# length.
MAX_ROLLBACKS = 3
# A step has exploded, even if all numbers are finite, if its loss is so many times the smallest one since the density
# rule was last applied and at least this share of the first: the scene has left the frame, or colours are far out of
# range. (The density rule may raise the loss as much; a sound step never does.)
EXPLODED = 3.0
EXPLODED_SHARE_OF_FIRST = 0.3


class CoarseRun:
    """A fit of Gaussians and poses to the measurement that can be paused after any share of its schedule.

    Its iterations step, densify, look and stop, and return to the best state when the fit diverges.

    Args:
        exposures: One or more; several are fitted by one scene.
        start: Initial Gaussians.
        settings: The schedule.
        seed: For the density rule's draws.
        monitoring: What is called at looks and iterations, and what may interrupt.
        pace: Decides how many iterations there are, instead of the settings.
        outside: Which initial Gaussians lie beyond the borders of all views, in a fit that another has begun, [G] bool.
        keeper: Keeps the fit of several exposures, and may have kept it before: then this one goes on from there.

    Attributes:
        iterations: How many are done.

    Raises:
        InputError: The settings make no sense.
    """

    def __init__(
        self,
        exposures: Sequence[FittedExposure],
        start: Gaussians,
        settings: CoarseSettings,
        seed: int,
        monitoring: Monitoring,
        pace: Pace | None = None,
        outside: Tensor | None = None,
        keeper: Keeper | None = None,
    ) -> None:
        settings.check()
        self.iterations = 0
        self._fit = FitState(exposures, start, settings, seed, outside)
        self._settings = settings
        self._looks = Looks(monitoring.since_s)
        self._progress, self._halt = monitoring.progress, monitoring.halt
        self._pace = pace or Pace(settings.iterations)
        self._judged = any(one.holdout.pixels.any() for one in exposures)
        self._results: dict[int, CoarseFit] = {}
        self._end: CoarseFit | None = None
        self._stopped: Finding | None = None
        self._best = self._fit.snapshot(0)
        self._notes: list[Finding] = []
        self._watch = Watch(settings.hold_out)
        self._damping = 1.0
        self._rollbacks = 0
        self._first_loss: float | None = None
        self._least_loss = float("inf")
        self._keeper = keeper
        kept = None if keeper is None else keeper.kept()
        if keeper is not None and kept is not None:
            self._resume(kept, keeper)

    @property
    def curve(self) -> tuple[CurvePoint, ...]:
        """Get the looks so far."""
        return tuple(self._looks.curve)

    @property
    def has_ended(self) -> bool:
        """Get whether there is nothing to continue."""
        return self._stopped is not None

    def advance(self, share: float = 1.0, progress: Progress | None = None) -> None:
        """Go on until this share of the schedule is done, or until the fit ends, and note why it ended.

        Args:
            share: From 0 to 1.
            progress: Receives the iterations from now on; None: whatever did so far.

        Raises:
            NumericsError: The very first iteration is not finite.
            ResourceError: The population exceeds the memory guard.
        """
        if self.has_ended:
            return
        self._progress = progress or self._progress
        total = self._pace.total(self.iterations)
        # Also if it goes on: another stage may have reported since.
        self._progress.stage("fit", total)
        while self._stopped is None and self.iterations < min(total, math.ceil(share * total)):
            before, total = total, self._iterate(total)
            if total != before:
                self._progress.expect(total)
        if self._stopped is None and self.iterations >= total:
            self._stopped = self._all_done()
        # What was asked to end early is no result for whoever gives the same command again.
        if not self._halt.asked:
            self._keep()

    def views(self) -> F32:
        """Render the scene as each mask of the first exposure sees it now, [N, H, W, C] float32.

        A fit that its last step has spoilt goes back to its best state.
        """
        if not self._fit.optimiser.scene_is_finite():
            self._fit.restore(self._best)
        return self._fit.views()

    @property
    def scene(self) -> Gaussians:
        """Get the Gaussians as they are now, on the host."""
        return self._fit.scene.map(Tensor.cpu)

    def result(self, exposure: int = 0) -> CoarseFit:
        """Return the state with the smallest held-out residual as an exposure sees it; a paused fit ends here.

        All exposures share one scene; each has its own poses and views, which are rendered by this call.
        """
        fit = self._ended()
        if exposure not in self._results:
            one = self._fit.exposures[exposure]
            own = (one.path(), one.views(self._fit.scene))
            found = replace(fit, world_to_camera=own[0], views=own[1], intrinsics=one.exposure.geometry.intrinsics)
            if len(self._fit.exposures) > 1:
                return found
            self._results[exposure] = found
        return self._results[exposure]

    def paths(self) -> tuple[F64, ...]:
        """Return the poses of each exposure in that state, [N, 4, 4]; a paused fit ends here."""
        self._ended()
        return tuple(one.path() for one in self._fit.exposures)

    def _ended(self) -> CoarseFit:
        """Return that state without poses and views; all exposures have gone back to it."""
        if self._end is None:
            best, code = self._best, Code.FIT_INTERRUPTED if self._halt.asked else Code.FIT_BEHIND
            self._stopped = self._stopped or finding(code, iterations=self.iterations, best=best.iteration)
            # Views are still rendered; surfaces, which are as large as they, are not needed any more.
            self._best = replace(best, surfaces=(None,) * len(best.surfaces))
            self._fit.restore(self._best)
            self._end = CoarseFit(
                scene=best.scene.map(Tensor.cpu),
                world_to_camera=np.empty((0, 4, 4)),
                views=np.empty((0, 0, 0, 0), np.float32),
                curve=self.curve,
                stopped=self._stopped,
                notes=tuple(self._notes),
                intrinsics=np.eye(3),
                outside=best.outside,
            )
        return self._end

    def _keep(self) -> None:
        """Keep the fit as it is between two iterations."""
        if self._keeper is None:
            return
        kept = KeptFit(
            self._fit.state(),
            self._fit.kept(self._best),
            self.iterations,
            self._stopped,
            tuple(self._notes),
            tuple(self._looks.curve),
            self._watch.state(),
            self._damping,
            self._rollbacks,
            self._first_loss,
            self._least_loss,
        )
        self._keeper.keep(kept)

    def _resume(self, kept: KeptFit, keeper: Keeper) -> None:
        self._fit.resume(kept.state, keeper)
        self._best = self._fit.again(kept.best, keeper)
        self.iterations, self._stopped, self._notes = kept.iteration, kept.stopped, list(kept.notes)
        self._looks.curve[:] = kept.curve
        self._watch.resume(kept.watch)
        self._damping, self._rollbacks = kept.damping, kept.rollbacks
        self._first_loss, self._least_loss = kept.first_loss, kept.least_loss

    def _iterate(self, total: int) -> int:
        """Make one iteration, or return to the best state if it must not be used; return the schedule's length."""
        iteration = self.iterations
        # A search in many exposures takes long; each of them is kept as soon as it is done, for the state before it.
        if self._keeper is not None and (self._fit.search_is_due(iteration / total) or self._keeper.is_due()):
            self._keep()
        self._fit.split_masks(iteration / total)
        if self._fit.find_surfaces(iteration / total, self._keeper, (iteration, self._rollbacks)):
            # Only states from here on may become the result, since their light is drawn to the surfaces: an earlier
            # one may predict the held-out pixels as well, but its depth is worse.
            self._watch.begin_again(iteration)
            # A margin beyond the borders may be new, and raise the loss as newcomers of the density rule do.
            self._least_loss = float("inf")
        loss = self._fit.backward(iteration / total, iteration)
        ran_away = self._how_it_ran_away(iteration, loss)
        if ran_away is not None:
            if not self._roll_back(iteration, ran_away):
                self._stopped = finding(Code.FIT_DIVERGED, times=MAX_ROLLBACKS, best=self._best.iteration)
            return total
        self._step(iteration, total)
        self.iterations = iteration = iteration + 1
        total = self._pace.total(iteration)
        halted = self._halt.asked
        looks = iteration % self._settings.hold_out.look_every == 0 or iteration >= total or halted
        if looks:
            self._look(iteration, loss)
        self._progress.step(iteration, loss=loss, **self._figures())
        if halted:
            self._stopped = finding(Code.FIT_INTERRUPTED, iterations=iteration, best=self._watch.best_iteration)
        elif looks and self._stalled(iteration):
            self._stopped = finding(Code.FIT_STALLED, best=self._watch.best_iteration)
        return total

    def _all_done(self) -> Finding:
        late = self._pace.is_late(self.iterations)
        if not self._judged:
            return finding(
                Code.FIT_TIME_UP_UNJUDGED if late else Code.FIT_ALL_DONE_UNJUDGED, iterations=self.iterations
            )
        code = Code.FIT_TIME_UP if late else Code.FIT_ALL_DONE
        return finding(code, iterations=self.iterations, best=self._watch.best_iteration)

    def _stalled(self, iteration: int) -> bool:
        """Tell whether the residual has not improved for long, or has risen clearly, and nothing to come helps."""
        if self._fit.awaits_moments:
            return False
        return self._watch.has_risen(iteration) or (self._watch.stalled(iteration) and not self._fit.awaits_surfaces)

    def _step(self, iteration: int, total: int) -> None:
        share = iteration / total
        self._fit.step(share, self._damping)
        begin, end, bound = self._settings.densify_from, self._settings.densify_until, self._settings.cap_from
        if bound is not None and share >= bound:
            self._fit.bound_population()
        turn = begin <= share < end and iteration % self._settings.densify_every == 0
        if turn and self._watch.may_grow(iteration):
            self._least_loss = float("inf")
            if self._fit.densify(iteration):
                self._watch.set_back(iteration)

    def _look(self, iteration: int, loss: float) -> None:
        """Judge the views as they would be delivered now, and keep the state if it is the best so far.

        A state that its last step has spoilt has no views; the next iteration goes back from it.
        """
        if not self._fit.optimiser.scene_is_finite():
            return
        began_s = time.monotonic()
        heldout = self._looks.take(self._fit.seen(), iteration, loss, len(self._fit.scene))
        # What explodes just before the population changes, or surfaces are found, is seen by the earlier looks alone.
        least = min(point.loss for point in self._looks.curve if point.loss is not None)
        if self._watch.note(heldout, iteration, sound=not self._has_exploded(loss, least)):
            self._best = self._fit.snapshot(iteration)
        self._pace.looked(time.monotonic() - began_s)

    def _figures(self) -> dict[str, float | int]:
        """Return the figures of the last look, for the display."""
        curve = self._looks.curve
        found = {"heldout": curve[-1].heldout, "psnr_db": curve[-1].psnr_db} if curve else {}
        known = {name: figure for name, figure in found.items() if figure is not None}
        return {**known, "gaussians": len(self._fit.scene)}

    def _how_it_ran_away(self, iteration: int, loss: float) -> Finding | None:
        """Return why the present iteration must not be used; None if it may."""
        best = self._best.iteration
        if not self._fit.is_finite(loss):
            return finding(Code.ROLLED_BACK_NOT_FINITE, iteration=iteration, best=best)
        if self._first_loss is None:
            self._first_loss = loss
        least = self._least_loss
        if self._has_exploded(loss, least):
            return finding(Code.ROLLED_BACK_EXPLODED, iteration=iteration, best=best, least_loss=least, loss=loss)
        self._least_loss = min(self._least_loss, loss)
        return None

    def _has_exploded(self, loss: float, least: float) -> bool:
        return loss > EXPLODED * least and loss > EXPLODED_SHARE_OF_FIRST * (self._first_loss or 0.0)

    def _roll_back(self, iteration: int, ran_away: Finding) -> bool:
        if iteration == 0:
            raise NumericsError(
                "the first iteration of the fit is not finite",
                allowed="finite measurement, masks, poses and Gaussians",
                remedy="run `gs2ci import` on the measurement again and read its warnings",
            )
        if self._rollbacks == MAX_ROLLBACKS:
            return False
        self._rollbacks += 1
        self._damping *= 0.5
        self._fit.restore(self._best)
        self._least_loss = float("inf")
        self._notes.append(ran_away)
        self._progress.say(ran_away.sentence)
        return True
