"""`gs2ci recover`: save the finished rows of an interrupted capture.

Here: the arguments. Not here: the copying (`gs2ci.core.storage`). Only `gs2ci.cli` imports this file.
"""

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.markup import escape

from gs2ci.core.storage import count_shots, recover


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
    target = out or partial.with_name(partial.name.removesuffix(".partial").removesuffix(".h5") + ".recovered.h5")
    recover(partial, target)
    count = count_shots(target)
    Console().print(
        f"{count} finished row{'s' if count != 1 else ''} saved in [bold]{escape(str(target))}[/]", soft_wrap=True
    )
    return target
