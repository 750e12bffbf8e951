"""The race: every hypothesis gets part of a fit, the better ones go on, and at most two still ones reach the end.

    first hypothesis ─┬─ the other density rule beside it
                      │    half of the schedule
                      ├─ path in doubt: proposers see the views so far; theirs run a quarter, the best two go on
                      │    all of the schedule
                      └─ residual like motion, or no better than a decode: moving ones, or matched features, likewise
                         ─► the jury: held-out pixels

This is successive halving (Jamieson and Talwalkar 2016): nothing that was fitted for a hypothesis that goes on is
fitted again. One rule holds for all: after a quarter of its schedule a fit that is far behind the leader's residual
after as many iterations is given up, and so is all but the best of those that entered with it. A fit that may not be
needed waits.

Here: the schedule. Not here: the hypotheses (a file each), the fits (`fitting`), who is taken (`jury`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from gs2ci.core.arrays import F32
from gs2ci.core.errors import NumericsError
from gs2ci.reconstruct.choices import LeftOut
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.fit.coarse.stage import CoarseFit
from gs2ci.reconstruct.fit.combining.ensemble import Ensemble
from gs2ci.reconstruct.geometry.depth.view_depths import turns_far
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.hypotheses.again import is_wanted, second_look
from gs2ci.reconstruct.hypotheses.fitting import Entrant, Fits
from gs2ci.reconstruct.hypotheses.hypothesis import (
    Hypothesis,
    OrderFound,
    Origin,
    RaceEvidence,
    RaceOutcome,
)
from gs2ci.reconstruct.hypotheses.jury import Jury, or_infinite
from gs2ci.reconstruct.hypotheses.matches import look_far_apart
from gs2ci.reconstruct.hypotheses.moving import (
    MOVING,
    STILL,
    MotionQuestion,
    MotionReport,
    clearly_less,
    rested,
)

QUARTER: Final = 0.25
"""After this share of the schedule the residual of a fit predicts its final one well enough: on the real fan that of
fits from rest was 1.38 times that of fits along a path, and 1.4 times in the end; on two others it was 0.99 times in
both, and 0.6 and 0.97 times in the end."""
HALF: Final = 0.5
"""The share after which proposers see the views of a leader whose path is in doubt."""
LEAST_SCHEDULE: Final = 150
"""If the whole fit has fewer iterations, its residual is not asked whether things move: it would look so anyway."""
BEHIND: Final = 1.2
"""A fit whose residual is so many times that of another after as many iterations will not catch up: before a quarter of
the schedule it had been up to 1.2 times on the two others named above."""


@dataclass(frozen=True)
class Raced:
    """The result of the race.

    Args:
        first: The first look, with the best decode so far.
        look: That of the leader.
        geometry: At the start of the leader's fit.
        fits: The leader's, and those that count in the mean.
        ensemble: Their mean.
        order: What is known of the order of depth.
        motion: Why the scene is still or moves.
        course: What became of each hypothesis, in the order of entering.
    """

    first: FirstLook
    look: FirstLook
    geometry: Geometry
    fits: tuple[CoarseFit, ...]
    ensemble: Ensemble
    order: OrderFound
    motion: MotionReport
    course: tuple[RaceEvidence, ...]


class Race:
    """Lets hypotheses compete for one measurement.

    Args:
        fits: Makes their fits.
    """

    def __init__(self, fits: Fits) -> None:
        self.fits = fits
        self._settings, self._jury = fits.settings, Jury(fits)
        self._entered: list[Entrant] = []
        self._outcomes: dict[int, RaceOutcome] = {}

    def run(self, first: FirstLook, order: OrderFound) -> Raced:
        """Let all hypotheses compete that the settings allow and that are worth their time."""
        field = self._begun(first, order)
        if field[0].hypothesis.moves:
            return self._delivered(first, self._to(1.0, field), order, MotionQuestion(), {})
        waiting = len(field) if not self._may_wait(field[0]) else 1
        field = (*self._to(1.0, field[:waiting]), *field[waiting:])
        first, field = self._matched(first, field)
        asked = MotionQuestion()
        if self._may_move:
            asked = self._jury.question(field[0].hypothesis.look, field[0].run.result().views)
            if asked.speaks_for_motion:
                # A moving scene has to be better than the mean of several.
                field = self._to(1.0, field)
        residuals: dict[str, float | None] = {}
        if self._wants_motion or (asked.speaks_for_motion and not self.fits.halt.asked):
            moving, residuals = self._moving(first, field)
            if moving:
                for entrant in field:
                    self._outcomes.setdefault(entrant.number, RaceOutcome.LESS)
                return self._delivered(self._decoded_better(first), moving, OrderFound(), asked, residuals)
            if or_infinite(residuals.get(MOVING)) < or_infinite(residuals[STILL]):
                # Things move in a way that no scene follows well; patches do.
                first = self._decoded_better(first)
        field = self._to(1.0, field)
        field = self._jury.taken(field)
        return self._delivered(first, field, field[0].hypothesis.order, asked, residuals)

    # Who enters.

    def _begun(self, first: FirstLook, order: OrderFound) -> tuple[Entrant, ...]:
        """Return those that may reach the end, after half of their schedule; the leader first."""
        # Moving scenes start from the views of a still one if that has a use beside it: to look again.
        moves = self._wants_motion and not self._settings.may_look_again
        origin = Origin.MOVING if moves else Origin.FIRST
        leader = self._enter(Hypothesis(origin, rested(first) if moves else first, first.decoded, order, moves))
        if not self._may_look_again(first.geometry):
            return self._to(HALF, (leader, *self._companions(leader)))
        self._to(HALF, [leader])
        if self.fits.halt.asked:
            return (leader,)
        views = self.fits.refine(leader.run.views())
        kept = self._kept(leader, [self._enter(one) for one in self._proposed(leader, views)])
        return self._to(HALF, (*kept, *self._companions(kept[0], len(kept) - 1)))

    def _proposed(self, leader: Entrant, views: F32) -> list[Hypothesis]:
        """Return what is proposed after a look at the views of a leader whose path is in doubt."""
        first, order = leader.hypothesis.look, leader.hypothesis.order
        again = second_look(first, views, self.fits.lens, self._settings, self.fits.progress)
        if again is None or self.fits.halt.asked:
            return []
        if first.geometry.lacks_path:
            settled, order = self.fits.order_of(replace(again, decoded=views))
            again = replace(again, geometry=settled.geometry)
        return [Hypothesis(Origin.AGAIN, again, views, order)]

    def _kept(self, leader: Entrant, entered: list[Entrant]) -> list[Entrant]:
        """Return those that are not far behind after a quarter of their schedule, at most two, the best first.

        A scene along a path that was not found at first must be clearly better than one without.
        """
        for entrant in entered:
            self._try(QUARTER, entrant)
        entered = [one for one in entered if one.number not in self._outcomes]
        if not entered:
            return [leader]
        iteration = min(one.run.iterations for one in entered)
        ranked = sorted([leader, *entered], key=lambda one: one.heldout_at(iteration))
        least, own = ranked[0].heldout_at(iteration), leader.heldout_at(iteration)
        if leader.geometry.lacks_path and not clearly_less(least, own):
            ranked = [leader, *(one for one in ranked if one.number != leader.number)]
        near = [one for one in ranked if one.heldout_at(iteration) <= BEHIND * least]
        self._leave([one for one in ranked if one not in near[:2]], RaceOutcome.BEHIND)
        return near[:2]

    def _companions(self, leader: Entrant, beside: int = 0) -> list[Entrant]:
        """Enter those that a leader's fit is averaged with, if so many others are beside it."""
        members = range(1, self._settings.fits - beside) if not self.fits.halt.asked else ()
        return [self._enter(leader.hypothesis.companion(number), leader.of) for number in members]

    def _enter(self, hypothesis: Hypothesis, of: int | None = None) -> Entrant:
        began, number = sum(one.run.iterations for one in self._entered), len(self._entered)
        self._entered.append(self.fits.enter(hypothesis, number, number if of is None else of, began))
        return self._entered[-1]

    # How far they go.

    def _to(self, share: float, field: Sequence[Entrant]) -> tuple[Entrant, ...]:
        """Continue fits side by side to a share of their schedules; return those that are sound."""
        if self.fits.halt.asked:
            begun = [one for one in field if one.run.iterations or one.number == 0]
            self._leave([one for one in field if one not in begun], RaceOutcome.NOT_NEEDED)
            field = begun
        going = [one for one in field if not one.run.has_ended]
        if not going:
            return tuple(field)
        sound = self.fits.advance(going, share)
        failed = [one for one in going if one not in sound]
        self._leave(failed, RaceOutcome.FAILED)
        return tuple(one for one in field if one not in failed)

    def _try(self, share: float, entrant: Entrant) -> None:
        """Continue a fit that need not succeed."""
        try:
            self._to(share, [entrant])
        except NumericsError as error:
            self.fits.progress.say(f"One of the further fits failed and is left out: {error.problem}.")
            self._leave([entrant], RaceOutcome.FAILED)

    def _leave(self, field: Sequence[Entrant], outcome: RaceOutcome) -> None:
        for entrant in field:
            self._outcomes.setdefault(entrant.number, outcome)

    def _may_wait(self, leader: Entrant) -> bool:
        """Tell whether fits beside the leader may turn out not to be needed: by motion, or by matched features."""
        may_match = self._settings.may_look_again
        return self._wants_motion or (
            may_match and self._jury.is_behind_decode(leader.hypothesis.look, leader.run.views())
        )

    # Features matched again.

    def _matched(self, first: FirstLook, field: tuple[Entrant, ...]) -> tuple[FirstLook, tuple[Entrant, ...]]:
        """Let a path from matched features compete, if the leader's turns far or its scene explains too little.

        Tracks through views far apart may agree on a path that is wrong. The fit's own views show that path again.

        Returns:
            The first look, with the longer decode if one was made and is better; and those that go on.
        """
        leader, geometry, settings = field[0], first.geometry, self._settings
        result = leader.run.result()
        left_out = LeftOut.MATCHES_IN_A_LONGER_DECODE in settings.left_out
        matched = left_out or geometry.is_matched
        may_match = settings.poses == "auto" and settings.may_look_again and geometry.is_estimated and not matched
        far = turns_far(result.world_to_camera) or self._jury.is_behind_decode(first, result.views)
        if self.fits.halt.asked or not (may_match and far):
            return first, field
        first = self._decoded_better(first)
        if not first.is_decoded_at_length or self.fits.halt.asked:
            return first, field
        fits, path = self.fits, result.world_to_camera
        found = look_far_apart(first, fits.lens, settings, fits.progress, fits.clock.lap, path)
        if found is None or fits.halt.asked:
            return first, field
        look, order = fits.order_of(found)
        entrant = self._enter(Hypothesis(Origin.MATCHES, look, look.decoded, order))
        kept = self._kept(leader, [entrant])
        if entrant.number in self._outcomes:
            return first, field
        self._leave(field[1:], RaceOutcome.NOT_NEEDED)
        return first, self._to(1.0, kept)

    # Things that move.

    @property
    def _wants_motion(self) -> bool:
        return self._settings.motion == "on"

    @property
    def _may_move(self) -> bool:
        # Fits on a short schedule leave much that looks like motion, whether or not anything moves.
        whole = self._settings.fit.iterations >= LEAST_SCHEDULE
        return self._settings.may_move and whole and not self.fits.halt.asked

    def _moving(
        self, first: FirstLook, field: tuple[Entrant, ...]
    ) -> tuple[tuple[Entrant, ...], dict[str, float | None]]:
        """Let a moving scene compete with still ones; return its fits if it is taken, and what each leaves.

        It is not taken unless it is clearly better than the still scene, or asked for.
        """
        if not self._wants_motion:
            self.fits.progress.say("The still scene's residual looks like motion: moving scenes are fitted as well.")
        ended = [one for one in field if one.run.has_ended]
        still = self._jury.mean_of(self._jury.counting(ended))
        residuals = {STILL: self.fits.holdout.residual_rms(self._jury.shown(still, first.decoded))}
        moving = self._enter(self._jury.moving_hypothesis(first, field[0], still))
        if not self._wants_motion and moving not in self._kept(field[0], [moving]):
            if self._outcomes[moving.number] == RaceOutcome.BEHIND:
                residuals[MOVING] = self._jury.left(moving, first.decoded)
            return (), residuals
        for share in (HALF, 1.0):
            self._try(share, moving)
            if moving.number in self._outcomes:
                return (), residuals
            residuals[MOVING] = self._jury.left(moving, first.decoded)
            if not self._wants_motion and not or_infinite(residuals[MOVING]) < or_infinite(residuals[STILL]):
                break
        else:
            if self._wants_motion or clearly_less(residuals[MOVING], residuals[STILL]):
                return self._to(1.0, [moving, *self._companions(moving, len(ended) - 1)]), residuals
        self._leave([moving], RaceOutcome.LESS)
        return (), residuals

    def _delivered(
        self,
        first: FirstLook,
        field: Sequence[Entrant],
        order: OrderFound,
        asked: MotionQuestion,
        residuals: dict[str, float | None],
    ) -> Raced:
        """Return the result of the hypothesis taken, the first of those that may count in the mean."""
        leader, *others = self._jury.counting(field)
        fits = (leader.run.result(), *(replace(one.run.result(), beside=one.of != leader.of) for one in others))
        ensemble = self.fits.mean(fits)
        self._outcomes[leader.number] = RaceOutcome.LED
        for one in others:
            self._outcomes[one.number] = RaceOutcome.AVERAGED if ensemble.averaged > 1 else RaceOutcome.LESS
        moves = ensemble.best.scene.motion is not None
        chosen = leader.hypothesis.origin.value if moves or leader.hypothesis.moves else STILL
        motion = MotionReport(self._settings.motion, asked, tuple(residuals.items()), chosen, moves=moves)
        geometry = leader.geometry
        if order.is_open:
            geometry = replace(geometry, order_errors=order.errors)
        return Raced(first, leader.hypothesis.look, geometry, fits, ensemble, order, motion, self._course())

    def _course(self) -> tuple[RaceEvidence, ...]:
        return tuple(
            RaceEvidence(
                one.hypothesis.origin,
                str(one.geometry.source),
                one.began,
                one.run.iterations,
                one.schedule,
                tuple((point.iteration, point.heldout) for point in one.run.curve if point.heldout is not None),
                self._jury.judged.get(one.number),
                self._outcomes.get(one.number, RaceOutcome.LESS),
            )
            for one in self._entered
        )

    def _may_look_again(self, geometry: Geometry) -> bool:
        may = self._settings.may_look_again and LeftOut.SECOND_LOOK not in self._settings.left_out
        return may and is_wanted(geometry, self._settings.geometry)

    def _decoded_better(self, first: FirstLook) -> FirstLook:
        """Return a first look with views decoded by similar patches, if they predict the held-out pixels better.

        Sparsely: views decoded densely take three times as long, and where they only start fits and take part in the
        combination, they gained 0.14 dB in one clip of three (docs/decisions/schedule.md).
        """
        schedule = self._settings.long_decode
        if first.is_decoded_at_length or schedule is None:
            return first
        longer = first.decoded_longer(schedule.sparse, self.fits.progress)
        self.fits.clock.lap("decode")
        before, after = (self.fits.holdout.residual_rms(look.decoded) for look in (first, longer))
        return longer if or_infinite(after) < or_infinite(before) else first
