"""What a table compares: named changes to the settings of a reconstruction.

Here: the names, and settings from a name. Not here: what a setting does. For this package.
"""

from collections.abc import Callable
from typing import Final

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.pipeline import Settings

Change = Callable[[Settings], Settings]

VARIANTS: Final[dict[str, Change]] = {
    "default": lambda settings: settings,
}


def settings_of(variant: str, seed: int) -> Settings:
    """Return the settings of a variant.

    Raises:
        InputError: There is no such variant.
    """
    if variant not in VARIANTS:
        raise InputError(f"variant {variant!r}", allowed=", ".join(VARIANTS))
    return VARIANTS[variant](Settings(seed=seed))
