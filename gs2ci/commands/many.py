"""`gs2ci reconstruct` for many exposures: files or exposures in plenty, processes of this machine or a Dask cluster.

Here: what the arguments mean for the batch, and what is printed. Not here: the batch (`gs2ci.batch`).
"""

from collections.abc import Sequence
from dataclasses import astuple
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from gs2ci.api.display import open_display
from gs2ci.api.options import check_whole
from gs2ci.core.errors import Gs2ciError, InputError

if TYPE_CHECKING:
    from gs2ci.api.wishes import Wishes
    from gs2ci.reconstruct.choices import PresetName


def run_many(
    files: Sequence[Path],
    output: Path,
    wishes: "Wishes",
    *,
    every: bool,
    index: int,
    preset: "PresetName",
    focal_px: float | None,
    processes: int | None,
    scheduler: str,
    overwrite: bool,
) -> Path:
    """Reconstruct exposures of files into one folder; print where the page over all lies.

    Raises:
        Gs2ciError: A file or the folder cannot be used, no scheduler answers, or some exposures have no run: the
            others have theirs.
    """
    check_whole("--processes", processes, 1, 1000)
    if scheduler and processes is not None:
        raise InputError("--processes beside --scheduler", remedy="the cluster has its own workers: leave one out")
    from gs2ci.api.wishes import score_against_truth, settings_of, with_focal
    from gs2ci.batch.exposures import list_exposures
    from gs2ci.batch.reconstruct import bearable_processes, reconstruct_many
    from gs2ci.core.storage import read_shot

    exposures = list_exposures(files, every=every, index=index)
    first = read_shot(exposures[0].file, exposures[0].index)
    if processes is None:
        processes = 1 if scheduler else min(len(exposures), bearable_processes(first.masks.size))
    with open_display() as display:
        rows = reconstruct_many(
            exposures,
            output,
            settings_of(preset, wishes),
            prepare=partial(with_focal, focal_px),
            score=score_against_truth,
            wishes=repr((astuple(wishes), preset, focal_px)),
            processes=processes,
            scheduler=scheduler,
            overwrite=overwrite,
            progress=display,
        )
    console = Console(highlight=False)
    console.print(f"{output / 'index.html'}  all of them on one page", soft_wrap=True, markup=False)
    console.print(f"{output / 'runs.csv'}  a line each", soft_wrap=True, markup=False)
    without = [row for row in rows if row.state != "done"]
    if without:
        raise Gs2ciError(
            f"{len(without)} of {len(rows)} exposures have no run, {without[0].name} the first of them",
            remedy=f"{output / 'index.html'} says why; the same command tries them again and leaves the others alone",
        )
    return output
