"""The log of a user's own stage, beside a coded measurement: camera poses from the positions that it reported.

Here: a table of positions (CSV, or an array), one row for each mask, and which way the camera goes along its columns.
Not here: poses as matrices (`camera`), a log against time, whose positions must be taken at the masks' times
(docs/how-to.md), the stage of a rig file (`gs2ci.rig.telemetry`).
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import rigid
from gs2ci.core.errors import InputError
from gs2ci.core.foreign import roles
from gs2ci.core.foreign.camera import TRAJECTORIES, pose_stacks, trajectory
from gs2ci.core.foreign.camera_files import is_camera_file, read_poses
from gs2ci.core.foreign.container import Array, damage_as_input_error
from gs2ci.core.foreign.opening import load_single, open_foreign
from gs2ci.core.foreign.text import ENDINGS, Table, table

Way = Literal["right", "left", "down", "up", "ahead", "back"]
USUAL_WAYS: Final[tuple[Way, Way, Way]] = ("right", "down", "ahead")
"""OpenCV's axes of a camera."""
_MM: Final = {"m": 1e3, "cm": 10.0, "in": 25.4, "inch": 25.4, "mm": 1.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "nm": 1e-6}
_LONG: Final = {"": 1e3, "centi": 10.0, "milli": 1.0, "micro": 1e-3, "nano": 1e-6}
_MM.update({before + word: mm for before, mm in _LONG.items() for word in ("meter", "meters", "metre", "metres")})
_MM.update({"micron": 1e-3, "microns": 1e-3, "inches": 25.4})
_AXES: Final = "xyz"
_POSES: Final[tuple[roles.Role, ...]] = ("telemetry", "world_to_camera", "camera_to_world")
# What may stand beside the axis and the unit in the name of a column: stage_x_mm, PosX (mm), X Position [mm].
_POSITIONS: Final = {"position", "pos", "stage", "axis", "actual", "camera", "cam", "encoder"}
# Columns that turn the camera; a log that has them is not read without them.
_TURNS: Final = re.compile(
    r"(?<![a-z])(?:yaw|pitch|roll|tilt|angle|theta|phi|psi|omega|kappa|heading|azimuth|elevation|rot|quat|[qo][wxyz]"
    r"|r[xyz]|[rm]\d[012])"
)
_CAMEL: Final = re.compile(r"(?<=[a-z])(?=[A-Z])")
# How hexapods (PI) and robots (Kuka) name the angles beside x, y, z.
_LETTERS: Final = ({"u", "v", "w"}, {"a", "b", "c"})
# The columns of a trajectory in TUM's order, and how others name them: tx, pos_x, quat_x, p_RS_R_x [m], q_RS_w [],
# .pose.orientation.w and /pose/pose/position/x (exports of ROS's messages).
_POSE: Final = ("x", "y", "z", "qx", "qy", "qz", "qw")
_IN_POSE: Final = re.compile(
    r"(?:.*?[./])??(?:(q(?:uat[a-z]*)?|o(?:rientation)?|r(?:ot(?:ation)?)?)|t|p|pos|position|translation|)"
    r"(?:[_./ ](?:\w+_)?)?([wxyz])\s*(?:\[.*\])?"
)
_WORD: Final = re.compile(r"[A-Z]?[a-zµμ]+|[A-Z]+(?![a-z])")
_HOW: Final = "one row for each mask, in the order of exposure, under a first row of names: x_mm, y_mm, z_mm"


def stage_poses(path: Path, ways: Sequence[str], guesses: list[str]) -> Array:
    """Return world-to-camera poses, [R, 4, 4], from a stage's log; the first is no special one.

    Args:
        path: A CSV file (comma, semicolon, tab or blanks; its columns named, or one or three without names), or a file
            with one array: positions [R], [R, 1] or [R, 3], or poses (`pose_stacks`), which are taken as they are.
        ways: Which way the camera goes as x, y and z of the log grow, of `Way`.
        guesses: Sentences are added here.

    Raises:
        InputError: The file is no such log, says of the camera what positions do not, or does not move; or the ways
            are not three at right angles.
    """
    axes = _axes(ways)
    poses = poses_in(path, guesses)
    if poses is None:
        return _straight(path, _positions(path, guesses), ways, axes, guesses)
    if tuple(ways) != USUAL_WAYS:
        raise InputError(f"--stage-axes with {path}, which holds poses", remedy="leave --stage-axes out")
    return poses


def poses_in(path: Path, guesses: list[str]) -> Array | None:
    """Return the world-to-camera poses, [R, 4, 4], that a file of any kind holds; None: it may hold positions.

    Raises:
        InputError: It cannot be read.
    """
    if is_camera_file(path):
        guesses.append(f"{path.name}: poses in the order of the numbers in the pictures' names")
        return Array(str(path), read_poses(path))
    inverse = False
    if _is_text(path):
        read = table(path, _HOW)
        if (found := _trajectory(path, read, guesses)) is not None:
            return found
        given = Array(str(path), read.columns)
    else:
        held = open_foreign(path)
        keys = {role: key for role in _POSES if (key := roles.key_of(held, role, None, guesses)) is not None}
        role, key = next(iter(keys.items()), (None, None))
        given = load_single(path) if key is None else held.load(key)
        inverse = role == "camera_to_world"
    matrices = pose_stacks(np.asarray(given.values, np.float64))
    if not matrices or len(matrices[0][0]) < 2:
        return None
    told = "camera-to-world, inverted" if inverse else "taken for world-to-camera"
    guesses.append(f"{given.where}: poses of OpenCV's axes (x right, y down, z ahead), {told}")
    with damage_as_input_error(given.where):
        return Array(given.where, np.linalg.inv(matrices[0][0]) if inverse else matrices[0][0])


