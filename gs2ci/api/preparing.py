"""Compilation of all kernels in advance, in as many processes as there are processors: `compile_kernels`.

Here: the modules that contain kernels, and the processes. Not here: how a module is compiled and where machine code is
stored (`gs2ci.core.kernels`).
"""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Final

from gs2ci.api.display import shown
from gs2ci.core.progress import Progress

_PACKAGES: Final = ("gs2ci", "gs2ci_drivers", "gs2ci_calibration", "gs2ci_sims")
_KERNEL: Final = b"\n@kernel("
_MOMENT_S: Final = 1.0
_SERVE: Final = "from gs2ci.core.kernels import serve; serve()"


def compile_kernels(progress: Progress | None = None) -> float:
    """Compile all kernels for this processor, and keep the machine code on disk.

    Otherwise the first reconstruction after an installation does so, and takes longer.

    Args:
        progress: Told of each module; None draws a bar, `Silent()` shows nothing.

    Returns:
        The seconds that it took.

    Example:
        >>> gs2ci.compile_kernels(gs2ci.Silent()) > 0
        True
    """
    began_s = time.monotonic()
    todo: SimpleQueue[str] = SimpleQueue()
    modules = modules_with_kernels()
    for module in modules:
        todo.put(module)
    done: list[str] = []
    lock, stop = threading.Lock(), threading.Event()
    workers = min(len(os.sched_getaffinity(0)), len(modules))
    with shown(progress) as display, ThreadPoolExecutor(workers) as threads:

        def finished(module: str) -> None:
            with lock:
                done.append(module)
                display.step(len(done))

        display.stage("compile", len(modules))
        try:
            for worker in [threads.submit(_compile, todo, finished, stop) for _ in range(workers)]:
                worker.result()
        finally:
            stop.set()
    return time.monotonic() - began_s


def modules_with_kernels() -> tuple[str, ...]:
    """Return the names of all modules that declare kernels, the longest first: what is compiled last is short."""
    found: list[tuple[int, str]] = []
    for package in _PACKAGES:
        spec = find_spec(package)
        assert spec is not None
        root = Path(str(spec.origin)).parent
        for path in root.rglob("*.py"):
            source = path.read_bytes()
            if _KERNEL in source:
                name = ".".join((package, *path.relative_to(root).with_suffix("").parts))
                found.append((-len(source), name))
    return tuple(name for _, name in sorted(found))


def prepare_first_run(backend: str, display: Progress) -> None:
    """Compile what a reconstruction calls before it begins, unless that is done: several processes take less time."""
    from gs2ci.core.kernels import cache_folder
    from gs2ci.render.backend import needs_compiling

    if not needs_compiling(backend):
        return
    display.say(
        "The first run on this machine compiles its kernels, which takes about half a minute; "
        "`gs2ci compile` does it in advance."
    )
    if cache_folder(__name__) is not None:
        compile_kernels(display)


def _compile(todo: "SimpleQueue[str]", finished: Callable[[str], None], stop: threading.Event) -> None:
    """Let one process compile modules until none is left."""
    from gs2ci.core.kernels import compile_module

    paths = os.pathsep.join(path for path in sys.path if path)
    with subprocess.Popen(  # noqa: S603  (this Python)
        [sys.executable, "-c", _SERVE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": paths},
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        while not stop.is_set():
            try:
                module = todo.get_nowait()
            except Empty:
                break
            process.stdin.write(module + "\n")
            process.stdin.flush()
            if process.stdout.readline().strip() != module:
                # It ended: interrupted, as this one then is in a moment; else the reason is raised here.
                if not stop.wait(_MOMENT_S):
                    compile_module(module)
                    finished(module)
                break
            finished(module)
