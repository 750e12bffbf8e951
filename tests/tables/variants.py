"""Named changes to the settings of a reconstruction, which tables compare.

The default is the mean of two fits. A line with one change makes it to a single fit, and has to be compared with the
line `one fit`: this shows the effect of the change at two thirds of the cost.

Here: the names, and the settings that belong to a name. Not here: the effect of a setting.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Final

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.choices import RULE_NAMES, ProxyName
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.mechanisms import MECHANISMS
from gs2ci.reconstruct.paper.fine import FineSettings
from gs2ci.reconstruct.paper.preset import COMPONENTS, paper_settings, without
from gs2ci.reconstruct.settings import Settings

Change = Callable[[Settings], Settings]


def _one_fit(settings: Settings) -> Settings:
    return replace(settings, fits=1)


def _one_fit_with(settings: Settings, **changes: Any) -> Settings:
    return replace(_one_fit(settings), **changes)


def _with_rule(name: str, settings: Settings) -> Settings:
    return _one_fit(settings).with_density_rule(name)


def _paper(settings: Settings) -> Settings:
    return replace(paper_settings(), seed=settings.seed)


def _paper_fine(settings: Settings) -> Settings:
    paper = _paper(settings)
    return replace(paper, fine=paper.fine_if_asked)


def _scisplat(settings: Settings) -> Settings:
    paper = replace(_paper(settings), proxy="eni", poses="tracks")
    return paper.with_density_rule("mcmc")


def _with_proxy(name: ProxyName, settings: Settings) -> Settings:
    return replace(settings, proxy=name)


def _on_papers_schedule(change: Change, settings: Settings) -> Settings:
    return change(_paper(settings))


def _bounded_at(iteration: int, paper: Settings) -> Settings:
    return replace(paper, fit=replace(paper.fit, cap_from=iteration / paper.fit.iterations))


def _with_opacities_kept(paper: Settings) -> Settings:
    density = paper.fit.density
    assert isinstance(density, Osgr)
    return replace(paper, fit=replace(paper.fit, density=replace(density, preserving="neither")))


def _without(names: tuple[str, ...], settings: Settings) -> Settings:
    return without(_one_fit(settings), names)


def _one_fit_without(change: Change, settings: Settings) -> Settings:
    return change(_one_fit(settings))


def _with_osgr(density: Osgr, settings: Settings) -> Settings:
    return _one_fit_with(settings, fit=replace(settings.fit, density=density))


RULES: Final[dict[str, Change]] = {
    "osgr by the book": partial(_with_osgr, Osgr()),
    **{name: partial(_with_rule, name) for name in RULE_NAMES if name != Settings().fit.density.name},
}
"""OSGR with the criteria of the literature, and the other density rules, on the default's schedule."""

ABLATION: Final[dict[str, Change]] = {
    **{f"without {name}": partial(_without, (name,)) for name in COMPONENTS},
    "without all six": partial(_without, tuple(COMPONENTS)),
}
"""One fit without a component, by its name in `gs2ci.reconstruct.paper.preset`."""

GEOMETRY: Final[dict[str, Change]] = {
    "naive": partial(_one_fit_with, proxy="naive"),
    "eni": partial(_one_fit_with, proxy="eni"),
    "amdi": partial(_one_fit_with, proxy="amdi"),
    "adaptive": partial(_one_fit_with, proxy="routed"),
}
"""Images in which tracks are searched for instead of decoded views: the masked measurement, and the paper's proxies
(its Table S-II)."""

FITS: Final[dict[str, Change]] = {
    "one fit": _one_fit,
    "one generous fit": partial(_with_osgr, Osgr.generous()),
    "two sparing fits": lambda settings: replace(settings, second_density=None),
    "four fits": lambda settings: replace(settings, fits=4),
    "one look": lambda settings: replace(settings, look_again=False),
}
"""How many fits are averaged, how they differ, and whether a doubtful path is estimated a second time."""

FINE: Final[dict[str, Change]] = {
    "fine": partial(_one_fit_with, fine=FineSettings()),
}
"""The fine stage with each prior that needs no weights, and without a prior, which shows the effect of its iterations
alone."""

PAPER: Final[dict[str, Change]] = {"paper": _paper, "paper, fine": _paper_fine, "scisplat": _scisplat}
"""The system of the paper, without and with its fine stage, and SCISplat's choices on the same schedule: ENI, tracks,
MCMC.

SCISplat (Li et al. 2024) has no public implementation; the paper reproduced it as well. Its own schedule is not known:
the line uses the paper's, and no other cap on the population than that of `paper`.
"""

_PROXIES: Final[tuple[ProxyName, ...]] = ("naive", "eni", "amdi")
BOUNDED_AT: Final = (5_000, 6_000, 8_000, 9_000)
"""Iterations from which the population is bounded, which the supplement compares with 7,000."""

_CHANGES: Final[dict[str, Change]] = {
    **{name: partial(Settings.with_density_rule, rule=name) for name in RULE_NAMES if name != Osgr.name},
    **{name: partial(_with_proxy, name) for name in _PROXIES},
    **{f"without {name}": partial(without, names=(name,)) for name in COMPONENTS},
    **{f"bounded at {iteration:,}": partial(_bounded_at, iteration) for iteration in BOUNDED_AT},
    "opacities kept": _with_opacities_kept,
}
ON_PAPERS_SCHEDULE: Final[dict[str, Change]] = {
    f"paper, {name}": partial(_on_papers_schedule, change) for name, change in _CHANGES.items()
}
"""The paper's system with one change, on its own schedule: another density rule, another proxy, a component left out
(its Table VII), the population bounded from another iteration on, or copies and children that keep the opacity of
their original (supplement II)."""

MECHANISM_LINES: Final[dict[str, Change]] = {f"no {one.name}": one.without for one in MECHANISMS}
"""The default without a mechanism, by its name in `gs2ci.reconstruct.mechanisms`."""

IN_ONE_FIT: Final = "one fit, "
MECHANISM_LINES_IN_ONE_FIT: Final[dict[str, Change]] = {
    f"{IN_ONE_FIT}{name}": partial(_one_fit_without, change) for name, change in MECHANISM_LINES.items()
}
"""The same in one fit, to be compared with the line `one fit`: half the time for mechanisms of a fit."""

VARIANTS: Final[dict[str, Change]] = {
    "default": lambda settings: settings,
    **FITS,
    **GEOMETRY,
    **FINE,
    **RULES,
    **PAPER,
    **ABLATION,
    **ON_PAPERS_SCHEDULE,
}


def settings_of(variant: str, seed: int) -> Settings:
    """Return the settings of a variant.

    Raises:
        InputError: There is no such variant.
    """
    known = VARIANTS | MECHANISM_LINES | MECHANISM_LINES_IN_ONE_FIT
    if variant not in known:
        raise InputError(f"variant {variant!r}", allowed=", ".join(known))
    return known[variant](Settings(seed=seed))
