"""Near and far exchanged: the hypothesis of the other order of depth, and what whole fits of both say.

Fits of both orders explain the measurement about as well. Which of them hides what the views do not show tells them
apart from about 3 px of parallax on (docs/decisions/depth-order.md). The fit of the other order is not in
vain: its views count in the mean, in place of a companion.

Here: the hypothesis, and what follows from its fit. Not here: the evidence (`geometry/depth/occlusion.py`), short fits
(`order`), which are asked first.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from gs2ci.core.arrays import Bool
from gs2ci.reconstruct.geometry.depth.occlusion import (
    Occlusion,
    doubted_things,
    is_one_things_word,
    preferred,
    things,
)
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


def shown_by(
    one: Sequence[Occlusion], other: Sequence[Occlusion], moves: Bool | None = None
) -> tuple[bool, OrderFound] | None:
    """Tell whether the first of two fits hides what the views do not show, and how clearly; None if neither does.

    A fit shows what it hides: its views and its depths are of the same Gaussians, and one that floats before the others
    is both near and seen. So an order is shown only if the views of the fit in the other order show it as well, and if
    no single thing has the only word. Otherwise it is likely.

    Args:
        one: What the views of the first fit show of its depths, and what those of the second one do.
        other: What the views of the first fit show of the depths of the second one, and what its own do.
        moves: Pixels, [H, W], that may move by themselves: a thing of which one does hides what it hides whichever
            order the rest of the scene has, and is not asked.
    """
    apart = things(one[0], other[1])
    if moves is not None:
        left_out = doubted_things(apart, moves)
        one, other = ([seen.without(left_out) for seen in views] for views in (one, other))
    told = preferred(one[0], other[1])
    if told is None:
        return None
    better, worse = (one, other) if told.first else (other, one)
    seen = [preferred(mine, theirs) for mine, theirs in zip(better, worse, strict=True)]
    agreed = [view for view in seen if view is not None and view.first]
    alone = any(is_one_things_word(mine, theirs, apart) for mine, theirs in zip(better, worse, strict=True))
    state = DepthOrder.SHOWN if len(agreed) == len(seen) and not alone else DepthOrder.LIKELY
    errors, times = (min(getattr(view, name) for view in (told, *agreed)) for name in ("errors", "times"))
    return told.first, OrderFound(state, errors, min(times, _MOST_TIMES))
