"""The stage in the camera's frame: where each axis takes the camera, how far, and how faithfully.

A board at rest is seen from many positions of the stage. A stage that only shifts the camera shows it in one
orientation, so that all pictures share one rotation and each gives the camera's place. Here: the fit of the axes. Not
here: the pictures (`stage`), the camera's own figures, which come in with their covariance (`intrinsics`), what an axis
is refused for (`axis_checks`).
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
"""A line has two unknowns in each direction; two further targets leave a scatter to judge it by."""
SWEEP_MIN: Final = 4
"""Pictures during a sweep: the same, of a line in time."""
COVERAGE: Final = 0.95
COMMON_PX: Final = 0.005
"""By how much the board's place in a picture may be off in ways that no scatter shows: where edges fall between pixels,
what the lens's model leaves. Corners of rendered boards are good to 0.004 to 0.007 px rms."""
DECIMALS: Final = 6
"""Targets that agree to a nanometre are one."""


@dataclass(frozen=True)
class StagePicture:
    """A picture of the board with the stage at rest.

    Args:
        axis: The axis that was moved.
        position_mm: Where the stage says it is along that axis.
        upwards: Whether it came there from smaller positions.
        sighting: What the picture shows of the board, None where it was not found.
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
        time_s: Middle of the exposure, from any beginning.
        position_mm: Where the stage ought to be then.
        sighting: What the picture shows of the board, None where it was not found.
    """

    axis: str
    time_s: float
    position_mm: float
    sighting: Sighting | None


@dataclass(frozen=True)
class AxisEstimate:
    """An axis, as measured.

    Args:
        name: Of the axis.
        per_mm: The camera's motion per mm of the axis, in its own frame (x right, y down, z ahead), mm, [3].
        covariance: Of `per_mm`, [3, 3].
        backlash_mm: Lost motion at a reversal, in mm of the axis.
        repeatability_mm: Standard deviation of coming back to one target from one side.
        linearity_mm: Root mean square of what is left over a straight line, in mm of the axis.
        speed_error: Relative error of the speed during a sweep; None where none was made.
        speed_ripple_mm: Root mean square of what is left over an even motion, in mm of the axis; 0 without a sweep.
        sweep_lag_s: By how much later than the camera's places say the stage counts its position during a sweep: it was
            asked over a line that takes its time. At the middle of play that is taken up, as at rest.
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
        return np.asarray(self.per_mm / np.linalg.norm(self.per_mm))

    @property
    def direction_error_deg(self) -> float:
        """Get the standard error of the direction, as an angle: both components across in quadrature."""
        return float(np.degrees(np.sqrt(np.trace(self._across))))

    @property
    def direction_errors(self) -> F64:
        """Get the standard errors of `direction`, [3].

        Along itself a unit vector errs in second order only, by half the square of its angle.
        """
        return np.asarray(np.sqrt(np.diag(self._across)) + 0.5 * np.trace(self._across))

    @property
    def _across(self) -> F64:
        """Get the covariance of the direction, which has none along itself, [3, 3]."""
        across = np.eye(3) - np.outer(self.direction, self.direction)
        return np.asarray(across @ self.covariance @ across / self.scale.value**2)


def estimate_stage(
    pictures: Sequence[StagePicture],
    sweeps: Sequence[SweepPicture],
    camera: CameraEstimate,
    expected: Mapping[str, tuple[float, float, float]] | None = None,
) -> dict[str, AxisEstimate]:
    """Estimate all axes that were moved.

    Args:
        pictures: At rest; each axis visits each of its targets from both sides, all equally often.
        sweeps: In motion; may be empty.
        camera: The camera, from `estimate_camera`.
        expected: How the rig file says that the axes move the camera, per mm; an axis not named may go anywhere.

    Raises:
        CalibrationError: The board is not in every picture, there are too few targets, or an axis does not move,
            slips, goes the wrong way or by a wrong distance.
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
                remedy="show more of the board: corners on a line leave its turn about that line free",
            )
        seen.append(shot.sighting)
    return seen


def _measure(name: str, pictures: Sequence[StagePicture], sweeps: Sequence[SweepPicture], places: Places) -> FittedAxis:
    """Fit one axis.

    The mean of both sides at each target makes the line, their difference the backlash: a periodic error of the
    screw is the same at each return to a target, so that targets, not pictures, count as independent.

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
    """Fit y [n, 3] = a + b x; return b [3], its covariance [3, 3] from the scatter, and what is left [n, 3]."""
    centred = x - x.mean()
    slope = centred @ y / float(centred @ centred)
    left = y - y.mean(axis=0) - np.outer(centred, slope)
    scatter = left.T @ left / (len(x) - 2)
    return slope, scatter / float(centred @ centred) * _widened(1.0, len(x) - 2) ** 2, left


def _by_returns(targets: list[float], visits: dict[tuple[float, bool], F64]) -> F64:
    """Return the covariance of a line's slope that the scatter of returns alone gives, [3, 3]."""
    every = list(visits.values())
    freedom = sum(len(visit) - 1 for visit in every)
    scatter = (
        sum((np.cov(visit.T, ddof=0) * len(visit) for visit in every if len(visit) > 1), np.zeros((3, 3))) / freedom
    )
    per_target = sum(len(visit) for visit in every) / len(targets)
    centred = np.array(targets) - np.mean(targets)
    return np.asarray(scatter / per_target / float(centred @ centred) * _widened(1.0, freedom) ** 2)


