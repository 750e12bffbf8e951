"""Attempts at one measurement: which fits are made, from which starts, and which attempt is chosen.

A doubtful path is fitted once, and estimated again from the views of that fit (`second_look`). So is one that was not
found; a scene along it must be clearly better than one without. A uniform motion that tracks do not confirm competes
with a camera at rest: if the scene shows only a periodic pattern or a gradient, any motion explains the measurement,
and a fit from rest ends several dB better. Both further fits are stopped if they are far behind after a quarter of the
schedule. The fits along the other paths replace companions in the mean if that does not raise the held-out residual:
fits along two paths differ at least as much as two along one. If the path turns far, or the scene is hardly better than
a decode, features of all pairs of views are matched again (`far_apart`), unless they were before any fit. If the fits'
residual looks like motion, moving scenes compete too (`moving`). The held-out pixels choose. If none moves and the
order of depth is open, a fit of the other order follows (`both_orders`). Not here: what an attempt is made of
(`fits.py`).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from gs2ci.core.arrays import F32
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.reconstruct.attempts.attempt import Attempt, How
from gs2ci.reconstruct.attempts.both_orders import in_shown_order
from gs2ci.reconstruct.attempts.fits import Fits
from gs2ci.reconstruct.attempts.order import LEAST_SCHEDULE
from gs2ci.reconstruct.attempts.second_look import is_wanted, lacks_path, second_look
from gs2ci.reconstruct.choices import LeftOut
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings, patch_decode_from
from gs2ci.reconstruct.far_apart import joins_in_part, look_far_apart
from gs2ci.reconstruct.first_look import FirstLook, from_rest, needs_rest
from gs2ci.reconstruct.fit.motion import moving_share
from gs2ci.reconstruct.fit.stopping import Rival, has_clearly_risen
from gs2ci.reconstruct.geometry.choose import is_doubtful
from gs2ci.reconstruct.geometry.sources import ESTIMATED, FromWide
from gs2ci.reconstruct.geometry.view_depths import turns_far
from gs2ci.reconstruct.measurement.over_time import followed_by_other_alone, replaced
from gs2ci.reconstruct.moving import (
    BEHIND_DECODE,
    BEHIND_PATCHES,
    LEAST_GAIN,
    LEAST_UNFOLLOWED,
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
    """Makes the attempts, from the first look and from further starts that are worth it, and chooses one.

    Args:
        fits: Makes the fits of an attempt.
    """

    fits: Fits

    def hurried(self, first: FirstLook) -> tuple[FirstLook, Attempt, MotionReport]:
        """Make one attempt and no other."""
        moving = self.fits.settings.motion == "on"
        tried = self.fits.attempt(rested(first) if moving else first, first.decoded, How(moving))
        name = MOVING if moving else STILL
        return first, tried, self._report(MotionQuestion(), {name: tried}, tried, {})

    def all(self, first: FirstLook) -> tuple[FirstLook, Attempt, MotionReport]:
        """Make all attempts that are worth their time.

        Returns:
            The first look, with the best decode so far; the best attempt; and the report why its scene is still or
            moves.
        """
        better, tried, report = self._all(first)
        # What moves hides other things than a scene at rest would, also where a moving scene explains no more.
        if tried.ensemble.best.scene.motion is None and not report.question.speaks_for_motion:
            tried = in_shown_order(self.fits, tried)
        return better, self.fits.with_order(first, tried), report

    def _all(self, first: FirstLook) -> tuple[FirstLook, Attempt, MotionReport]:
        alone = self._may_look_again(first) or self.fits.is_order_open(first.geometry)
        still = self.fits.attempt(first, first.decoded, How(alone=alone))
        # Fits on a short schedule leave much that patches explain, whether or not anything moves.
        whole = self.fits.settings.fit.iterations >= LEAST_SCHEDULE
        if self.fits.halt.asked or not (self._wanted or (self.fits.settings.may_move and whole)):
            first, still = self._far_apart(first, self._again(first, still))
            return first, still, self._report(MotionQuestion(), {STILL: still}, still, {})
        # A wrong path leaves a residual that looks like motion, too.
        first, again = (first, still) if self._wanted else self._far_apart(first, self._again(first, still))
        # The answer for one fit is of use only if its path is kept: if patches did not reduce its residual, they will
        # not reduce that of the mean of several either.
        asked = self._question(still) if again.look is still.look else None
        if asked is None or (again.ensemble is not still.ensemble and (asked.gain is None or asked.speaks_for_motion)):
            asked = self._question(again)
        still = again
        if self.fits.halt.asked or not (self._wanted or asked.speaks_for_motion):
            # Patches follow what no still scene can, and are worth their time if the scene hardly beats GAP-TV, or if
            # its fits only got worse.
            worth_decoding = (asked.behind_decode or _got_worse(still)) and not self.fits.halt.asked
            first = self._decoded_better(first) if worth_decoding else first
            return first, still, self._report(asked, {STILL: still}, still, {})
        self.fits.progress.say("The still scene's residual looks like motion: moving scenes are fitted as well.")
        still = self.fits.completed(still)
        first = self._decoded_better(first)
        refined = self._delivered(still.ensemble.views, first.decoded)
        views = min((refined, first.decoded), key=lambda shown: self.fits.holdout.residual_rms(shown) or 0.0)
        attempts, residuals = {STILL: still}, {STILL: self.fits.holdout.residual_rms(refined)}
        if not self.fits.halt.asked:
            attempts[MOVING] = self.fits.attempt(rested(still.look), views, How(moving=True))
            residuals[MOVING] = self._residual(attempts[MOVING].ensemble.views, first.decoded)
        # Without a path both moving scenes are of a camera at rest, and differ by their start alone. Along a doubtful
        # path that explains less than things that move before a camera at rest, nothing is worth continuing.
        geometry = still.look.geometry
        sure = geometry.verdict == "full" and not is_doubtful(geometry, self.fits.settings.geometry.criteria)
        settled = not sure and _clearly_less(residuals.get(MOVING), residuals[STILL])
        if not (settled or self.fits.halt.asked or LeftOut.RELEASED_FITS in self.fits.settings.left_out):
            attempts[RELEASED] = self.fits.release(still)
            residuals[RELEASED] = self._residual(attempts[RELEASED].ensemble.views, first.decoded)
        tried = self._moving_or_still(attempts, residuals)
        return first, tried, self._report(asked, attempts, tried, residuals)

    @property
    def _wanted(self) -> bool:
        return self.fits.settings.motion == "on"

    def _again(self, first: FirstLook, tried: Attempt) -> Attempt:
        """Fit a still scene once more from a second look, or from rest, if the first path is doubtful.

        A doubtful first path has one fit so far, which is compared with the leaders of the other attempts.
        """
        if self.fits.halt.asked or not self._may_look_again(first):
            return tried
        views, pathless = self.fits.refine(tried.ensemble.views), lacks_path(first.geometry)
        attempts = {first.geometry.source: tried}
        again = second_look(first, views, self.fits.lens, self.fits.settings, self.fits.progress)
        if again is not None and pathless and not self.fits.halt.asked:
            again = self._in_order(again, views)
        if again is not None and not self.fits.halt.asked:
            attempts["second look"] = self.fits.attempt(again, views, How(alone=True, rival=self._rival(tried)))
        may_rest = LeftOut.REST_AS_RIVAL not in self.fits.settings.left_out
        if may_rest and needs_rest(first) and not self.fits.halt.asked:
            how = How(alone=True, rival=self._rival(tried))
            attempts["rest"] = self.fits.attempt(from_rest(first), first.decoded, how)
        if len(attempts) == 1:
            return self.fits.completed(tried)
        taken, residuals = self._compared(attempts, first.geometry.source if pathless else None)
        chosen = _name_of(taken, attempts)
        others = sorted(attempts.keys() - {chosen}, key=lambda name: _or_infinite(residuals[name]))
        return self.fits.completed(taken, tuple(attempts[name].fits[0] for name in others), residuals[chosen])

    def _far_apart(self, first: FirstLook, tried: Attempt) -> tuple[FirstLook, Attempt]:
        """Fit a still scene along a path from matched features, if the path turns far or the scene explains too little.

        Tracks through views far apart may agree on a path that is wrong. The fit's own views show that path again. The
        fits along the other path replace companions as those of a doubtful path do.

        Returns:
            The first look, with the longer decode if one was made and is better; and the better attempt.
        """
        settings, source = self.fits.settings, first.geometry.source
        path = tried.ensemble.best.world_to_camera
        matched = (
            source == FromWide.name or joins_in_part(first) or LeftOut.MATCHES_IN_A_LONGER_DECODE in settings.left_out
        )
        may_match = settings.poses == "auto" and settings.may_look_again and source in ESTIMATED and not matched
        if self.fits.halt.asked or not (may_match and (turns_far(path) or self._is_behind_decode(tried))):
            return first, tried
        first = self._decoded_better(first)
        # Beside a motion without tracks, features were matched before any fit.
        if first.decoder != "patches" or needs_rest(first) or self.fits.halt.asked:
            return first, tried
        fits = self.fits
        found = look_far_apart(first, first.holdout, fits.lens, settings, fits.progress, fits.clock.lap, path)
        if found is None or fits.halt.asked:
            return first, tried
        found = fits.settle_order(found, hurried=False)
        how = How(alone=True, rival=self._rival(tried))
        attempts = {source: tried, FromWide.name: fits.attempt(found, found.decoded, how)}
        taken, residuals = self._compared(attempts)
        chosen = _name_of(taken, attempts)
        beside = () if chosen == source else tried.fits
        return first, fits.completed(taken, beside, residuals[chosen])

    def _in_order(self, again: FirstLook, views: F32) -> FirstLook:
        """Settle the depth order of a path that was found in the views of a fit, [N, H, W, C]."""
        settled = self.fits.settle_order(replace(again, decoded=views), hurried=False)
        return replace(again, geometry=settled.geometry)

    def _rival(self, tried: Attempt) -> Rival:
        """Return the held-out residuals of an attempt's leader by iteration, to compare another leader with."""
        looks = {point.iteration: point.heldout for point in tried.fits[0].curve if point.heldout is not None}
        return Rival(looks, self.fits.settings.fit.iterations)

    def _may_look_again(self, first: FirstLook) -> bool:
        may = self.fits.settings.may_look_again and LeftOut.SECOND_LOOK not in self.fits.settings.left_out
        return may and is_wanted(first.geometry, self.fits.settings.geometry)

    def _decoded_better(self, first: FirstLook) -> FirstLook:
        """Return a first look with views decoded by similar patches, if they predict the held-out pixels better.

        Sparsely: views decoded densely take three times as long, and where they only start fits and take part in the
        combination, they gained 0.14 dB in one clip of three (docs/decisions/schedule.md).
        """
        schedule = self.fits.settings.long_decode
        if first.decoder == "patches" or schedule is None:
            return first
        longer = first.decoded_longer(schedule.sparse, self.fits.progress)
        self.fits.clock.lap("decode")
        before, after = self.fits.holdout.residual_rms(first.decoded), self.fits.holdout.residual_rms(longer.decoded)
        better = before is not None and after is not None and after < before
        return longer if better else first

    def _question(self, still: Attempt) -> MotionQuestion:
        """Test a still scene's residual for motion, and if the test is positive, how much patches reduce it."""
        views = still.ensemble.views
        unfollowed = float(followed_by_other_alone(self.fits.holdout, views, still.look.decoded).mean())
        left = ask(self.fits.holdout, views)
        at_rest = still.look.geometry.known_at_rest
        asked = MotionQuestion(left, unfollowed=unfollowed, known_at_rest=at_rest)
        if unfollowed >= LEAST_UNFOLLOWED or not speaks_for_motion(left, known_at_rest=at_rest):
            return asked
        if LeftOut.PATCH_TEST_OF_MOTION in self.fits.settings.left_out:
            return replace(asked, gain=1.0)
        refined = self.fits.refine(views)
        further = [patch_decode_from(self.fits.holdout.seen, refined, PatchSettings.from_scene_briefly())]
        if still.look.decoder == "patches":
            further.append(still.look.decoded)
        gain = max(self._gain(refined, decoded) for decoded in further)
        return replace(
            asked,
            gain=gain,
            behind_decode=self._is_behind_decode(still),
            got_worse=_got_worse(still),
            no_path=still.geometry.verdict != "full",
        )

    def _is_behind_decode(self, still: Attempt) -> bool:
        """Tell whether the best still scene explains the held-out pixels barely better than a brief decode, or worse.

        A whole decode by patches follows moving things, and may be better than a scene that is right: against it the
        scene has to be clearly worse.
        """
        least = BEHIND_PATCHES if still.look.decoder == "patches" else BEHIND_DECODE
        fitted, decoded = (
            self.fits.holdout.residual_rms(one) for one in (still.ensemble.best.views, still.look.decoded)
        )
        return fitted is not None and decoded is not None and fitted >= least * decoded > 0

    def _gain(self, refined: F32, decoded: F32) -> float:
        """Return the share by which decoded views, [N, H, W, C], have less of a held-out residual than refined ones."""
        before, after = (self.fits.holdout.residual_rms(views) for views in (refined, decoded))
        return 0.0 if not before or after is None else 1 - after / before

    def _compared(
        self, attempts: dict[str, Attempt], preferred: str | None = None
    ) -> tuple[Attempt, dict[str, float | None]]:
        """Choose an attempt by the first fit of each, as `_best`; also return their held-out residuals."""
        residuals = {name: self._residual(one.fits[0].views) for name, one in attempts.items()}
        return self._best(attempts, residuals, preferred), residuals

    def _best(
        self, attempts: dict[str, Attempt], residuals: dict[str, float | None], preferred: str | None = None
    ) -> Attempt:
        """Choose the attempt that predicts the held-out pixels best, and report the residuals of all.

        Args:
            attempts: By name.
            residuals: Of their held-out pixels.
            preferred: The one without a path, or without motion: another is chosen only if it is clearly better.
        """
        best = min(attempts, key=lambda name: _or_infinite(residuals[name]))
        if preferred is not None and not _clearly_less(residuals[best], residuals[preferred]):
            best = preferred
        tried, notes = attempts[best], ranking({name: residuals[name] for name in attempts}, best)
        return replace(tried, geometry=replace(tried.geometry, notes=(*tried.geometry.notes, *notes)))

    def _moving_or_still(self, attempts: dict[str, Attempt], residuals: dict[str, float | None]) -> Attempt:
        """Choose a moving scene if one is wanted and a fit moves, or else only if it is clearly better."""
        if not self._wanted:
            return self._best(attempts, residuals, STILL)
        moving = {name: tried for name, tried in attempts.items() if moving_share(tried.ensemble.best.scene) > 0}
        return self._best(moving or attempts, residuals)

    def _delivered(self, views: F32, decoded: F32) -> F32:
        """Return a scene's views about as delivered: replaced by decoded ones where it errs over time, and refined."""
        where = followed_by_other_alone(self.fits.holdout, views, decoded)
        return self.fits.refine(replaced(views, decoded, where) if where.any() else views)

    def _residual(self, views: F32, decoded: F32 | None = None) -> float | None:
        """Return the held-out residual of a scene's views, [N, H, W, C], refined; about as delivered if decoded."""
        shown = self.fits.refine(views) if decoded is None else self._delivered(views, decoded)
        return self.fits.holdout.residual_rms(shown)

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


