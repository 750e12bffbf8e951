"""`sweep`: plans of a rig file with one parameter varied. Not here: plans, regimes (`gs2ci_sims`)."""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from gs2ci.api.options import check_number, every
from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci.core.progress import Progress

if TYPE_CHECKING:
    from gs2ci_sims.simulation_plan import Plan
    from gs2ci_sims.sweeping import FigureSweep

DEFAULT_POINTS: Final = 9
MOST_POINTS: Final = 200
_RANGE: Final = "two numbers in the rig file's unit, the first below the second: NAME=0.1..10"
DECADE: Final = 10.0
"""By default a parameter is swept from a tenth of the file's value to ten times it."""


@dataclass(frozen=True)
class _Figure:
    """Meaning of a short name in one kind of rig file: a dotted key, and its unit."""

    key: str
    unit: str


# In the rig file of a simulation alone, and of a simulated bench.
SIMULATION_NAMES: Final = {
    "travel": _Figure("path.parallax_px", "px of parallax"),
    "mask_s": _Figure("timing.interval_s", "s"),
    "aperture": _Figure("effects.defocus.aperture", "scene units"),
}
TRAVEL_KEY: Final = "capture.to_mm - from_mm"
BENCH_NAMES: Final = {
    "travel": _Figure(TRAVEL_KEY, "mm"),
    "mask_s": _Figure("capture.mask_s", "s"),
    "aperture": _Figure("world.effects.defocus.aperture", "scene units"),
}


def sweep(
    rig: str | Path,
    quantities: Sequence[str],
    *,
    points: int = DEFAULT_POINTS,
    tolerance_dn: float | None = None,
    rays: bool = False,
    progress: Progress | None = None,
) -> "tuple[FigureSweep, ...]":
    """Find the value of a rig parameter from which each effect matters; nothing is exposed.

    Args:
        rig: The rig file (TOML) of a simulated bench or of a simulation alone.
        quantities: Each "NAME=LOW..HIGH" or "NAME": travel, mask_s, aperture, or a dotted key of the file such as
            effects.stage_vibration.amplitude. All others keep the file's values.
        points: Values per parameter, 2 to 200.
        tolerance_dn: Largest total error of the readings, DN rms; by default the rig file's.
        rays: Include the error of the rasteriser in each plan, and render Gaussians ray by ray if it is too large.
        progress: Receives each plan.

    Returns:
        One sweep per parameter.

    Raises:
        InputError: A parameter is not in the file's tables, is no number or has no range, a value cannot be planned, or
            a simulated bench with `rays`.

    Example:
        >>> (found,) = gs2ci.sweep("rig.toml", ["mask_s=0.02..0.04"], points=2)
        >>> found.values.tolist(), "shot_noise" in found.bounds_dn
        ([0.02, 0.04], True)
    """
    from gs2ci.api.plans import foreseen
    from gs2ci.core.config import read_toml
    from gs2ci.rig.config import describes_simulation
    from gs2ci_sims.sweeping import along, swept

    if not 2 <= points <= MOST_POINTS:
        raise InputError(f"--points {points}", allowed=f"2 to {MOST_POINTS}")
    rig = Path(rig)
    tables, _ = read_toml(rig)
    names = SIMULATION_NAMES if describes_simulation(tables) else BENCH_NAMES
    check_number("--tolerance-dn", tolerance_dn, above=0, remedy="leave --tolerance-dn out for the rig file's number")
    asked = []
    for text in every(quantities):
        name, _, span = text.partition("=")
        figure = names.get(name, _Figure(name, ""))
        own = _value_in_file(tables, figure.key)
        if own is None and "." not in figure.key:
            allowed = f"{', '.join(names)}, or a dotted key of the file, as capture.density"
            raise InputError(f"a sweep of {name!r}", allowed=allowed)
        low, high = _span(text, span, own)
        read = partial(_read, partial(foreseen, rig, tolerance_dn=tolerance_dn, rays=rays), tables, figure.key)
        values = along(low, high, points)
        values = np.unique(np.rint(values)) if _whole(read, values) else values
        for end in values[[0, -1]]:  # before any plan of any sweep is made
            read(float(end))
        plan_at = partial(_planned, read)
        asked.append(
            partial(swept, plan_at, values, quantity=name, key=figure.key, unit=figure.unit, own=own, progress=progress)
        )
    return tuple(one() for one in asked)


def _read(
    reader: "Callable[[Mapping[str, Any]], Callable[[], Plan]]", tables: Mapping[str, Any], key: str, value: float
) -> "Callable[[], Plan]":
    """Read the tables with one value changed; counts are whole numbers."""
    return reader(_with_value(tables, key, int(value) if value.is_integer() else value))


def _planned(read: "Callable[[float], Callable[[], Plan]]", value: float) -> "Plan":
    return read(value)()


def _whole(read: "Callable[[float], Callable[[], Plan]]", values: F64) -> bool:
    """Return whether a parameter takes only whole numbers.

    Raises:
        InputError: It takes no number at all.
    """
    fractional = float(values[0] + (values[-1] - values[0]) / math.e)
    try:
        read(fractional)
    except InputError:
        read(float(np.rint(fractional)))
        return True
    return False


def _span(text: str, span: str, own: float | None) -> tuple[float, float]:
    """Read a range; by default it goes from a tenth to ten times the file's value."""
    if not span:
        if not own or own < 0:
            raise InputError(f"a sweep of {text!r} without a range", remedy=f"give one: {text}=0.1..10")
        return own / DECADE, own * DECADE
    try:
        low, high = (float(end) for end in span.split(".."))
    except ValueError:
        raise InputError(f"the range {span!r} of a sweep", allowed=_RANGE) from None
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(f"a sweep from {low:g} to {high:g}", allowed="finite numbers, the first below the second")
    return low, high


def _value_in_file(tables: Mapping[str, Any], key: str) -> float | None:
    """Return the file's value of a key, None where it has none."""
    if key == TRAVEL_KEY:
        capture = tables.get("capture", {})
        return abs(float(capture.get("to_mm", 0.0)) - float(capture.get("from_mm", 0.0)))
    value: Any = tables
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"a sweep of {key}, which is {value!r}", allowed="a number of the rig file")
    return float(value)


def _with_value(tables: Mapping[str, Any], key: str, value: float) -> dict[str, Any]:
    """Return the tables with one value changed."""
    changed = copy.deepcopy(dict(tables))
    if key == TRAVEL_KEY:
        capture = changed.setdefault("capture", {})
        middle = 0.5 * (capture.get("from_mm", 0.0) + capture.get("to_mm", 0.0))
        capture.update(from_mm=middle - 0.5 * value, to_mm=middle + 0.5 * value)
        return changed
    *parents, last = key.split(".")
    table: Any = changed
    for depth, part in enumerate(parents, start=1):
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise InputError(
                f"a sweep of {key} within {'.'.join(parents[:depth])}, which is {table!r}", allowed="a table"
            )
    table[last] = value
    return changed
