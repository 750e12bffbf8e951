"""Lengths between points that a run's views see, with their standard errors.

Here: the length of a line between two pixels' points. Not here: points (`gs2ci.evaluate.points`), the command.

The standard error combines the standard errors of the two depths (`gs2ci.reconstruct.uncertainty`) and those of the
places within a pixel, on a surface as slanted as the neighbours say. Runs without such errors, as those in which things
move, get a depth's error from the spread along the ray of the light whose median it is and from what the places of
points in the views leave open: a point that moves little through the views has an uncertain depth, as near the axis of
a camera that travels along it; and in the unit of given poses an error that all lengths have in common, by the same
uncertainty of places and by small turns of the cameras. Not included are other errors common to all depths: those of
the unit, of the focal length and, in such runs, of the places of the cameras.
"""

from dataclasses import dataclass
from numbers import Integral
from typing import Any, Final

import numpy as np
import torch

from gs2ci.core.arrays import F32, F64
from gs2ci.core.cameras import SAME_SURFACE, camera_centres
from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code
from gs2ci.evaluate.pages.run_evidence import FinishedRun
from gs2ci.evaluate.points import Cameras
from gs2ci.reconstruct.geometry.path.telemetry import errors_of_given
from gs2ci.reconstruct.uncertainty.depths import movement
from gs2ci.reconstruct.uncertainty.factors import factors

# The error of a depth as a share of the light's spread along the ray: Gaussians are thicker than the uncertainty of the
# surface that they show. Determined on solids of known size (`python -m tests.benchmarks lengths`).
_OF_SPREAD: Final = 0.6
# Where no tracked point confirms depths in the unit of given poses, that error of all together is so many times larger.
_UNTRACKED: Final = 4.0
_AGAINST_DEPTH: Final = (
    Code.PATH_UNCERTAIN,
    Code.PATH_UNCONFIRMED,
    Code.POSES_CONTRADICTED,
    Code.DEPTH_ORDER_OPEN,
    Code.DEPTH_IN_NOISE,
    Code.VGGT_DEPTH_TAKEN,
    Code.SCENE_NOT_FOLLOWING,
    Code.FOCAL_ASSUMED,
    Code.TIME_TOO_SHORT,
)
"""Findings that say not to rely on depth."""
# Standard deviation of a position that is uniformly distributed within a pixel.
_WITHIN_PIXEL_PX: Final = 12.0**-0.5


@dataclass(frozen=True)
class Length:
    """A length between two pixels' points.

    Args:
        length: The length, in the unit of the path.
        standard_error: Its standard error.
        points: Both points, in the world of the path, [2, 3].
        confidence: Confidence of both depths.
        unit: As `Report.length_unit` says it.
        doubts: Why the run's report advises not to rely on its depth, which no standard error includes; usually none.
    """

    length: float
    standard_error: float
    points: F64
    confidence: tuple[float, float]
    unit: str
    doubts: tuple[str, ...]


def measure(run: FinishedRun, one: tuple[int, int], other: tuple[int, int], view: int) -> Length:
    """Measure the distance between the points that two pixels of a view show.

    Args:
        run: A finished run with depth.
        one: Column and row, px, counted from 0.
        other: Likewise.
        view: Which view, counted from 0.

    Raises:
        InputError: The run has no depth or no spread of it, or no camera path to measure it by; there is no such view
            or pixel, both ends are the same one, or there is no depth at a pixel.
    """
    run.report.check_depth()
    if run.depth is None or run.depth_spread is None or run.depth_confidence is None:
        raise InputError(
            f"{run.folder} holds no depth with its spread",
            allowed="a run with depth.npy, depth_spread.npy and depth_confidence.npy",
            remedy="reconstruct again; a camera that does not move shows no depth",
        )
    count, height, width = run.depth.shape
    if not 0 <= view < count:
        raise InputError(f"view {view + 1}", allowed=f"1 to {count}")
    cameras = Cameras(run.world_to_camera, run.intrinsics, run.distortion)
    points, spreads = [], []
    ends = [_pixel(given, width, height) for given in (one, other)]
    if ends[0] == ends[1]:
        told = f"both ends are pixel {ends[0][0]},{ends[0][1]}"
        raise InputError(told, allowed="two pixels", remedy="choose another one as an end")
    for column, row in ends:
        depth = float(run.depth[view, row, column])
        if depth <= 0:
            raise InputError(
                f"nothing is seen at pixel {column},{row} of view {view + 1}",
                allowed="a pixel where depth.npy is above 0",
                remedy="choose a pixel beside it, or another view",
            )
        ray = cameras.rays(np.array([column + 0.5, row + 0.5]))
        points.append(cameras.in_world(view, ray * depth))
        if run.depth_error is not None:
            unsure = float(run.depth_error[view, row, column])
        else:
            there = torch.from_numpy(ray * depth).unbind()
            moves = movement(run.world_to_camera, np.diag(run.intrinsics)[:2], view, there)
            of_place = factors.place_px / float(moves)
            unsure = depth * float(np.hypot(_OF_SPREAD * run.depth_spread[view, row, column], of_place))
        along = cameras.in_world(view, ray * unsure, directions=True)
        # How the point moves from one pixel to the next: beside the ray, and along it where the surface is slanted.
        beside = depth * np.eye(3)[:2] / np.diag(run.intrinsics)[:2, None]
        moved = _WITHIN_PIXEL_PX * (beside + ray * _slopes(run.depth[view], column, row)[:, None])
        spreads.append(np.stack([along, *cameras.in_world(view, moved, directions=True)]))
    line = points[1] - points[0]
    length = float(np.linalg.norm(line))
    variances = [np.square(s @ line / length).sum() for s in spreads]
    seen = [float(run.depth_confidence[view, row, column]) for column, row in ends]
    # Where depths have standard errors, those contain what they have in common.
    common = 0.0 if run.depth_error is not None else _error_of_scale(run)
    error = float(np.hypot(np.sqrt(sum(variances)), length * common))
    doubts = tuple(note.advice for note in run.report.notes if note.kind in _AGAINST_DEPTH)
    return Length(length, error, np.stack(points), (seen[0], seen[1]), run.report.length_unit, doubts)


