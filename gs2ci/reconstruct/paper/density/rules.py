"""The density rules of the paper's comparison (Table VIII) beside its own, by name.

Here: the names, each with the terms of the objective that belong to it. Not here: the rules.
"""

from typing import Final

from gs2ci.reconstruct.fit.rules import RuleChoice
from gs2ci.reconstruct.paper.density.adc import Adc
from gs2ci.reconstruct.paper.density.mcmc import Mcmc
from gs2ci.reconstruct.paper.density.revised import Revised

RULES: Final[dict[str, RuleChoice]] = {
    "adc": RuleChoice(Adc),
    "mcmc": RuleChoice(Mcmc, opacity=0.01, size=0.01),
    "revised": RuleChoice(Revised),
}
