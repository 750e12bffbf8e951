"""64 small shots by two workers against one process, and by two workers of which one is killed every ten seconds.

Simulated scenes of 64 × 88 px, preset "draft". Wall-clock and processor seconds (this process and all below it), the
rows of all three, and for the last: the number of workers that died, the number of runs, and whether a run is doubled.
`GS2CI_BATCH_SHOTS` takes fewer shots. A single process uses every core for one shot; each of two workers uses half
of them for its own.
"""

import os
import random
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

from gs2ci.batch.exposures import list_exposures
from gs2ci.batch.reconstruct import reconstruct_many
from gs2ci.batch.rows import Row
from gs2ci.core.storage import write_shots
from gs2ci.evaluate.report import read_report
from gs2ci.reconstruct.presets.named import PRESETS
from tests.tables.cases import Case

SHOTS = int(os.environ.get("GS2CI_BATCH_SHOTS", "64"))
SIZE = (64, 88)
SCENES = ("boxes", "corridor")
KILL_EVERY_S = 10.0


def run() -> None:
    with tempfile.TemporaryDirectory() as folder:
        files = [
            write_shots(
                Path(folder) / f"{SCENES[k % len(SCENES)]}-{k}.h5",
                [Case(name="x", scene=SCENES[k % len(SCENES)], size=SIZE).shot(k)],
            )
            for k in range(SHOTS)
        ]
        # What every process would compile for itself is compiled once, before any time is taken.
        timed(files[:1], Path(folder) / "first", 1)
        one = told("one process", timed(files, Path(folder) / "one", 1))
        two = told("two workers", timed(files, Path(folder) / "two", 2))
        print(f"two workers against one process: {one[1] / two[1]:.2f} times as fast", flush=True)
        with killing() as deaths:
            killed = told("with deaths", timed(files, Path(folder) / "killed", 2))
        check(killed[0], Path(folder) / "killed", deaths)
        pairs = [
            (first.psnr_db, other.psnr_db)
            for rows in (two[0], killed[0])
            for first, other in zip(one[0], rows, strict=True)
        ]
        largest = max((abs(a - b) for a, b in pairs if a is not None and b is not None), default=float("nan"))
        print(f"largest difference of a shot's PSNR between the three: {largest:.2g} dB")


def told(name: str, found: tuple[list[Row], float, float]) -> tuple[list[Row], float, float]:
    """Print what a way took as soon as it has ended."""
    rows, wall_s, cpu_s = found
    states = dict(Counter(row.state for row in rows))
    print(f"{name:<12} {wall_s:7.1f} s wall, {cpu_s:7.1f} s of processors, {states}", flush=True)
    return found


def timed(files: list[Path], output: Path, processes: int) -> tuple[list[Row], float, float]:
    """Reconstruct all; return rows, seconds on the wall, and those of processors in this process and its children."""
    began_s, cpu_s = time.monotonic(), processor_seconds()
    rows = reconstruct_many(list_exposures(files, every=True), output, PRESETS["draft"], processes=processes)
    return rows, time.monotonic() - began_s, processor_seconds() - cpu_s


def processor_seconds() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@contextmanager
def killing() -> Iterator[list[int]]:
    """Kill one of this process's workers every ten seconds; the list fills with their numbers."""
    deaths: list[int] = []
    over = threading.Event()

    def kill() -> None:
        while not over.wait(KILL_EVERY_S):
            workers = [child for child in psutil.Process().children(recursive=True) if _is_worker(child)]
            if workers:
                victim = random.choice(workers)
                victim.kill()
                deaths.append(victim.pid)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield deaths
    finally:
        over.set()
        thread.join()


def _is_worker(child: psutil.Process) -> bool:
    try:
        return "spawn_main" in " ".join(child.cmdline())
    except psutil.Error:  # it ended in the meantime
        return False


def check(rows: list[Row], output: Path, deaths: list[int]) -> None:
    folders = [path.parent.name for path in output.glob("*/report.json")]
    names = Counter(row.name for row in rows)
    lines = (output / "runs.csv").read_text().splitlines()[1:]
    readable = sum(read_report(output / name).views > 0 for name in folders)
    print(
        f"{len(deaths)} workers killed: {len(folders)} of {SHOTS} run folders, {readable} whole; "
        f"{sum(count > 1 for count in names.values())} rows twice; {len(lines)} lines in runs.csv; "
        f"{len(list(output.glob('.*.partial')))} left half-written"
    )
