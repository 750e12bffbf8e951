"""Density rules by name, each with the terms of the objective that belong to it.

Here: the choice. Not here: the rules (`density/`, `gs2ci.reconstruct.paper.density`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

from gs2ci.core.errors import InputError
from gs2ci.core.plugins import PluginError, allowed, load
from gs2ci.reconstruct.choices import RULE_NAMES
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.density.base import DensityRule
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.paper_parts import PaperPart, paper_part


@dataclass(frozen=True)
class RuleChoice:
    """A rule, and the weights of mean opacity and mean size that its authors put into the loss.

    An entry point of the group `gs2ci.density_rules` is one of these; its rule's name is the entry point's.
    """

    rule: Callable[[], DensityRule]
    opacity: float = 0.0
    size: float = 0.0


_RULES: Final[dict[str, RuleChoice]] = {
    "osgr": RuleChoice(Osgr.sparing, opacity=0.01),
}
RULE_GROUP: Final = "gs2ci.density_rules"


def with_rule(settings: CoarseSettings, name: str) -> CoarseSettings:
    """Return settings with the density rule of a name; the same settings if they have it already.

    The comparison of the paper's Table VIII uses this: everything else is unchanged.

    Raises:
        InputError: There is no rule of that name, or a plug-in's cannot be used.
    """
    if settings.density.name == name:
        return settings
    choice = _RULES.get(name)
    if choice is None:
        choice = paper_part(PaperPart.DENSITY_RULES)[name] if name in RULE_NAMES else _plugged(name)
    loss = replace(settings.loss, opacity=choice.opacity, size=choice.size)
    return replace(settings, density=choice.rule(), loss=loss)


def _plugged(name: str) -> RuleChoice:
    found = load(RULE_GROUP, name)
    if found is None:
        raise InputError(f"no density rule {name!r}", allowed=allowed(RULE_GROUP, RULE_NAMES))
    if not isinstance(found, RuleChoice) or found.rule().name != name:
        raise PluginError(
            f"the plug-in {name!r} is not a density rule", allowed=f"a {__name__}.RuleChoice whose rule has that name"
        )
    return found
