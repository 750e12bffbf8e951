"""The renderers that are held to the definition, by name: Warp's where it is installed."""

from importlib.util import find_spec

import pytest

from gs2ci.render import backend
from gs2ci.render.interface import Backend
from gs2ci.render.settings import RasterSettings
from tests.render.reference import ReferenceBackend

WARP = pytest.param("warp", marks=pytest.mark.skipif(find_spec("warp") is None, reason="Warp is not installed"))
FAST = ["cpu", WARP]
BACKENDS = [*FAST, "reference"]
NEVER = RasterSettings(termination_transmittance=0.0)
"""Blending that never stops early, as the definition."""


def load_backend(name: str = "cpu", settings: RasterSettings | None = None) -> Backend:
    """Return a new renderer by name: one of the registry's, or the definition."""
    return ReferenceBackend(settings) if name == "reference" else backend.load_backend(name, settings)


def to_the_end(name: str) -> Backend:
    """Return a renderer that leaves nothing out."""
    return load_backend(name, NEVER)
