"""Near and far: which order of depth a measurement shows, found by short fits of both.

    first geometry ─► (tracks are sure? done) ─► short fits of it and of its reversal, in pairs ─► the better, or open

If the motion is small and the field of view narrow, a scene with its depth order reversed (near and far exchanged)
moves almost like the right one. Tracks then cannot tell them apart, or all err alike if the camera model is slightly
wrong. But near things hide far ones, and a fit in which the wrong things are hidden leaves a larger residual. Fits also
differ by chance, for instance by where their path starts. So a geometry is compared with its own exact reversal, which
shares its chance errors, and the solution that tracks find in the other order is compared with the reversal of that
one. A reversal is not a minimum of the tracks' error and leaves a slightly larger residual for this reason alone; the
effect cancels between the two pairs. Prior knowledge counts a little: the order in which the camera turns less is
likelier, since a stage hardly turns.

Here: when to compare, how many pairs, how much each kind of evidence counts, and what follows. Not here: the fits
(`fitting`), the reversal and its turn (`geometry/reversal.py`), the tracks' preference (`geometry/path/motion.py`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final, TypeVar

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.path.validity import Criteria
from gs2ci.reconstruct.geometry.reversal import reversed_geometry, share_with_travel, turned
from gs2ci.reconstruct.hypotheses.hypothesis import DepthOrder, OrderFound
from gs2ci.reconstruct.measurement.holdout import SURE, Holdout

LEAST_SCHEDULE: Final = 150
"""If the whole fit has fewer iterations, no short fits are made, which would cost as much again. A draft has fewer."""
# Iterations of a short fit. After 20, things did not yet hide one another, and chance reversed a given path.
_ITERATIONS: Final = 60
# Pairs of short fits at most: one for each of the two solutions of the tracks, since more pairs add little if these
# leave the order open. A given path has no second solution, and short fits are the only evidence against its sign.
_MOST_PAIRS: Final = 2
_MOST_PAIRS_OF_GIVEN: Final = 4
# The standard deviation of a pair's log ratio by chance, measured on pictures of this many pixels and larger in smaller
# ones (`python -m tests.benchmarks depth_order`).
_LUCK: Final = 0.08
_LUCK_PIXELS: Final = 96 * 128
# The factor for pairs of one solution alone: a reversal leaves up to a tenth more because it is no minimum, once three
# times as much.
_ONE_FINDING_COUNTS: Final = 1 / 2
# A given path (from a file) is reversed only by at least so many errors and by several pairs that all agree: short fits
# of tiny pictures reversed exact paths.
_SURE_AGAINST_GIVEN: Final = 5.0
_LEAST_PAIRS_AGAINST_GIVEN: Final = 3
# The tracks' preference counts a third, since their errors are correlated (`motion.preference`).
_TRACKS_COUNT: Final = 1 / 3
# By how many errors a camera that does not turn is preferred to its reversal, which does. This is a prior, not seen in
# the picture: a hand-held camera may turn, or one on a rail whose sensors are shifted. It decides between orders that
# pixels and tracks hardly tell apart, but never makes an order sure.
_TRAVEL_COUNTS: Final = 1.0
# The least preference, in errors, for an order that is preferred only for turning less.
_BY_TRAVEL_ALONE: Final = 0.05
# If the preference for turning less reaches so many errors and pixels and tracks prefer the other order, their
# preference counts half: one of the two is wrong.
_CONTRADICTS: Final = 0.25
_CONTRADICTED_COUNTS: Final = 1 / 2

Begun = TypeVar("Begun")
"""A geometry as fits begin with it."""


def is_open(geometry: Geometry, criteria: Criteria) -> bool:
    """Tell whether the order of a geometry's depths is in question: there is a path, and its tracks are not sure.

    It is not if a stage gave the order: points in front of its cameras would lie behind those of the reversed path.
    """
    if geometry.order_given:
        return False
    surely = geometry.order_errors is not None and geometry.order_errors >= criteria.order_errors
    return geometry.has_path and not surely


def shortened(fit: CoarseSettings) -> CoarseSettings:
    """Return the schedule of a short fit.

    The measurement alone judges: surfaces estimated from the views of either order would confirm that order. And it
    judges the depths as they are: with steps that move them fast, a wrong order soon leaves hardly more. The poses of
    both orders are free: a reversal is only near its minimum.
    """
    return replace(
        fit,
        iterations=_ITERATIONS,
        densify_every=_ITERATIONS // 8,
        surfaces=None,
        relief=None,
        steps=replace(fit.steps, in_view=None),
        poses=replace(fit.poses, given_weight=0.0),
    )


def mean_square(holdout: Holdout, views: F32) -> float:
    """Return the mean square of the residual that views, [N, H, W, C], leave at lit pixels that are not saturated."""
    residual = (holdout.coded(views) - holdout.shot.measurement)[holdout.shot.usable].astype(np.float64)
    return float(np.mean(residual**2)) if residual.size else 0.0


def settle(
    geometry: Geometry, begin: Callable[[Geometry], Begun], fit_briefly: Callable[[Begun, int], float]
) -> tuple[Geometry, OrderFound]:
    """Choose the order of depth by short fits of both.

    The sign of a path that a file or a model gave is kept unless pixels clearly contradict it.

    Args:
        geometry: The first estimate.
        begin: Returns a geometry as fits begin with it.
        fit_briefly: Fits one.

    Returns:
        The geometry in the preferred order, and what is known of it. Its `order_errors` are those of pixels, tracks and
        travel together.
    """
    given = not geometry.is_estimated
    luck = _LUCK * max(1.0, math.sqrt(_LUCK_PIXELS / geometry.inverse_depth.size))
    tracks = _TRACKS_COUNT * (geometry.order_errors or 0.0)
    travel = 0.0 if given else _travel_errors(geometry)
    found, errors = _of_pairs(geometry, begin, fit_briefly, luck, tracks, travel)
    backwards = errors < 0
    if given:
        agreed = len(found) >= _LEAST_PAIRS_AGAINST_GIVEN and all(ratio < 0 for ratio in found)
        backwards = agreed and errors <= -_SURE_AGAINST_GIVEN
    taken = turned(geometry) if backwards else geometry
    order = OrderFound(_state(errors, given=given, backwards=backwards), abs(errors), less=_less(found))
    known = abs(errors) if backwards else errors
    return replace(taken, source=geometry.source, order_errors=known, other_order=None, notes=geometry.notes), order


def _state(errors: float, *, given: bool, backwards: bool) -> DepthOrder:
    if given:
        return DepthOrder.CONTRADICTED if backwards else DepthOrder.SETTLED
    if abs(errors) < SURE:
        return DepthOrder.OPEN
    return DepthOrder.TURNED if backwards else DepthOrder.SETTLED


def _travel_errors(geometry: Geometry) -> float:
    """Return by how many errors a geometry is preferred to its reverse because it turns less."""
    return _TRAVEL_COUNTS * (share_with_travel(geometry) - share_with_travel(turned(geometry)))


def _with_travel(seen: float, travel: float) -> float:
    """Return by how many errors an order is preferred, from what was seen (pixels and tracks) and its travel together.

    If what was seen is not sure, the sign is that of the sum, and the size is that of what was seen alone.
    """
    both = seen + travel
    sign = math.copysign(1.0, both)
    if travel != 0 and sign * seen < SURE:
        return sign * max(sign * seen, _BY_TRAVEL_ALONE)
    return both * _CONTRADICTED_COUNTS if sign * travel <= -_CONTRADICTS else both


def _of_pairs(
    geometry: Geometry,
    begin: Callable[[Geometry], Begun],
    fit_briefly: Callable[[Begun, int], float],
    luck: float,
    tracks: float,
    travel: float,
) -> tuple[list[float], float]:
    """Compare orders by pairs of short fits, until they are sure.

    Args:
        geometry: Compared with its reversal; the tracks' solution in the other order, if any, with its own.
        begin: Returns a geometry as fits begin with it.
        fit_briefly: Fits one.
        luck: The standard deviation of a pair's log ratio by chance.
        tracks: By how many errors tracks prefer the geometry's own order.
        travel: By how many errors it is preferred because it turns less.

    Returns:
        The log ratios of pairs, above 0 for the geometry's own order; and by how many errors it is preferred in all.
    """
    given = not geometry.is_estimated
    beginnings = [geometry] if geometry.other_order is None else [geometry, turned(geometry)]
    pairs: list[tuple[Begun, Begun]] = []
    found: list[float] = []
    errors, sure = 0.0, False
    while not sure and len(found) < (_MOST_PAIRS_OF_GIVEN if given else _MOST_PAIRS):
        number = len(found)
        which = number % len(beginnings)
        if len(pairs) <= which:
            pairs.append((begin(beginnings[which]), begin(reversed_geometry(beginnings[which]))))
        here, there = pairs[which]
        ratio = _log_ratio(fit_briefly(there, number), fit_briefly(here, number))
        found.append(-ratio if which else ratio)
        both = len(beginnings) > 1 and len(found) % len(beginnings) == 0
        seen = _errors(found, luck) * (1.0 if given or both else _ONE_FINDING_COUNTS) + tracks
        errors = _with_travel(seen, travel)
        if given:
            doubted = errors <= -_SURE_AGAINST_GIVEN and len(found) >= _LEAST_PAIRS_AGAINST_GIVEN
            sure = errors >= SURE or doubted
        else:
            sure = abs(errors) >= SURE
    return found, errors


def _log_ratio(one: float, other: float) -> float:
    """Return the logarithm of one mean square over another; 0 if either is not a positive finite number."""
    if not (math.isfinite(one) and math.isfinite(other) and one > 0 and other > 0):
        return 0.0
    return math.log(one / other)


def _less(ratios: Sequence[float]) -> float:
    """Return the share by which the mean square is smaller in the order that short fits prefer."""
    return -math.expm1(-abs(sum(ratios) / len(ratios)))


def _errors(ratios: Sequence[float], luck: float) -> float:
    """Return by how many standard errors the mean of pairs' log ratios differs from zero.

    Args:
        ratios: One or more.
        luck: A lower bound on their standard deviation.
    """
    mean = sum(ratios) / len(ratios)
    spread = math.sqrt(sum((ratio - mean) ** 2 for ratio in ratios) / (len(ratios) - 1)) if len(ratios) > 1 else 0.0
    return mean / (max(spread, luck) / math.sqrt(len(ratios)))
