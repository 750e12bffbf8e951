"""Near and far: which order of depth a measurement shows, found by short fits of both.

    first geometry ─► (tracks are sure? done) ─► short fits of it and of its reversal, in pairs ─► the better, or open

A scene inside out moves like the right one where the motion is small and the field of view narrow; tracks then cannot
tell, or err together where the camera model is a little wrong. But near hides far, and a fit that has to hide the wrong
thing leaves more of the measurement. Fits also differ by luck: by where their path begins. So a geometry is compared
with its own exact reversal, which shares its luck, and what tracks find the other way round with the reversal of that.
A reversal is no minimum of its own and leaves a little more for that alone, which cancels between the two. Before any
pixel is asked, the order in which the camera turns less is the likelier: a stage hardly turns. Here: when to compare,
how many pairs, what each judge counts, and what follows. Not here: the fits (`order_fits`), the reversal and its turn
(`geometry/reversal.py`), the tracks' preference (`geometry/motion.py`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.progress import Progress
from gs2ci.reconstruct.fit.coarse_settings import CoarseSettings
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.reversal import reversed_geometry, share_with_travel
from gs2ci.reconstruct.geometry.validity import Criteria

LEAST_SCHEDULE: Final = 150
"""Iterations of the whole fit below which nothing is tried: it would cost as much again. A draft has fewer."""
# Of a short fit. With 20 fits had not yet begun to hide one thing by another, and chance turned a told path over.
_ITERATIONS: Final = 60
# Pairs of short fits at most: one from either finding of the tracks, since more of them tell little more of an order
# that these leave open. A told path has no finding the other way round, and is asked about by them alone.
_MOST_PAIRS: Final = 2
_MOST_PAIRS_OF_TOLD: Final = 4
# The standard deviation of a pair's log ratio that is luck, found on pictures of so many pixels, and more in smaller
# ones; and so many errors that are sure (`python -m tests.benchmarks depth_order`).
_LUCK: Final = 0.08
_LUCK_PIXELS: Final = 96 * 128
_SURE: Final = 2.0
# What pairs of one finding alone count: a reversal leaves up to a tenth more for being one, once three times as much.
_ONE_FINDING_COUNTS: Final = 1 / 2
# A told path, a file's, is turned over by no less, and only by several pairs that all say so: short fits of tiny
# pictures turned over exact ones.
_SURE_AGAINST_TOLD: Final = 5.0
_LEAST_PAIRS_AGAINST_TOLD: Final = 3
# What tracks say counts a third of what it claims: they err together (`motion.preference`).
_TRACKS_COUNT: Final = 1 / 3
# So many errors speak for a camera that does not turn against its reversal, which does. No picture shows that, and a
# hand, or a rail whose sensors are shifted, turns as it likes: it decides between orders that pixels and tracks hardly
# tell apart, and is sure of none that they are not sure of.
_TRAVEL_COUNTS: Final = 1.0
# What an order is preferred by at least where its travel alone speaks for it.
_BY_TRAVEL_ALONE: Final = 0.05
# What pixels and tracks say against a travel that speaks by so many errors counts half: one of them errs.
_CONTRADICTS: Final = 0.25
_CONTRADICTED_COUNTS: Final = 1 / 2

# A source of paths that no tracks bear out.
_UNTRACKED: Final = "uniform"

ShortFit = Callable[[Geometry, int], float]
"""Fits a geometry briefly, with a seed, and returns the mean square that it leaves of the measurement."""


def is_open(geometry: Geometry, criteria: Criteria) -> bool:
    """Tell whether the order of a geometry's depths is in question: there is a path, and its tracks are not sure.

    A stage's word is not: points that lie before its cameras would lie behind those of the path reversed.
    """
    if geometry.order_told:
        return False
    surely = geometry.order_errors is not None and geometry.order_errors >= criteria.order_errors
    return geometry.verdict == "full" and not surely


def unsettled(geometry: Geometry) -> Geometry:
    """Note for a geometry whose order is open that no fits were made."""
    return replace(geometry, notes=(*geometry.notes, finding(Code.DEPTH_ORDER_UNTRIED)))


def shortened(fit: CoarseSettings) -> CoarseSettings:
    """Return the schedule of a short fit; its steps stay."""
    return replace(fit, iterations=_ITERATIONS, densify_every=_ITERATIONS // 8)


def settle(geometry: Geometry, fit_briefly: ShortFit, progress: Progress, *, told: bool) -> Geometry:
    """Choose the order of depth by short fits of both.

    Args:
        geometry: What was found first.
        fit_briefly: Called for each geometry that is tried, with the same object each time.
        progress: Receives what is done.
        told: Whether a file or a model told the path: its sign decides where pixels do not do so clearly.

    Returns:
        The geometry the right way round as far as anything tells, with a note where it was turned or is open. Its
        `order_errors` are then those of pixels, tracks and travel together.
    """
    progress.say("Near and far may be exchanged: both orders of depth are tried in short fits.")
    luck = _LUCK * max(1.0, math.sqrt(_LUCK_PIXELS / geometry.inverse_depth.size))
    tracks = _TRACKS_COUNT * (geometry.order_errors or 0.0)
    travel = 0.0 if told else _travel_errors(geometry)
    found, errors = _of_pairs(geometry, fit_briefly, luck, tracks, travel, told=told)
    if geometry.source == _UNTRACKED and errors < 0:
        return _contested(geometry, -errors)
    if told:
        agreed = len(found) >= _LEAST_PAIRS_AGAINST_TOLD and all(ratio < 0 for ratio in found)
        return _taken(geometry, errors, agreed and errors <= -_SURE_AGAINST_TOLD, _less(found), told=True)
    return _taken(geometry, errors, errors < 0, _less(found), told=False)


def _contested(geometry: Geometry, errors: float) -> Geometry:
    """Return a motion that was found without tracks as it was found, its order open: pairs prefer the other one.

    It stands on what it leaves of the whole measurement, less than its reverse and than rest. Where short fits surely
    say the opposite, one of two judges of the same pixels errs, and no track tells which: that counts for nothing.
    """
    errors = errors if errors < _SURE else 0.0
    notes = (*geometry.notes, finding(Code.DEPTH_ORDER_OPEN, errors=errors))
    return replace(geometry, order_errors=errors, reverse=None, notes=notes)


def _travel_errors(geometry: Geometry) -> float:
    """Return by how many errors a geometry is preferred to its reverse for turning less."""
    other = geometry.reverse or reversed_geometry(geometry)
    return _TRAVEL_COUNTS * (share_with_travel(geometry) - share_with_travel(other))


def _with_travel(seen: float, travel: float) -> float:
    """Return by how many errors an order is preferred by what was seen, pixels and tracks, and by its travel.

    Where what was seen is not sure, the sign is that of both, and the errors are those of what was seen.
    """
    both = seen + travel
    sign = math.copysign(1.0, both)
    if travel != 0 and sign * seen < _SURE:
        return sign * max(sign * seen, _BY_TRAVEL_ALONE)
    return both * _CONTRADICTED_COUNTS if sign * travel <= -_CONTRADICTS else both


def _of_pairs(
    geometry: Geometry, fit_briefly: ShortFit, luck: float, tracks: float, travel: float, *, told: bool
) -> tuple[list[float], float]:
    """Compare orders by pairs of short fits, until they are sure.

    Args:
        geometry: Compared with its reversal, and so is what tracks found the other way round.
        fit_briefly: Fits a geometry briefly.
        luck: The standard deviation of a pair's log ratio that is luck.
        tracks: By how many errors tracks prefer the geometry's own order.
        travel: By how many errors it is preferred for turning less.
        told: Whether a file or a model told the path.

    Returns:
        The log ratios of pairs, above 0 for the geometry's own order; and by how many errors it is preferred in all.
    """
    beginnings = [geometry, *([] if geometry.reverse is None else [geometry.reverse])]
    pairs = [(one, reversed_geometry(one)) for one in beginnings]
    found: list[float] = []
    errors, sure = 0.0, False
    while not sure and len(found) < (_MOST_PAIRS_OF_TOLD if told else _MOST_PAIRS):
        one, turned = pairs[len(found) % len(pairs)]
        number = len(found)
        ratio = _log_ratio(fit_briefly(turned, number), fit_briefly(one, number))
        found.append(ratio if one is geometry else -ratio)
        both = len(pairs) > 1 and len(found) % len(pairs) == 0
        seen = _errors(found, luck) * (1.0 if told or both else _ONE_FINDING_COUNTS) + tracks
        errors = _with_travel(seen, travel)
        if told:
            doubted = errors <= -_SURE_AGAINST_TOLD and len(found) >= _LEAST_PAIRS_AGAINST_TOLD
            sure = errors >= _SURE or doubted
        else:
            sure = abs(errors) >= _SURE
    return found, errors


def _taken(geometry: Geometry, errors: float, backwards: bool, less: float, *, told: bool) -> Geometry:
    """Return a geometry in the order that was found, and say what there is to say of it."""
    taken = geometry if not backwards else geometry.reverse or reversed_geometry(geometry)
    return replace(
        taken,
        source=geometry.source,
        order_errors=abs(errors) if backwards else errors,
        reverse=None,
        notes=(*geometry.notes, *_said(geometry.source, abs(errors), less, backwards=backwards, told=told)),
    )


def _said(source: str, errors: float, less: float, *, backwards: bool, told: bool) -> tuple[Finding, ...]:
    """Say what follows from the order that was found, and how sure it is."""
    if errors < _SURE and not told:
        return (finding(Code.DEPTH_ORDER_OPEN, errors=errors),)
    if not backwards:
        return ()
    if told:
        return (finding(Code.POSES_SIGN_CONTRADICTED, source=source, less=less),)
    return (finding(Code.DEPTH_ORDER_TURNED, errors=errors),)


def _log_ratio(one: float, other: float) -> float:
    """Return the logarithm of one mean square over another; 0 where either is nothing or not a number."""
    if not (math.isfinite(one) and math.isfinite(other) and one > 0 and other > 0):
        return 0.0
    return math.log(one / other)


def _less(ratios: Sequence[float]) -> float:
    """Return by which share the order that short fits prefer leaves less."""
    return -math.expm1(-abs(sum(ratios) / len(ratios)))


def _errors(ratios: Sequence[float], luck: float) -> float:
    """Return by how many standard errors the mean of pairs' log ratios differs from nothing.

    Args:
        ratios: One or more.
        luck: The least standard deviation that they may have.
    """
    mean = sum(ratios) / len(ratios)
    spread = math.sqrt(sum((ratio - mean) ** 2 for ratio in ratios) / (len(ratios) - 1)) if len(ratios) > 1 else 0.0
    return mean / (max(spread, luck) / math.sqrt(len(ratios)))
