"""`gs2ci tradeoff`: what accuracy costs in time, for one shot on this machine.

Here: the arguments and what is printed. Not here: the work (`gs2ci.api.costs`).
"""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.markdown import Markdown


def run(
    shot: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("tradeoff"),
    *,
    index: int = 0,
    knobs: tuple[str, ...] = (),
    most: str = "15min",
    seed: int = 42,
    report: Path | None = None,
    fresh: bool = False,
) -> list[Path]:
    """Try presets and settings on one measurement, and say what the next decibel costs.

    Every trial is judged by the truth where the shot holds it, and by pixels of the measurement that no trial sees.
    Finished trials are kept in `<output>/cells`: an interrupted command goes on where it was left. Seconds are only
    worth reading on a quiet machine.

    Args:
        shot: A shot file, as `gs2ci import` and `gs2ci capture` write them.
        output: Folder for CSV, picture, section and the finished trials.
        index: Which shot of the file.
        knobs: What to vary, one thing at a time: preset (decode only, draft, standard, fine, paper), resolution,
            fits, iterations, population, start, "decode steps", "first look", "depth planes", windows, "list reuse",
            precision;
            all of them when not given.
        most: Leave out what is expected to take longer than this, by costs measured on the shot beforehand.
        seed: Of every random draw.
        report: A run folder of the same shot: its report.html gets a section on what accuracy costs, and keeps it
            when `gs2ci report` builds it again.
        fresh: Try everything again.

    Returns:
        The pages; last the run's, if there is one.

    Raises:
        Gs2ciError: The file or a value cannot be used.
    """
    from gs2ci.api import costs

    made = costs.tradeoff(
        shot,
        output,
        index=index,
        knobs=knobs,
        most=most,
        seed=seed,
        report=report,
        fresh=fresh,
        command=shlex.join(["gs2ci", *sys.argv[1:]]),
    )
    console = Console()
    console.print(Markdown(made.text))
    for page in made.pages:
        console.print(str(page), soft_wrap=True)
    return made.pages
