"""`gs2ci export`: a part of a run for another program. Here: the arguments and what is printed."""

from pathlib import Path
from typing import Annotated, Any

import tyro

from gs2ci.api.derived import with_options_of
from gs2ci.api.exports import ExportFormat, export
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import say
from gs2ci.core.progress import Silent


@with_options_of(export, without=("run", "path", "progress"))
def run(
    folder: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    *,
    to: ExportFormat,
    json: AsJson = False,
    **options: Any,
) -> Path:
    """Write a part of a run for another program.

    Args:
        folder: A run folder, as `gs2ci reconstruct` writes it.
        output: The file or folder to write; by default one with the format's usual name in the current folder.

    Returns:
        What was written.

    Raises:
        Gs2ciError: The folder is no run, or has no such part, or the output cannot be written.
    """
    with answered(json) as answer:
        heard = Silent()
        written = export(folder, to, output, progress=heard, **options)
        for line in (*heard.sentences, written):
            say(line)
        answer({"path": written, "format": to, "notes": heard.sentences})
    return written
