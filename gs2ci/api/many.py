"""Many exposures of many files: `reconstruct_many`. Not here: the batch (`gs2ci.batch`)."""

from collections.abc import Sequence
from dataclasses import astuple
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gs2ci.api.derived import with_options_of
from gs2ci.api.display import interrupted_within, shown
from gs2ci.api.options import check_whole
from gs2ci.api.reconstruction import check_overrides, reconstruct
from gs2ci.core.errors import InputError
from gs2ci.core.progress import Progress
from gs2ci.reconstruct.choices import PresetName

if TYPE_CHECKING:
    from gs2ci.batch.rows import Row


@with_options_of(reconstruct, without=("shot", "budget", "together", "unfinished"))
def reconstruct_many(
    files: Sequence[str | Path],
    output: str | Path = "runs",
    preset: PresetName = "standard",
    *,
    every: bool = True,
    index: int | None = None,
    processes: int | None = None,
    scheduler: str = "",
    overwrite: bool = False,
    progress: Progress | None = None,
    **overrides: Any,
) -> "list[Row]":
    """Reconstruct exposures of shot files into one run folder each, with a page and a CSV of all of them.

    Finished runs are skipped, so that a repeated call continues an interrupted one.

    Args:
        files: Shot files.
        output: The folder of runs.
        every: Every exposure of each file; otherwise the one selected by `index`.
        index: Which exposure of each file, without `every`; by default the first.
        processes: Number of processes on this machine; by default as many as its cores and memory allow.
        scheduler: Address of a Dask scheduler to use instead.
        overwrite: Replace runs of other files or with other settings.
        progress: Receives every exposure that ends.

    Returns:
        A row for each exposure: its name, its state, its figures, or why it has no run.

    Raises:
        InputError: A file or a value cannot be used, or no scheduler answers.
        StorageError: The folder cannot be written, is itself a run, or holds other runs.

    Example:
        >>> rows = gs2ci.reconstruct_many(
        ...     ["shot.h5"], "runs", "draft", iterations=2, processes=1, progress=gs2ci.Silent()
        ... )
        >>> [row.state for row in rows], gs2ci.open_run(f"runs/{rows[0].name}").views.shape
        (['done'], (4, 24, 32, 3))
    """
    check_whole("--processes", processes, 1, 1000)
    if scheduler and processes is not None:
        raise InputError("--processes and --scheduler together", remedy="the cluster has its own workers: omit one")
    if every and index is not None:
        raise InputError(
            f"both --all and --index {index}", remedy="give one of them; in Python, index with every=False"
        )
    numbers = dict(overrides)
    focal_px = overrides.pop("focal_px", None)
    from gs2ci.api.overrides import Overrides, score_against_truth, settings_of, with_focal

    changes = Overrides(**overrides)
    check_overrides(numbers)
    from gs2ci.batch import reconstruct as batch
    from gs2ci.batch.exposures import largest_pixels, list_exposures

    exposures = list_exposures([Path(file) for file in files], every=every, index=index or 0)
    if processes is None:
        processes = 1 if scheduler else min(len(exposures), batch.bearable_processes(largest_pixels(exposures)))
    with interrupted_within(), shown(progress) as display:
        return batch.reconstruct_many(
            exposures,
            Path(output),
            settings_of(preset, changes),
            prepare=partial(with_focal, focal_px),
            score=score_against_truth,
            depends_on=repr((astuple(changes), preset, focal_px)),
            processes=processes,
            scheduler=scheduler,
            overwrite=overwrite,
            progress=display,
        )
