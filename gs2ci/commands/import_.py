"""`gs2ci import`: a foreign file, or an interrupted capture, becomes a shot file.

Here: the command's arguments and what it prints. Not here: any guess or file layout
(`gs2ci.api.shots`).
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import tyro
from rich.console import Console
from rich.markup import escape

from gs2ci.api.shots import check_imports, import_file, picked
from gs2ci.commands.answers import answered
from gs2ci.commands.recover import save_finished_rows
from gs2ci.core.errors import InputError
from gs2ci.core.records import CfaPattern

if TYPE_CHECKING:
    from gs2ci.core.foreign.assemble import Imported

# What options say that were left out, where that is not None.
_SILENT: Final = {
    "distortion": (),
    "mask_axis": "auto",
    "meas_layout": "auto",
    "reverse_masks": False,
    "bad_pixels": "refuse",
}


def run(
    file: tyro.conf.Positional[Path],
    masks_file: tyro.conf.Positional[Path | None] = None,
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    masks: Path | None = None,
    truth: Path | None = None,
    poses: Path | None = None,
    intrinsics: tuple[str, ...] = (),
    focal_px: float | None = None,
    distortion: tuple[float, ...] = (),
    meas_key: str | None = None,
    mask_key: str | None = None,
    truth_key: str | None = None,
    mask_axis: Literal["auto", "first", "last"] = "auto",
    meas_layout: Literal["auto", "rgb", "stack"] = "auto",
    views: int | None = None,
    reverse_masks: bool = False,
    mask_scale: float | None = None,
    scale: float | None = None,
    offset: float | None = None,
    saturation: float | None = None,
    cfa: CfaPattern | None = None,
    bad_pixels: Literal["refuse", "median"] = "refuse",
    index: int | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> Path:
    """Turn a coded measurement and its masks (.npz, .npy, .mat, pictures) into a shot file.

    What is not said is guessed from the numbers, and every guess is printed. An interrupted capture
    (NAME.h5.partial) is recovered: its finished rows are copied into the new file.

    Args:
        file: Measurement, with or without masks: .npz, .npy, .mat (v5, v7.3), a PNG or TIFF, or a .partial.
        masks_file: Masks, if they lie in a file of their own, or a folder of PNG or TIFF pictures.
        out: Shot file to write, ends in .h5.
        masks: Same as the second file.
        truth: File with the true views, for scoring only.
        poses: File with the true poses, world-to-camera [N, 4, 4], OpenCV axes, for scoring only.
        intrinsics: Camera matrix as a file with [3, 3], or fx fy cx cy in pixels (pixel centres at +0.5).
        focal_px: Focal length in pixels, with the principal point at the centre.
        distortion: Of the lens, as OpenCV states it: k1 k2 p1 p2, and k3 if it was fitted. Needs the camera matrix.
        meas_key: Key of the measurement in its file.
        mask_key: Key of the masks in their file.
        truth_key: Key of the true views; none leaves them out.
        mask_axis: Whether the masks are counted along the first or the last axis.
        meas_layout: Whether three images are one RGB measurement or a stack of three measurements.
        views: Use only the first so many masks.
        reverse_masks: The masks were exposed in the opposite order.
        mask_scale: Reading of a fully open mask.
        scale: Reading of a white scene under one open mask, above the offset.
        offset: Reading without light.
        saturation: Readings at or above it count as clipped; 0 says that none is.
        cfa: Colour filter array of a Bayer measurement.
        bad_pixels: Refuse NaN in the measurement, or replace them from their neighbours.
        index: Keep only this one of several measurements, counted from 0.
        overwrite: Replace a finished file of that name.
        json: Print the answer as JSON, and nothing else, on standard output.

    Returns:
        The shot file.
    """
    known: dict[str, Any] = {
        "truth": truth,
        "poses": poses,
        "intrinsics": _camera(intrinsics),
        "focal_px": focal_px,
        "distortion": distortion,
        "meas_key": meas_key,
        "mask_key": mask_key,
        "truth_key": truth_key,
        "mask_axis": mask_axis,
        "meas_layout": meas_layout,
        "views": views,
        "reverse_masks": reverse_masks,
        "mask_scale": mask_scale,
        "scale": scale,
        "offset": offset,
        "saturation": saturation,
        "cfa": cfa,
        "bad_pixels": bad_pixels,
    }
    check_imports(focal_px, mask_scale, scale, offset, saturation, views, distortion)
    from gs2ci.core.storage import count_shots, write_shots
    from gs2ci.core.storage.sealing import check_target

    check_target(out, replace=overwrite, remedy="choose another name with -o, or add --overwrite to replace it")
    with answered(as_text=not json) as answer:
        if file.name.endswith(".partial"):
            _check_alone(
                file, masks_file, masks, index is not None, *(value != _SILENT.get(key) for key, value in known.items())
            )
            saved = save_finished_rows(file, out, replace=overwrite)
            answer({"file": saved, "shots": count_shots(saved), "guesses": []})
            return saved
        masks = _only_one(masks_file, masks)
        _check_apart(out, file, masks, truth, poses)
        imported = import_file(file, masks, **known)
        kept = picked(imported.shots, index, file)
        write_shots(out, kept)
        _print(Console(), file, out, imported, index)
        answer({"file": out, "shots": len(kept), "guesses": list(imported.guesses)})
        return out


def _check_alone(partial: Path, *given: object) -> None:
    """Return if nothing else was given that an interrupted capture could not heed."""
    if any(given):
        raise InputError(
            f"options beside {partial}, an interrupted capture, which tells all by itself",
            allowed="-o and --overwrite",
            remedy="leave the others out",
        )


def _only_one(masks_file: Path | None, masks: Path | None) -> Path | None:
    """Return the file with the masks, which may be given in either of two ways."""
    if masks is not None and masks_file is not None:
        raise InputError(f"masks given twice: {masks_file} and --masks {masks}", remedy="give one of them")
    return masks or masks_file


def _check_apart(out: Path, *files: Path | None) -> None:
    """Return if what is to be written replaces nothing that is read: a measurement cannot be taken again."""
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


def _print(console: Console, file: Path, out: Path, imported: "Imported", index: int | None) -> None:
    console.print(f"[bold]{escape(file.name)}[/]")
    for guess in imported.guesses:
        style = "yellow" if guess.startswith("WARNING") else ""
        console.print(f"  • {escape(guess)}", style=style, highlight=False, soft_wrap=True)
    count = len(imported.shots) if index is None else 1
    console.print(f"{count} shot{'s' if count > 1 else ''} in [bold]{escape(str(out))}[/]", soft_wrap=True)
