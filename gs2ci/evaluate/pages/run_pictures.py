"""Which pictures of a run its page shows, and their colours, all within one budget of bytes.

Not here: encoding (`pictures.py`), the page (`run_page.py`).
"""

from collections.abc import Mapping, Sequence
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

# Names, captions and units of the maps.
MAPS: Final = {
    "depth": (
        "Depth",
        "Depth along the optical axis, in the unit of the path, colours linear in inverse depth; grey: no depth.",
        "",
    ),
    "error": ("Error", "Error: mean over the colours of |recovered − true|, full scale 1.", ""),
    "disagreement": (
        "Disagreement",
        "Difference between the fits' views and their mean, full scale 1: where it is high, the measurement is "
        "ambiguous and the error is larger than elsewhere; it does not measure the error itself.",
        "",
    ),
    "views_error": (
        "Standard error of the view",
        "Standard error of the view's values, full scale 1: about 68 % of them are off by less.",
        "",
    ),
    "depth_error": (
        "Standard error of depth",
        "Standard error of depth, in per cent of it; where there is no depth, the largest.",
        " %",
    ),
}

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
    most: float
    unit: str


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
        maps: Those of `MAPS` that the run has.
    """

    indices: Sequence[int]
    count: int
    start: int
    pixelated: bool
    recovered: Sequence[Picture]
    layers: Sequence[ComparisonLayer]
    measurement: Picture | None
    maps: Mapping[str, Map]

    @property
    def numbered(self) -> dict[str, Any]:
        """Get what a piece that shows them view by view is told: the views' numbers, from 1, and the first shown."""
        return {"views": [index + 1 for index in self.indices], "start": self.start}

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
    maps = {name: _from_zero(values, name) for name, values in _errors(evidence, indices).items()}
    if (depth := _depth(evidence, indices)) is not None:
        maps = {"depth": depth, **maps}
    encoded = encode_all(stacks | {name: coloured for name, (coloured, _, _) in maps.items()})
    return RunPictures(
        indices=indices,
        count=count,
        start=len(indices) // 2,
        pixelated=is_pixel_art((evidence.views.shape[1], evidence.views.shape[2])),
        recovered=encoded["recovered"],
        layers=_layers(encoded, evidence.report.verdict),
        measurement=encoded["measurement"][0] if "measurement" in encoded else None,
        maps={
            name: Map(label, caption, encoded[name], scale_strip(name), maps[name][1], maps[name][2], unit)
            for name, (label, caption, unit) in MAPS.items()
            if name in maps
        },
    )


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
    depth = np.asarray(evidence.depth[indices], np.float64)
    empty = ~(np.isfinite(depth) & (depth > 0))
    if empty.all():
        return None
    inverse = 1 / np.where(empty, 1.0, depth)
    low, high = inverse_depth_limits(inverse[~empty])
    ticks = told_apart([float(1 / value) for value in np.linspace(low, high, TICKS)], describe_number)
    return list(colour(inverse, (low, high), "depth", empty=empty)), ticks, high


def _errors(evidence: FinishedRun, indices: Sequence[int]) -> dict[str, F64]:
    """Return the maps of which smaller is better, [V, H, W] each, as far as the run has them."""

    def chosen(values: NDArray[Any]) -> F64:
        return np.asarray(values[indices], np.float64)

    found = {}
    if evidence.true_views is not None:
        # A mono truth stands for all three colours.
        off = np.clip(chosen(evidence.views), 0, 1) - chosen(evidence.true_views) / 255
        found["error"] = np.abs(off).mean(-1)
    if evidence.disagreement is not None:
        found["disagreement"] = np.nan_to_num(chosen(evidence.disagreement))
    if evidence.views_error is not None:
        found["views_error"] = chosen(evidence.views_error)
    if evidence.depth_error is not None and evidence.depth is not None:
        depth = chosen(evidence.depth)
        there = depth > 0
        percent = np.where(there, 100 * chosen(evidence.depth_error) / np.where(there, depth, 1), 0)
        found["depth_error"] = np.where(there, percent, percent.max())
    return found


def _from_zero(values: F64, name: str) -> _Coloured:
    """Colour a quantity of which smaller is better; one scale for all views, which begins at zero."""
    ceiling = error_ceiling(values)
    ticks = told_apart(np.linspace(0, ceiling, TICKS).tolist(), describe_number)
    return list(colour(values, (0.0, ceiling), name, empty=np.zeros(values.shape, bool))), ticks, ceiling
