"""Shots from files and into files.

Here: `load`, `save`, `import_file`, `recover`. Not here: any guess about a foreign file (`gs2ci.core.foreign`), file
layouts (`gs2ci.core.storage`).
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar, cast, get_args

import numpy as np

from gs2ci.api.options import as_path, check_choice, check_number, check_whole
from gs2ci.core.arrays import on_host
from gs2ci.core.errors import InputError
from gs2ci.core.records import FOCAL_RANGE_PX, MEASUREMENT_LIMIT, CfaPattern, Shot

_SHOT_FILES: Final = (".h5", ".hdf5")
# Of a stage's positions, in any unit from nm to km.
_ERROR_RANGE: Final = (1e-9, 1e9)

if TYPE_CHECKING:
    from gs2ci.core.foreign.assemble import Imported
    from gs2ci.core.foreign.container import Array

_Exposure = TypeVar("_Exposure", bound=Shot | str | Path)
ArrayOrFile = Any
"""An array of numpy or torch, nested lists, or the path of a file that holds one array."""


def load(path: str | Path, masks: str | Path | None = None, *, index: int = 0, **known: Any) -> Shot:
    """Load one shot from a shot file, or from .npz, .npy, .mat or pictures.

    Guesses about a foreign file are listed in the shot's `provenance["guesses"]`; `import_file` returns every shot of
    a file.

    Args:
        path: A shot file (`.h5`), or a foreign one that `gs2ci import` reads.
        masks: File or folder of pictures with the masks, if they are not in the measurement's file.
        index: Which shot of the file, from 0.
        known: Properties of a foreign file: any of the keyword arguments of `import_file`.

    Returns:
        The shot, checked.

    Raises:
        StorageError: A shot file cannot be read, or has no such shot.
        InputError: The first argument is no path, the index no number from 0, or a foreign file cannot be understood;
            the message names file, key and remedy.

    Example:
        >>> shot = gs2ci.load("measurement.npz", focal_px=40.0)
        >>> shot.views, shot.size, shot.channels
        (4, (24, 32), 3)
    """
    path = _place(path)
    check_whole("--index", index, 0)
    if path.suffix in _SHOT_FILES:
        if masks is not None or known:
            raise InputError(
                f"{path} is a shot file, which describes itself",
                allowed="only index with it",
                remedy=f"leave {', '.join(known) or 'masks'} out; dataclasses.replace changes a part of a shot",
            )
        from gs2ci.core.storage import read_shot

        return read_shot(path, index)
    return picked(import_file(path, masks, **known).shots, index, path)[0]


def import_file(
    path: str | Path,
    masks: str | Path | None = None,
    *,
    truth: ArrayOrFile = None,
    poses: ArrayOrFile = None,
    stage: str | Path | None = None,
    stage_axes: tuple[str, ...] = ("right", "down", "ahead"),
    stage_error: float | None = None,
    stage_turn_error_deg: float | None = None,
    intrinsics: ArrayOrFile = None,
    focal_px: float | None = None,
    distortion: Sequence[float] = (),
    meas_key: str | None = None,
    mask_key: str | None = None,
    truth_key: str | None = None,
    white_key: str | None = None,
    dark_key: str | None = None,
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
    curve: Literal["auto", "linear", "srgb", "gamma", "root", "divided", "overflow"] = "auto",
) -> "Imported":
    """Turn a foreign file into shots; what is not given is inferred from the numbers, and every guess is returned.

    Args:
        path: Measurement, with or without masks: .npz, .npy, .mat (v5, v7.3), a PNG or TIFF.
        masks: Masks, if they are in a separate file, or a folder of PNG or TIFF pictures.
        truth: True views, or their file, for scoring only.
        poses: True poses, for scoring only: world-to-camera [N, 4, 4], OpenCV axes, or their file; or a
            transforms.json, the folder of a COLMAP model, or the text of a trajectory (TUM, KITTI).
        stage: Log of the stage that carried the camera, from which a reconstruction begins: a CSV file with one row
            for each mask, columns named x_mm, y_mm, z_mm; or one array in .npy, .npz or .mat: positions [N, 3], or
            world-to-camera poses [N, 4, 4]; or a camera file as for poses.
        stage_axes: Which way the camera goes as x, y and z of the log grow: three of right, left, down, up, ahead and
            back.
        stage_error: Standard error of these positions, in mm, or in their own unit if no column names it; by default
            1 % of the path.
        stage_turn_error_deg: By how many degrees the stage may turn the camera from the first to the last position
            (standard error); by default 0.1 px. Depths and lengths err with it.
        intrinsics: Camera matrix: fx fy cx cy in pixels (pixel centres at +0.5); a file with [3, 3]; or a calibration
            by OpenCV or ROS, a transforms.json or a COLMAP model, with the lens; in Python an array as well.
        focal_px: Focal length in pixels, with the principal point at the centre.
        distortion: Coefficients of the lens in OpenCV's convention: k1 k2 p1 p2, and k3 if it was fitted. Needs the
            camera matrix.
        meas_key: Key of the measurement in its file.
        mask_key: Key of the masks in their file.
        truth_key: Key of the true views, in the file of --truth if there is one; "none" leaves them out.
        white_key: Key of frames of an even light, by which readings are divided; "none" leaves them out.
        dark_key: Key of frames without light, which are subtracted; "none" leaves them out.
        mask_axis: Whether the masks are stacked along the first or the last axis.
        meas_layout: Whether three images are one RGB measurement or a stack of three measurements.
        views: Use only this many masks, from the first.
        reverse_masks: The masks, with their weights, were exposed in the opposite order.
        mask_scale: Reading of a fully open mask.
        scale: Reading of a white scene under one open mask, above the offset.
        offset: Reading without light.
        saturation: Readings at or above it count as clipped; 0 means that none is.
        cfa: Colour filter array of a Bayer measurement.
        bad_pixels: Refuse NaN in the measurement, or replace it by the median of its neighbours.
        curve: How readings are stored: in proportion to light, encoded for a display (sRGB, gamma 2.2), as square
            roots, divided by the sum of the masks, or summed in integers that went round; auto: as they show.

    Returns:
        `shots`, and `guesses`, one sentence each.

    Raises:
        InputError: The file cannot be understood or contradicts itself; names file, key and remedy. Or an argument is
            out of bounds.

    Example:
        >>> imported = gs2ci.import_file("measurement.npz", focal_px=40.0)
        >>> len(imported.shots), len(imported.guesses) > 0
        (1, True)
    """
    given = locals()
    check_imports(given)
    check_number("--stage-turn-error-deg", stage_turn_error_deg, most=90, above=0)
    about = stage_error, stage_turn_error_deg, None if tuple(stage_axes) == ("right", "down", "ahead") else stage_axes
    if stage is None and any(one is not None for one in about):
        raise InputError(
            "options of a stage's log without --stage", remedy="give the log by --stage, or leave them out"
        )
    from gs2ci.core.foreign import curves, pixels
    from gs2ci.core.foreign.assemble import import_shots
    from gs2ci.core.foreign.container import Array
    from gs2ci.core.foreign.options import ImportOptions, Layout, MaskAxis

    check_choice("--mask-axis", mask_axis, get_args(MaskAxis))
    check_choice("--meas-layout", meas_layout, get_args(Layout))
    check_choice("--bad-pixels", bad_pixels, get_args(pixels.BadPixels))
    check_choice("--curve", curve, get_args(curves.CurveName))
    options = {name: given[name] for name in ImportOptions.__dataclass_fields__ if name in given} | {
        "distortion": Array("--distortion", np.array(distortion)) if len(distortion) else None,
        "intrinsics": Path(intrinsics) if isinstance(intrinsics, str | Path) else _given("--intrinsics", intrinsics),
        "world_to_camera": Path(poses) if isinstance(poses, str | Path) else _given("--poses", poses),
        "truth": _given("--truth", truth, "truth", None if truth_key == "none" else truth_key),
        "stage": None if stage is None else _place(stage),
        "stage_axes": tuple(stage_axes),
    }
    return import_shots(_place(path), None if masks is None else _place(masks), ImportOptions(**options))


# What is accepted, from and to.
_BOUNDS: Final = {
    "focal_px": FOCAL_RANGE_PX,
    "mask_scale": (1 / MEASUREMENT_LIMIT, MEASUREMENT_LIMIT),
    "scale": (1 / MEASUREMENT_LIMIT, MEASUREMENT_LIMIT),
    "offset": (-MEASUREMENT_LIMIT, MEASUREMENT_LIMIT),
    "saturation": (0, MEASUREMENT_LIMIT),
    "stage_error": _ERROR_RANGE,
}


def check_imports(given: Mapping[str, Any]) -> None:
    """Check the numbers among the arguments of `import_file`.

    Raises:
        InputError: One is out of bounds, or the distortion is no list.
    """
    check_whole("--views", given["views"], 1)
    for name, bounds in _BOUNDS.items():
        check_number(f"--{name.replace('_', '-')}", given[name], *bounds)
    distortion = given["distortion"]
    if not isinstance(distortion, Iterable):
        raise InputError(
            f"--distortion {distortion}",
            allowed="a list: k1 k2 p1 p2, and k3 if it was fitted",
            remedy="give such a list, or leave --distortion out",
        )
    for coefficient in distortion:
        check_number("--distortion", coefficient)


def save(path: str | Path, shots: Shot | Sequence[Shot], *, overwrite: bool = False) -> Path:
    """Write one shot, or several that share masks and camera, into a shot file; reading gives the same numbers back.

    Args:
        path: Of the file, ends in .h5.
        shots: One or several.
        overwrite: Replace a finished file of that name.

    Returns:
        The path.

    Raises:
        InputError: A shot contradicts itself, the first argument is no path, or the second is no shot.
        StorageError: The file exists, cannot be written, or the shots differ in data that a file stores only once.

    Example:
        >>> shot = gs2ci.load("measurement.npz", focal_px=40.0)
        >>> path = gs2ci.save("copy.h5", shot)
        >>> bool((gs2ci.load(path).measurement == shot.measurement).all())
        True
    """
    from gs2ci.core.storage import write_shots
    from gs2ci.core.storage.sealing import check_target

    path = as_path(path, of="the file to write", remedy="the path comes first: gs2ci.save('shot.h5', shot)")
    kept = list(shots) if isinstance(shots, Iterable) else [shots]
    if not all(isinstance(shot, Shot) for shot in kept):
        raise InputError(
            f"{type(shots).__name__} where shots are expected",
            allowed="a gs2ci.Shot, or several",
            remedy="make a shot of arrays by gs2ci.Shot(measurement, masks)",
        )
    check_target(path, replace=overwrite, remedy="choose another name with -o, or add --overwrite to replace it")
    return write_shots(path, kept)


def recover(partial: str | Path, target: str | Path | None = None, *, overwrite: bool = False) -> Path:
    """Copy every finished row of an interrupted capture into a new shot file; the damaged file is only read.

    Args:
        partial: The interrupted capture, NAME.h5.partial.
        target: The shot file to write; by default NAME.recovered.h5.
        overwrite: Replace a finished file of that name.

    Returns:
        The new shot file.

    Raises:
        StorageError: There is no finished row, or the new file cannot be written.
        InputError: An argument is no path.

    Example:
        >>> gs2ci.load(gs2ci.recover("interrupted.h5.partial")).views
        4
    """
    from gs2ci.core import storage

    partial = as_path(partial, of="an interrupted capture", remedy="give that of NAME.h5.partial")
    name = partial.name.removesuffix(".partial").removesuffix(".h5")
    saved = partial.with_name(f"{name}.recovered.h5") if target is None else _place(target)
    storage.recover(partial, saved, replace=overwrite)
    return saved


def picked(shots: Sequence[Shot], index: int | None, path: Path) -> list[Shot]:
    """Return one of a file's shots, or all of them if none is selected.

    Raises:
        InputError: There is no such shot.
    """
    if index is None:
        return list(shots)
    if not 0 <= index < len(shots):
        raise InputError(
            f"{path}: no measurement {index}", allowed=f"0 to {len(shots) - 1}" if len(shots) > 1 else "0: it holds one"
        )
    return [shots[index]]


def _place(path: str | Path) -> Path:
    """Return a path as a Path.

    Raises:
        InputError: It is something else.
    """
    return as_path(path, of="a file", remedy="make a shot of arrays by gs2ci.Shot(measurement, masks)")


def _given(
    name: str, value: ArrayOrFile, role: Literal["truth"] | None = None, key: str | None = None
) -> "Array | None":
    from gs2ci.core.foreign.container import Array
    from gs2ci.core.foreign.opening import load_single

    if value is None:
        return None
    if isinstance(value, str | Path):
        return load_single(Path(value), role, key)
    try:
        return Array(name, np.asarray(on_host(value), dtype=np.float64))
    except (TypeError, ValueError, RuntimeError) as error:  # the last of tensors without data, or lazily negated
        raise InputError(
            f"{name} is {type(value).__name__}, no array of numbers: {error}", allowed="an array, or the path of a file"
        ) from error


def every_exposure(shot: Shot | str | Path | Sequence[Shot | str | Path], *, together: bool) -> list[Shot | str | Path]:
    """Return the shots to reconstruct: one, or with `together` all of a list, those of a shot file one by one.

    Raises:
        InputError: There are several, and they are not to be reconstructed together; or there is none.
        StorageError: A shot file cannot be read.
    """
    # Whatever else it is, `load` refuses it by its type.
    given = list(shot) if isinstance(shot, list | tuple) else [cast(Shot | str | Path, shot)]
    if not together:
        if len(given) != 1:
            raise InputError(
                f"{len(given)} shots to reconstruct",
                allowed="one, or several with together=True, for one scene",
                remedy="give together=True, or reconstruct each by itself (gs2ci.reconstruct_many)",
            )
        return given
    from gs2ci.core.storage import count_shots

    found: list[tuple[Shot | str | Path, str]] = []
    for one in given:
        if isinstance(one, str | Path) and Path(one).suffix.lower() in _SHOT_FILES:
            count = count_shots(Path(one))
            found += exposures_in(Path(one), range(count), count)
        else:
            found.append((one, ""))
    if not found:
        raise InputError("no exposure to reconstruct", allowed="one or more")
    return named_apart(found)


def exposures_in(file: Path, numbers: Iterable[int], count: int) -> list[tuple[Shot, str]]:
    """Read exposures of a file that holds so many, each with a name after the file, as `named_apart` takes them.

    Raises:
        StorageError: The file cannot be read.
    """
    from gs2ci.core.storage import read_shot

    return [(read_shot(file, number), file.stem if count == 1 else f"{file.stem}-{number}") for number in numbers]


def named_apart(found: Sequence[tuple[_Exposure, str]]) -> list[_Exposure]:
    """Return exposures under the names of their files where they have one name, as all captures of a bench do."""
    many = Counter(one.name for one, _ in found if isinstance(one, Shot))
    return [
        replace(one, name=own) if isinstance(one, Shot) and own and many[one.name] > 1 else one for one, own in found
    ]
