"""`gs2ci design`: which masks, travel and number of exposures serve a bench and a kind of scene best.

Here: the arguments and what is printed. Not here: the work (`gs2ci.api.designing`).
"""

import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import tyro

from gs2ci.api import designing
from gs2ci.api.derived import with_options_of
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.printed_pages import print_pages


@with_options_of(designing.design, without=("command", "progress"))
def run(
    rig: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("designed.toml"),
    *,
    scene: str,
    masks: tuple[int, ...] = (),
    open_share: tuple[float, ...] = (),
    element: tuple[int, ...] = (),
    travel_mm: tuple[float, ...] = (),
    exposures: tuple[int, ...] = (),
    json: AsJson = False,
    **options: Any,
) -> Path:
    """Find which masks, travel and number of exposures serve a bench and a kind of scene best; nothing is opened.

    Each candidate is judged by what its coding tells of a simulated scene; the best are checked by reconstructions.
    The rig file that is written takes the best, everything else in it stays as you wrote it.

    Returns:
        The rig file.

    Raises:
        Gs2ciError: A file or a value cannot be used.
    """
    command = shlex.join(["gs2ci", *sys.argv[1:]])
    with answered(json) as answer:
        made = designing.design(
            rig,
            output,
            scene=scene,
            masks=masks,
            open_share=open_share,
            element=element,
            travel_mm=travel_mm,
            exposures=exposures,
            command=command,
            **options,
        )
        print_pages(made.text, [made.rig_file, *made.pages])
        answer(
            {
                "rig_file": made.rig_file,
                "chosen": made.found.chosen,
                "candidates": made.found.rows,
                "commands": made.found.commands,
                "pages": made.pages,
            }
        )
    return made.rig_file
