"""How kernels are compiled, kept on disk and shared out to threads: the two decorators that all kernels use.

A `kernel` is called from Python and declares the types of its arguments, so that it has one form, and can be compiled
before it is called (`compile_module`). A `helper` is called from kernels only: it is compiled into each of them, and
nothing is kept of it alone. Kernels that many threads share compute a part of their work, from one task up to another,
and `in_parts` calls them. Numba's own parallel loops are not used: they take half as long again to compile, and their
thread pools come from the system (oneTBB's has been seen to spin at the end of a process).

Numba caches compiled kernels on disk and takes a cached kernel for fresh as long as *its own* file is unchanged. Ours
call helpers from neighbouring files, so an edited helper would go on running in its old form. Hence a module's kernels
lie in a folder named after a digest of that module and of all modules of ours that it imports.
"""

import hashlib
import importlib
import itertools
import os
import re
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import numba
from numba import config, types
from numba.core.registry import CPUDispatcher

FUSED: Final = frozenset({"contract"})
"""Multiply-adds may be fused. Nothing else is relaxed: NaN and infinity keep their meaning, and no sum is
reordered, so that results do not depend on how a compiler feels."""
EXACT: Final[frozenset[str]] = frozenset()
"""Every operation is rounded by itself."""

f32, f64, i64, b1 = types.float32, types.float64, types.int64, types.boolean
f32_1, f32_2, f32_3, f32_4, f32_5 = (types.Array(types.float32, n, "C") for n in range(1, 6))
f64_1, f64_2, f64_3, f64_4 = (types.Array(types.float64, n, "C") for n in range(1, 5))
i32_1, i32_2, i32_3 = (types.Array(types.int32, n, "C") for n in range(1, 4))
i64_1, i64_2 = (types.Array(types.int64, n, "C") for n in range(1, 3))
u8_1 = types.Array(types.uint8, 1, "C")
u32_1, u32_2, u32_3 = (types.Array(types.uint32, n, "C") for n in range(1, 4))
b1_1, b1_2 = (types.Array(types.boolean, n, "C") for n in range(1, 3))
"""Types of arguments: `f32` is a number, `f32_2` an array of two dimensions in one piece of memory."""

_Function = Callable[..., Any]
# Only kept modules' kernels: what a test decorates goes when the test does.
_declared: dict[str, list[tuple[Any, tuple[Any, ...]]]] = {}
_digests: dict[str, str] = {}
_OURS: Final = re.compile(r"^from (gs2ci[\w.]*) import", re.MULTILINE)

# Numba tells how many threads there are to be, and starts idle ones to do so. Those of oneTBB come last, unless a user
# has chosen.
if "NUMBA_THREADING_LAYER_PRIORITY" not in os.environ:
    config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]


# ------------------------------------------------------------------------------------------------------ decorators


def _options(fastmath: frozenset[str]) -> dict[str, Any]:
    # Kernels let go of the interpreter's lock, so that fits side by side and a progress display go on beside them.
    # Wrappers that C would call are never needed.
    return {
        "nopython": True,
        "error_model": "numpy",
        "fastmath": set(fastmath),
        "nogil": True,
        "no_cfunc_wrapper": True,
    }


def kernel(*arguments: Any, fastmath: frozenset[str] = FUSED) -> Callable[[_Function], Any]:
    """Compile a function when it is first called, and keep the machine code on disk if that can be.

    Args:
        arguments: The types of its arguments, in order, such as `f32_2`. Arguments of other types would be
            compiled for as well, once more: callers convert.
        fastmath: What may be relaxed.
    """

    def decorate(function: _Function) -> Any:
        options = _options(fastmath)
        options.pop("nopython")
        folder = cache_folder(function.__module__)
        if folder is None:
            compiled = numba.njit(**options)(function)
        else:
            users_choice = config.CACHE_DIR
            # Numba reads the setting while decorating and at no other time.
            config.CACHE_DIR = folder
            try:
                compiled = numba.njit(cache=True, **options)(function)
            finally:
                config.CACHE_DIR = users_choice
        _declared.setdefault(function.__module__, []).append((compiled, tuple(_type(each) for each in arguments)))
        return compiled

    return decorate


def _type(argument: Any) -> Any:
    return types.Tuple(argument) if isinstance(argument, tuple) else argument


class _Helper(CPUDispatcher):
    """A function of kernels that has no entry from Python; called from there, it runs as it is written."""

    def __call__(self, *args: Any) -> Any:
        return self.py_func(*args)


