"""The log of a user's own stage, beside a coded measurement: camera poses from the positions that it reported.

Here: a table of positions (CSV, or an array), one row for each mask, and which way the camera goes along its columns.
Not here: poses as matrices (`camera`), a log against time, whose positions must be taken at the masks' times
(docs/how-to.md), the stage of a rig file (`gs2ci.rig.telemetry`).
"""

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import Array, damage_as_input_error
from gs2ci.core.foreign.opening import load_single

Way = Literal["right", "left", "down", "up", "ahead", "back"]
USUAL_WAYS: Final[tuple[Way, Way, Way]] = ("right", "down", "ahead")
"""OpenCV's axes of a camera."""
_ENDINGS: Final = (".csv", ".txt", ".tsv", ".log", ".dat")
_MM: Final = {"m": 1e3, "cm": 10.0, "mm": 1.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "nm": 1e-6}
_AXES: Final = "xyz"
_POSITIONS: Final = ("position", "pos", "stage")
# Columns that turn the camera; a log that has them is not read without them.
_TURNS: Final = re.compile(r"(yaw|pitch|roll|tilt|angle|theta|phi|rot|quat|q[wxyz]|r[xyz])", re.IGNORECASE)
_NAMED: Final = re.compile(r"([a-zA-Z]+)(?:[ _]*[\[(/_ ]\s*([a-zA-Zµμ]+)\s*[\])]?)?")
_HOW: Final = "one row for each mask, in the order of exposure, under a first row of names: x_mm, y_mm, z_mm"


def stage_poses(path: Path, ways: Sequence[str], guesses: list[str]) -> Array:
    """Return world-to-camera poses, [R, 4, 4], from a stage's log; the first is no special one.

    Args:
        path: A CSV file (comma, semicolon, tab or blanks; its columns named, or one or three without names), or a file
            with one array: positions [R], [R, 1] or [R, 3], or poses [R, 4, 4] or [R, 3, 4], which are taken as they
            are.
        ways: Which way the camera goes as x, y and z of the log grow, of `Way`.
        guesses: Sentences are added here.

    Raises:
        InputError: The file is no such log, says of the camera what positions do not, or does not move; or the ways
            are not three at right angles.
    """
    axes = _axes(ways)
    if path.suffix.lower() in _ENDINGS:
        places = _table(path, guesses)
    else:
        given = load_single(path)
        values = np.asarray(given.values, np.float64)
        if values.ndim == 3:
            if tuple(ways) != USUAL_WAYS:
                raise InputError(f"--stage-axes with {path}, which holds poses", remedy="leave --stage-axes out")
            return given
        places = values.reshape(-1, 1) if values.ndim == 1 else values
        if places.ndim != 2 or places.shape[1] not in (1, 3):
            raise InputError(f"{path}: an array of shape {list(values.shape)}", allowed="[N, 3], [N] or [N, 4, 4]")
    if not np.isfinite(places).all():
        row = int(np.flatnonzero(~np.isfinite(places).all(axis=1))[0])
        raise InputError(
            f"{path}: position {row + 1} holds NaN or infinity", remedy="mend the log, or leave --stage out"
        )
    if len(places) > 1 and not np.ptp(places, axis=0).any():
        raise InputError(f"{path}: all {len(places)} positions are the same", remedy="leave --stage out, or mend it")
    places = np.pad(places, ((0, 0), (0, 3 - places.shape[1])))
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    poses[:, :3, 3] = -places @ axes
    told = ", ".join(f"{way} as {axis} grows" for axis, way in zip(_AXES, ways, strict=True))
    guesses.append(f"{path.name}: poses of the stage: the camera goes {told}, and does not turn (--stage-axes)")
    return Array(str(path), poses)


