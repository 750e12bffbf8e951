"""Attempts at one measurement: which fits are made, from which beginnings, and which of them is taken.

A doubtful path is fitted once, and sought again in the views of that fit (`second_look`). A uniform motion that no
tracks bear out competes with a camera at rest: where nothing shows but a period or a gradient, any motion explains the
measurement, and a fit from rest ends several dB better; where it is far behind after a quarter of the schedule, it is
given up. Where the fits' residual looks like motion, scenes that move compete too (`moving`). The held-out pixels
choose. Not here: what an attempt is made of (`fits.py`).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from gs2ci.core.arrays import F32
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.reconstruct.attempts.attempt import Attempt, How
from gs2ci.reconstruct.attempts.fits import Fits
from gs2ci.reconstruct.attempts.order import LEAST_SCHEDULE
from gs2ci.reconstruct.attempts.second_look import is_wanted, second_look
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings, patch_decode_from
from gs2ci.reconstruct.first_look import FirstLook, from_rest, needs_rest
from gs2ci.reconstruct.fit.motion import moving_share
from gs2ci.reconstruct.fit.stopping import Rival
from gs2ci.reconstruct.moving import (
    BEHIND_DECODE,
    LEAST_GAIN,
    MOVING,
    RELEASED,
    STILL,
    MotionQuestion,
    MotionReport,
    ask,
    rested,
    speaks_for_motion,
)


@dataclass(frozen=True)
class Attempts:
    """What is fitted to a measurement, from the first look and from what else is worth it, and which of it is taken.

    Args:
        fits: Make the attempts.
    """

    fits: Fits

    def hurried(self, first: FirstLook) -> tuple[FirstLook, Attempt, MotionReport]:
        """Make one attempt, whatever comes of it."""
        moving = self.fits.settings.motion == "on"
        tried = self.fits.attempt(rested(first) if moving else first, first.decoded, How(moving))
        name = MOVING if moving else STILL
        return first, tried, self._report(MotionQuestion(), {name: tried}, tried, {})

    def all(self, first: FirstLook) -> tuple[FirstLook, Attempt, MotionReport]:
        """Make those that are worth it.

        Returns:
            The first look, with the best decode there is; the best attempt; and how anything in it came to move, or
            not to.
        """
        still = self.fits.attempt(first, first.decoded, How(alone=self._may_look_again(first)))
        # Fits that were cut short leave much that patches explain, whether or not anything moves.
        whole = self.fits.settings.fit.iterations >= LEAST_SCHEDULE
        if self.fits.halt.asked or not (self._wanted or (self.fits.settings.may_move and whole)):
            still = self._again(first, still)
            return first, still, self._report(MotionQuestion(), {STILL: still}, still, {})
        asked = self._question(still)
        if not self._wanted:
            # A path that is not right leaves what looks like motion, too.
            again = self._again(first, still)
            # What patches did not take off one fit they take off two still less.
            same = again.look is still.look and asked.gain is not None and not asked.speaks_for_motion
            asked, still = asked if same or again.ensemble is still.ensemble else self._question(again), again
        if self.fits.halt.asked or not (self._wanted or asked.speaks_for_motion):
            # Patches follow what no scene does: they are worth some time where a scene leads GAP-TV by so little.
            worth_decoding = asked.behind_decode and not self.fits.halt.asked
            first = self._decoded_better(first, sparsely=True) if worth_decoding else first
            return first, still, self._report(asked, {STILL: still}, still, {})
        self.fits.progress.say("What the still scene leaves looks like motion: scenes that move are fitted as well.")
        still = self.fits.completed(still)
        first, refined = self._decoded_better(first), self.fits.refine(still.ensemble.views)
        views = min((refined, first.decoded), key=lambda shown: self.fits.jury.residual_rms(shown) or 0.0)
        attempts = {STILL: still, RELEASED: self.fits.release(still)}
        if not self.fits.halt.asked:
            attempts[MOVING] = self.fits.attempt(rested(still.look), views, How(moving=True))
        residuals = self._residuals({name: one.ensemble.views for name, one in attempts.items()})
        tried = self._clearly_best(attempts, residuals)
        return first, tried, self._report(asked, attempts, tried, residuals)

    @property
    def _wanted(self) -> bool:
        return self.fits.settings.motion == "on"

    def _again(self, first: FirstLook, tried: Attempt) -> Attempt:
        """Fit a still scene once more from a second look, or from rest, where the first path is doubtful.

        Of a first path that is doubtful there is one fit so far: it is held against the leaders of the other attempts.
        """
        if self.fits.halt.asked or not self._may_look_again(first):
            return tried
        views = self.fits.refine(tried.ensemble.views)
        attempts = {first.geometry.source: tried}
        again = second_look(first, views, self.fits.lens, self.fits.settings, self.fits.progress)
        if again is not None and not self.fits.halt.asked:
            attempts["second look"] = self.fits.attempt(again, views, How())
        if needs_rest(first) and not self.fits.halt.asked:
            attempts["rest"] = self.fits.attempt(from_rest(first), first.decoded, How(rival=self._rival(tried)))
        if len(attempts) == 1:
            return self.fits.completed(tried)
        leaders = {name: one.fits[0].views for name, one in attempts.items()}
        return self.fits.completed(self._best(attempts, self._residuals(leaders)))

    def _rival(self, tried: Attempt) -> Rival:
        """Return what an attempt's leader has left, for another one to keep up with."""
        looks = {point.iteration: point.heldout for point in tried.fits[0].curve if point.heldout is not None}
        return Rival(looks, self.fits.settings.fit.iterations)

    def _may_look_again(self, first: FirstLook) -> bool:
        return self.fits.settings.may_look_again and is_wanted(first.geometry, self.fits.settings.geometry)

    def _decoded_better(self, first: FirstLook, *, sparsely: bool = False) -> FirstLook:
        """Return a first look with views decoded by similar patches, where they predict the held-out pixels better."""
        schedule = self.fits.settings.long_decode
        if first.decoder == "patches" or schedule is None:
            return first
        longer = first.decoded_longer(schedule.sparse if sparsely else schedule, self.fits.progress)
        self.fits.clock.lap("decode")
        before, after = self.fits.jury.residual_rms(first.decoded), self.fits.jury.residual_rms(longer.decoded)
        better = before is not None and after is not None and after < before
        return longer if better else first

    def _question(self, still: Attempt) -> MotionQuestion:
        """Ask what a still scene leaves, and if it speaks for motion, what patches take off it."""
        left = ask(self.fits.jury, still.ensemble.views)
        if not speaks_for_motion(left):
            return MotionQuestion(left)
        refined = self.fits.refine(still.ensemble.views)
        gain = self._gain(refined, PatchSettings.from_scene_briefly())
        return MotionQuestion(left, gain, self._is_behind_decode(still))

    def _is_behind_decode(self, still: Attempt) -> bool:
        """Tell whether the best still scene explains the held-out pixels hardly better than a brief decode.

        Whole decodes by patches follow what moves, and may lead any scene.
        """
        if still.look.decoder == "patches":
            return False
        fitted, decoded = (self.fits.jury.residual_rms(one) for one in (still.ensemble.best.views, still.look.decoded))
        return fitted is not None and decoded is not None and fitted >= BEHIND_DECODE * decoded > 0

    def _gain(self, refined: F32, steps: PatchSettings) -> float:
        """Return by which share a patch decode from these views on leaves less of the held-out pixels."""
        before = self.fits.jury.residual_rms(refined)
        after = self.fits.jury.residual_rms(patch_decode_from(self.fits.jury.seen, refined, steps))
        return 0.0 if not before or after is None else 1 - after / before

    def _best(self, attempts: dict[str, Attempt], residuals: dict[str, float | None]) -> Attempt:
        """Choose the attempt that predicts the held-out pixels best, and say how all of them did."""
        tried = attempts[min(attempts, key=lambda name: math.inf if (rms := residuals[name]) is None else rms)]
        notes = ranking({name: residuals[name] for name in attempts})
        return replace(tried, geometry=replace(tried.geometry, notes=(*tried.geometry.notes, *notes)))

    def _clearly_best(self, attempts: dict[str, Attempt], residuals: dict[str, float | None]) -> Attempt:
        """Choose likewise, but a scene that moves only if it predicts them clearly better than the still one."""
        if self._wanted:
            moving = {name: tried for name, tried in attempts.items() if moving_share(tried.ensemble.best.scene) > 0}
            return self._best(moving or attempts, residuals)
        best, still = self._best(attempts, residuals), attempts[STILL]
        if best.ensemble is still.ensemble:
            return best
        moves, stays = residuals[_name_of(best, attempts)], residuals[STILL]
        better = moves is not None and stays is not None and moves < (1 - LEAST_GAIN) * stays
        return best if better else still

    def _residuals(self, views: dict[str, F32]) -> dict[str, float | None]:
        """Return what each attempt's views, [N, H, W, C], leave of the held-out pixels when they are refined."""
        return {name: self.fits.jury.residual_rms(self.fits.refine(one)) for name, one in views.items()}

    def _report(
        self,
        asked: MotionQuestion,
        attempts: dict[str, Attempt],
        taken: Attempt,
        residuals: dict[str, float | None],
    ) -> MotionReport:
        moves = taken.ensemble.best.scene.motion is not None
        return MotionReport(
            self.fits.settings.motion, asked, tuple(residuals.items()), _name_of(taken, attempts), moves=moves
        )


def _name_of(taken: Attempt, attempts: dict[str, Attempt]) -> str:
    return next(name for name, tried in attempts.items() if tried.ensemble is taken.ensemble)


def ranking(left: Mapping[str, float | None]) -> tuple[Finding, ...]:
    """Say what attempts leave of the held-out pixels, the least first; nothing of one attempt, or without pixels.

    Args:
        left: Root mean square by the attempt's name.
    """
    known = {name: rms for name, rms in left.items() if rms is not None and math.isfinite(rms)}
    if len(known) < 2:
        return ()
    order = sorted(known, key=lambda name: known[name])
    best, second = (known[name] for name in order[:2])
    said = ", ".join(f"{name} {known[name]:.4f}" for name in order)
    return (finding(Code.ATTEMPTS_RANKED, ranking=said, margin=second / best - 1 if best > 0 else 0.0),)
