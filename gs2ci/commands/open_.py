"""`gs2ci open`: a run's page in the browser. Here: the arguments and what is printed."""

from pathlib import Path
from typing import Annotated, Final

import tyro

from gs2ci.commands.lines import say
from gs2ci.core.errors import StorageError

# Pages of our folders; the first that exists is opened.
PAGES: Final = ("report.html", "index.html")


def run(
    folder: Annotated[Path, tyro.conf.Positional],
    /,
) -> Path:
    """Open the page of a run, or of a folder of runs, in the browser.

    Args:
        folder: As `gs2ci reconstruct` wrote it. A missing page of a run is rebuilt.

    Returns:
        The page.

    Raises:
        Gs2ciError: The folder is no run, or a part of it is damaged.
    """
    from gs2ci.api.runs import open_page, open_run

    page = next((folder / name for name in PAGES if (folder / name).is_file()), None)
    if page is None:
        if not folder.is_dir():
            raise StorageError(f"{folder} is no folder", remedy="give the folder that `gs2ci reconstruct -o` wrote")
        page = open_run(folder).page()
    seen = open_page(page)
    say(page if seen else f"{page}: no browser was found here; open this file in one")
    return page
