"""The record of several exposures as one, with the views of all of them, one exposure after the other.

Here: how the records of single exposures become that of all, and what is kept of each. Not here: the records of single
exposures (`reconstruct.record`), the sum of the measurements (`core.summed`).
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.run_figures import VERDICTS, ExposureSection, HeldOut, Verdict
from gs2ci.core.run_records import RunResult
from gs2ci.core.uncertainty import joined

_Number = TypeVar("_Number", np.float32, np.float64)


def merged(
    parts: Sequence[RunResult], names: Sequence[str], notes: Sequence[Finding], seconds: Mapping[str, float]
) -> RunResult:
    """Return the record of all exposures; that of one alone if there is only one.

    Args:
        parts: Of each exposure, from one fit.
        names: Of the exposures.
        notes: Findings about all together.
        seconds: Wall-clock time of each stage, for all together.
    """
    if len(parts) == 1:
        return replace(parts[0], notes=(*notes, *parts[0].notes), seconds=dict(seconds)).check()
    first, sure = parts[0], [one.uncertainty for one in parts]
    return RunResult(
        views=_together([one.views for one in parts]),
        scene_views=_together([one.scene_views for one in parts]),
        decode=_together([one.decode for one in parts]),
        depth=_if_all([one.depth for one in parts]),
        depth_spread=_if_all([one.depth_spread for one in parts]),
        depth_confidence=_if_all([one.depth_confidence for one in parts]),
        world_to_camera=_together([one.world_to_camera for one in parts]),
        intrinsics=first.intrinsics,
        distortion=first.distortion,
        predicted_measurement=np.sum([one.predicted_measurement for one in parts], axis=0, dtype=np.float32),
        curve=first.curve,
        stopped=first.stopped,
        seconds=dict(seconds),
        gaussians=first.gaussians,
        notes=(*notes, *_of_each(parts, names)),
        settings=first.settings,
        seed=first.seed,
        verdict=_verdict(parts),
        heldout_rms={verdict: _rms([one.heldout_rms[verdict] for one in parts]) for verdict in VERDICTS},
        geometry=next((one.geometry for one in parts if one.geometry and one.geometry.unit_of), first.geometry),
        ensemble=first.ensemble,
        brightness=_brightness(parts),
        exposed_views=_exposed(parts),
        uncertainty=None if any(one is None for one in sure) else joined([one for one in sure if one is not None]),
        exposures=tuple(_summary(parts, number, name) for number, name in enumerate(names)),
    ).check()


def _summary(parts: Sequence[RunResult], number: int, name: str) -> ExposureSection:
    one = parts[number]
    return ExposureSection(
        name=name,
        first_view=sum(len(part.views) for part in parts[:number]),
        views=len(one.views),
        verdict=one.verdict,
        heldout_rms=HeldOut(**{verdict: one.heldout_rms[verdict] for verdict in VERDICTS}),
        path="" if one.geometry is None else one.geometry.method,
        moved=None if one.geometry is None else one.geometry.moved,
    )


def _of_each(parts: Sequence[RunResult], names: Sequence[str]) -> tuple[Finding, ...]:
    """Return the findings of the exposures: those that all share once, the others with the name of their exposure."""
    shared = Counter(note for part in parts for note in {(note.code, note.sentence) for note in part.notes})
    found, told = [], set()
    for part, name in zip(parts, names, strict=True):
        for note in part.notes:
            key = (note.code, note.sentence)
            if shared[key] < len(parts):
                found.append(finding(Code.OF_EXPOSURE, name=name, sentence=note.sentence, code=note.code))
            elif key not in told:
                found.append(note)
                told.add(key)
    return tuple(found)


def _verdict(parts: Sequence[RunResult]) -> Verdict:
    """Return the verdict that all share, or that their views are combinations."""
    first, *others = (one.verdict for one in parts)
    return first if all(one == first for one in others) else "refined"


def _rms(figures: Sequence[float | None]) -> float | None:
    known = [figure for figure in figures if figure is not None]
    return math.sqrt(float(np.mean(np.square(known)))) if known else None


def _brightness(parts: Sequence[RunResult]) -> list[float] | None:
    if all(one.brightness is None for one in parts):
        return None
    return [factor for one in parts for factor in one.brightness or [1.0] * len(one.views)]


def _exposed(parts: Sequence[RunResult]) -> NDArray[np.float32] | None:
    if all(one.exposed_views is None for one in parts):
        return None
    return _together([one.views if one.exposed_views is None else one.exposed_views for one in parts])


def _together(arrays: Sequence[NDArray[_Number]]) -> NDArray[_Number]:
    return np.concatenate(arrays)


def _if_all(arrays: Sequence[NDArray[np.float32] | None]) -> NDArray[np.float32] | None:
    known = [array for array in arrays if array is not None]
    return np.concatenate(known) if len(known) == len(arrays) else None
