"""`gs2ci reconstruct`: from a shot file to a run folder.

Here: the arguments, and the order read → reconstruct → write → print. Not here: any of the four
(`gs2ci.api.reconstruction`).
"""

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import tyro

from gs2ci.api import reconstruction
from gs2ci.api.derived import with_options_of
from gs2ci.api.display import open_display
from gs2ci.api.options import check_whole
from gs2ci.api.shots import exposures_in, named_apart
from gs2ci.api.summary import print_summary
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import say
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.halt import Halt, halted_by_interruption
from gs2ci.reconstruct.choices import MOST_MOMENTS, RuleName

if TYPE_CHECKING:
    from gs2ci.api.runs import Run
    from gs2ci.core.progress import Progress
    from gs2ci.core.records import Shot


@with_options_of(reconstruction.reconstruct, without=("progress", "unfinished"))
def run(
    shot: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("run"),
    *,
    index: int | str | None = None,
    density: RuleName | None = None,
    moments: int | None = None,
    overwrite: bool = False,
    more: Annotated[tuple[Path, ...], tyro.conf.Positional] = (),
    every: Annotated[bool, tyro.conf.arg(name="all")] = False,
    processes: int | None = None,
    scheduler: str = "",
    explain_plan: bool = False,
    json: AsJson = False,
    **overrides: Any,
) -> Path:
    """Recover views, camera path and scene from one coded measurement, or from each of many.

    Ctrl-C, `kill` or a closed terminal during the fit ends the fit: the folder is written with the best result so far
    and a note that says so, and the exit status is 130. A second one, or one before the fit, writes nothing. With
    --together, `kill` and a closed terminal end it at once: what is done is kept beside the output, and the same
    command goes on from there after any of these, or a failure.

    Args:
        shot: A shot file, as `gs2ci import` and `gs2ci capture` write them.
        output: The run folder to write; for many exposures, the folder of their run folders.
        index: Which shot of the file; by default the first. With --together, which of each file, 3 or a range such as
            0:8; by default all.
        moments: Also write this many pictures spread evenly over the exposure: slow motion, if there are more of them
            than masks. They show the scene alone, at times and poses between those of the masks.
        overwrite: Replace an earlier run at the same place.
        more: More shot files. Of many exposures each is reconstructed; finished runs are skipped.
        every: Reconstruct every exposure of every file.
        processes: Number of exposures at once on this machine; by default as many as its cores and memory allow.
        scheduler: Address of a Dask scheduler to use instead, e.g. tcp://host:8786; its workers must see the same
            paths.
        explain_plan: Only print which paths, orders of depth and motions would be fitted, what each would cost and why;
            fit nothing and write nothing.

    Returns:
        The folder.

    Raises:
        Gs2ciError: The file, a value or the destination cannot be used; then the
            folder is unchanged.
        KeyboardInterrupt: The user interrupted; during the fit or later, the folder is written first.
    """
    overrides["density"] = density
    reconstruction.check_overrides(overrides)
    check_whole("--moments", moments, 2, MOST_MOMENTS)
    together = overrides.pop("together")
    if together and (explain_plan or scheduler or processes is not None or moments is not None):
        raise InputError(
            "--together with --explain-plan, --moments, --processes or --scheduler",
            allowed="one reconstruction of all exposures, in this process",
            remedy="leave these options out",
        )
    if isinstance(index, str) and not together:
        raise InputError(f"--index {index}", allowed="a whole number; a range only with --together")
    if together:
        # Beside the folder to be written, which does not exist before all is done.
        unfinished = output.absolute().parent / f".{output.absolute().name}.unfinished"
        exposures = chosen_exposures((shot, *more), index)
        try:
            return _write_run(
                lambda display: reconstruction.reconstruct(
                    exposures,
                    together=True,
                    unfinished=unfinished,
                    progress=display,
                    **overrides,
                ),
                exposures,
                output,
                overwrite=overwrite,
                json=json,
            )
        except (KeyboardInterrupt, SystemExit):
            if unfinished.is_dir():
                again = "the same command with --overwrite" if output.exists() and not overwrite else "the same command"
                say(f"what is done is kept in {unfinished}: {again} goes on from there", aside=True)
            raise
    assert not isinstance(index, str)
    if explain_plan:
        _explain(shot, index or 0, more=bool(more) or every, **overrides)
        return output
    if more or every or scheduler or processes is not None:
        if moments is not None:
            remedy = "reconstruct one exposure at a time, with --index"
            raise InputError("--moments of many exposures", remedy=remedy)
        if overrides.pop("budget") is not None:
            remedy = "give a --preset: machines differ, and so would results"
            raise InputError("--budget for many exposures", remedy=remedy)
        from gs2ci.commands.many import run_many

        return run_many(
            (shot, *more),
            output,
            every=every,
            index=index,
            processes=processes,
            scheduler=scheduler,
            overwrite=overwrite,
            json=json,
            **overrides,
        )
    from gs2ci.core.storage import count_shots, read_shot

    measured = read_shot(shot, index or 0)
    if index is None and (count := count_shots(shot)) > 1:
        others = "--together reconstructs all as one scene, --all each, --index another one"
        say(f"{shot} holds {count} exposures, and this is the first: {others}", aside=True)
    return _write_run(
        lambda display: reconstruction.reconstruct(measured, progress=display, **overrides),
        [measured],
        output,
        overwrite=overwrite,
        json=json,
        moments=moments,
    )


