"""Many exposures in order: list them, skip finished ones, distribute the others, keep CSV and page up to date.

Here: `reconstruct_many` and the number of processes for a machine. Not here: any of the steps.
"""

import hashlib
import re
import shutil
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

import psutil

from gs2ci import __version__
from gs2ci.batch.crew import complete
from gs2ci.batch.exposures import FiledShot
from gs2ci.batch.index_page import write_index
from gs2ci.batch.rows import ROWS_NAME, Row, read_row, read_rows, write_csv, write_row
from gs2ci.batch.work import Task, as_it_is, unscored
from gs2ci.core.arrays import F32
from gs2ci.core.errors import StorageError
from gs2ci.core.json_text import as_json
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.records import Shot
from gs2ci.core.whole_file import check_place
from gs2ci.evaluate.environment import machine
from gs2ci.evaluate.whole_folder import REPORT_NAME, check_destination
from gs2ci.reconstruct.settings import Settings

# Largest memory of a reconstruction, a fixed part and a part for each pixel of each view: an estimate that agrees with
# one run of 8 views of 264 × 353 px, 1,535 MiB (`peak_mib` of its report).
BASE_MIB: Final = 1000
BYTES_PER_VIEW_PIXEL: Final = 700
# Writing a run takes seconds: what has not changed for so long was left by a killed worker. Another command may be
# writing into the same folder, perhaps on another machine, where process ids say nothing.
_ABANDONED_S: Final = 3600.0


def reconstruct_many(
    exposures: Sequence[FiledShot],
    output: Path,
    settings: Settings,
    *,
    prepare: Callable[[Shot], Shot] = as_it_is,
    score: Callable[[Shot], Callable[[F32], float] | None] = unscored,
    depends_on: str = "",
    processes: int = 1,
    scheduler: str = "",
    overwrite: bool = False,
    progress: Progress | None = None,
) -> list[Row]:
    """Reconstruct exposures into one folder each; finished ones are not repeated.

    Args:
        exposures: From `list_exposures`.
        output: The folder of runs; beside them it gets `rows/`, `runs.csv` and `index.html`.
        settings: The same for all.
        prepare: Changes each shot before it; a function of a module, or a `functools.partial` of one.
        score: Makes the curve's score from each shot, as `reconstruct` takes it; the same.
        depends_on: All else that the results depend on, as a text.
        processes: Number of processes on this machine; 1 works in this process.
        scheduler: Address of a Dask scheduler that is used instead.
        overwrite: Replace runs that were made of other files or with other settings.
        progress: Receives every exposure that ends.

    Returns:
        A row for each exposure, in their order.

    Raises:
        StorageError: The folder cannot be written, is itself a run, or holds other runs at these places.
        InputError: No scheduler answers, or dask.distributed is not installed.
        DeviceError: The scheduler went away.
    """
    output, progress = output.absolute(), progress or Silent()
    check_place(output / ROWS_NAME)
    if (output / REPORT_NAME).exists():
        raise StorageError(
            f"{output} holds a result of its own, {REPORT_NAME}, and no folder of runs",
            allowed="a new folder, or one that an earlier such command wrote",
            remedy="choose another place with -o",
        )
    tasks = [Task(one, output, _key(one, settings, depends_on), settings, prepare, score) for one in exposures]
    rows = {task.exposure.name: row for task in tasks if (row := _finished(task, overwrite=overwrite)) is not None}
    missing = [task for task in tasks if task.exposure.name not in rows]
    (output / ROWS_NAME).mkdir(parents=True, exist_ok=True)
    progress.stage("exposures", len(tasks))
    if rows:
        progress.say(f"{len(rows)} of {len(tasks)} are done already.")
    progress.step(len(rows))
    failed = 0
    try:
        for row in complete(missing, processes=processes, scheduler=scheduler):
            rows[row.name] = row
            if read_row(output, row.name) != row:
                write_row(output, row)
            if row.problem is not None:
                failed += 1
                progress.say(f"{row.name}: {row.problem.problem}")
            progress.step(len(rows), **({"failed": failed} if failed else {}))
    finally:
        # After an interruption the finished runs stay, and the command can be continued.
        _sweep(output, [task.exposure.name for task in tasks])
        known = read_rows(output)
        write_csv(output, known)
        write_index(output, known)
    return [rows[task.exposure.name] for task in tasks]


def bearable_processes(exposure_pixels: int) -> int:
    """Return how many reconstructions this machine can run at once: one per core, as far as free memory allows.

    Args:
        exposure_pixels: Pixels of all views of the largest exposure.
    """
    each = BASE_MIB * 2**20 + BYTES_PER_VIEW_PIXEL * exposure_pixels
    return max(1, min(machine().usable_cores, int(psutil.virtual_memory().available // each)))


def _key(one: FiledShot, settings: Settings, depends_on: str) -> str:
    """Hash all that a result depends on: the program's version, the file's last change, the settings."""
    told = as_json([__version__, str(one.file), one.index, one.stamp, settings, depends_on])
    return hashlib.sha256(told.encode()).hexdigest()[:20]


def _finished(task: Task, *, overwrite: bool) -> Row | None:
    """Return the row of a finished exposure; None if it is still to be done.

    Raises:
        StorageError: Another run lies at its place.
    """
    name = task.exposure.name
    row, folder = read_row(task.output, name), task.output / name
    if row is not None and row.key == task.key:
        return row if row.state == "done" and folder.is_dir() else None
    if row is not None and row.state == "done" and not overwrite:
        raise StorageError(
            f"{folder} was made of another file, or with other settings",
            remedy="choose another folder with -o, or add --overwrite to replace such runs",
        )
    # A folder without a row comes from a process that died between writing the two, and is done again.
    check_destination(folder, overwrite=overwrite or row is None or row.state != "done")
    return None


def _sweep(output: Path, names: Sequence[str]) -> None:
    """Remove incomplete files of killed workers, and none that another command may be writing."""
    ours = re.compile(rf"\.(?:{'|'.join(map(re.escape, names))})\.\d+\.(?:partial|old)")
    for path in output.glob(".*.*"):
        with suppress(OSError):  # another command removed or renamed it meanwhile
            # An earlier run that is set aside is old by its own times, but not by that of its new name.
            if ours.fullmatch(path.name) and time.time() - path.stat().st_ctime > _ABANDONED_S:
                shutil.rmtree(path, ignore_errors=True)
