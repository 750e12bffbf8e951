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


def _without_points(settings: Settings) -> Settings:
    return replace(settings, withheld=replace(settings.withheld or Withheld(), points=True))


def _without_poses(settings: Settings) -> Settings:
    return replace(settings, withheld=replace(settings.withheld or Withheld(), poses=True))


def _without_opacity_split(settings: Settings) -> Settings:
    first, *second = (_unsplit(rule) for rule in settings.density_rules)
    return replace(settings, fit=replace(settings.fit, density=first), second_density=second[0] if second else None)


def _unsplit(density: DensityRule) -> DensityRule:
    if not isinstance(density, Osgr) or not density.opacity_splits:
        raise InputError(
            f"density rule {density.name!r} without its opacity splits", allowed="osgr, the rule that has them"
        )
    return replace(density, opacity_splits=False)


def _without_opacity_regulation(settings: Settings) -> Settings:
    return replace(settings, fit=replace(settings.fit, loss=replace(settings.fit.loss, opacity=0.0)))


def _without_count_cap(settings: Settings) -> Settings:
    # The paper's own runs without the cap ran out of memory; here the memory guard ends them with an error.
    most = settings.fit.most_gaussians or MOST_GAUSSIANS
    return replace(settings, fit=replace(settings.fit, cap_from=None, gaussians_per_pixel=None, most_gaussians=most))


def _without_pose_refinement(settings: Settings) -> Settings:
    return replace(settings, fit=replace(settings.fit, poses=replace(settings.fit.poses, refine=False)))


COMPONENTS: Final[dict[str, Callable[[Settings], Settings]]] = {
    "points": _without_points,
    "poses": _without_poses,
    "opacity-split": _without_opacity_split,
    "opacity-regulation": _without_opacity_regulation,
    "count-cap": _without_count_cap,
    "pose-refinement": _without_pose_refinement,
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
