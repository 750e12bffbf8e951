"""Runs inside the guest, before any check."""

import importlib.util
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

if importlib.util.find_spec("numba") is None:
    # The guest has no compiler: kernels run there as the Python that they are written in.
    stand_in = ModuleType("numba")

    def njit(*functions: Callable[..., Any], **options: object) -> Any:
        return functions[0] if functions else lambda function: function

    stand_in.njit = njit  # type: ignore[attr-defined]
    sys.modules["numba"] = stand_in
