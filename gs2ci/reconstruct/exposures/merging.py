"""The record of several exposures as one, with the views of all of them, one exposure after the other.

Here: how the records of single exposures become that of all, and what is kept of each. Not here: the records of single
exposures (`reconstruct.record`), the sum of the measurements (`core.summed`).
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64, I64, Bool
from gs2ci.core.cameras import SAME_SURFACE, in_world
from gs2ci.core.findings import Code, Finding, Findings, finding
from gs2ci.core.lens import rays_of, seen_by
from gs2ci.core.run_figures import VERDICTS, ExposureSection, HeldOut, Verdict
from gs2ci.core.run_records import RunResult
from gs2ci.core.uncertainty import Uncertainty

# What each of several exposures alone shows, and what would be lost without it; nothing is fitted again.

# Points of each exposure's middle view, on a lattice.
_POINTS: Final = 800


@dataclass(frozen=True, eq=False)
class ViewsTogether:
    """The views of several exposures in common coordinates.

    Args:
        depth: Along the optical axis, [V, H, W]; 0 where there is none.
        world_to_camera: [V, 4, 4].
        intrinsics: [3, 3], px.
        distortion: Of the lens, [5]; None for a pinhole.
        exposure: Which exposure each view is of, [V], in order.
    """

    depth: F32
    world_to_camera: F64
    intrinsics: F64
    distortion: F64 | None
    exposure: I64

    def sees(self, view: int, points: F64) -> Bool:
        """Tell which points, [P, 3], a view shows: those in its picture that lie on its own surface, [P]."""
        pose, depth = self.world_to_camera[view], self.depth[view]
        inside, ahead, pixels = seen_by(points, pose, self.intrinsics, depth.shape, self.distortion)
        column, row = np.where(inside[:, None], pixels, 0.0).astype(np.int64).T
        return inside & (np.abs(depth[row, column] - ahead) <= SAME_SURFACE * ahead)

    def points(self, view: int) -> F64:
        """Return points that a view shows, [P, 3], on a lattice."""
        height, width = self.depth.shape[1:]
        step = max(1, int(np.ceil(np.sqrt(height * width / _POINTS))))
        rows, columns = (one.ravel() for one in np.mgrid[step // 2 : height : step, step // 2 : width : step])
        rays = rays_of(np.stack([columns, rows], axis=1) + 0.5, self.intrinsics, self.distortion)
        depth = self.depth[view, rows, columns].astype(np.float64)
        return in_world(rays * depth[:, None], self.world_to_camera[view])[depth > 0]


def seen_alone(views: ViewsTogether) -> tuple[float, ...]:
    """Return the share of what each exposure's middle view shows that no other one shows; 0 if it shows nothing."""
    found = []
    for number in range(int(views.exposure.max()) + 1):
        members = np.flatnonzero(views.exposure == number)
        points = views.points(int(members[len(members) // 2]))
        seen = np.zeros(len(points), bool)
        for view in np.flatnonzero(views.exposure != number):
            seen |= views.sees(int(view), points)
        found.append(float((~seen).mean()) if len(points) else 0.0)
    return tuple(found)


_STACKED: Final = (
    "views",
    "scene_views",
    "decode",
    "exposed_views",
    "depth",
    "depth_spread",
    "depth_confidence",
    "world_to_camera",
)
_ERRORS: Final = tuple(field.name for field in fields(Uncertainty))


def side_by_side(parts: Iterable[RunResult], views: int) -> list[RunResult]:
    """Return the records of exposures with their arrays in those of all, one exposure after the other.

    Args:
        parts: Of each exposure; their own arrays are copied, and need not be in memory together.
        views: How many there are of all exposures.
    """
    whole: dict[tuple[type, str], NDArray[Any]] = {}

    def placed(record: Any, names: Sequence[str], at: int) -> Any:
        own = {name: getattr(record, name) for name in names}
        for name, array in own.items():
            if array is not None:
                stack = whole.setdefault((type(record), name), np.empty((views, *array.shape[1:]), array.dtype))
                own[name] = stack[at : at + len(array)]
                own[name][:] = array
        return replace(record, **own)

    found, at = [], 0
    for part in parts:
        sure = part.uncertainty and placed(part.uncertainty, _ERRORS, at)
        found.append(replace(placed(part, _STACKED, at), uncertainty=sure))
        at += len(part.views)
    return found


def merged(
    parts: Sequence[RunResult], names: Sequence[str], notes: Sequence[Finding], seconds: Mapping[str, float]
) -> RunResult:
    """Return the record of all exposures; that of one alone if there is only one.

    Args:
        parts: Of each exposure, from one fit, `side_by_side`.
        names: Of the exposures.
        notes: Findings about all together.
        seconds: Wall-clock time of each stage, for all together.
    """
    if len(parts) == 1:
        return replace(parts[0], notes=(*notes, *parts[0].notes), seconds=dict(seconds)).check()
    first, sure = parts[0], [one.uncertainty for one in parts if one.uncertainty is not None]
    errors = {name: _whole([getattr(one, name) for one in sure]) for name in _ERRORS if sure}
    return RunResult(
        **{name: _whole([getattr(one, name) for one in parts]) for name in _STACKED if name != "exposed_views"},
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
        uncertainty=Uncertainty(**errors) if len(sure) == len(parts) else None,
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


def with_what_each_gave(result: RunResult) -> RunResult:
    """Return the record of all exposures, from `merged`, with what each of them alone shows, if it has depth."""
    if result.depth is None or not result.exposures:
        return result
    own = np.repeat(np.arange(len(result.exposures)), [one.views for one in result.exposures])
    views = ViewsTogether(result.depth, result.world_to_camera, result.intrinsics, result.distortion, own)
    each = zip(result.exposures, seen_alone(views), strict=True)
    return replace(result, exposures=tuple(replace(one, seen_alone=share) for one, share in each))


def _of_each(parts: Sequence[RunResult], names: Sequence[str]) -> Findings:
    """Return the findings of the exposures: those that all share once, the others with the name of their exposure."""
    shared = Counter(note for part in parts for note in {(note.code, note.sentence) for note in part.notes})
    found, told = [], set()
    for part, name in zip(parts, names, strict=True):
        for note in part.notes:
            key = (note.code, note.sentence)
            if shared[key] < len(parts):
                own = {
                    figure: value
                    for figure, value in note.figures.items()
                    if figure not in ("name", "sentence", "code")
                }
                found.append(finding(Code.OF_EXPOSURE, name=name, sentence=note.sentence, code=note.code, **own))
            elif key not in told:
                found.append(note)
                told.add(key)
    return tuple(found)


def _verdict(parts: Sequence[RunResult]) -> Verdict:
    """Return the verdict that all share, or that their views are combinations."""
    found = {one.verdict for one in parts}
    return found.pop() if len(found) == 1 else "refined"


def _rms(figures: Sequence[float | None]) -> float | None:
    known = [figure for figure in figures if figure is not None]
    return math.sqrt(float(np.mean(np.square(known)))) if known else None


def _brightness(parts: Sequence[RunResult]) -> list[float] | None:
    given = any(one.brightness for one in parts)
    return [factor for one in parts for factor in one.brightness or [1.0] * len(one.views)] if given else None


def _exposed(parts: Sequence[RunResult]) -> Any:
    given = [one.exposed_views for one in parts]
    if any(one is not None for one in given) and any(one is None for one in given):
        return np.concatenate([one.views if one.exposed_views is None else one.exposed_views for one in parts])
    return _whole(given)


def _whole(arrays: Sequence[NDArray[Any] | None]) -> Any:
    """Return the array of all exposures in which those of each lie; None unless there is one of each."""
    first = arrays[0]
    if first is None or any(array is None for array in arrays):
        return None
    if first.base is not None and len(first.base) == sum(len(array) for array in arrays if array is not None):
        return first.base
    return np.concatenate([array for array in arrays if array is not None])
