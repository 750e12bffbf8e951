"""The stage in the camera's frame: direction, scale and precision of the camera's motion by each axis.

A board at rest is seen from many positions of the stage. If the stage only shifts the camera, the board keeps its
orientation, so that all pictures share one rotation and each gives the camera's place. Here: the fit of the axes. Not
here: the pictures (`stage`), the camera's own parameters, which are used with their covariance (`intrinsics`), the
reasons for refusing an axis (`axis_checks`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.stats import t as student

from gs2ci.core.arrays import F64
from gs2ci_calibration.geometry.axis_checks import STEP, FittedAxis, Measured, require_faithful, require_moving
from gs2ci_calibration.geometry.board import Sighting
from gs2ci_calibration.geometry.intrinsics import CameraEstimate
from gs2ci_calibration.geometry.places import Places, find_places
from gs2ci_calibration.refusals import CalibrationError, Reason

TARGETS_MIN: Final = 4
"""A line has two unknowns in each direction; two further targets give the scatter around it."""
SWEEP_MIN: Final = 4
"""Fewest pictures during a sweep, likewise for a line in time."""
COVERAGE: Final = 0.95
COMMON_PX: Final = 0.005
"""Error of the board's place in a picture that does not appear in the scatter: by edges' positions between the pixels,
errors of the lens model. Corners of rendered boards have errors of 0.004 to 0.007 px rms."""
DECIMALS: Final = 6
"""Targets that agree to a nanometre count as the same."""


@dataclass(frozen=True)
class StagePicture:
    """A picture of the board with the stage at rest.

    Args:
        axis: The axis that was moved.
        position_mm: Position along that axis that the stage reports.
        upwards: Whether it was approached from smaller positions.
        sighting: The board in the picture, None if it was not found.
    """

    axis: str
    position_mm: float
    upwards: bool
    sighting: Sighting | None


@dataclass(frozen=True)
class SweepPicture:
    """A picture of the board while the stage sweeps.

    Args:
        axis: The axis that moved.
        time_s: Middle of the exposure, from an arbitrary origin.
        position_mm: Position where the stage should be then.
        sighting: The board in the picture, None if it was not found.
    """

    axis: str
    time_s: float
    position_mm: float
    sighting: Sighting | None


@dataclass(frozen=True)
class AxisEstimate:
    """The measured properties of an axis.

    Args:
        name: Name of the axis.
        per_mm: The camera's motion per mm of the axis, in its own frame (x right, y down, z ahead), mm, [3].
        covariance: Covariance of `per_mm`, [3, 3].
        backlash_mm: Lost motion at a reversal, in mm of the axis.
        repeatability_mm: Standard deviation of returns to one target from one side.
        linearity_mm: Rms residual of a straight line, in mm of the axis.
        speed_error: Relative error of the speed during a sweep; None without a sweep.
        speed_ripple_mm: Rms residual of a uniform motion, in mm of the axis; 0 without a sweep.
        sweep_lag_s: Delay of the stage's counted position during a sweep relative to the camera's places, because the
            query over its line takes time. It refers to the middle of the backlash, as at rest.
    """

    name: str
    per_mm: F64
    covariance: F64
    backlash_mm: Measured
    repeatability_mm: Measured
    linearity_mm: float
    speed_error: Measured | None = None
    speed_ripple_mm: float = 0.0
    sweep_lag_s: Measured | None = None

    @property
    def scale(self) -> Measured:
        """Get the true distance per mm of the axis."""
        length = float(np.linalg.norm(self.per_mm))
        way = self.per_mm / length
        return Measured(length, float(np.sqrt(way @ self.covariance @ way)))

    @property
    def direction(self) -> F64:
        """Get the unit vector of the camera's motion in its own frame, [3]."""
        return self.per_mm / np.linalg.norm(self.per_mm)

    @property
    def direction_error_deg(self) -> float:
        """Get the standard error of the direction, as an angle: both perpendicular components in quadrature."""
        return float(np.degrees(np.sqrt(np.trace(self._across))))

    @property
    def direction_errors(self) -> F64:
        """Get the standard errors of `direction`, [3].

        Along its own direction the error of a unit vector is of second order only, half the square of the angle.
        """
        return np.sqrt(np.diag(self._across)) + 0.5 * np.trace(self._across)

    @property
    def _across(self) -> F64:
        """Get the covariance of the direction, [3, 3]; it has no component along the direction itself."""
        across = np.eye(3) - np.outer(self.direction, self.direction)
        return across @ self.covariance @ across / self.scale.value**2


