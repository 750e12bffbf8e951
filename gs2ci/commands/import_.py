"""`gs2ci import`: a foreign file, or an interrupted capture, becomes a shot file.

Here: the command's arguments and what it prints. Not here: any guess or file layout
(`gs2ci.api.shots`).
"""

import inspect
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from gs2ci.api.derived import with_options_of
from gs2ci.api.shots import check_imports, import_file, picked
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import say, say_what_reconstructs
from gs2ci.commands.recover import save_finished_rows
from gs2ci.core.errors import InputError

if TYPE_CHECKING:
    from gs2ci.core.foreign.assemble import Imported


@with_options_of(import_file, without=("path",))
def run(
    file: tyro.conf.Positional[Path],
    masks: tyro.conf.Positional[Path | None] = None,
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    truth: Path | None = None,
    poses: Path | None = None,
    stage: Path | None = None,
    stage_axes: tuple[str, str, str] = ("right", "down", "ahead"),
    intrinsics: tuple[str, ...] = (),
    distortion: tuple[float, ...] = (),
    index: int | None = None,
    overwrite: bool = False,
    json: AsJson = False,
    **known: Any,
) -> Path:
    """Turn a coded measurement and its masks (.npz, .npy, .mat, pictures) into a shot file.

    What is not given is inferred from the numbers, and every guess is printed. An interrupted capture
    (NAME.h5.partial) is recovered: its finished rows are copied into the new file.

    Args:
        file: Measurement, with or without masks: .npz, .npy, .mat (v5, v7.3), a PNG or TIFF, or a .partial.
        out: Shot file to write, ends in .h5.
        index: Keep only this one of several measurements, counted from 0.
        overwrite: Replace a finished file of that name.

    Returns:
        The shot file.
    """
    known |= {
        "truth": truth,
        "poses": poses,
        "stage": stage,
        "stage_axes": stage_axes,
        "intrinsics": _camera(intrinsics),
        "distortion": distortion,
    }
    check_imports(known)
    from gs2ci.core.storage import count_shots, write_shots
    from gs2ci.core.storage.sealing import check_target

    check_target(out, replace=overwrite, remedy="choose another name with -o, or add --overwrite to replace it")
    with answered(json) as answer:
        if file.name.endswith(".partial"):
            usual = inspect.signature(run).parameters
            said = (value != usual[name].default for name, value in known.items() if name != "intrinsics")
            _check_alone(file, masks, intrinsics, index is not None, *said)
            saved = save_finished_rows(file, out, replace=overwrite)
            answer({"file": saved, "shots": count_shots(saved), "guesses": []})
            return saved
        _check_apart(out, file, masks, truth, poses, stage)
        imported = import_file(file, masks, **known)
        kept = picked(imported.shots, index, file)
        write_shots(out, kept)
        _print(file, out, imported, index)
        answer({"file": out, "shots": len(kept), "guesses": list(imported.guesses)})
        return out


def _check_alone(partial: Path, *given: object) -> None:
    """Return only if no option was given that does not apply to an interrupted capture."""
    if any(given):
        raise InputError(
            f"options with {partial}, an interrupted capture, which describes itself",
            allowed="-o and --overwrite",
            remedy="leave the others out",
        )


def _check_apart(out: Path, *files: Path | None) -> None:
    """Return only if the output replaces no input: a measurement cannot be taken again."""
    if any(file is not None and out.resolve() == file.resolve() for file in files):
        raise InputError(f"{out}: would replace a file that it is made from", remedy="choose another name with -o")


def _camera(words: tuple[str, ...]) -> Path | list[float] | None:
    """Return the camera matrix as it was typed: a file, or the four numbers.

    Raises:
        InputError: It is neither.
    """
    if not words:
        return None
    if len(words) == 1:
        return Path(words[0])
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != 4:
        raise InputError(f"--intrinsics {' '.join(words)}", allowed="a file, or the four numbers fx fy cx cy in pixels")
    return values


def _print(file: Path, written: Path, imported: "Imported", index: int | None) -> None:
    say("", file.name)
    for guess in imported.guesses:
        say(f"  • {guess}", style="yellow" if guess.startswith("WARNING") else "")
    count = len(imported.shots) if index is None else 1
    say(f"{count} shot{'s' if count > 1 else ''} in ", written)
    say_what_reconstructs(written, count, one_scene=False)
