"""The jury of the race: what views leave of the held-out pixels, which hypothesis is taken, and which views count.

Here: these comparisons, and the questions whether things move and from where moving scenes start. Not here: the
schedule (`race`), thresholds of motion (`moving`).
"""

import math
from collections.abc import Sequence

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.choices import LeftOut
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings, patch_decode_from
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.hypotheses.fitting import Entrant, Fits
from gs2ci.reconstruct.hypotheses.hypothesis import Hypothesis, Origin
from gs2ci.reconstruct.hypotheses.moving import (
    BEHIND_DECODE,
    BEHIND_PATCHES,
    MotionQuestion,
    ask,
    clearly_less,
    rested,
)
from gs2ci.reconstruct.measurement.holdout import surely_larger
from gs2ci.reconstruct.measurement.over_time import followed_by_other_alone, replaced


class Jury:
    """Judges the fits of one measurement by its held-out pixels.

    Args:
        fits: What they share.

    Attributes:
        judged: The residuals of those that were compared, by their number.
    """

    def __init__(self, fits: Fits) -> None:
        self.judged: dict[int, float | None] = {}
        self._fits, self._settings = fits, fits.settings

    def question(self, look: FirstLook, views: F32) -> MotionQuestion:
        """Test still views' residual for motion, and whether they err over time."""
        return MotionQuestion(ask(self._fits.holdout, views), float(self._unfollowed(views, look.decoded).mean()))

    def moving_hypothesis(self, first: FirstLook, leader: Entrant, still: F32) -> Hypothesis:
        """Return a scene that moves from the first, before a camera at rest unless a path was given."""
        refined, brief = self._fits.refine(still), PatchSettings(iterations=4, first_sigma=10 / 255)
        further = patch_decode_from(self._fits.holdout.seen, refined, brief)
        starts = (self.shown(still, first.decoded), first.decoded, further)
        views = min(starts, key=lambda shown: or_infinite(self._fits.holdout.residual_rms(shown)))
        return Hypothesis(Origin.MOVING, rested(leader.hypothesis.look), views, moves=True)

    def taken(self, field: tuple[Entrant, ...]) -> tuple[Entrant, ...]:
        """Return the fits of a still scene, that of the hypothesis taken first."""
        leader = field[0]
        rivals = [one for one in field if one.hypothesis.origin != Origin.COMPANION]
        if len(rivals) > 1:
            for rival in rivals:
                self.judged[rival.number] = self.left(rival)
            leader = min(rivals, key=lambda one: or_infinite(self.judged[one.number]))
            pathless = next((one for one in rivals if one.geometry.lacks_path), leader)
            if not clearly_less(self.judged[leader.number], self.judged[pathless.number]):
                leader = pathless
        return (leader, *(one for one in field if one.number != leader.number))

    def counting(self, field: Sequence[Entrant]) -> list[Entrant]:
        """Return those whose views count in the mean: other hypotheses unless they surely raise its residual.

        The leader was chosen by the same held-out pixels, so that the mean seems worse by chance where it is better: on
        photographs of 96 x 128 px its residual was 1 to 5 % larger and its views 0.3 to 0.5 dB better.
        """
        leader = field[0]
        own = [one for one in field if one.of == leader.of]
        others = [one for one in field if one.of != leader.of]
        if self._fits.mask_moments is not None:
            # Views at the middle of the masks are rendered anew from all fits, with the camera matrix of the best.
            focal_px = leader.geometry.intrinsics[0, 0]
            others = [one for one in others if one.geometry.intrinsics[0, 0] == focal_px]
        if not others:
            return own
        others.sort(key=lambda one: or_infinite(self.left(one)))
        alone = self._squared(leader.run.result().views)
        while others and surely_larger(self._squared(self.mean_of([*own, *others])), alone):
            others.pop()
        return [*own, *others]

    def _squared(self, views: F32) -> F64:
        """Return the squared residual of views, [N, H, W, C], refined, at each held-out pixel, [K]."""
        return self._fits.holdout.squared_residuals(self._fits.refine(views))

    def mean_of(self, field: Sequence[Entrant]) -> F32:
        """Return the mean of the views of fits, [N, H, W, C]."""
        together = field[0].run.result().views.copy()
        for one in field[1:]:
            together += one.run.result().views
        return together / np.float32(len(field))

    def is_behind_decode(self, look: FirstLook, views: F32) -> bool:
        """Tell whether views of a scene explain the held-out pixels barely better than a brief decode, or worse.

        A whole decode by patches follows moving things, and may be better than a scene that is right: against it the
        scene has to be clearly worse.
        """
        least = BEHIND_PATCHES if look.is_decoded_at_length else BEHIND_DECODE
        fitted, decoded = (self._fits.holdout.residual_rms(one) for one in (views, look.decoded))
        return fitted is not None and decoded is not None and fitted >= least * decoded > 0

    def shown(self, views: F32, decoded: F32) -> F32:
        """Return a scene's views about as delivered: replaced by decoded ones where it errs over time, and refined."""
        where = self._unfollowed(views, decoded)
        return self._fits.refine(replaced(views, decoded, where) if where.any() else views)

    def _unfollowed(self, views: F32, decoded: F32) -> F32:
        """Return where views err over time and decoded ones do not, [H, W]; nowhere if that is not asked."""
        if LeftOut.ERRORS_OVER_TIME in self._settings.left_out:
            return np.zeros(self._fits.holdout.shot.size, np.float32)
        return followed_by_other_alone(self._fits.holdout, views, decoded)

    def left(self, entrant: Entrant, decoded: F32 | None = None) -> float | None:
        """Return the held-out residual of a fit's views, refined; about as delivered if decoded."""
        run = entrant.run
        views = run.result().views if run.has_ended else run.views()
        return self._fits.holdout.residual_rms(
            self._fits.refine(views) if decoded is None else self.shown(views, decoded)
        )


def or_infinite(rms: float | None) -> float:
    """Return a held-out residual, or infinity if it is not known."""
    return math.inf if rms is None or math.isnan(rms) else rms
