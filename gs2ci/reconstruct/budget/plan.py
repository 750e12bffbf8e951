"""The best result within a number of seconds: which settings to run with, and the deadline of their fit.

Here: the plan, made from measured costs. Not here: the measuring (`gs2ci.reconstruct.budget.costs`), keeping to the
deadline (`fit/pace.py`), reading `60s` (`gs2ci.core.durations`).

Decode, geometry and what follows the fit have their prices, and the fit gets the rest: as many iterations as fit, on
a schedule of that length. The costliest preset is taken for which enough iterations are left to be worth its price.
The fit then watches the clock and stretches or shortens its schedule, so that errors of the prediction cancel.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

from gs2ci.core.durations import spoken_duration
from gs2ci.core.errors import InputError
from gs2ci.reconstruct.budget.costs import CostModel
from gs2ci.reconstruct.choices import PresetName
from gs2ci.reconstruct.fit.pace import Deadline
from gs2ci.reconstruct.presets import PRESETS, rescheduled
from gs2ci.reconstruct.settings import Settings

Adapt = Callable[[Settings], Settings]


@dataclass(frozen=True)
class Rung:
    """A preset, the fewest iterations for which it is worth its price, and the most that it has a use for."""

    preset: PresetName
    least: int
    most: int


# From the costliest. `paper` is none of them: it is there to be faithful, and has nothing to be judged by.
LADDER: Final = (Rung("fine", 250, 800), Rung("standard", 80, 800), Rung("draft", 20, 600))
# Seconds are promised to a tenth; this share is kept back for what no model knows.
KEPT_BACK: Final = 0.05
# Closing files, printing, the interpreter's end.
_ENDING_S: Final = 0.5


@dataclass(frozen=True)
class BudgetPlan:
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
    model: CostModel,
    *,
    report_s: float = 0.0,
    spent_s: float = 0.0,
    adapt: Adapt = lambda settings: settings,
    clock: Callable[[], float] = time.monotonic,
) -> BudgetPlan:
    """Choose settings whose reconstruction and report end within a budget.

    Args:
        budget_s: Seconds allowed in all.
        model: What the shot costs on this machine (`gs2ci.reconstruct.budget.costs.probe`).
        report_s: Seconds to keep for what the caller does with the result.
        spent_s: How much of the budget is gone already.
        adapt: Brings what no preset decides (seed, poses, density rule) into the settings of one.
        clock: The time in seconds; never decreases.

    Raises:
        InputError: The budget does not suffice for the cheapest way; says what would.
    """
    now_s = clock()
    left_s = budget_s * (1 - KEPT_BACK) - _ENDING_S - report_s - spent_s
    for rung in LADDER:
        # The fine stage keeps to no deadline, and its gain is small: the coarse stage gets its time.
        settings = replace(adapt(PRESETS[rung.preset]), fine=None)
        iterations = affordable_iterations(model, settings, left_s, rung.most)
        if iterations >= rung.least:
            break
    else:
        raise _too_little(budget_s, spent_s, report_s, model, settings)
    settings = replace(settings, fit=rescheduled(settings.fit, iterations))
    pace = Deadline(
        most=rung.most,
        until_s=now_s + left_s,
        costs=lambda share: model.iteration_s(settings, share),
        look_s=model.look,
        look_every=settings.fit.hold_out.look_every,
        clock=clock,
    )
    cost = model.predict(settings)
    sentence = (
        f"Of {spoken_duration(budget_s)}, {spoken_duration(left_s)} are left for preset {rung.preset}: expected are "
        f"{spoken_duration(cost.decode)} of decode, {spoken_duration(cost.geometry)} of geometry, {iterations} "
        f"iterations in {spoken_duration(cost.fit)}, and {spoken_duration(cost.finish + report_s)} to end and report."
    )
    return BudgetPlan(settings, pace, rung.preset, sentence)


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


def _too_little(budget_s: float, spent_s: float, report_s: float, model: CostModel, settings: Settings) -> InputError:
    """Say what the cheapest way would need."""
    cost = model.predict(replace(settings, fit=rescheduled(settings.fit, LADDER[-1].least)))
    needed_s = (cost.total + spent_s + report_s + _ENDING_S) / (1 - KEPT_BACK)
    return InputError(
        f"{spoken_duration(budget_s)} are too little: starting and measuring this machine took "
        f"{spoken_duration(spent_s)}, the decode takes {spoken_duration(cost.decode)}, geometry "
        f"{spoken_duration(cost.geometry)}, the shortest fit {spoken_duration(cost.fit + cost.finish)}, the report "
        f"{spoken_duration(report_s)}",
        allowed=f"{math.ceil(needed_s)} s or more for this shot on this machine",
        remedy="`gs2ci decode` recovers the views alone, without a scene, in less",
    )