def estimate_stage(
    pictures: Sequence[StagePicture],
    sweeps: Sequence[SweepPicture],
    camera: CameraEstimate,
    expected: Mapping[str, tuple[float, float, float]] | None = None,
) -> dict[str, AxisEstimate]:
    """Estimate all axes that were moved.

    Args:
        pictures: Pictures at rest; each axis visits each of its targets from both sides, all equally often.
        sweeps: Pictures in motion; may be empty.
        camera: The camera, from `estimate_camera`.
        expected: The camera's motion per mm of each axis by the rig file; an axis that is not named may have any
            direction.

    Raises:
        CalibrationError: The board is not in every picture, there are too few targets, or an axis does not move,
            slips, or moves in a wrong direction or by a wrong distance.
    """
    sightings = _all_seen([*pictures, *sweeps])
    places = find_places(sightings, camera.values)
    names = list(dict.fromkeys(picture.axis for picture in pictures))

    def measure(found: Places) -> list[FittedAxis]:
        return [_measure(name, pictures, sweeps, found) for name in names]

    axes = measure(places)
    for axis in axes:
        require_faithful(axis, (expected or {}).get(axis.name))
    by_camera = _through_camera(measure, sightings, camera, places)
    mm_per_px = float(np.median(places.board_mm[:, 2])) / float(camera.values[:2].mean())
    return {axis.name: _estimate(axis, by_camera[index], camera, mm_per_px) for index, axis in enumerate(axes)}


def _all_seen(shots: Sequence[StagePicture | SweepPicture]) -> list[Sighting]:
    """Return all sightings.

    Raises:
        CalibrationError: There are no pictures, or one does not show enough of the board.
    """
    if not any(isinstance(shot, StagePicture) for shot in shots):
        raise CalibrationError(
            STEP,
            Reason.BOARD_NOT_SEEN,
            "no pictures of the board along any axis",
            remedy="name a stage in the rig file",
        )
    seen = []
    for number, shot in enumerate(shots):
        where = f"with {shot.axis} at {shot.position_mm:g} mm"
        if shot.sighting is None:
            raise CalibrationError(
                STEP,
                Reason.BOARD_NOT_SEEN,
                f"the board is not in picture {number + 1} of {len(shots)}, {where}",
                remedy="place the board so that it stays in the frame, lit and in focus, over the whole travel",
            )
        if shot.sighting.collinear:
            raise CalibrationError(
                STEP,
                Reason.DEGENERATE_VIEWS,
                f"picture {number + 1} of {len(shots)}, {where}, shows one line of the board's corners",
                remedy="show more of the board: corners on one line do not determine its rotation about that line",
            )
        seen.append(shot.sighting)
    return seen


def _measure(name: str, pictures: Sequence[StagePicture], sweeps: Sequence[SweepPicture], places: Places) -> FittedAxis:
    """Fit one axis.

    The means of both sides at each target give the line, their differences the backlash. A periodic error of the screw
    is the same at each return to a target, so that targets, not pictures, count as independent.

    Raises:
        CalibrationError: Fewer targets than a line needs, or the axis stands still.
    """
    targets, visits = _visits(name, pictures, places)
    up, down = (np.stack([visits[target, side].mean(axis=0) for target in targets]) for side in (True, False))
    line, by_targets, left = _line(np.array(targets), 0.5 * (up + down))
    travel_mm = float(np.ptp(targets))
    require_moving(name, line, travel_mm, float(np.sqrt(np.trace(places.covariance_mm2))))
    along = line / float(line @ line)  # from mm of the camera to mm of the axis
    lost = (down - up) @ along
    noise_mm = float(np.sqrt(along @ places.covariance_mm2 @ along))
    returns = [visit @ along for visit in visits.values()]
    seen_mm = places.camera_mm[len(pictures) :] @ along
    speed, ripple_mm = _speed(name, sweeps, seen_mm)
    repeatability = _repeatability(returns, noise_mm)
    backlash = Measured(float(lost.mean()), _widened(float(lost.std(ddof=1)) / np.sqrt(len(lost)), len(lost) - 1))
    offsets = 0.5 * (up + down) @ along - np.array(targets)
    rest = Measured(float(offsets.mean()), float(offsets.std(ddof=1)) / np.sqrt(len(offsets)))
    come_to = float(np.hypot(rest.standard_error, repeatability.value))
    lag = _lag(name, sweeps, seen_mm, Measured(rest.value, come_to), backlash)
    return FittedAxis(
        name=name,
        per_mm=line,
        covariance=_wider(by_targets, _by_returns(targets, visits)),
        backlash=backlash,
        repeatability=repeatability,
        worst_return_mm=max(float(np.ptp(visit)) for visit in returns),
        linearity_mm=float(np.sqrt(np.mean(np.square(left @ along)))),
        travel_mm=travel_mm,
        noise_mm=noise_mm,
        speed=speed,
        speed_ripple_mm=ripple_mm,
        lag=lag,
    )


