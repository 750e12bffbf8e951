"""Density rules by name, each with the terms of the objective that belong to it.

Here: the choice. Not here: the rules (`density/`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.fit.coarse import CoarseSettings
from gs2ci.reconstruct.fit.density.adc import Adc
from gs2ci.reconstruct.fit.density.base import DensityRule
from gs2ci.reconstruct.fit.density.mcmc import Mcmc
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.density.revised import Revised


@dataclass(frozen=True)
class _Choice:
    """A rule, and the weights of mean opacity and mean size that its authors put into the loss."""

    rule: Callable[[], DensityRule]
    opacity: float = 0.0
    size: float = 0.0


_RULES: Final[dict[str, _Choice]] = {
    "osgr": _Choice(Osgr.sparing, opacity=0.01),
    "adc": _Choice(Adc),
    "mcmc": _Choice(Mcmc, opacity=0.01, size=0.01),
    "revised": _Choice(Revised),
}
RULE_NAMES: Final = tuple(_RULES)


def with_rule(settings: CoarseSettings, name: str) -> CoarseSettings:
    """Return settings with the density rule of a name, unless they have it already.

    The comparison of the paper's Table VIII is made with this: everything else stays as it is.

    Raises:
        InputError: There is no rule of that name.
    """
    if name not in _RULES:
        raise InputError(f"no density rule {name!r}", allowed=", ".join(RULE_NAMES))
    if settings.density.name == name:
        return settings
    choice = _RULES[name]
    loss = replace(settings.loss, opacity=choice.opacity, size=choice.size)
    return replace(settings, density=choice.rule(), loss=loss)
