"""One exposure, from its file to its run folder and its row, on any machine.

Here: `Task`, which is small enough to be sent (a path, an index, settings: no arrays), and `work`, which reads the
file where it runs. The solver is imported only after that, so that a worker whose file cannot be read answers at once.
Not here: the distribution of tasks (`crew`).
"""

import socket
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from gs2ci.batch.exposures import FiledShot
from gs2ci.batch.rows import ROWS_NAME, Row, RowProblem, read_row, remove_row, row_of, write_row
from gs2ci.core.arrays import F32
from gs2ci.core.errors import Gs2ciError, StorageError
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.core.storage import read_shot
from gs2ci.evaluate.environment import machine, restart_peak
from gs2ci.evaluate.report import read_report

if TYPE_CHECKING:
    from gs2ci.reconstruct.settings import Settings

# A Dask worker may have several threads; a reconstruction takes the whole process (its renderer's buffers, torch's
# number of threads), so they take turns.
_TURN: Final = threading.Lock()


def as_it_is(shot: Shot) -> Shot:
    """Return the shot."""
    return shot


def unscored(_shot: Shot) -> None:
    """Give no score for the curve."""
    return


@dataclass(frozen=True)
class Task:
    """All that a worker needs.

    Args:
        exposure: The exposure.
        output: The folder of runs, absolute, valid on every worker.
        key: Hash of all that the result depends on.
        settings: Settings of the reconstruction.
        prepare: Changes the shot before it; a function of a module, or a `functools.partial` of one.
        score: As `reconstruct` takes it, made from the shot; the same.
        sharing: How many workers there are on each machine, by host name: they share its processors evenly.
    """

    exposure: FiledShot
    output: Path
    key: str
    settings: "Settings"
    prepare: Callable[[Shot], Shot] = as_it_is
    score: Callable[[Shot], Callable[[F32], float] | None] = unscored
    sharing: dict[str, int] = field(default_factory=dict)


def work(task: Task) -> Row:
    """Reconstruct one exposure and write its run folder and its row; a failure becomes a row as well.

    An exposure that a worker considered dead has finished meanwhile is not done again, if its folder is there.

    Returns:
        The row. It is also on the disk, except for a failure if the output folder cannot be reached.
    """
    with _TURN:
        kept = read_row(task.output, task.exposure.name)
        there = (task.output / task.exposure.name).is_dir()
        if there and kept is not None and kept.key == task.key and kept.state == "done":
            return kept
        try:
            row = _done(task)
        except (Gs2ciError, MemoryError, OSError) as error:
            row = failed(task, RowProblem.of(error))
        except Exception as error:  # an error of one exposure must not stop the others
            row = failed(task, RowProblem.of(error, traceback.format_exc()))
        if (task.output / ROWS_NAME).is_dir():
            write_row(task.output, row)
        return row


def failed(task: Task, problem: RowProblem, *, lost: bool = False) -> Row:
    """Return the row of an exposure that has no run."""
    one = task.exposure
    return Row(
        name=one.name,
        state="lost" if lost else "failed",
        file=str(one.file),
        index=one.index,
        key=task.key,
        machine="" if lost else socket.gethostname(),
        problem=problem,
    )


def _done(task: Task) -> Row:
    """Reconstruct the exposure and write its run folder.

    Raises:
        Gs2ciError: The file or the folder cannot be seen from here, or the exposure cannot be reconstructed.
    """
    restart_peak()  # a worker does one exposure after another, and each has a peak of its own
    one, host = task.exposure, socket.gethostname()
    for path in (task.output / ROWS_NAME, one.file):
        if not path.exists():
            raise StorageError(
                f"{path} is not to be seen from {host}",
                remedy="give paths on a disk that all workers share, mounted at the same place",
            )
    shot = task.prepare(read_shot(one.file, one.index))
    from gs2ci.evaluate.run_folder import write_run  # noqa: PLC0415
    from gs2ci.reconstruct.pipeline import reconstruct  # noqa: PLC0415

    _take_share(task.sharing.get(host, 1))
    found = reconstruct(shot, task.settings, Silent(), task.score(shot))
    folder = task.output / one.name
    # A process that dies between writing the two leaves a folder without a row, never one with the row of another run.
    remove_row(task.output, one.name)
    write_run(folder, shot, found.result, found.scene, overwrite=True)
    return row_of(one.name, one.file, one.index, task.key, read_report(folder), machine=host)


def _take_share(workers: int) -> None:
    """Limit the process to this worker's share of its machine's processors."""
    import numba  # noqa: PLC0415
    import torch  # noqa: PLC0415

    threads = max(1, machine().usable_cores // workers)
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    if torch.get_num_threads() != threads:
        torch.set_num_threads(threads)
