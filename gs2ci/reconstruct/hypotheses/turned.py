"""Near and far exchanged: the hypothesis of the other order of depth, and what whole fits of both say.

Fits of both orders explain the measurement about as well. Which of them hides what the views do not show tells them
apart from about 3 px of parallax on (docs/decisions/depth-order.md). The fit of the other order is not in
vain: its views count in the mean, in place of a companion.

Here: the hypothesis, and what follows from its fit. Not here: the evidence (`geometry/depth/occlusion.py`), what is
known before (`order`).
"""

from dataclasses import replace
from typing import Final

from gs2ci.core.arrays import Bool
from gs2ci.reconstruct.geometry.depth.occlusion import Occlusion, doubted_things, preferred, things
from gs2ci.reconstruct.geometry.reversal import reversed_geometry
from gs2ci.reconstruct.hypotheses.hypothesis import DepthOrder, Hypothesis, OrderFound, Origin

# A scene and its depth reversal leave about as much of the held-out pixels. Where one leaves more than so many times as
# much, they differ by more than their order: a thing that crossed half the picture had 1.43 times, and much to hide.
_AS_WELL: Final = 1.25
# More is not said of how clearly one order is shown: the other may show nothing at all.
_MOST_TIMES: Final = 99.0


def turned_over(hypothesis: Hypothesis) -> Hypothesis:
    """Return a hypothesis with its order of depth reversed."""
    look = hypothesis.look
    other = replace(look, geometry=reversed_geometry(look.geometry))
    return replace(hypothesis, origin=Origin.TURNED, look=other)


def explain_alike(one_rms: float | None, other_rms: float | None) -> bool:
    """Tell whether two fits leave so alike that what hides what in them may decide."""
    less, more = sorted((one_rms or 0.0, other_rms or 0.0))
    return more <= _AS_WELL * less


def told_by(one: Occlusion, other: Occlusion, moves: Bool | None = None) -> tuple[bool, OrderFound] | None:
    """Tell whether the first of two fits hides what the views do not show, and how clearly; None if neither does.

    That order is likely, never sure: a fit shows what it hides, since its views and its depths are of the same
    Gaussians, and one that floats before the others is both near and seen.

    Args:
        one: What the views of the first fit show of its depths.
        other: Likewise of the second.
        moves: Pixels, [H, W], that may move by themselves: a thing of which one does hides what it hides whichever
            order the rest of the scene has, and is not asked.
    """
    if moves is not None:
        left_out = doubted_things(things(one, other), moves)
        one, other = one.without(left_out), other.without(left_out)
    told = preferred(one, other)
    return (
        None if told is None else (told.first, OrderFound(DepthOrder.LIKELY, told.errors, min(told.times, _MOST_TIMES)))
    )
