"""Attempts at one measurement, and the held-out pixels' ranking of them.

A doubtful path is sought again in fitted views (`second_look`). A uniform motion that no tracks bear out competes with
a camera at rest: where nothing shows but a period or a gradient, any motion explains the measurement, and a fit from
rest ends several dB better. Here: rest as a beginning, and the ranking. Not here: what an attempt is made of
(`pipeline`).
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from gs2ci.core.findings import Code, Finding, finding
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.geometry.direct import at_rest
from gs2ci.reconstruct.geometry.initialise import PLANE_NOTE

# What is said of a path says nothing of a camera at rest.
_OF_A_PATH: Final = (Code.UNIFORM_MOTION, Code.DEPTH_ORDER_OPEN, Code.DEPTH_ORDER_TURNED)


def needs_rest(first: FirstLook) -> bool:
    """Tell whether a first look is worth an attempt from rest beside it: a motion was found without tracks."""
    return first.geometry.source == "uniform" and first.geometry.verdict == "full"


def from_rest(first: FirstLook) -> FirstLook:
    """Return a first look as if no path had been found: a camera at rest before a plane."""
    rest = at_rest(first.geometry)
    kept = tuple(note for note in rest.notes if note.code not in _OF_A_PATH)
    return replace(first, geometry=replace(rest, source="tracks", notes=(*kept, PLANE_NOTE)))


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
