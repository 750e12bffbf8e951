"""The best result within a number of seconds: which settings to run with, and the deadline of their fit.

Here: the plan, made from measured costs. Not here: the measuring (`gs2ci.reconstruct.costs`), keeping to the deadline
(`fit/pace.py`), reading `60s` (`gs2ci.core.durations`). The commands and `gs2ci.evaluate` import this file.

Decode, geometry and what follows the fit have their prices, and the fit gets the rest: as many iterations as fit, on
a schedule of that length. The costliest preset is taken for which enough iterations are left to be worth its price.
The fit then watches the clock and stretches or shortens its schedule, so that errors of the prediction cancel.
"""

import math
import time
from dataclasses import dataclass, replace
from typing import Final

from gs2ci.core.durations import spoken_duration
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.costs import CostModel, probe
from gs2ci.reconstruct.fit.pace import Deadline
from gs2ci.reconstruct.pipeline import Settings
from gs2ci.reconstruct.presets import PRESETS, PresetName, rescheduled


@dataclass(frozen=True)
class Rung:
    """A preset, the fewest iterations for which it is worth its price, and the most that it has a use for."""

    preset: PresetName
    least: int
    most: int


# From the costliest.
LADDER: Final = (Rung("fine", 1500, 3000), Rung("standard", 300, 1500), Rung("draft", 20, 300))
# Seconds are promised to a tenth; this share is kept back for what no model knows.
_KEPT_BACK: Final = 0.03


@dataclass(frozen=True)
class Plan:
    """What to run, and until when.

    Args:
        settings: Of every stage; the fit's iterations are those expected.
        pace: Ends the fit in time.
        preset: The preset that the settings derive from.
        sentence: What was decided, for the user.
    """

    settings: Settings
    pace: Deadline
    preset: PresetName
    sentence: str


def plan_within(
    budget_s: float,
    shot: Shot,
    base: Settings,
    *,
    report_s: float = 0.0,
    spent_s: float = 0.0,
    model: CostModel | None = None,
) -> Plan:
    """Choose settings whose reconstruction and report end within a budget.

    Args:
        budget_s: Seconds allowed in all.
        shot: The measurement.
        base: Settings that no preset changes: seed, poses and backend are taken from here.
        report_s: Seconds to keep for what the caller does with the result.
        spent_s: How much of the budget is gone already.
        model: Costs measured earlier on this shot; measured now if None.

    Raises:
        InputError: The budget does not suffice for the cheapest way; says what would.
    """
    began_s = time.monotonic() - spent_s
    model = model or probe(shot, base.backend)
    until_s = began_s + budget_s * (1 - _KEPT_BACK) - report_s
    left_s = until_s - time.monotonic()
    for rung in LADDER:
        settings = replace(PRESETS[rung.preset], seed=base.seed, poses=base.poses, backend=base.backend)
        iterations = affordable_iterations(model, settings, left_s, rung.most)
        if iterations >= rung.least:
            break
    else:
        raise _too_little(budget_s, budget_s - left_s, model, settings)
    settings = replace(settings, fit=rescheduled(settings.fit, iterations))
    predicted = model.predict(settings)
    pace = Deadline(
        most=rung.most,
        until_s=until_s,
        costs=lambda share: model.iteration_s(settings, share),
        look_s=model.look,
        look_every=settings.fit.hold_out.look_every,
    )
    sentence = (
        f"Of {spoken_duration(budget_s)}, {spoken_duration(max(0.0, left_s))} are left for preset {rung.preset}: expected are "
        f"decode {predicted.decode:.1f} s, geometry {predicted.geometry:.1f} s, "
        f"{iterations} iterations in {predicted.fit:.1f} s, the rest {predicted.finish + report_s:.1f} s."
    )
    return Plan(settings, pace, rung.preset, sentence)


def affordable_iterations(model: CostModel, settings: Settings, left_s: float, most: int) -> int:
    """Return the largest number of iterations, at most `most`, with which a reconstruction ends in time; 0: none."""
    low, high = 0, most
    while low < high:
        middle = (low + high + 1) // 2
        tried = replace(settings, fit=rescheduled(settings.fit, middle))
        if model.predict(tried).total <= left_s:
            low = middle
        else:
            high = middle - 1
    return low


def _too_little(budget_s: float, apart_s: float, model: CostModel, settings: Settings) -> InputError:
    """Say what the cheapest way would need.

    Args:
        budget_s: Seconds allowed.
        apart_s: Seconds of these that no stage gets: spent before the decode, kept for the report.
        model: Measured costs.
        settings: Of the cheapest way.
    """
    least = replace(settings, fit=rescheduled(settings.fit, LADDER[-1].least))
    cost = model.predict(least)
    needed_s = (cost.total + apart_s) / (1 - _KEPT_BACK)
    return InputError(
        f"{spoken_duration(budget_s)} are too little: starting, measuring this machine and the report take "
        f"{spoken_duration(apart_s)}, the decode {spoken_duration(cost.decode)}, geometry "
        f"{spoken_duration(cost.geometry)}, the shortest fit {spoken_duration(cost.fit + cost.finish)}",
        allowed=f"{math.ceil(needed_s)} s or more for this shot on this machine",
        remedy="`gs2ci decode` recovers the views alone, without a scene, in less",
    )
