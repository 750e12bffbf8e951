"""Intrinsics, distortion and poses as users have them, converted to the conventions of gs2ci.

Accepted: [3, 3] (or transposed), four numbers fx fy cx cy, or a focal length with a centred principal point; OpenCV's
coefficients of distortion; poses [N, 4, 4], [N, 3, 4] or with the counting axis last, world-to-camera or
camera-to-world, OpenCV axes; trajectories of TUM and KITTI. Pixel centres lie at +0.5, so a centred principal point is
(W/2, H/2).
"""

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import pinhole, rigid
from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import Array, damage_as_input_error
from gs2ci.core.foreign.pixels import LARGEST
from gs2ci.core.lens import COEFFICIENTS
from gs2ci.core.records import are_rigid, check_intrinsics, check_rigid

FEWEST_COEFFICIENTS: Final = 4
"""OpenCV's smallest model."""
TRAJECTORIES: Final = {8: "TUM's: time, place and quaternion", 12: "KITTI's: matrices of 3 x 4"}
"""Numbers in a row of the text files in which trajectories are kept, all of them camera-to-world."""


# Lenses are centred better than this.
_MOST_TANGENTIAL: Final = 0.015
# Principal points lie within this share of the picture, unless it was cut or scaled.
_CENTRAL: Final = (0.3, 0.7)
# The w of a camera that hardly turns from the axes of its world is larger.
_MOSTLY_ONE: Final = 0.9


def intrinsics_from(given: Array, size: tuple[int, ...], guesses: list[str]) -> F64:
    """Make a camera matrix from what a file or the user gives.

    Args:
        given: [3, 3], the same row by row, as part of [3, 4] or [4, 4], [N, 3, 3] all equal, four numbers fx fy cx cy,
            or one focal length.
        size: Height and width in pixels.
        guesses: Sentences are added here.

    Raises:
        InputError: It is no camera matrix.
    """
    values = np.asarray(given.values, np.float64).squeeze()
    if values.ndim == 3 and values.shape[1:] == (3, 3):
        if not np.allclose(values, values[0]):
            raise InputError(f"{given.where}: intrinsics change from view to view", allowed="one camera: [3, 3]")
        values = values[0]
    if values.ndim == 0:
        values = pinhole(float(values), size)
    elif values.shape == (4,):
        fx, fy, cx, cy = values
        values = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    elif values.shape == (9,):
        values = values.reshape(3, 3)
    elif values.shape in ((3, 4), (4, 4)) and np.array_equal(values[:, 3], np.eye(4)[3, : len(values)]):
        values = values[:3, :3]
    if values.shape == (3, 3) and not np.allclose(values[2], (0, 0, 1)) and np.allclose(values[:, 2], (0, 0, 1)):
        values = values.T
        guesses.append(f"{given.where}: camera matrix was transposed")
    try:
        check_intrinsics(values)
    except InputError as error:
        raise InputError(f"{given.where}: {error.problem}", allowed=error.allowed, remedy=error.remedy) from error
    guesses.append(
        f"camera: fx {values[0, 0]:.5g}, fy {values[1, 1]:.5g}, cx {values[0, 2]:.5g}, cy {values[1, 2]:.5g} px"
    )
    _doubt(values, size, guesses)
    return values


def distortion_from(given: Array, guesses: list[str]) -> F64:
    """Take a lens's coefficients, [5], in OpenCV's order, k1 k2 p1 p2 k3; those of models with more must be zero.

    Raises:
        InputError: Fewer than four numbers, or more than five that matter.
    """
    values = np.asarray(given.values, np.float64).reshape(-1)
    if len(values) < FEWEST_COEFFICIENTS or values[len(COEFFICIENTS) :].any():
        raise InputError(
            f"{given.where}: distortion {values.tolist()}",
            allowed="OpenCV's k1 k2 p1 p2 and, if it was fitted, k3",
            remedy="calibrate with the model of five coefficients, or undistort masks and measurement first",
        )
    coefficients = np.zeros(len(COEFFICIENTS))
    coefficients[: min(len(values), len(COEFFICIENTS))] = values[: len(COEFFICIENTS)]
    told = ", ".join(f"{name} {value:.5g}" for name, value in zip(COEFFICIENTS, coefficients, strict=True))
    guesses.append(f"lens: {told}")
    if np.abs(coefficients[2:4]).max() > _MOST_TANGENTIAL:
        guesses.append(
            f"WARNING: {given.where}: p1 and p2 are unusually large for a lens: are these OpenCV's k1 k2 p1 p2 k3? "
            "Other programs write k1 k2 k3 p1 p2, and a fisheye's k1 k2 k3 k4 are another model, which is not supported"
        )
    return coefficients


