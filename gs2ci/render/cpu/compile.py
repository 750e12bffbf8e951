"""How kernels are compiled: the one decorator that all kernels of this folder use.

Numba caches compiled kernels on disk and takes a cached kernel for fresh as long as *its own* file is unchanged.
Ours call helpers from neighbouring files, so an edited helper would go on running in its old form. Hence the cache
lives in a folder named after a digest of all sources that kernels are made of. Only `gs2ci.render.cpu` imports
this file.
"""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numba
from numba import config

FASTMATH: Final = frozenset({"contract"})
"""Multiply-adds may be fused. Nothing else is relaxed: NaN and infinity keep their meaning, and no sum is
reordered, so that results do not depend on how a compiler feels."""


def _sources_digest() -> str:
    folder = Path(__file__).parent
    digest = hashlib.sha256()
    for path in [*sorted(folder.glob("*.py")), folder.parent / "conventions.py"]:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> str:
    base = Path(config.CACHE_DIR) if config.CACHE_DIR else Path(__file__).parent / "__pycache__"
    return str(base / f"kernels-{_sources_digest()}")


_CACHE_FOLDER: Final = _cache_folder()


def kernel(*, parallel: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function with Numba on its first call, and keep the machine code on disk.

    Where the package's own folder cannot be written, Numba falls back on the user's cache folder.

    Args:
        parallel: The function contains a `prange` loop over independent tasks.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        user_choice = config.CACHE_DIR
        # Numba reads the setting while decorating and at no other time.
        config.CACHE_DIR = _CACHE_FOLDER if os.access(_writable_parent(_CACHE_FOLDER), os.W_OK) else user_choice
        try:
            return numba.njit(cache=True, parallel=parallel, error_model="numpy", fastmath=set(FASTMATH), nogil=True)(
                function
            )
        finally:
            config.CACHE_DIR = user_choice

    return decorate


def _writable_parent(folder: str) -> Path:
    path = Path(folder)
    while not path.exists():
        path = path.parent
    return path
