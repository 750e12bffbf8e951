"""Which pictures of a run its page shows, and their colours, all within one budget of bytes.

Not here: encoding (`pictures.py`), the page (`run_page.py`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64, U8
from gs2ci.evaluate.pages.pictures import (
    Picture,
    colour,
    encode_all,
    is_pixel_art,
    scale_strip,
    to_eight_bit,
)
from gs2ci.evaluate.pages.run_evidence import FinishedRun
from gs2ci.evaluate.scales import error_ceiling, inverse_depth_limits
from gs2ci.evaluate.wording import describe_number, told_apart

# With more views than this, all of them would be small; the views shown are equally spaced over the exposure.
MOST_VIEWS: Final = 16
TICKS: Final = 5

_Coloured = tuple[list[U8], list[str], float]
"""Coloured maps, the ticks of their scale, and its upper end."""


@dataclass(frozen=True)
class ComparisonLayer:
    """Pictures to compare the recovered views with; it has none for the measurement, which all views share."""

    name: str
    label: str
    alt: str
    pictures: Sequence[Picture]


@dataclass(frozen=True)
class Map:
    """A coloured map for each view, with its scale, whose last tick is at `most`, in a unit."""

    label: str
    caption: str
    pictures: Sequence[Picture]
    picture: Picture
    ticks: Sequence[str]
    most: float = 0.0
    unit: str = ""


@dataclass(frozen=True)
class RunPictures:
    """All pictures of a page.

    Args:
        indices: Indices of the views shown.
        count: How many views there are.
        start: Which of the views shown is shown first.
        pixelated: Whether they are so small that they are shown pixel by pixel.
        recovered: The recovered views.
        layers: What they can be compared with, at least one.
        measurement: The measurement, or None if the folder does not have it.
        depth: Depth, or None if none was found.
        error: Error, or None if the truth is not known.
        disagreement: Difference between fits, or None if there was one fit.
        views_error: Standard error of the views, or None if the run has none.
        depth_error: Standard error of depth as a share of it, in per cent, or None likewise.
    """

    indices: Sequence[int]
    count: int
    start: int
    pixelated: bool
    recovered: Sequence[Picture]
    layers: Sequence[ComparisonLayer]
    measurement: Picture | None
    depth: Map | None
    error: Map | None
    disagreement: Map | None
    views_error: Map | None = None
    depth_error: Map | None = None

    @property
    def all_shown(self) -> bool:
        """Return whether every view is shown."""
        return len(self.indices) == self.count


def collect_pictures(evidence: FinishedRun) -> RunPictures:
    """Choose, colour and encode the pictures of a run's page."""
    count = len(evidence.views)
    indices = np.unique(np.linspace(0, count - 1, min(count, MOST_VIEWS)).round().astype(int)).tolist()
    stacks: dict[str, list[U8]] = {
        "recovered": [to_eight_bit(evidence.views[i]) for i in indices],
        "decode": [to_eight_bit(evidence.decode[i]) for i in indices],
    }
    if evidence.report.verdict == "refined":
        stacks["scene"] = [to_eight_bit(evidence.scene_views[i]) for i in indices]
    if evidence.true_views is not None:
        stacks["truth"] = [evidence.true_views[i] for i in indices]
    if evidence.measurement is not None:
        stacks["measurement"] = [evidence.measurement]
    maps = {
        "depth": _depth(evidence, indices),
        "error": _error(evidence, indices),
        "disagreement": _disagreement(evidence, indices),
        "views_error": _views_error(evidence, indices),
        "depth_error": _depth_error(evidence, indices),
    }
    ceilings = {name: found[2] for name, found in maps.items() if found is not None}
    stacks |= {name: found[0] for name, found in maps.items() if found is not None}
    encoded = encode_all(stacks)

    def shown(name: str, label: str, caption: str, unit: str = "") -> Map | None:
        found = maps[name]
        if found is None:
            return None
        return Map(label, caption, encoded[name], scale_strip(name), found[1], ceilings[name], unit)

    return RunPictures(
        indices=indices,
        count=count,
        start=len(indices) // 2,
        pixelated=is_pixel_art((evidence.views.shape[1], evidence.views.shape[2])),
        recovered=encoded["recovered"],
        layers=_layers(encoded, evidence.report.verdict),
        measurement=encoded["measurement"][0] if "measurement" in encoded else None,
        depth=shown("depth", "Depth", _DEPTH),
        error=shown("error", "Error", _ERROR),
        disagreement=shown("disagreement", "Disagreement", _DISAGREEMENT),
        views_error=shown("views_error", "Standard error of the view", _VIEWS_ERROR),
        depth_error=shown("depth_error", "Standard error of depth", _DEPTH_ERROR, " %"),
    )


