"""How kernels are compiled: the one decorator that all kernels of this folder use.

Numba caches compiled kernels on disk and takes a cached kernel for fresh as long as *its own* file is unchanged. Ours
call helpers from neighbouring files, so an edited helper would go on running in its old form. Hence the cache lives in
a folder named after a digest of all sources that kernels are made of.
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


# Modules of `gs2ci.render` whose constants and functions kernels compile, beside the folders `cpu` and `simd`.
_BESIDE: Final = ("conventions.py", "gaussians.py", "screen.py", "stopping.py")


def sources_digest() -> str:
    """Digest everything that compiled kernels depend on."""
    render = Path(__file__).parent.parent
    digest = hashlib.sha256()
    folders = (path for name in ("cpu", "simd") for path in sorted((render / name).glob("*.py")))
    for path in [*folders, *(render / name for name in _BESIDE)]:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> str | None:
    """Choose where kernels are kept: the user's setting, the package's folder, the user's cache, or nowhere."""
    user_cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "gs2ci"
    in_package = Path(__file__).parent / "__pycache__"
    for base in [Path(config.CACHE_DIR)] if config.CACHE_DIR else [in_package, user_cache]:
        if _can_write(base):
            return str(base / f"kernels-{sources_digest()}")
    return None


def _can_write(folder: Path) -> bool:
    """Tell whether files can be made in a folder, or the folder itself where it is missing."""
    while not folder.exists():
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK)


_CACHE_FOLDER: Final = _cache_folder()


def is_compiled() -> bool:
    """Tell whether kernels of these sources lie on disk, so that their first call does not have to compile them."""
    return _CACHE_FOLDER is not None and any(Path(_CACHE_FOLDER).rglob("*.nbc"))


def kernel(*, parallel: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function with Numba on its first call, and keep the machine code on disk if that can be.

    Args:
        parallel: The function contains a `prange` loop over independent tasks.
    """
    # Kernels let go of the interpreter's lock, so that a progress display stays alive beside them.
    options = {"parallel": parallel, "error_model": "numpy", "fastmath": set(FASTMATH), "nogil": True}

    def decorate(function: Callable[..., Any]) -> Any:
        if _CACHE_FOLDER is None:
            return numba.njit(**options)(function)
        users_choice = config.CACHE_DIR
        # Numba reads the setting while decorating and at no other time.
        config.CACHE_DIR = _CACHE_FOLDER
        try:
            return numba.njit(cache=True, **options)(function)
        finally:
            config.CACHE_DIR = users_choice

    return decorate