def _is_text(path: Path) -> bool:
    return path.suffix.lower() in ENDINGS


def _straight(path: Path, places: F64, ways: Sequence[str], axes: F64, guesses: list[str]) -> Array:
    """Return the poses of a camera that does not turn."""
    if places.ndim != 2 or places.shape[1] not in (1, 3):
        raise InputError(
            f"{path}: an array of shape {list(places.shape)}",
            allowed="positions [N, 3] or [N], world-to-camera poses [N, 4, 4]",
            remedy="make matrices of quaternions or angles, or a text of TUM's form (time, place, quaternion)",
        )
    if not np.isfinite(places).all():
        row = int(np.flatnonzero(~np.isfinite(places).all(axis=1))[0])
        raise InputError(
            f"{path}: position {row + 1} holds NaN or infinity", remedy="mend the log, or leave --stage out"
        )
    if len(places) > 1 and not np.ptp(places, axis=0).any():
        raise InputError(f"{path}: all {len(places)} positions are the same", remedy="leave --stage out, or mend it")
    places = np.pad(places, ((0, 0), (0, 3 - places.shape[1])))
    poses = rigid(np.eye(3), -places @ axes)
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


def _trajectory(path: Path, read: Table, guesses: list[str]) -> Array | None:
    """Return the poses of a trajectory in a form of others; None: a table of positions."""
    columns = read.columns
    if read.names:
        # In whatever order they stand: TUM has w last, EuRoC and COLMAP first.
        parts = [
            match and "q" * bool(match[1]) + match[2] for match in map(_IN_POSE.fullmatch, map(str.lower, read.names))
        ]
        if any(parts.count(part) != 1 for part in _POSE):
            return None
        columns = np.insert(columns[:, [parts.index(part) for part in _POSE]], 0, 0.0, axis=1)
        if any(name.lower().endswith("child_frame_id") for name in read.names):
            guesses.append(
                f"WARNING: {path}: poses of ROS's odometry, which are those of the body that its child frame names (x "
                "ahead, y left, z up), unless that name ends with _optical_frame; taken as if it did: turn them, and "
                "move them by the camera's place on that body"
            )
    if columns.shape[1] not in TRAJECTORIES:
        return None
    return Array(str(path), trajectory(str(path), columns, guesses))


def _positions(path: Path, guesses: list[str]) -> F64:
    """Return the positions of a file, [R, 1] or [R, 3], in mm if it names a unit."""
    if _is_text(path):
        read = table(path, _HOW)
        return (
            _by_name(path, read.names, read.columns, guesses) if read.names else _unnamed(path, read.columns, guesses)
        )
    values = np.asarray(load_single(path).values, np.float64)
    places = values.reshape(-1, 1) if values.ndim == 1 else values
    return places.T if len(places) == len(_AXES) and places.shape[1] not in (1, len(_AXES)) else places


def _unnamed(path: Path, columns: F64, guesses: list[str]) -> F64:
    if columns.shape[1] not in (1, 3):
        raise InputError(f"{path}: {columns.shape[1]} columns without names", allowed=_HOW)
    guesses.append(f"{path.name}: columns without names, taken for {'x, y, z' if columns.shape[1] == 3 else 'x'}")
    return columns


def _by_name(path: Path, names: Sequence[str], columns: F64, guesses: list[str]) -> F64:
    found: dict[int, F64] = {}
    unused = []
    for name, column in zip(names, columns.T, strict=True):
        words = [word.lower() for word in _WORD.findall(name)]
        unit = words.pop() if words and words[-1] in _MM else ""
        letters = [word for word in words if word not in _POSITIONS]
        axis = 0 if words and not letters else _AXES.find(letters[0]) if list(map(len, letters)) == [1] else -1
        if axis >= 0:
            if axis in found:
                raise InputError(f"{path}: two columns for {_AXES[axis]}", allowed=_HOW)
            found[axis] = column * _MM.get(unit, 1.0)
            guesses.append(f"{path.name}: {name} = {_AXES[axis]}, {f'in {unit}' if unit else 'of no named unit'}")
        elif np.ptp(column) != 0 and _turns(name, names):
            raise InputError(
                f"{path}: column {name} turns the camera, and a log of positions cannot say how",
                allowed="a log of a stage that does not turn, or poses [N, 4, 4] in an .npy file",
                remedy="make poses of it: world-to-camera matrices, OpenCV axes",
            )
        elif name:
            unused.append(name)
    if not found:
        raise InputError(f"{path}: columns {', '.join(names)}, none of them a position", allowed=_HOW)
    if unused:
        guesses.append(f"{path.name}: not used: {', '.join(unused)}")
    return np.stack([found.get(axis, np.zeros(len(columns))) for axis in range(3)], axis=1)


def _turns(name: str, names: Sequence[str]) -> bool:
    """Tell whether a column's name, among the others, says that it turns the camera."""
    every = {one.strip().lower() for one in names}
    letter = any(letters <= every and name.strip().lower() in letters for letters in _LETTERS)
    return letter or _TURNS.search(_CAMEL.sub("_", name).lower()) is not None
