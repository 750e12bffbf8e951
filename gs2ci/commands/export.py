"""`gs2ci export`: a part of a run for another program. Here: the arguments and what is printed."""

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from gs2ci.api.exports import ExportFormat, export
from gs2ci.commands.answers import answered


def run(
    folder: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    *,
    to: ExportFormat,
    overwrite: bool = False,
    json: bool = False,
) -> Path:
    """Write a part of a run for another program.

    Args:
        folder: A run folder, as `gs2ci reconstruct` writes it.
        output: The file or folder to write; one of its own name here if not given.
        to: ply and spz hold the Gaussians; colmap is a folder with sparse model and images, nerfstudio one with
            transforms.json and images; depth-png (16 bit) and depth-exr are folders of depth maps; nexus is an HDF5
            file with views, depth and cameras under the names of the NeXus standard; gif and mp4 a short orbit of
            the scene.
        overwrite: Replace what lies there; a folder is replaced as a whole.
        json: Print the answer as JSON, and nothing else, on standard output.

    Returns:
        What was written.

    Raises:
        Gs2ciError: The folder is no run, or has no such part, or the output cannot be written.
    """
    with answered(as_text=not json) as answer:
        written = export(folder, to, output, overwrite=overwrite)
        Console(highlight=False).print(str(written), markup=False, soft_wrap=True)
        answer({"path": written, "format": to})
    return written