def _axes(ways: Sequence[str]) -> F64:
    """Return the camera's motion per unit of each axis of the log, [3, 3], in its own frame (x right, y down)."""
    vectors = {way: np.eye(3)[k // 2] * (1 - 2 * (k % 2)) for k, way in enumerate(get_args(Way))}
    axes = np.array([vectors.get(way, np.zeros(3)) for way in ways]).reshape(-1, 3)
    if axes.shape != (3, 3) or abs(np.linalg.det(axes)) != 1:
        raise InputError(
            f"--stage-axes {' '.join(map(str, ways))}",
            allowed=f"where the camera goes as x, y and z grow: three of {', '.join(get_args(Way))}, at right angles",
        )
    return axes


def _table(path: Path, guesses: list[str]) -> F64:
    """Return the positions of a text file, [R, 1] or [R, 3], in mm if it names a unit."""
    with damage_as_input_error(str(path)):
        if not path.is_file():
            raise InputError(f"{path}: no such file", remedy="check the name")
        text = path.read_text(encoding="utf-8-sig")
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    names, unmarked = [], [line for line in lines if not line.startswith("#")]
    if not unmarked:
        raise InputError(f"{path}: no rows", allowed=_HOW)
    mark = next((one for one in ";\t" if one in unmarked[0]), "," if "," in unmarked[0] else None)
    rows = [line.split() if mark is None else next(csv.reader([line], delimiter=mark)) for line in unmarked]
    if _numbers(rows[0], mark) is None:
        names, rows = [name.strip() for name in rows[0]], rows[1:]
    elif lines[0].startswith("#"):  # as numpy.savetxt writes a header
        names = next(csv.reader([lines[0].lstrip("# ")], delimiter=mark or " "))
    values = [_numbers(row, mark) for row in rows]
    for number, row in enumerate(values, 1):
        if row is None or len(row) != len(values[0] or ()):
            raise InputError(f"{path}: row {number} of the log is no row of numbers like the others", allowed=_HOW)
    if not values:
        raise InputError(f"{path}: names, and no rows", allowed=_HOW)
    columns = np.array(values, np.float64)
    if names and len(names) != columns.shape[1]:
        raise InputError(f"{path}: {len(names)} names for {columns.shape[1]} columns", allowed=_HOW)
    return _by_name(path, names, columns, guesses) if names else _unnamed(path, columns, guesses)


def _numbers(row: Sequence[str], mark: str | None) -> list[float] | None:
    try:  # decimal commas, as spreadsheets write them beside semicolons and tabs
        return [float(one if mark == "," else one.replace(",", ".")) for one in row]
    except ValueError:
        return None


def _unnamed(path: Path, columns: F64, guesses: list[str]) -> F64:
    if columns.shape[1] not in (1, 3):
        raise InputError(f"{path}: {columns.shape[1]} columns without names", allowed=_HOW)
    guesses.append(f"{path.name}: columns without names, taken for {'x, y, z' if columns.shape[1] == 3 else 'x'}")
    return columns


def _by_name(path: Path, names: Sequence[str], columns: F64, guesses: list[str]) -> F64:
    found: dict[int, F64] = {}
    unused = []
    for name, column in zip(names, columns.T, strict=True):
        match = _NAMED.fullmatch(name.strip())
        word, unit = (match[1].lower(), (match[2] or "").lower()) if match else ("", "")
        axis = 0 if word in _POSITIONS else _AXES.find(word) if len(word) == 1 else -1
        if axis >= 0 and (not unit or unit in _MM):
            if axis in found:
                raise InputError(f"{path}: two columns for {_AXES[axis]}", allowed=_HOW)
            found[axis] = column * _MM.get(unit, 1.0)
            guesses.append(f"{path.name}: {name} = {_AXES[axis]}, {f'in {unit}' if unit else 'of no named unit'}")
        elif _TURNS.match(name.strip()) and np.ptp(column) != 0:
            raise InputError(
                f"{path}: column {name} turns the camera, and a log of positions cannot say how",
                allowed="a log of a stage that does not turn, or poses [N, 4, 4] in an .npy file",
                remedy="make poses of it: world-to-camera matrices, OpenCV axes",
            )
        else:
            unused.append(name)
    if not found:
        raise InputError(f"{path}: columns {', '.join(names)}, none of them a position", allowed=_HOW)
    if unused:
        guesses.append(f"{path.name}: not used: {', '.join(unused)}")
    return np.stack([found.get(axis, np.zeros(len(columns))) for axis in range(3)], axis=1)