def _error_of_scale(run: FinishedRun) -> float:
    """Return the standard error, as a share, of all lengths together in the unit of given poses; 0 in any other unit.

    A turn that the prior on given poses allows moves the picture as travel past a nearer scene does. Of N cameras at t
    from their mean, turns by independent errors of sigma change inverse depths by sigma / (sum t^2)^(1/2); travel along
    the line of sight moves a picture as no turn does. To this is added the error of places in the views, which all
    points share, at the middle view's median movement.
    """
    geometry = run.report.geometry
    if geometry is None or geometry.unit_of is None or run.depth is None:
        return 0.0
    poses, middle = run.world_to_camera, len(run.world_to_camera) // 2
    centres = camera_centres(poses) @ poses[middle, :3, :3].T
    aside, along = np.split(np.square(centres - centres.mean(axis=0)).sum(axis=0), [2])
    rows, columns = np.nonzero(run.depth[middle] > 0)
    travel = float(aside.sum() + along.sum())
    if travel == 0 or not rows.size:
        return 0.0
    known = run.depth[middle, rows, columns]
    turned = errors_of_given(poses, run.intrinsics).rotation * float(np.median(known)) * np.sqrt(aside.sum()) / travel
    pixels = np.stack([columns, rows], axis=-1).astype(np.float64) + 0.5
    rays = Cameras(poses, run.intrinsics, run.distortion).rays(pixels)
    there = torch.from_numpy(rays * known[:, None]).unbind(dim=1)
    moved = float(np.median(movement(poses, np.diag(run.intrinsics)[:2], middle, there).numpy()))
    return float(np.hypot(turned, factors.place_px * (1.0 if geometry.tracks else _UNTRACKED) / moved))


def _slopes(depth: F32, column: int, row: int) -> F64:
    """Return how depth, [H, W], changes per pixel along columns and rows, [2]; 0 where this is not known.

    A neighbour on another surface, or without a depth, says nothing of this one.
    """
    found = np.zeros(2)
    for k, (place, line) in enumerate(((column, depth[row]), (row, depth[:, column]))):
        near = line[max(place - 1, 0) : place + 2].astype(np.float64)
        if (np.abs(near - line[place]) <= SAME_SURFACE * line[place]).all() and len(near) > 1:
            found[k] = (near[-1] - near[0]) / (len(near) - 1)
    return found


def _pixel(given: Any, width: int, height: int) -> tuple[int, int]:
    """Return column and row of a pixel.

    Raises:
        InputError: It is not two whole numbers, or lies outside the view.
    """
    parts = np.asarray(given, dtype=object)
    if parts.shape == (2,) and all(isinstance(part, Integral) for part in parts):
        column, row = (int(part) for part in parts)
        if 0 <= column < width and 0 <= row < height:
            return column, row
    raise InputError(
        f"pixel {','.join(map(str, parts.flat))}",
        allowed=f"columns 0 to {width - 1}, rows 0 to {height - 1}, as COLUMN,ROW",
        remedy="give column and row as whole numbers, counted from 0 at the upper left",
    )
