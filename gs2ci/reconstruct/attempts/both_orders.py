"""Near and far where short fits leave them open: a whole fit of each order, and what hides what in them.

    attempt whose order of depth is open ─► a fit from its reversal ─► the one whose near things hide far ones in the
    views as well, or open

Fits of both orders explain the measurement about as well. Which of them hides what the views do not show tells them
apart from about 3 px of parallax on (docs/decisions/depth-order.md). The fit of the other order is not in
vain: its views count in the mean, in place of a companion.

Here: when both are fitted, and what follows. Not here: the evidence (`geometry/occlusion.py`), short fits (`order`),
which the pipeline asks first.
"""

from dataclasses import replace
from typing import Final

from gs2ci.core.errors import NumericsError
from gs2ci.core.findings import Code, finding
from gs2ci.reconstruct.attempts.attempt import Attempt, How
from gs2ci.reconstruct.attempts.fits import Fits
from gs2ci.reconstruct.choices import LeftOut
from gs2ci.reconstruct.geometry.occlusion import Preference, preferred
from gs2ci.reconstruct.geometry.reversal import reversed_geometry

# A scene and its depth reversal leave about as much of the held-out pixels. Where one leaves more than so many times as
# much, they differ by more than their order: a thing that crossed half the picture had 1.43 times, and much to hide.
_AS_WELL: Final = 1.25
# More is not said of how clearly one order is shown: the other may show nothing at all.
_MOST_TIMES: Final = 99.0


def in_shown_order(fits: Fits, tried: Attempt) -> Attempt:
    """Return an attempt in the order of depth that occlusion shows, with all its fits.

    If its order is not open, or a fit of the other order fails, or occlusion does not tell, it keeps its own.

    Args:
        fits: Makes the fits.
        tried: The attempt, of a still scene.
    """
    left_out = LeftOut.OCCLUSION in fits.settings.left_out
    if left_out or fits.halt.asked or not fits.is_order_open(tried.geometry):
        return fits.completed(tried)
    fits.progress.say("Near and far may still be exchanged: a fit of the other order shows what would hide what.")
    other = _turned(fits, tried)
    if other is None:
        return fits.completed(tried)
    told = _told(fits, tried, other)
    if told is None:
        return _beside(fits, tried, other)
    shown = finding(Code.DEPTH_ORDER_SHOWN, errors=told.errors, times=min(told.times, _MOST_TIMES))
    fits.progress.say(shown.sentence)
    taken, left = (tried, other) if told.first else (other, tried)
    notes = (*(note for note in tried.geometry.notes if note.code != Code.DEPTH_ORDER_OPEN), shown)
    geometry = replace(taken.geometry, order_errors=told.errors, notes=notes)
    return _beside(fits, replace(taken, geometry=geometry), left)


def _told(fits: Fits, one: Attempt, other: Attempt) -> Preference | None:
    """Tell which of two attempts hides what its leader's refined views do not show; None if that is not clear."""
    refined = [fits.refine(tried.fits[0].views) for tried in (one, other)]
    less, more = sorted(fits.holdout.residual_rms(views) or 0.0 for views in refined)
    if more > _AS_WELL * less:
        return None
    return preferred(*(fits.occlusion(tried, views) for tried, views in zip((one, other), refined, strict=True)))


def _turned(fits: Fits, tried: Attempt) -> Attempt | None:
    """Make one fit of the other order of depth; None if it fails, or if an early end is requested meanwhile."""
    look = replace(tried.look, geometry=reversed_geometry(tried.look.geometry))
    try:
        other = fits.attempt(look, look.decoded, How(alone=True))
    except NumericsError:
        return None
    return None if fits.halt.asked else other


def _beside(fits: Fits, taken: Attempt, left: Attempt) -> Attempt:
    """Complete an attempt; the leader of the other one counts in the mean."""
    return fits.completed(taken, (replace(left.fits[0], beside=True),))