def _clearly_less(one: float | None, other: float | None) -> bool:
    return one is not None and other is not None and one < (1 - LEAST_GAIN) * other


def _got_worse(still: Attempt) -> bool:
    """Tell whether the held-out residual of the best fit ended clearly above its least value."""
    left = [point.heldout for point in still.ensemble.best.curve if point.heldout is not None]
    return bool(left) and has_clearly_risen(min(left), left[-1])


def _or_infinite(rms: float | None) -> float:
    return math.inf if rms is None else rms


def ranking(left: Mapping[str, float | None], chosen: str) -> tuple[Finding, ...]:
    """Report the held-out residuals of attempts, smallest first; nothing for a single attempt, or without such pixels.

    Args:
        left: Root mean square of the held-out residual, by the attempt's name.
        chosen: The name of the attempt that is used.
    """
    known = {name: rms for name, rms in left.items() if rms is not None and math.isfinite(rms)}
    if len(known) < 2:
        return ()
    order = sorted(known, key=lambda name: known[name])
    best, second = (known[name] for name in order[:2])
    said = ", ".join(f"{name} {known[name]:.4f}" for name in order)
    margin = second / best - 1 if best > 0 else 0.0
    return (finding(Code.ATTEMPTS_RANKED, ranking=said, margin=margin, chosen=chosen),)
