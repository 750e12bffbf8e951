"""The door to the paper's own parts (`paper`): what the default loads of them, and only if a user names it.

Here: where each lies, as text: the default imports none of them. Not here: what they do.
"""

from enum import StrEnum
from importlib import import_module
from typing import Any


class PaperPart(StrEnum):
    """A function or table of the paper's, as MODULE:NAME in `gs2ci.reconstruct.paper`."""

    DENSITY_RULES = "density.rules:RULES"
    GEOMETRY_VIEWS = "proxies.routing:geometry_views"
    VGGT = "hierarchy:prior_by_name"


def paper_part(part: PaperPart) -> Any:
    """Load a part of the paper's."""
    module, name = part.value.split(":")
    return getattr(import_module(f"gs2ci.reconstruct.paper.{module}"), name)
