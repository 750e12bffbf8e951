"""Why a plan simulates an effect or leaves it out: the bound's derivation with the rig's numbers, and the decision.

The steps are those that each effect's `bound` returns (`effects.base.BoundStep`); what the effect is and its law in
words are its docstrings'. Not here: the bounds (`effects`), the decision (`planner`), how it is printed.
"""

import inspect
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import BoundStep
from gs2ci_sims.light_path import light_path
from gs2ci_sims.simulation_plan import Decision, Plan

ALL = "all"
"""Stands for every effect of the rig."""


@dataclass(frozen=True)
class Explanation:
    """The derivation of one effect's bound, and what was decided on it.

    Args:
        name: The effect's.
        what: What the effect is, a sentence or two.
        law: What its bound is, in words.
        steps: How it follows, with this rig's numbers; the last is the bound.
        decision: What was decided.
        verdict: Why, with the figures that decided it.
    """

    name: str
    what: str
    law: str
    steps: tuple[BoundStep, ...]
    decision: Decision
    verdict: str

    def record(self) -> dict[str, Any]:
        """Return the explanation as plain data; a bound without limit reads "unavoidable"."""
        return {
            "effect": self.name,
            "what": self.what,
            "law": self.law,
            "steps": [{**asdict(step), "value": _plain(step.value)} for step in self.steps],
            "bound_rms_dn": _plain(self.decision.bound.rms_dn),
            "bound_peak_dn": _plain(self.decision.bound.peak_dn),
            "random": self.decision.bound.random,
            "simulated": self.decision.simulated,
            "why": self.decision.why,
            "verdict": self.verdict,
        }


def explain(plan: Plan, names: Sequence[str]) -> tuple[Explanation, ...]:
    """Explain what a plan says of some effects, in physical order.

    Args:
        plan: The plan.
        names: Of effects that the rig has; `ALL` for every one.

    Raises:
        InputError: The rig has no such effect.
    """
    decisions = {decision.name: decision for decision in plan.decisions}
    for name in names:
        if name not in decisions and name != ALL:
            raise InputError(
                f"no effect {name!r} on this rig to explain",
                allowed=", ".join((*decisions, ALL)),
                remedy=f"give the rig file a table [effects.{name}] to see what it would do"
                if name in {kind.name for kind in light_path(names)}
                else "",
            )
    return tuple(_explained(plan, one) for name, one in decisions.items() if name in names or ALL in names)


def _explained(plan: Plan, decision: Decision) -> Explanation:
    kind = next(kind for kind in light_path([decision.name]) if kind.name == decision.name)
    return Explanation(
        decision.name,
        _first_paragraph(kind.__doc__),
        _first_paragraph(kind.bound.__doc__),
        decision.bound.steps,
        decision,
        _verdict(plan, decision),
    )


def _verdict(plan: Plan, decision: Decision) -> str:
    """Say what the bound was held against."""
    state = "simulated" if decision.simulated else "left out"
    bound, limit = decision.bound.rms_dn, plan.omission_limit_dn
    if decision.why.startswith("forced"):
        return f"{state}: {decision.why}"
    if math.isinf(bound):
        return f"{state}: no tolerance is wide enough for what it decides"
    if decision.name == "motion_blur":
        return f"{state}: {decision.why}; views may be off by what else is left of {plan.tolerance_dn:.3g} DN"
    others = plan.omitted_dn(without=decision.name)
    together = plan.omitted_dn(including=decision)
    return (
        f"{state}: {decision.why}; all that is left out may change readings by {limit:.3g} DN rms "
        f"(half of the tolerance of {plan.tolerance_dn:.3g} DN): the others that are left out {others:.3g} DN, "
        f"with this one {together:.3g} DN"
    )


def _first_paragraph(text: str | None) -> str:
    return " ".join(inspect.cleandoc(text or "").split("\n\n", maxsplit=1)[0].split())


def _plain(value: float) -> float | str:
    return float(value) if math.isfinite(value) else "unavoidable"
