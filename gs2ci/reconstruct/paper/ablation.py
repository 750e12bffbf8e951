"""The components of the method, each of which can be switched off by name (paper, Table VII).

Here: the names, and how switching off changes the settings. Not here: what a component is (its stage's own file), the
table (docs/tables.md).
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Final

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.fit.density.base import DensityRule
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.withheld import Withheld
from gs2ci.reconstruct.paper.preset import MOST_GAUSSIANS
from gs2ci.reconstruct.settings import Settings

_Without = Callable[[Settings], Settings]


def _withheld(what: str) -> _Without:
    return lambda settings: replace(settings, withheld=replace(settings.withheld or Withheld(), **{what: True}))


def _without_opacity_split(settings: Settings) -> Settings:
    first, *second = (_unsplit(rule) for rule in settings.density_rules)
    return replace(settings, fit=replace(settings.fit, density=first), second_density=second[0] if second else None)


def _unsplit(density: DensityRule) -> DensityRule:
    if not isinstance(density, Osgr) or not density.opacity_splits:
        raise InputError(
            f"density rule {density.name!r} without its opacity splits", allowed="osgr, the rule that has them"
        )
    return replace(density, opacity_splits=False)


def _without_count_cap(settings: Settings) -> Settings:
    # The paper's own runs without the cap ran out of memory; here the memory guard ends them with an error.
    most = settings.fit.most_gaussians or MOST_GAUSSIANS
    return replace(settings, fit=replace(settings.fit, cap_from=None, gaussians_per_pixel=None, most_gaussians=most))


def _of_fit(part: str, field: str, off: float) -> _Without:
    """Set a field of a part of the fit's settings."""
    return lambda settings: replace(
        settings, fit=replace(settings.fit, **{part: replace(getattr(settings.fit, part), **{field: off})})
    )


COMPONENTS: Final[dict[str, _Without]] = {
    "points": _withheld("points"),
    "poses": _withheld("poses"),
    "opacity-split": _without_opacity_split,
    "opacity-regulation": _of_fit("loss", "opacity", 0.0),
    "count-cap": _without_count_cap,
    "pose-refinement": _of_fit("poses", "refine", False),
}
"""By component, in the order of the paper's table: the function that returns settings without it."""


def without(settings: Settings, names: Iterable[str]) -> Settings:
    """Return settings with the named components switched off.

    Raises:
        InputError: There is no component of that name, or the settings do not have it.
    """
    for name in names:
        if name not in COMPONENTS:
            raise InputError(f"no component {name!r}", allowed=", ".join(COMPONENTS))
        settings = COMPONENTS[name](settings)
    return settings
