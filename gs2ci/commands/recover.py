"""`gs2ci recover`: save the finished rows of an interrupted capture.

Here: the arguments, and saving with a word on what was saved. Not here: the copying (`gs2ci.core.storage`).
"""

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.markup import escape


def run(
    partial: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
) -> Path:
    """Copy every finished row of an interrupted capture (NAME.h5.partial) into a new shot file.

    The damaged file is only read, never changed.

    Args:
        partial: The interrupted capture.
        out: The shot file to write; NAME.recovered.h5 when it is not given.

    Returns:
        The new shot file.
    """
    name = partial.name.removesuffix(".partial").removesuffix(".h5")
    return save_finished_rows(partial, out or partial.with_name(f"{name}.recovered.h5"))


def save_finished_rows(partial: Path, target: Path, *, replace: bool = False) -> Path:
    """Copy the finished rows of an interrupted capture into a shot file, and say how many they were.

    Args:
        partial: The interrupted capture.
        target: The shot file to write.
        replace: Whether a finished file of that name may be replaced.

    Returns:
        The shot file.
    """
    from gs2ci.core.storage import count_shots, recover

    recover(partial, target, replace=replace)
    count = count_shots(target)
    rows = f"{count} finished row{'s' if count != 1 else ''}"
    Console().print(f"{rows} of {escape(partial.name)} saved in [bold]{escape(str(target))}[/]", soft_wrap=True)
    return target
