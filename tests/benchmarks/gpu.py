"""What only a GPU can tell, in one run of at most 15 minutes, the most telling first.

    python -m tests.benchmarks gpu                                     on the first CUDA device
    GS2CI_PARTS=errors,races python -m tests.benchmarks gpu            some parts alone
    GS2CI_PAGE=page.md python -m tests.benchmarks gpu                  and keep what is printed, line by line
    GS2CI_DEVICE=cpu GS2CI_SMALL=1 python -m tests.benchmarks gpu      the flow of all, by fibers

Each part is begun only if the time that it may take is left (`GS2CI_MINUTES`, 15): parts that are left out are named at
the end, and the first command that runs them. Where packages or a card are missing, nothing begins, and all that is
missing is said. A part that fails says how, and the next one begins. The parts run in a
process of their own, since a device that failed once fails for the rest of a process: when that ends, or a part takes
twice its time, another process begins with the next part. Here: the plan. Not here: the parts (`gpu_parts`,
`gpu_whole`).
"""

import os
import queue
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import IO

from tests.benchmarks import gpu_needs

gpu_needs.check()

from tests.benchmarks import gpu_parts, gpu_whole  # noqa: E402  they import what may be missing
from tests.benchmarks.gpu_parts import Asked  # noqa: E402

MINUTES = 15.0
_BEGINS = "== "
_BEGINNING_S = 90.0
"""Within so many seconds a process begins its first part, or the next one."""
_ENDING_S = 20.0
"""So long is waited for a process that was told to end."""


@dataclass(frozen=True)
class Part:
    """One part.

    Args:
        name: For `GS2CI_PARTS`.
        run: Prints its figures.
        most_s: How long it may take, a guess with room to spare: nothing of it was ever measured.
    """

    name: str
    run: Callable[[Asked], None]
    most_s: float


PLAN = (
    Part("here", gpu_parts.here, 20),
    Part("compiled", gpu_parts.compiled, 150),
    Part("errors", gpu_parts.errors, 60),
    Part("beside_the_host", gpu_parts.beside_the_host, 60),
    Part("iterations", gpu_parts.iterations, 60),
    Part("standard", gpu_whole.standard, 150),
    Part("large_draft", gpu_whole.large_draft, 150),
    Part("exponent", gpu_whole.exponent, 180),
    Part("worst_kernel", gpu_parts.worst_kernel, 20),
    Part("beside_gsplat", gpu_parts.beside_gsplat, 120),
    Part("races", gpu_parts.races, 240),
)


def run() -> None:
    """Print the figures."""
    parts, minutes = chosen(os.environ.get("GS2CI_PARTS", "")), float(os.environ.get("GS2CI_MINUTES", MINUTES))
    if "GS2CI_WATCHED" in os.environ:
        left_out = within(parts, gpu_parts.asked(), 60 * minutes)
    else:
        page = os.environ.get("GS2CI_PAGE")
        with open(page or os.devnull, "w", encoding="utf-8") as kept:
            left_out = watched([sys.executable, "-u", "-m", "tests.benchmarks", "gpu"], parts, 60 * minutes, kept)
            if left_out:
                names = ",".join(part.name for part in left_out)
                say(f"\nleft out: GS2CI_PARTS={names} python -m tests.benchmarks gpu", kept)


def watched(command: Sequence[str], parts: Sequence[Part], seconds: float, kept: IO[str]) -> list[Part]:
    """Run parts in a process of their own, and in another one those after a part that ended it or took too long.

    Args:
        command: Runs the parts of `GS2CI_PARTS`.
        parts: Which.
        seconds: For all.
        kept: What is printed is written there, too, at once.

    Returns:
        The parts that were not begun.
    """
    ends, left = time.monotonic() + seconds, {part.name: part for part in parts}
    while left and time.monotonic() < ends:
        surroundings = {
            **os.environ,
            "GS2CI_WATCHED": "1",
            "GS2CI_PARTS": ",".join(left),
            "GS2CI_MINUTES": f"{(ends - time.monotonic()) / 60:.3f}",
        }
        begun, now, before = _Begun(command, surroundings), "", len(left)
        for line in begun.lines():
            say(line, kept)
            part = left.pop(line.removeprefix(_BEGINS).partition(":")[0], None) if line.startswith(_BEGINS) else None
            if part is not None:
                now, begun.until_s = part.name, min(ends, time.monotonic() + 2 * part.most_s)
            elif line.startswith(f"({now} took"):
                now, begun.until_s = "", time.monotonic() + _BEGINNING_S
        if begun.process.returncode == 0:
            break
        say(f"{now or 'what comes before the parts'} FAILS: its process ended with {begun.process.returncode}", kept)
        if len(left) == before:
            break
    return list(left.values())


class _Begun:
    """A process that prints.

    Args:
        command: Its command.
        surroundings: Its environment.

    Attributes:
        until_s: When it is ended, on the monotonic clock.
    """

    def __init__(self, command: Sequence[str], surroundings: dict[str, str]) -> None:
        self.process = subprocess.Popen(
            command, env=surroundings, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
        )
        self.until_s = time.monotonic() + _BEGINNING_S
        self._told: queue.Queue[str | None] = queue.Queue()
        self._listening = threading.Thread(target=self._listen, daemon=True)
        self._listening.start()

    def lines(self) -> Iterator[str]:
        """Yield what it prints, line by line, and end it when its time has come."""
        while True:
            try:
                line = self._told.get(timeout=max(0.0, self.until_s - time.monotonic()))
            except queue.Empty:
                self.process.kill()
                yield "(it took too long)"
                break
            if line is None:
                break
            yield line
        with suppress(subprocess.TimeoutExpired):  # a driver may keep what was killed
            self.process.wait(_ENDING_S)
        self._listening.join(timeout=1)

    def _listen(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as printed:
            for line in printed:
                self._told.put(line.rstrip("\n"))
        self._told.put(None)


def say(line: str, kept: IO[str]) -> None:
    """Print a line, and keep it."""
    print(line, flush=True)
    print(line, file=kept, flush=True)


def chosen(names: str) -> tuple[Part, ...]:
    """Return the parts of these names, joined by commas, in the plan's order; all if there are none."""
    wanted = [name for name in names.split(",") if name]
    unknown = sorted(set(wanted) - {part.name for part in PLAN})
    if unknown:
        raise SystemExit(f"no part {', '.join(unknown)}: {', '.join(part.name for part in PLAN)}")
    return tuple(part for part in PLAN if not wanted or part.name in wanted)


def within(parts: Sequence[Part], asked: Asked, seconds: float) -> list[Part]:
    """Run the parts for which there is time, one after the other; return the others."""
    ends, left_out = time.monotonic() + seconds, []
    for part in parts:
        if time.monotonic() + part.most_s > ends:
            left_out.append(part)
            continue
        began = time.monotonic()
        print(f"\n{_BEGINS}{part.name}: {(part.run.__doc__ or '').splitlines()[0]}", flush=True)
        try:
            part.run(asked)
        except Exception:
            print(f"{part.name} FAILS\n{traceback.format_exc()}", flush=True)
        print(f"({part.name} took {time.monotonic() - began:.0f} s of {part.most_s:.0f})", flush=True)
    return left_out
