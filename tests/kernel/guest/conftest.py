"""Runs inside the guest, before any check."""

import importlib.util
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

if importlib.util.find_spec("numba") is None:
    # The guest has no compiler: kernels run there as the Python that they are written in.
    stand_in = ModuleType("gs2ci.core.kernels")

    def plain(*types: object, **options: object) -> Callable[[Any], Any]:
        return lambda function: function

    # Types of arguments are asked for by name, and say nothing here.
    names = {"kernel": plain, "helper": plain}
    stand_in.__getattr__ = names.get  # type: ignore[method-assign]
    sys.modules["gs2ci.core.kernels"] = stand_in