def helper(fastmath: frozenset[str] = FUSED) -> Callable[[_Function], Any]:
    """Make a function that kernels call; it is compiled into each of them."""
    options = {**_options(fastmath), "no_cpython_wrapper": True}

    def decorate(function: _Function) -> Any:
        return _Helper(function, targetoptions=options)

    return decorate


def declared(module: str) -> tuple[tuple[Any, tuple[Any, ...]], ...]:
    """Return the kernels of a module that is imported, each with the types of its arguments."""
    return tuple(_declared.get(module, ()))


def compile_module(module: str) -> None:
    """Import a module by name and compile its kernels, or load them where they are kept."""
    importlib.import_module(module)
    for compiled, arguments in declared(module):
        compiled.compile(arguments)


# ----------------------------------------------------------------------------------------------------------- disk


def sources_digest(module: str) -> str:
    """Digest the source of a module that is imported, or is being, and of all modules of ours that it imports."""
    if module not in _digests:
        digest = hashlib.sha256()
        for name, source in sorted(_sources(module).items()):
            digest.update(name.encode())
            digest.update(source)
        _digests[module] = digest.hexdigest()[:16]
    return _digests[module]


def _sources(module: str) -> dict[str, bytes]:
    """Return the sources that a module's kernels may be made of, by the modules' names."""
    found: dict[str, bytes] = {}
    names = [module]
    while names:
        name = names.pop()
        file = getattr(sys.modules.get(name), "__file__", None)
        if name in found or file is None:
            continue
        found[name] = Path(file).read_bytes()
        names += _OURS.findall(found[name].decode())
    return found


def cache_folder(module: str) -> str | None:
    """Choose where kernels are kept: the user's setting, the package's folder, the user's cache, or nowhere (None)."""
    user_cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "gs2ci"
    in_package = Path(__file__).parent / "__pycache__"
    for base in [Path(config.CACHE_DIR)] if config.CACHE_DIR else [in_package, user_cache]:
        if _can_write(base):
            return str(base / "kernels" / f"{module}-{sources_digest(module)}")
    return None


def _can_write(folder: Path) -> bool:
    """Tell whether files can be made in a folder, or the folder itself where it is missing."""
    while not folder.exists():
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK)


def is_compiled(module: str) -> bool:
    """Tell whether a module's kernels lie on disk, so that their first call does not have to compile them."""
    folder = cache_folder(module)
    return folder is not None and any(Path(folder).rglob("*.nbc"))


# -------------------------------------------------------------------------------------------------------- threads

_PARTS_OF_A_THREAD: Final = 2
"""So many parts for each thread: one that is held up leaves the rest of its work to the others."""
_lock: Final = threading.Lock()
_pools: Final[list[ThreadPoolExecutor]] = []


def in_parts(compiled: Any, tasks: int, *args: Any) -> None:
    """Let threads share out the tasks of a kernel, and wait for them.

    Each thread takes parts until none is left, the one that calls included, so that kernels of several threads may run
    at a time. There are as many threads as `numba.get_num_threads` says.

    Args:
        compiled: A kernel whose first two arguments are the first task and the end of the tasks it is to do. Tasks
            write to different places.
        tasks: How many there are.
        args: Its other arguments.
    """
    threads = min(numba.get_num_threads(), tasks)
    if threads <= 1:
        compiled(0, tasks, *args)
        return
    parts = min(tasks, threads * _PARTS_OF_A_THREAD)
    # Counting up is one step of the interpreter, so no part is taken twice.
    counter = itertools.count()

    def work() -> None:
        while (part := next(counter)) < parts:
            compiled(tasks * part // parts, tasks * (part + 1) // parts, *args)

    others: list[Future[None]] = [_threads().submit(work) for _ in range(threads - 1)]
    try:
        work()
    finally:
        for other in others:
            # One that has not begun has nothing left to do.
            if not other.cancel():
                other.result()


def _threads() -> ThreadPoolExecutor:
    """Return the threads that wait for parts; they are started as they are needed."""
    with _lock:
        if not _pools:
            _pools.append(ThreadPoolExecutor(config.NUMBA_NUM_THREADS, "kernels"))
        return _pools[0]


# A process that was split off has none of the threads.
os.register_at_fork(before=_lock.acquire, after_in_parent=_lock.release, after_in_child=_lock.release)
os.register_at_fork(after_in_child=_pools.clear)


# ------------------------------------------------------------------------------------------------------ in advance


def serve() -> None:
    """Compile the kernels of each module named in a line of the standard input; answer each line with itself."""
    for line in sys.stdin:
        compile_module(line.strip())
        print(line, end="", flush=True)
