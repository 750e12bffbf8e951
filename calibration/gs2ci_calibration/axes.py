"""The stage in the camera's frame: where each axis takes the camera, how far, and how faithfully.

A board at rest is seen from many positions of the stage. A stage that only shifts the camera shows it in one
orientation, so that all pictures share one rotation and each gives the camera's place. Here: the places, the axes
and what is refused. Not here: the pictures (`procedures`), the camera's own figures, which come in with their
covariance (`intrinsics`), how positions are written (`bundle`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from gs2ci_calibration.board import Sighting
from gs2ci_calibration.intrinsics import CameraEstimate
from gs2ci_calibration.places import Places, find_places
from gs2ci_calibration.refusals import CalibrationError, Reason

F64 = NDArray[np.float64]

STEP: Final = "stage"

TARGETS_MIN: Final = 4
"""A line has two unknowns in each direction; two further targets leave a scatter to judge it by."""
SWEEP_MIN: Final = 4
"""Pictures during a sweep: the same, of a line in time."""
MOVED_MIN: Final = 0.1
"""Share of the commanded distance below which a stage does not move: the least ratio that a wrong lead screw or
microstep setting makes is about a half."""
SCALE_RANGE: Final = (0.5, 2.0)
"""Of the measured to the expected distance: outside, a setting is wrong by a factor, not a little."""
ANGLE_MAX_DEG: Final = 30.0
"""Between the measured direction and the one in the rig file: more is another axis or another mounting."""
OPPOSITE_DEG: Final = 150.0
SLIP_SHARE: Final = 0.003
"""Of the travel: an axis that comes back to a target by this much elsewhere has slipped. Stages repeat to some
micrometres, 1e-4 of the travel."""
NOISE_FACTOR: Final = 5.0
"""What is seen to slip or not to move must exceed the pictures' own noise this many times."""
COVERAGE: Final = 0.95


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
class Measured:
    """A number with its standard error, scaled for few degrees of freedom so that two of them hold 95 %."""

    value: float
    standard_error: float


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
    """

    name: str
    per_mm: F64
    covariance: F64
    backlash_mm: Measured
    repeatability_mm: Measured
    linearity_mm: float
    speed_error: Measured | None = None
    speed_ripple_mm: float = 0.0

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
        across = np.eye(3) - np.outer(self.direction, self.direction)
        return float(np.degrees(np.sqrt(np.trace(across @ self.covariance @ across)) / self.scale.value))


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
    shots: list[StagePicture | SweepPicture] = [*pictures, *sweeps]
    sightings = _all_seen(shots)
    places = find_places(sightings, camera.values)
    names = list(dict.fromkeys(picture.axis for picture in pictures))

    def measure(found: Places) -> list[_Axis]:
        return [_measure(name, shots, found) for name in names]

    axes = measure(places)
    for axis in axes:
        _require_faithful(axis, (expected or {}).get(axis.name))
    by_camera = _through_camera(measure, sightings, camera, places)
    return {axis.name: _estimate(axis, by_camera[index], camera) for index, axis in enumerate(axes)}


@dataclass(frozen=True)
class _Axis:
    """An axis before the camera's own uncertainty is added.

    Args:
        name: Of the axis.
        per_mm: [3].
        covariance: From scatter alone, [3, 3].
        backlash: Along the axis, in mm of it.
        repeatability: The same.
        linearity_mm: The same.
        travel_mm: Between the outermost targets.
        noise_mm: What the pictures' noise makes of one place.
        speed: Relative error, or None.
        speed_ripple_mm: In mm of the axis.
    """

    name: str
    per_mm: F64
    covariance: F64
    backlash: Measured
    repeatability: Measured
    linearity_mm: float
    travel_mm: float
    noise_mm: float
    speed: Measured | None
    speed_ripple_mm: float

    @property
    def figures(self) -> F64:
        """Get what depends on the camera's figures: motion per mm, backlash, speed error, [5]."""
        return np.array([*self.per_mm, self.backlash.value, self.speed.value if self.speed else 0.0])


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