def _wider(first: F64, second: F64) -> F64:
    """Stretch a covariance until no variance is below that of another; few targets may lie on a line by chance."""
    stretch = np.sqrt(np.maximum(np.diag(second) / np.maximum(np.diag(first), np.finfo(np.float64).tiny), 1.0))
    return np.asarray(first * np.outer(stretch, stretch))


def _widened(standard_error: float, freedom: int) -> float:
    """Scale a standard error from few degrees of freedom so that two of them hold what two hold of a Gaussian."""
    return standard_error * float(student.ppf(0.5 + 0.5 * COVERAGE, freedom)) / 1.96


def _repeatability(visits: Sequence[F64], noise_mm: float) -> Measured:
    """Return the scatter of returns to one target from one side, without what the pictures' noise adds.

    The standard error is that of a variance from n degrees of freedom, sqrt(2 / n) of it, on the root's scale; near
    0, where a root has no slope, it is the root of the variance's.
    """
    freedom = sum(len(visit) - 1 for visit in visits)
    variance = sum(float(np.square(visit - visit.mean()).sum()) for visit in visits) / freedom
    spread = float(np.sqrt(2 / freedom)) * max(variance, noise_mm**2)
    value = float(np.sqrt(max(variance - noise_mm**2, 0.0)))
    error = float(np.sqrt(spread)) if value**2 < spread else spread / (2 * value)
    return Measured(value, error)


def _speed(name: str, sweeps: Sequence[SweepPicture], along_mm: F64) -> tuple[Measured | None, float]:
    """Fit an even motion to the pictures of a sweep.

    Args:
        name: Of the axis.
        sweeps: Pictures of all axes' sweeps.
        along_mm: Where the camera was in each, along the axis, in mm of it.

    Returns:
        The speed's relative error, None without a sweep, and what is left, in mm.
    """
    mine = [(shot.time_s, shot.position_mm, at) for shot, at in zip(sweeps, along_mm, strict=True) if shot.axis == name]
    if len(mine) < SWEEP_MIN or len({position for _, position, _ in mine}) < 2:
        return None, 0.0
    time_s, asked_mm, seen_mm = np.array(mine).T
    slopes, covariance, left = _line(time_s, np.stack([seen_mm, asked_mm, 0 * asked_mm], axis=1))
    asked = float(slopes[1])
    error = Measured(float(slopes[0]) / asked - 1, float(np.sqrt(covariance[0, 0])) / abs(asked))
    return error, float(np.sqrt(np.mean(np.square(left[:, 0]))))


def _lag(
    name: str, sweeps: Sequence[SweepPicture], along_mm: F64, rest: Measured, backlash: Measured
) -> Measured | None:
    """Return how much later than seen a position is counted during a sweep, s; None without one.

    Args:
        name: Of the axis.
        sweeps: Pictures of all axes' sweeps.
        along_mm: Where the camera was in each, along the axis, in mm of it.
        rest: Seen less counted at rest, the mean of both sides, mm, and how well a sweep comes back to that.
        backlash: In mm of the axis: half of it lies behind the mean of both sides.
    """
    mine = [(shot.time_s, shot.position_mm, at) for shot, at in zip(sweeps, along_mm, strict=True) if shot.axis == name]
    if len(mine) < SWEEP_MIN or len({position for _, position, _ in mine}) < 2:
        return None
    time_s, counted_mm, seen_mm = np.array(mine).T
    way_mm_s = float(np.polyfit(time_s, counted_mm, 1)[0])
    ahead_mm = seen_mm - counted_mm
    speed_mm_s, sign = abs(way_mm_s), np.sign(way_mm_s)
    # The stage is asked once, as the sweep reaches its first picture; from there a speed that is not as counted leads
    # away.
    (_, first_mm), covariance = np.polyfit(time_s - time_s.min(), ahead_mm, 1, cov=True)
    lag_s = (sign * (float(first_mm) - rest.value) + backlash.value / 2) / speed_mm_s
    errors_mm = (float(np.sqrt(covariance[1, 1])), rest.standard_error, backlash.standard_error / 2)
    return Measured(float(lag_s), float(np.linalg.norm(errors_mm)) / speed_mm_s)


def _through_camera(
    measure: Callable[[Places], list[FittedAxis]], sightings: Sequence[Sighting], camera: CameraEstimate, places: Places
) -> list[F64]:
    """Return how the figures of each axis change with the camera's, [6, 8] each, by central differences.

    The camera is not fitted again to these pictures: their corners' errors repeat from picture to picture, and the
    camera would seem better known than it is. Its errors are carried through instead.
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
        # The speed is compared with the scale at rest: its error comes in, in part with the same cause.
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
