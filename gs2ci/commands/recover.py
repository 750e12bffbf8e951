"""`gs2ci recover`: save the finished rows of an interrupted capture.

Here: the arguments, and saving with a report of what was saved. Not here: the copying (`gs2ci.api.shots`).
"""

from pathlib import Path
from typing import Annotated

import tyro

from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import say, say_what_reconstructs


def run(
    partial: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    json: AsJson = False,
) -> Path:
    """Copy every finished row of an interrupted capture (NAME.h5.partial) into a new shot file.

    The damaged file is only read, never changed.

    Args:
        partial: The interrupted capture.
        out: The shot file to write; by default NAME.recovered.h5.

    Returns:
        The new shot file.
    """
    from gs2ci.core.storage import count_shots

    with answered(json) as answer:
        saved = save_finished_rows(partial, out)
        answer({"file": saved, "shots": count_shots(saved)})
    return saved


def save_finished_rows(partial: Path, target: Path | None, *, replace: bool = False) -> Path:
    """Copy the finished rows of an interrupted capture into a shot file, and print their number.

    Args:
        partial: The interrupted capture.
        target: The shot file to write; by default NAME.recovered.h5.
        replace: Whether a finished file of that name may be replaced.

    Returns:
        The shot file.
    """
    from gs2ci.api.shots import recover
    from gs2ci.core.storage import count_shots

    saved = recover(partial, target, overwrite=replace)
    count = count_shots(saved)
    rows = f"{count} finished row{'s' if count != 1 else ''}"
    say(f"{rows} of {partial.name} saved in ", saved)
    say_what_reconstructs(saved, count, one_scene=True)
    return saved
