"""At which value of a figure of the rig each effect begins to matter: plans along it, the regimes, and their picture.

An effect matters where its bound alone exceeds what all that is left out may change in sum (`Plan.omission_limit_dn`):
no plan can leave it out there. Not here: how a figure of a rig file is changed (`gs2ci.api.sweeps`), plans.
"""

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import F64, Bool
from gs2ci.core.progress import Progress, Silent
from gs2ci_sims.simulation_plan import Plan

# Decades of bound over limit that the picture's colours tell apart, either way.
DECADES: Final = 3.0
# From this ratio of its ends on, a range is drawn on a logarithmic scale.
LOG_FROM: Final = 8.0


@dataclass(frozen=True)
class FigureSweep:
    """Plans along one figure of a rig, all others as the file has them.

    Args:
        quantity: As it was asked for.
        key: What it is in the rig file.
        unit: Of the values.
        values: At which plans were made, increasing, [P].
        own: The file's value; None where it has none.
        bounds_dn: Of each effect, in physical order, DN rms, [P]; infinite where it cannot be left out.
        limits_dn: What all effects that are left out may change in sum, DN rms, [P].
        views: How many are rendered, [P].
    """

    quantity: str
    key: str
    unit: str
    values: F64
    own: float | None
    bounds_dn: dict[str, F64]
    limits_dn: F64
    views: tuple[int, ...]

    def matters(self, effect: str) -> Bool:
        """Return at which of the values an effect cannot be left out, [P]."""
        return np.asarray(self.bounds_dn[effect] > self.limits_dn)

    def regimes(self, effect: str) -> tuple[tuple[float, float], ...]:
        """Return the ranges of values in which an effect matters.

        Between two values the ratio of bound and limit is taken for a power of the value (for an exponential of it
        where values are not positive), and for a millionth at least. A range that reaches an end of the sweep is
        taken to go on: to -inf or inf.
        """
        ratio = self.bounds_dn[effect] / self.limits_dn
        inside = self.matters(effect)
        edges: list[float] = [-math.inf] if inside[0] else []
        for left in np.flatnonzero(np.diff(inside.astype(int))):
            edges.append(_crossing(self.values[left : left + 2], ratio[left : left + 2]))
        if inside[-1]:
            edges.append(math.inf)
        return tuple(zip(edges[::2], edges[1::2], strict=True))

    def record(self) -> dict[str, Any]:
        """Return the sweep as plain data; ends of a range that the sweep did not reach are None."""

        def plain(number: float) -> float | None:
            return number if math.isfinite(number) else None

        return {
            "quantity": self.quantity,
            "key": self.key,
            "unit": self.unit,
            "values": self.values.tolist(),
            "own": self.own,
            "views": list(self.views),
            "limits_dn": self.limits_dn.tolist(),
            "effects": {
                name: {
                    "bounds_dn": [plain(float(bound)) for bound in bounds],
                    "matters": [[plain(low), plain(high)] for low, high in self.regimes(name)],
                }
                for name, bounds in self.bounds_dn.items()
            },
        }


def swept(
    plan_at: Callable[[float], Plan],
    values: F64,
    *,
    quantity: str,
    key: str,
    unit: str,
    own: float | None,
    progress: Progress | None = None,
) -> FigureSweep:
    """Plan at each of the values.

    Args:
        plan_at: Makes the plan for a value.
        values: Increasing, [P], two or more.
        quantity: For the `FigureSweep`, as are those below.
        key: As above.
        unit: As above.
        own: As above.
        progress: Hears about each plan.
    """
    progress = progress or Silent()
    progress.stage(f"plans along {quantity}", len(values))
    plans = []
    for done, value in enumerate(values):
        plans.append(plan_at(float(value)))
        progress.step(done + 1)
    names = [decision.name for decision in plans[0].decisions]
    bounds = np.array([[decision.bound.rms_dn for decision in plan.decisions] for plan in plans])
    return FigureSweep(
        quantity,
        key,
        unit,
        values,
        own,
        dict(zip(names, bounds.T, strict=True)),
        np.array([plan.omission_limit_dn for plan in plans]),
        tuple(plan.views for plan in plans),
    )


def along(low: float, high: float, points: int) -> F64:
    """Return values from low to high, evenly or, where the range is wide and positive, in equal ratios, [points]."""
    if low > 0 and high >= LOG_FROM * low:
        return np.geomspace(low, high, points)
    return np.linspace(low, high, points)


def _crossing(values: F64, ratio: F64) -> float:
    """Return where a ratio passes 1 between two values."""
    bottom, top = np.log10(_within_scale(ratio))
    ends = _scaled(values)
    place = ends[0] - bottom / (top - bottom) * (ends[1] - ends[0])
    return float(np.exp(place) if values[0] > 0 else place)


def _within_scale(ratio: F64) -> F64:
    """Return ratios within what the picture's colours tell apart, twice over: a bound of nothing has no logarithm."""
    return np.clip(ratio, 10.0 ** (-2 * DECADES), 10.0 ** (2 * DECADES))


def _scaled(values: F64) -> F64:
    return np.log(values) if values[0] > 0 else values


def picture(sweeps: Sequence[FigureSweep]) -> bytes:
    """Draw the map of regimes as PNG: a panel per sweep, a row per effect, coloured by its bound over the limit.

    Red: it matters; blue: it may be left out; the line is where one turns into the other. Dashed: the file's value.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415  only where somebody looks

    names = list(dict.fromkeys(name for one in sweeps for name in one.bounds_dn))
    figure = Figure(figsize=(2.2 + 3.6 * len(sweeps), 1.3 + 0.24 * len(names)), layout="constrained")
    panels = figure.subplots(1, len(sweeps), squeeze=False, sharey=True)[0]
    image = None
    for axes, one in zip(panels, sweeps, strict=True):
        # Fine enough that ranges end where `regimes` says.
        fine = np.unique(np.concatenate([along(one.values[0], one.values[-1], 240), one.values]))
        rows = np.full((len(names), len(fine)), np.nan)
        for place, name in enumerate(names):
            if name in one.bounds_dn:
                ratio = np.log10(_within_scale(one.bounds_dn[name] / one.limits_dn))
                rows[place] = np.interp(_scaled(fine), _scaled(one.values), ratio)
        image = axes.pcolormesh(
            fine, np.arange(len(names)), rows, cmap="RdBu_r", vmin=-DECADES, vmax=DECADES, shading="nearest"
        )
        for place, name in enumerate(names):
            for edge in (edge for ends in one.regimes(name) for edge in ends if math.isfinite(edge)):
                axes.plot([edge, edge], [place - 0.5, place + 0.5], color="black", linewidth=2)
        if one.own is not None and one.values[0] <= one.own <= one.values[-1]:
            axes.axvline(one.own, color="black", linestyle="--", linewidth=1)
        logarithmic = one.values[0] > 0 and one.values[-1] >= LOG_FROM * one.values[0]
        axes.set(
            xscale="log" if logarithmic else "linear", xlabel=f"{one.quantity} ({one.unit})" if one.unit else one.key
        )
        axes.set_yticks(np.arange(len(names)), names, fontsize=8)
    panels[0].invert_yaxis()
    assert image is not None
    bar = figure.colorbar(image, ax=list(panels), ticks=[-3, -2, -1, 0, 1, 2, 3])
    bar.set_label("log10 of bound / limit; above 0 it matters")
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()
