"""What a table compares: named changes to the settings of a reconstruction.

Here: the names, and settings from a name. Not here: what a setting does. For this package.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.fit.fine import FineSettings
from gs2ci.reconstruct.pipeline import Settings

Change = Callable[[Settings], Settings]

# Where the geometry comes from: the paper's proxies instead of decoded views, and the choice by evidence.
GEOMETRY: Final[dict[str, Change]] = {
    "eni": lambda settings: replace(settings, proxy="eni"),
    "amdi": lambda settings: replace(settings, proxy="amdi"),
    "auto": lambda settings: replace(settings, poses="auto"),
}
# The fine stage, with each prior that needs no weights, and with none: what its iterations alone are worth.
FINE: Final[dict[str, Change]] = {
    "fine": lambda settings: replace(settings, fine=FineSettings()),
    "fine, non-local means": lambda settings: replace(settings, fine=FineSettings(prior="nlm")),
    "fine, no prior": lambda settings: replace(settings, fine=FineSettings(prior="none")),
}
VARIANTS: Final[dict[str, Change]] = {
    "default": lambda settings: settings,
    **GEOMETRY,
    **FINE,
}


def settings_of(variant: str, seed: int) -> Settings:
    """Return the settings of a variant.

    Raises:
        InputError: There is no such variant.
    """
    if variant not in VARIANTS:
        raise InputError(f"variant {variant!r}", allowed=", ".join(VARIANTS))
    return VARIANTS[variant](Settings(seed=seed))