# Views, decode and scene in three colours, depth with its spread, confidence and error, and that of the views.
_RUN_BYTES_PER_PIXEL: Final = 4 * (3 * 3 + 5)


def _write_run(
    found_with: "Callable[[Progress], Run]",
    shots: "Sequence[Shot]",
    output: Path,
    *,
    overwrite: bool,
    json: bool,
    moments: int | None = None,
) -> Path:
    """Reconstruct, write the run folder, and print or answer what came of it."""
    from gs2ci.core.storage.sealing import check_room
    from gs2ci.evaluate.whole_folder import check_destination

    check_destination(output, overwrite=overwrite)
    check_room(output, _RUN_BYTES_PER_PIXEL * sum(one.masks.size for one in shots))
    with answered(json) as answer:
        with open_display() as display:
            found = found_with(display)
            writing = Halt("The result is being written; a second interruption discards it.")
            if not found.interrupted:
                writing.begin()
            display.stage("report")
            with halted_by_interruption(writing, display.say):
                _save(found, output, overwrite=overwrite, moments=moments, else_lost=len(shots) == 1)
        print_summary(output)
        answer({"folder": output, **found.report.model_dump(mode="json", by_alias=True)})
    if found.interrupted or writing.asked:
        # The run was written, but the exit status tells a script that it was to end.
        raise KeyboardInterrupt
    return output


def _save(found: "Run", output: Path, *, overwrite: bool, moments: int | None, else_lost: bool) -> None:
    """Write a run; where that is refused after all, and nothing else keeps it, among temporary files.

    Raises:
        StorageError: It could not be written to its place; says where it is.
    """
    try:
        found.save(output, overwrite=overwrite, moments=moments)
    except StorageError as error:
        if not else_lost:
            raise
        elsewhere = Path(tempfile.mkdtemp(prefix=f"{output.name}-"))
        try:
            found.save(elsewhere, moments=moments)
        except StorageError:
            elsewhere.rmdir()
            raise error from None
        raise StorageError(error.problem, remedy=f"the run is in {elsewhere}: move it from there") from error


def chosen_exposures(files: Sequence[Path], index: int | str | None) -> "list[Shot]":
    """Read the exposures of files that are to share a scene.

    Args:
        files: Shot files.
        index: Which of each: a number, a range such as 0:8, or None for all.

    Raises:
        InputError: The range is none, or a file does not hold these.
        StorageError: A file cannot be read.
    """
    from gs2ci.core.storage import count_shots

    found = []
    for file in files:
        count = count_shots(file)
        numbers = range(count)[_range(index)] if index is not None else range(count)
        if not numbers:
            raise InputError(f"{file} has no exposures {index}", allowed=f"0 to {count - 1}", remedy="see --index")
        found += exposures_in(file, numbers, count)
    return named_apart(found)


def _range(index: int | str) -> slice:
    """Return the slice that a number or a range such as 0:8 names."""
    first, colon, last = str(index).partition(":")
    try:
        begin, end = (int(part) if part.strip() else None for part in (first, last))
    except ValueError as error:
        raise InputError(f"--index {index}", allowed="a whole number, or a range such as 0:8") from error
    if (begin or 0) < 0 or (end or 0) < 0 or (begin is None and not colon):
        raise InputError(f"--index {index}", allowed="whole numbers from 0")
    return slice(begin, end) if colon else slice(begin, (begin or 0) + 1)


def _explain(shot: Path, index: int, *, more: bool, **overrides: Any) -> None:
    """Print what a reconstruction would try, and what that would cost."""
    from gs2ci.core.storage import read_shot

    if more:
        raise InputError("--explain-plan of many exposures", remedy="ask for one of them, with --index")
    with open_display() as display:
        plan = reconstruction.foresee(read_shot(shot, index), progress=display, **overrides)
    print(plan)
