"""`gs2ci mesh`: a mesh of the surfaces in a run. Here: the arguments and what is printed."""

from pathlib import Path
from typing import Annotated, Any

import tyro

from gs2ci.api.derived import with_options_of
from gs2ci.api.exports import mesh
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import say


@with_options_of(mesh, without=("run", "path"))
def run(
    folder: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("mesh.ply"),
    *,
    json: AsJson = False,
    **options: Any,
) -> Path:
    """Fuse the depths of a run into a mesh, PLY with a colour per vertex.

    Args:
        folder: A run folder, as `gs2ci reconstruct` writes it.
        output: The file to write.

    Returns:
        The mesh.

    Raises:
        Gs2ciError: The folder is no run, its depth is not reliable, or the output cannot be written.
    """
    with answered(json) as answer:
        written = mesh(folder, output, **options)
        say(written)
        answer({"path": written})
    return written