_DEPTH: Final = (
    "Depth along the optical axis, in the unit of the path, colours linear in inverse depth; grey: no depth."
)
_ERROR: Final = "Error: mean over the colours of |recovered − true|, full scale 1."
_DISAGREEMENT: Final = (
    "Difference between the fits' views and their mean, full scale 1: where it is high, the measurement is ambiguous "
    "and the error is larger than elsewhere; it does not measure the error itself."
)


_VIEWS_ERROR: Final = "Standard error of the view's values, full scale 1: about 68 % of them are off by less."
_DEPTH_ERROR: Final = "Standard error of depth, in per cent of it; where there is no depth, the largest."


def _layers(encoded: dict[str, list[Picture]], verdict: str) -> list[ComparisonLayer]:
    wanted = [
        ComparisonLayer("decode", "Decode", "decoded without a scene", encoded["decode"]),
        ComparisonLayer("measurement", "Measurement", "the coded measurement", ()),
        ComparisonLayer("scene", "Scene alone", "the scene alone, unrefined", encoded.get("scene", ())),
        ComparisonLayer("truth", "Truth", "the true view", encoded.get("truth", ())),
    ]
    found = [layer for layer in wanted if layer.name in encoded]
    # If the decode is the result, comparing it with itself is useless, unless there is nothing else.
    rest = [layer for layer in found if layer.name != "decode"]
    return rest if verdict == "decode" and rest else found


def _depth(evidence: FinishedRun, indices: Sequence[int]) -> _Coloured | None:
    """Colour depth by its inverse; one scale for all views."""
    if evidence.depth is None:
        return None
    depth = np.stack([evidence.depth[i] for i in indices]).astype(np.float64)
    empty = ~(np.isfinite(depth) & (depth > 0))
    if empty.all():
        return None
    inverse = 1 / np.where(empty, 1.0, depth)
    low, high = inverse_depth_limits(inverse[~empty])
    ticks = told_apart([float(1 / value) for value in np.linspace(low, high, TICKS)], describe_number)
    return list(colour(inverse, (low, high), "depth", empty=empty)), ticks, high


def _error(evidence: FinishedRun, indices: Sequence[int]) -> _Coloured | None:
    if evidence.true_views is None:
        return None
    return _from_zero(np.stack([_absolute_error(evidence.views[i], evidence.true_views[i]) for i in indices]), "error")


def _disagreement(evidence: FinishedRun, indices: Sequence[int]) -> _Coloured | None:
    if evidence.disagreement is None:
        return None
    values = np.stack([evidence.disagreement[i] for i in indices]).astype(np.float64)
    return _from_zero(np.nan_to_num(values), "disagreement")


def _views_error(evidence: FinishedRun, indices: Sequence[int]) -> _Coloured | None:
    if evidence.views_error is None:
        return None
    return _from_zero(np.stack([evidence.views_error[i] for i in indices]).astype(np.float64), "views_error")


def _depth_error(evidence: FinishedRun, indices: Sequence[int]) -> _Coloured | None:
    if evidence.depth_error is None or evidence.depth is None:
        return None
    depth, errors = (
        np.stack([values[i] for i in indices]).astype(np.float64) for values in (evidence.depth, evidence.depth_error)
    )
    there = depth > 0
    percent = np.where(there, 100 * errors / np.where(there, depth, 1), 0)
    return _from_zero(np.where(there, percent, percent.max()), "depth_error")


def _from_zero(values: F64, name: str) -> _Coloured:
    """Colour a quantity of which smaller is better; one scale for all views, which begins at zero."""
    ceiling = error_ceiling(values)
    ticks = told_apart(np.linspace(0, ceiling, TICKS).tolist(), describe_number)
    return list(colour(values, (0.0, ceiling), name, empty=np.zeros(values.shape, bool))), ticks, ceiling


def _absolute_error(view: NDArray[Any], truth: U8) -> F64:
    """Average |view − truth| over the colours, [H, W]; a mono truth stands for all three."""
    difference = np.clip(view, 0, 1).astype(np.float64) - truth / 255
    return np.asarray(np.abs(difference).mean(-1), np.float64)