def _measure(name: str, shots: Sequence[StagePicture | SweepPicture], places: Places) -> _Axis:
    """Fit one axis.

    The mean of both sides at each target makes the line, their difference the backlash: a periodic error of the
    screw is the same at each return to a target, so that targets, not pictures, count as independent.

    Raises:
        CalibrationError: Fewer targets than a line needs.
    """
    rest = [i for i, shot in enumerate(shots) if isinstance(shot, StagePicture) and shot.axis == name]
    position = np.array([shots[i].position_mm for i in rest])
    upwards = np.array([getattr(shots[i], "upwards", False) for i in rest])
    at = places.camera_mm[rest]
    targets = np.unique(np.round(position, 6))
    both = [t for t in targets if len(set(upwards[np.isclose(position, t, atol=2e-6)])) == 2]
    if len(both) < TARGETS_MIN:
        raise CalibrationError(
            STEP,
            Reason.DEGENERATE_VIEWS,
            f"axis {name} was seen from both sides at {len(both)} positions",
            allowed=f"{TARGETS_MIN} or more",
            remedy="give it a longer travel",
        )
    cells = [[at[np.isclose(position, t, atol=2e-6) & (upwards == up)] for up in (True, False)] for t in both]
    up, down = (np.stack([cell[side].mean(axis=0) for cell in cells]) for side in (0, 1))
    line, covariance, left = _line(np.array(both), 0.5 * (up + down))
    length2 = max(float(line @ line), np.finfo(np.float64).tiny)
    lost = (down - up) @ line / length2
    freedom = len(both) - 1
    noise_mm = places.noise_mm / np.sqrt(length2)
    speed, ripple_mm = _speed([i for i, s in enumerate(shots) if isinstance(s, SweepPicture) and s.axis == name],
                              shots, places, line)  # fmt: skip
    return _Axis(
        name=name,
        per_mm=line,
        covariance=covariance,
        backlash=Measured(float(lost.mean()), _widened(float(lost.std(ddof=1)) / np.sqrt(len(lost)), freedom)),
        repeatability=_repeatability([(side @ line / length2) for cell in cells for side in cell], noise_mm),
        linearity_mm=float(np.sqrt(np.mean(np.square(left @ line / length2)))),
        travel_mm=float(np.ptp(both)),
        noise_mm=noise_mm,
        speed=speed,
        speed_ripple_mm=ripple_mm,
    )


def _line(x: F64, y: F64) -> tuple[F64, F64, F64]:
    """Fit y [n, 3] = a + b x; return b [3], its covariance [3, 3] from the scatter, and what is left [n, 3]."""
    centred = x - x.mean()
    slope = centred @ y / float(centred @ centred)
    left = y - y.mean(axis=0) - np.outer(centred, slope)
    scatter = left.T @ left / (len(x) - 2)
    return slope, scatter / float(centred @ centred) * _widened(1.0, len(x) - 2) ** 2, left


def _widened(standard_error: float, freedom: int) -> float:
    """Scale a standard error from few degrees of freedom so that two of them hold what two hold of a Gaussian."""
    return standard_error * float(student.ppf(0.5 + 0.5 * COVERAGE, freedom)) / 1.96


def _repeatability(visits: Sequence[F64], noise_mm: float) -> Measured:
    """Return the scatter of returns to one target from one side, without what the pictures' noise adds.

    The standard error is that of a variance from n degrees of freedom, sqrt(2 / n) of it, on the root's scale; near
    0, where a root has no slope, it is the root of the variance's.
    """
    freedom = sum(len(visit) - 1 for visit in visits)
    if freedom < 1:
        return Measured(0.0, float("inf"))
    variance = sum(float(np.square(visit - visit.mean()).sum()) for visit in visits) / freedom
    spread = float(np.sqrt(2 / freedom)) * max(variance, noise_mm**2)
    value = float(np.sqrt(max(variance - noise_mm**2, 0.0)))
    error = float(np.sqrt(spread)) if value**2 < spread else spread / (2 * value)
    return Measured(value, error)


def _speed(
    moving: Sequence[int], shots: Sequence[StagePicture | SweepPicture], places: Places, line: F64
) -> tuple[Measured | None, float]:
    """Fit an even motion to the pictures of a sweep; return its speed's relative error and what is left, in mm."""
    if len(moving) < SWEEP_MIN:
        return None, 0.0
    time_s = np.array([getattr(shots[i], "time_s", 0.0) for i in moving])
    asked = np.array([shots[i].position_mm for i in moving])
    along = places.camera_mm[moving] @ line / max(float(line @ line), np.finfo(np.float64).tiny)
    speed, covariance, left = _line(time_s, np.stack([along, asked, 0 * asked], axis=1))
    asked_speed = float(speed[1])
    if asked_speed == 0:
        return None, 0.0
    error = float(np.sqrt(covariance[0, 0])) / abs(asked_speed)
    return Measured(float(speed[0]) / asked_speed - 1, error), float(np.sqrt(np.mean(np.square(left[:, 0]))))