def _doubt(matrix: F64, size: tuple[int, ...], guesses: list[str]) -> None:
    height, width = size
    low, high = _CENTRAL
    if not (low * width < matrix[0, 2] < high * width and low * height < matrix[1, 2] < high * height):
        guesses.append(
            f"WARNING: the principal point ({matrix[0, 2]:.1f}, {matrix[1, 2]:.1f}) lies far from the middle of the "
            f"image of {width} x {height}: are the intrinsics those of this resolution, and of this cut?"
        )
    if not 0.2 * width < matrix[0, 0] < 50 * width:
        guesses.append(
            f"WARNING: a focal length of {matrix[0, 0]:.4g} px for {width} px of width is unusual: intrinsics count in "
            f"pixels; lengths in mm are divided by the pixels' pitch, shares of the width multiplied by {width}"
        )


def trajectory(where: str, rows: F64, guesses: list[str]) -> F64:
    """Return the world-to-camera poses, [R, 4, 4], of the rows of a text file, [R, 8] or [R, 12] (`TRAJECTORIES`).

    Raises:
        InputError: They are no rigid motions, or their times do not grow.
    """
    with damage_as_input_error(where):
        if rows.shape[1] == 8:
            if (np.diff(rows[:, 0]) < 0).any():
                raise InputError(
                    f"{where}: times that do not grow from row to row",
                    allowed="rows in the order of exposure",
                    remedy="sort them, one row for each mask",
                )
            lacks = ~(np.isfinite(rows).all(axis=1) & rows[:, 4:].any(axis=1))
            if lacks.any():
                raise InputError(
                    f"{where}: row {int(lacks.argmax()) + 1} holds no pose: NaN, or a quaternion of zeros",
                    remedy="one pose for each mask: mend what the tracking lost, or leave the poses out",
                )
            if (np.abs(rows[:, 4]) > _MOSTLY_ONE).all():
                guesses.append(
                    f"WARNING: {where}: the first number of each quaternion is close to 1; TUM's last one is w, others "
                    "write it first: is it the first here? Then name the columns: t,x,y,z,qw,qx,qy,qz"
                )
            poses = rigid(Rotation.from_quat(rows[:, 4:]).as_matrix(), rows[:, 1:4])
        else:
            matrices = rows.reshape(-1, 3, 4)
            poses = rigid(matrices[:, :, :3], matrices[:, :, 3])
        guesses.append(f"{where}: rows of {rows.shape[1]} numbers, taken for {TRAJECTORIES[rows.shape[1]]}")
        return poses_from(Array(where, poses), len(rows), camera_to_world=True, guesses=guesses)


def poses_from(given: Array, count: int, *, camera_to_world: bool, guesses: list[str]) -> F64:
    """Make world-to-camera poses [count, 4, 4].

    Raises:
        InputError: Wrong number or shape, not finite, or no rigid motions.
    """
    values = np.asarray(given.values, np.float64)
    if values.ndim == 2 and len(values) == count and values.shape[1] in TRAJECTORIES:
        return trajectory(given.where, values, guesses)
    if not (np.abs(values) <= LARGEST).all():
        raise InputError(
            f"{given.where}: poses hold NaN, infinity or numbers that are far too large",
            remedy="mend them, or leave the poses out",
        )
    ways = [(way, turned) for way, turned in pose_stacks(values) if len(way) == count]
    if not ways:
        raise InputError(
            f"{given.where}: poses of shape {list(values.shape)} for {count} views",
            allowed=f"[{count}, 4, 4]",
            remedy="give one pose for each mask, in the order of exposure, or leave the poses out",
        )
    values, turned = ways[0]
    if turned:
        guesses.append(f"{given.where}: pose matrices were transposed")
    try:
        check_rigid("poses", values)
    except InputError as error:
        remedy = "take out scales and axis flips (x right, y down, z forward), or leave the poses out"
        raise InputError(f"{given.where}: {error.problem}", allowed=error.allowed, remedy=remedy) from error
    if camera_to_world:
        guesses.append(f"{given.where}: camera-to-world, of OpenCV's axes (x right, y down, z ahead), inverted")
        values = np.asarray(np.linalg.inv(values), np.float64)
    return np.ascontiguousarray(values)


def pose_stacks(values: F64) -> list[tuple[F64, bool]]:
    """Return every way to read numbers as poses, [R, 4, 4], rigid motions first, and whether it turns the matrices.

    Read are [R, 4, 4], [R, 3, 4], both with the counting axis last, [R, 16], and one pose, by rows or by columns.
    """
    if values.ndim == 2 and values.shape[1] == 16:
        values = values.reshape(-1, 4, 4)
    found = (values, np.moveaxis(values, -1, 0)) if values.ndim == 3 else (values[None],)
    last = np.array([0, 0, 0, 1.0])
    whole = [
        np.concatenate([one, np.broadcast_to(last, (len(one), 1, 4))], axis=1) if one.shape[1] == 3 else one
        for one in found
        if one.shape[1:] in ((4, 4), (3, 4))
    ]
    ways = [(way, turned) for one in whole for way, turned in ((one, False), (one.transpose(0, 2, 1), True))]
    return sorted(ways, key=lambda way: not are_rigid(way[0]))
