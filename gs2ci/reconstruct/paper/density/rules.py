"""The density rules of the paper's comparison (Table VIII) beside its own, by name.

Here: the names, each with the terms of the objective that belong to it. Not here: the rules.
"""

from typing import Final

from gs2ci.reconstruct.fit.density.classic import Classic
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.rules import RuleChoice
from gs2ci.reconstruct.paper.density.mcmc import Mcmc
from gs2ci.reconstruct.paper.density.revised import Revised


def adc(criteria: Classic | None = None) -> Osgr:
    """Return adaptive density control of 3D Gaussian splatting (Kerbl et al. 2023, section 5.2; gsplat's defaults).

    It splits large and duplicates small Gaussians whose gradient is high, and removes those that are faint or huge:
    OSGR without what it adds. Copies and children keep the opacity of the one they come from, as in the original.
    """
    return Osgr(criteria or Classic(), opacity_splits=False, preserving="neither", name="adc")


RULES: Final[dict[str, RuleChoice]] = {
    "adc": RuleChoice(adc),
    "mcmc": RuleChoice(Mcmc, opacity=0.01, size=0.01),
    "revised": RuleChoice(Revised),
}