def _visits(
    name: str, pictures: Sequence[StagePicture], places: Places
) -> tuple[list[float], dict[tuple[float, bool], F64]]:
    """Return the targets seen from both sides, and the camera's places at each from each side, [visits, 3].

    Raises:
        CalibrationError: There are too few, or none was visited twice.
    """
    at: dict[tuple[float, bool], list[F64]] = {}
    for picture, place in zip(pictures, places.camera_mm[: len(pictures)], strict=True):
        if picture.axis == name:
            at.setdefault((round(picture.position_mm, DECIMALS), picture.upwards), []).append(place)
    targets = sorted(target for target, upwards in at if upwards and (target, False) in at)
    visits = {(target, side): np.stack(at[target, side]) for target in targets for side in (True, False)}
    if len(targets) < TARGETS_MIN or max(len(visit) for visit in visits.values()) < 2:
        raise CalibrationError(
            STEP,
            Reason.DEGENERATE_VIEWS,
            f"axis {name} was seen from both sides at {len(targets)} positions",
            allowed=f"{TARGETS_MIN} or more, each twice",
            remedy="give it a longer travel",
        )
    return targets, visits


def _line(x: F64, y: F64) -> tuple[F64, F64, F64]:
    """Fit y [n, 3] = a + b x; return b [3], its covariance [3, 3] from the scatter, and the residuals [n, 3]."""
    centred = x - x.mean()
    slope = centred @ y / float(centred @ centred)
    left = y - y.mean(axis=0) - np.outer(centred, slope)
    scatter = left.T @ left / (len(x) - 2)
    return slope, scatter / float(centred @ centred) * _widened(1.0, len(x) - 2) ** 2, left


def _by_returns(targets: list[float], visits: dict[tuple[float, bool], F64]) -> F64:
    """Return the covariance of a line's slope by the scatter of returns alone, [3, 3]."""
    every = list(visits.values())
    freedom = sum(len(visit) - 1 for visit in every)
    scatter = (
        sum((np.cov(visit.T, ddof=0) * len(visit) for visit in every if len(visit) > 1), np.zeros((3, 3))) / freedom
    )
    per_target = sum(len(visit) for visit in every) / len(targets)
    centred = np.array(targets) - np.mean(targets)
    return scatter / per_target / float(centred @ centred) * _widened(1.0, freedom) ** 2


def _wider(first: F64, second: F64) -> F64:
    """Enlarge a covariance until no variance is below that of another: few targets may lie on a line by chance."""
    stretch = np.sqrt(np.maximum(np.diag(second) / np.maximum(np.diag(first), np.finfo(np.float64).tiny), 1.0))
    return first * np.outer(stretch, stretch)


def _widened(standard_error: float, freedom: int) -> float:
    """Enlarge a standard error from few degrees of freedom so that twice its value covers 95 %, as for a Gaussian."""
    return standard_error * float(student.ppf(0.5 + 0.5 * COVERAGE, freedom)) / 1.96


def _repeatability(visits: Sequence[F64], noise_mm: float) -> Measured:
    """Return the scatter of returns to one target from one side, the pictures' noise subtracted.

    The standard error is that of a variance from n degrees of freedom, sqrt(2 / n) of it, converted to the root; near
    0, where that conversion is singular, it is the root of the variance's error.
    """
    freedom = sum(len(visit) - 1 for visit in visits)
    variance = sum(float(np.square(visit - visit.mean()).sum()) for visit in visits) / freedom
    spread = float(np.sqrt(2 / freedom)) * max(variance, noise_mm**2)
    value = float(np.sqrt(max(variance - noise_mm**2, 0.0)))
    error = float(np.sqrt(spread)) if value**2 < spread else spread / (2 * value)
    return Measured(value, error)


def _of_axis(name: str, sweeps: Sequence[SweepPicture], along_mm: F64) -> F64 | None:
    """Return times, stated and seen positions of an axis' sweep, [3, P]; None if there are too few, or none moved."""
    mine = [(shot.time_s, shot.position_mm, at) for shot, at in zip(sweeps, along_mm, strict=True) if shot.axis == name]
    return np.array(mine).T if len(mine) >= SWEEP_MIN and len({position for _, position, _ in mine}) > 1 else None