def _require_faithful(axis: _Axis, expected: tuple[float, float, float] | None) -> None:
    """Let an axis pass that goes where it should and comes back.

    Raises:
        CalibrationError: It does not move, slips, or goes elsewhere than the rig file says.
    """
    length = float(np.linalg.norm(axis.per_mm))
    wanted = float(np.linalg.norm(expected)) if expected is not None else 1.0
    seen_mm = length * axis.travel_mm
    if length < MOVED_MIN * wanted or seen_mm < NOISE_FACTOR * axis.noise_mm * length:
        raise CalibrationError(
            STEP,
            Reason.STAGE_STILL,
            f"axis {axis.name} does not move the camera: {seen_mm:.3g} mm over a commanded {axis.travel_mm:g} mm",
            remedy="see that the camera stands on the stage, that its clamp is closed and the coupling holds",
        )
    back_mm = max(axis.repeatability.value, axis.linearity_mm)
    if back_mm > max(SLIP_SHARE * axis.travel_mm, NOISE_FACTOR * axis.noise_mm):
        raise CalibrationError(
            STEP,
            Reason.STAGE_SLIPS,
            f"axis {axis.name} slips: it comes back to one target {axis.repeatability.value:.3g} mm elsewhere (rms) and "
            f"leaves a straight line by {axis.linearity_mm:.3g} mm over {axis.travel_mm:g} mm",
            allowed=f"{SLIP_SHARE * axis.travel_mm:.3g} mm",
            remedy="tighten coupling and clamps, move slower, take load off the stage",
        )
    if expected is not None:
        _require_expected(axis, np.asarray(expected, dtype=np.float64), length)


def _require_expected(axis: _Axis, expected: F64, length: float) -> None:
    wanted = float(np.linalg.norm(expected))
    angle = float(np.degrees(np.arccos(np.clip(axis.per_mm @ expected / (length * wanted), -1, 1))))
    found = f"{np.round(axis.per_mm, 3).tolist()} per mm, not {expected.tolist()}"
    if angle > OPPOSITE_DEG:
        raise CalibrationError(
            STEP,
            Reason.STAGE_WRONG_WAY,
            f"axis {axis.name} moves the wrong way: {found}",
            remedy="check the cable and the axis's sign, or turn the sign in [stage.mount]",
        )
    if angle > ANGLE_MAX_DEG:
        raise CalibrationError(
            STEP,
            Reason.STAGE_WRONG_WAY,
            f"axis {axis.name} moves the camera {angle:.0f} degrees off the direction in [stage.mount]: {found}",
            allowed=f"{ANGLE_MAX_DEG:g} degrees",
            remedy="check which axis is plugged in where, or correct [stage.mount]",
        )
    ratio = length / wanted
    if not SCALE_RANGE[0] <= ratio <= SCALE_RANGE[1]:
        raise CalibrationError(
            STEP,
            Reason.STAGE_WRONG_WAY,
            f"axis {axis.name} moves the camera {ratio:.3g} times as far as it says",
            allowed=f"{SCALE_RANGE[0]:g} to {SCALE_RANGE[1]:g} times",
            remedy="check the axis's microstep or steps per mm, and square_mm of the board",
        )


def _through_camera(
    measure: Callable[[Places], list[_Axis]], sightings: Sequence[Sighting], camera: CameraEstimate, places: Places
) -> list[F64]:
    """Return how the figures of each axis change with the camera's, [5, 8] each, by central differences.

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


def _estimate(axis: _Axis, by_camera: F64, camera: CameraEstimate) -> AxisEstimate:
    carried = by_camera @ camera.covariance @ by_camera.T
    speed = axis.speed
    if speed is not None:
        # The speed is compared with the scale at rest: its error comes in, in part with the same cause.
        along = float(axis.per_mm @ axis.covariance @ axis.per_mm) / float(axis.per_mm @ axis.per_mm) ** 2
        total = np.sqrt(speed.standard_error**2 + along + carried[4, 4])
        speed = replace(speed, standard_error=float(total))
    return AxisEstimate(
        name=axis.name,
        per_mm=axis.per_mm,
        covariance=axis.covariance + carried[:3, :3],
        backlash_mm=Measured(axis.backlash.value, float(np.hypot(axis.backlash.standard_error, carried[3, 3] ** 0.5))),
        repeatability_mm=axis.repeatability,
        linearity_mm=axis.linearity_mm,
        speed_error=speed,
        speed_ripple_mm=axis.speed_ripple_mm,
    )
