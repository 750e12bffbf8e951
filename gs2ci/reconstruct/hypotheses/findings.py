"""What the race says to people, derived from its evidence at the end; no code reads it."""

import math
from collections.abc import Mapping

from gs2ci.core.findings import Code, Findings, finding
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.hypotheses.hypothesis import OrderFound, Origin, RaceEvidence, RaceOutcome


def order_findings(order: OrderFound, geometry: Geometry) -> Findings:
    """Report what is known of the order of depth; nothing if it is settled.

    Args:
        order: What is known.
        geometry: That of the result.
    """
    if not geometry.has_path or order.errors is None:
        return ()
    return (finding(Code.DEPTH_ORDER_OPEN, errors=order.errors),)


def course_findings(course: tuple[RaceEvidence, ...], motion: Mapping[str, float | None]) -> Findings:
    """Report the held-out residuals of the hypotheses that reached the jury, smallest first.

    Args:
        course: What became of each.
        motion: What still and moving scenes leave, by name; empty if motion was not tried.
    """
    left = {_name(one): one.refined_rms for one in course if one.refined_rms is not None}
    leaders = [one for one in course if one.outcome == RaceOutcome.LED]
    found = [ranking(left, _name(one)) for one in leaders]
    found += [ranking(motion, one.hypothesis.value if one.hypothesis.value in motion else "still") for one in leaders]
    return tuple(note for notes in found for note in notes)


def ranking(left: Mapping[str, float | None], chosen: str) -> Findings:
    """Report held-out residuals, smallest first; nothing for a single one, or without such pixels.

    Args:
        left: Root mean square of the held-out residual, by name.
        chosen: The name of the hypothesis that is used.
    """
    known = {name: rms for name, rms in left.items() if rms is not None and math.isfinite(rms)}
    if len(known) < 2:
        return ()
    order = sorted(known, key=lambda name: known[name])
    best, second = (known[name] for name in order[:2])
    said = ", ".join(f"{name} {known[name]:.4f}" for name in order)
    margin = second / best - 1 if best > 0 else 0.0
    return (finding(Code.ATTEMPTS_RANKED, ranking=said, margin=margin, chosen=chosen),)


def _name(one: RaceEvidence) -> str:
    return one.path if one.hypothesis == Origin.FIRST else one.hypothesis.value
