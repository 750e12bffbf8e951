"""What a table compares: named changes to the settings of a reconstruction.

Here: the names, and settings from a name. Not here: what a setting does. For this package.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Final

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.ablation import COMPONENTS, without
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.fine import FineSettings
from gs2ci.reconstruct.fit.paper import paper_settings
from gs2ci.reconstruct.fit.rules import RULE_NAMES
from gs2ci.reconstruct.pipeline import Settings

Change = Callable[[Settings], Settings]


def _with_rule(name: str, settings: Settings) -> Settings:
    return settings.with_density_rule(name)


def _paper(settings: Settings) -> Settings:
    return replace(paper_settings(), seed=settings.seed)


def _without(names: tuple[str, ...], settings: Settings) -> Settings:
    return without(settings, names)


def _by_the_book(settings: Settings) -> Settings:
    return replace(settings, fit=replace(settings.fit, density=Osgr()), second_density=None)


def _one_fit(settings: Settings) -> Settings:
    return replace(settings, fits=1)


RULES: Final[dict[str, Change]] = {
    "osgr by the book": _by_the_book,
    **{name: partial(_with_rule, name) for name in RULE_NAMES if name != Settings().fit.density.name},
}
"""The default's density rule with the criteria of the literature, and the other rules, on the default's schedule."""

ABLATION: Final[dict[str, Change]] = {
    **{f"without {name}": partial(_without, (name,)) for name in COMPONENTS},
    "without all six": partial(_without, tuple(COMPONENTS)),
}
"""The default without a component, by its name in `gs2ci.reconstruct.ablation`."""

GEOMETRY: Final[dict[str, Change]] = {
    "eni": lambda settings: replace(settings, proxy="eni"),
    "amdi": lambda settings: replace(settings, proxy="amdi"),
    "auto": lambda settings: replace(settings, poses="auto"),
}
"""Where the geometry comes from: the paper's proxies instead of decoded views, and the choice by evidence."""

FITS: Final[dict[str, Change]] = {
    "one fit": _one_fit,
    "one generous fit": lambda settings: replace(
        _one_fit(settings), fit=replace(settings.fit, density=Osgr.generous())
    ),
    "two sparing fits": lambda settings: replace(settings, second_density=None),
    "four fits": lambda settings: replace(settings, fits=4),
}
"""How many fits are averaged, and how they differ."""

FINE: Final[dict[str, Change]] = {
    "fine": lambda settings: replace(settings, fine=FineSettings()),
    "fine, non-local means": lambda settings: replace(settings, fine=FineSettings(prior="nlm")),
    "fine, no prior": lambda settings: replace(settings, fine=FineSettings(prior="none")),
}
"""The fine stage with each prior that needs no weights, and with none: what its iterations alone are worth."""

VARIANTS: Final[dict[str, Change]] = {
    "default": lambda settings: settings,
    **FITS,
    **GEOMETRY,
    **FINE,
    **RULES,
    "paper": _paper,
    **ABLATION,
}


def settings_of(variant: str, seed: int) -> Settings:
    """Return the settings of a variant.

    Raises:
        InputError: There is no such variant.
    """
    if variant not in VARIANTS:
        raise InputError(f"variant {variant!r}", allowed=", ".join(VARIANTS))
    return VARIANTS[variant](Settings(seed=seed))
