"""`gs2ci reconstruct` for many files or exposures, in processes of this machine or on a Dask cluster.

Here: what is printed. Not here: the arguments' effect on the batch (`gs2ci.api.many`), the batch (`gs2ci.batch`).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gs2ci.api.many import reconstruct_many
from gs2ci.commands.answers import answered
from gs2ci.commands.lines import kept_if_interrupted, say
from gs2ci.core.errors import Gs2ciError


def run_many(files: Sequence[Path], output: Path, *, json: bool, **options: Any) -> Path:
    """Reconstruct exposures of files into one folder; print the path of the page of all runs.

    Args:
        files: Shot files.
        output: The folder of runs.
        json: Answer with the rows.
        options: Of `gs2ci.reconstruct_many`.

    Raises:
        Gs2ciError: A file or the folder cannot be used, no scheduler answers, or some exposures failed; the runs of
            the others are complete.
    """
    with answered(json) as answer:
        with kept_if_interrupted("finished runs"):
            rows = reconstruct_many(files, output, **options)
        _print(output)
        answer([row.model_dump(mode="json") for row in rows])
    without = [row for row in rows if row.state != "done"]
    if without:
        raise Gs2ciError(
            f"{len(without)} of {len(rows)} exposures have no run, {without[0].name} the first of them",
            remedy=f"{output / 'index.html'} says why; the same command tries them again and leaves the others alone",
        )
    return output


def _print(output: Path) -> None:
    say(f"{output / 'index.html'}  all of them on one page")
    say(f"{output / 'runs.csv'}  a line each")
