"""What it takes to compile the kernels: processor seconds of each, one after another in a process, into an empty cache.

    python -m tests.benchmarks compiling
    GS2CI_AGAINST=path-of-a-checkout python -m tests.benchmarks compiling

The second also runs `compile_kernels` of this checkout and of another one with an environment of its own, one after the
other, and prints what each took: the processors' seconds and the clock's. What is compiled first loads the compiler.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

_ONE_BY_ONE = """
import importlib, time
from gs2ci.api.preparing import modules_with_kernels
from gs2ci.core.kernels import declared
for module in modules_with_kernels():
    importlib.import_module(module)
    for compiled, arguments in declared(module):
        began_s = time.process_time()
        compiled.compile(arguments)
        print(f"{time.process_time() - began_s:.3f} {module} {compiled.__name__}")
"""
_ALL = "import gs2ci; gs2ci.compile_kernels()"


def run() -> None:
    lines = [line.split() for line in _run_in_empty_cache(sys.executable, _ONE_BY_ONE)[0].splitlines()]
    taken = sorted(((float(seconds), module, name) for seconds, module, name in lines), reverse=True)
    print("| kernel | module | processor s |")
    print("|---|---|---|")
    for seconds, module, name in taken:
        print(f"| `{name}` | `{module}` | {seconds:.2f} |")
    print(f"| {len(taken)} kernels | | {sum(seconds for seconds, *_ in taken):.1f} |")
    other = os.environ.get("GS2CI_AGAINST")
    if other is not None:
        print("| checkout | processor s | s |")
        print("|---|---|---|")
        for name, python in (("this", sys.executable), ("the other", str(Path(other) / ".venv/bin/python"))):
            _, processors_s, clock_s = _run_in_empty_cache(python, _ALL, None if name == "this" else Path(other))
            print(f"| {name} | {processors_s:.0f} | {clock_s:.0f} |", flush=True)


def _run_in_empty_cache(python: str, program: str, folder: Path | None = None) -> tuple[str, float, float]:
    """Return what a program prints, the seconds of its processors, its children included, and the clock's."""
    began, began_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        done = subprocess.run(
            [python, "-c", program], env=environment, cwd=folder, stdout=subprocess.PIPE, text=True, check=True
        )
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    used_s = ended.ru_utime + ended.ru_stime - began.ru_utime - began.ru_stime
    return done.stdout, used_s, time.monotonic() - began_s
