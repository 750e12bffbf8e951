"""`gs2ci tradeoff`: accuracy against time, for one shot on this machine.

Here: the arguments and what is printed. Not here: the work (`gs2ci.api.costs`).
"""

import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import tyro

from gs2ci.api import costs
from gs2ci.api.derived import with_options_of
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import kept_if_interrupted
from gs2ci.commands.printed_pages import print_pages


@with_options_of(costs.tradeoff, without=("command", "progress"))
def run(
    shot: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("tradeoff"),
    *,
    knobs: tuple[str, ...] = (),
    report: Path | None = None,
    json: AsJson = False,
    **options: Any,
) -> list[Path]:
    """Try presets and settings on one measurement, and report the seconds per decibel of each step.

    Every trial is scored against the truth if the shot contains it, and on pixels of the measurement that no trial
    uses. Finished trials are kept in `<output>/cells`: a repeated command continues an interrupted one. Seconds are
    meaningful only on an idle machine.

    Args:
        shot: A shot file, as `gs2ci import` and `gs2ci capture` write them.
        output: Folder for CSV, section, page and the finished trials.

    Returns:
        The pages; last the run's, if there is one.

    Raises:
        Gs2ciError: The file or a value cannot be used.
    """
    command = shlex.join(["gs2ci", *sys.argv[1:]])
    with answered(json) as answer:
        with kept_if_interrupted("finished trials"):
            made = costs.tradeoff(shot, output, knobs=knobs, report=report, command=command, **options)
        print_pages(made.text, made.pages)
        answer(
            {"shot": made.found.name, "trials": made.found.rows, "left_out_s": made.found.left_out, "pages": made.pages}
        )
    return made.pages
