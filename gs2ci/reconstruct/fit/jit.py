"""How the kernels of a fit are compiled."""

from typing import Any, Final

JIT: Final[dict[str, Any]] = {"cache": True, "error_model": "numpy", "fastmath": {"contract"}, "nogil": True}
"""Contraction to fused multiply-adds only: no reassociation, so that results do not depend on the vector width. Without
the interpreter's lock, so that fits side by side do not wait for each other."""
