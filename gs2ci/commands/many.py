"""`gs2ci reconstruct` for many exposures: files or exposures in plenty, processes of this machine or a Dask cluster.

Here: what is printed. Not here: what the arguments mean for the batch (`gs2ci.api.many`), the batch (`gs2ci.batch`).
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from gs2ci.api.many import reconstruct_many
from gs2ci.core.errors import Gs2ciError

if TYPE_CHECKING:
    from gs2ci.reconstruct.choices import PresetName


def run_many(
    files: Sequence[Path],
    output: Path,
    preset: "PresetName",
    wishes: Mapping[str, Any],
    *,
    every: bool,
    index: int,
    processes: int | None,
    scheduler: str,
    overwrite: bool,
) -> Path:
    """Reconstruct exposures of files into one folder; print where the page over all lies.

    Raises:
        Gs2ciError: A file or the folder cannot be used, no scheduler answers, or some exposures have no run: the
            others have theirs.
    """
    rows = reconstruct_many(
        files,
        output,
        preset,
        every=every,
        index=index,
        processes=processes,
        scheduler=scheduler,
        overwrite=overwrite,
        **wishes,
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
