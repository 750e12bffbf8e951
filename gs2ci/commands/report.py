"""`gs2ci report`: rebuild the page of a run folder.

Here: the arguments and what is printed. Not here: the page (`gs2ci.evaluate.pages`).
"""

from pathlib import Path
from typing import Annotated

import tyro

from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import say


def run(
    folder: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    *,
    json: AsJson = False,
) -> Path:
    """Rebuild the page of a run from its folder.

    Use this command to get the page of a newer version of the program, or to write it to another place; `gs2ci
    reconstruct` writes the same page at its end.

    Args:
        folder: A run folder, as `gs2ci reconstruct` writes it.
        output: The page; by default report.html in the folder. An earlier page is replaced, any other file is not.

    Returns:
        The page.

    Raises:
        Gs2ciError: The folder is no run, a part of it is damaged, or the page cannot be written.
    """
    from gs2ci.evaluate.pages.run_page import write_run_page

    with answered(json) as answer:
        page = write_run_page(folder, output)
        size = page.stat().st_size
        say("", page, f"  {size / 1e6:.1f} MB, one file")
        answer({"page": page, "bytes": size})
    return page