def _speed(name: str, sweeps: Sequence[SweepPicture], along_mm: F64) -> tuple[Measured | None, float]:
    """Fit a uniform motion to the pictures of a sweep.

    Args:
        name: Name of the axis.
        sweeps: Pictures of all axes' sweeps.
        along_mm: Position of the camera in each, along the axis, in mm of it.

    Returns:
        The speed's relative error, None without a sweep, and the residual, in mm.
    """
    mine = _of_axis(name, sweeps, along_mm)
    if mine is None:
        return None, 0.0
    time_s, asked_mm, seen_mm = mine
    slopes, covariance, left = _line(time_s, np.stack([seen_mm, asked_mm, 0 * asked_mm], axis=1))
    asked = float(slopes[1])
    error = Measured(float(slopes[0]) / asked - 1, float(np.sqrt(covariance[0, 0])) / abs(asked))
    return error, float(np.sqrt(np.mean(np.square(left[:, 0]))))


def _lag(
    name: str, sweeps: Sequence[SweepPicture], along_mm: F64, rest: Measured, backlash: Measured
) -> Measured | None:
    """Return the delay of counted positions during a sweep relative to the pictures, s; None without a sweep.

    Args:
        name: Of the axis.
        sweeps: Pictures of all axes' sweeps.
        along_mm: Where the camera was in each, along the axis, in mm of it.
        rest: Seen minus counted position at rest, the mean of both sides, mm, and its repeatability in a sweep.
        backlash: In mm of the axis: half of it lies behind the mean of both sides.
    """
    mine = _of_axis(name, sweeps, along_mm)
    if mine is None:
        return None
    time_s, counted_mm, seen_mm = mine
    way_mm_s = float(np.polyfit(time_s, counted_mm, 1)[0])
    ahead_mm = seen_mm - counted_mm
    speed_mm_s, sign = abs(way_mm_s), np.sign(way_mm_s)
    # The position is read once, when the sweep reaches its first picture; from there on an error of the speed adds up.
    (_, first_mm), covariance = np.polyfit(time_s - time_s.min(), ahead_mm, 1, cov=True)
    lag_s = (sign * (float(first_mm) - rest.value) + backlash.value / 2) / speed_mm_s
    errors_mm = (float(np.sqrt(covariance[1, 1])), rest.standard_error, backlash.standard_error / 2)
    return Measured(float(lag_s), float(np.linalg.norm(errors_mm)) / speed_mm_s)


def _through_camera(
    measure: Callable[[Places], list[FittedAxis]], sightings: Sequence[Sighting], camera: CameraEstimate, places: Places
) -> list[F64]:
    """Return the derivatives of each axis's figures by the camera's parameters, [6, 8] each, by central differences.

    The camera is not fitted again to these pictures: the corners' errors repeat from picture to picture, so the
    camera's standard errors would be too small. Its errors are propagated instead.
    """
    columns = []
    for index, step in enumerate(camera.standard_errors):
        sides = []
        for way in (1.0, -1.0):
            values = camera.values.copy()
            values[index] += way * step
            sides.append(measure(find_places(sightings, values, start=places)))
        columns.append([(a.figures - b.figures) / (2 * step) for a, b in zip(*sides, strict=True)])
    return [np.stack([column[axis] for column in columns], axis=1) for axis in range(len(columns[0]))]


def _estimate(axis: FittedAxis, by_camera: F64, camera: CameraEstimate, mm_per_px: float) -> AxisEstimate:
    carried = by_camera @ camera.covariance @ by_camera.T
    unseen = COMMON_PX * mm_per_px / (0.5 * axis.travel_mm)
    covariance = axis.covariance + np.square(unseen) * np.eye(3)
    speed = axis.speed
    if speed is not None:
        # The speed is compared with the scale at rest, whose error enters, partly correlated.
        along = float(axis.per_mm @ covariance @ axis.per_mm) / float(axis.per_mm @ axis.per_mm) ** 2
        total = np.sqrt(speed.standard_error**2 + along + carried[4, 4])
        speed = replace(speed, standard_error=float(total))
    lag = axis.lag
    if lag is not None:
        lag = replace(lag, standard_error=float(np.hypot(lag.standard_error, carried[5, 5] ** 0.5)))
    return AxisEstimate(
        name=axis.name,
        per_mm=axis.per_mm,
        covariance=covariance + carried[:3, :3],
        backlash_mm=Measured(axis.backlash.value, float(np.hypot(axis.backlash.standard_error, carried[3, 3] ** 0.5))),
        repeatability_mm=axis.repeatability,
        linearity_mm=axis.linearity_mm,
        speed_error=speed,
        speed_ripple_mm=axis.speed_ripple_mm,
        sweep_lag_s=lag,
    )
