"""The step `stage`: pictures of a board at rest, taken along each axis, approached from both sides, and in motion.

Here: the targets, the pictures, the bundle's section. Not here: the fit (`axes`), the camera (step `camera`, whose
section this one needs).
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from gs2ci_calibration.bench import Arrangement, Bench
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.fitting import needed
from gs2ci_calibration.geometry.axes import AxisEstimate, StagePicture, SweepPicture, estimate_stage
from gs2ci_calibration.geometry.axis_checks import STEP
from gs2ci_calibration.geometry.board import Board, Sighting
from gs2ci_calibration.geometry.camera import camera_of
from gs2ci_calibration.geometry.intrinsics import CameraEstimate
from gs2ci_calibration.geometry.pictures import Pictures, require_sharp
from gs2ci_calibration.geometry.places import find_places
from gs2ci_calibration.refusals import CalibrationError, Reason
from gs2ci_drivers.axis import AxisInfo
from gs2ci_drivers.plan import Travel
from gs2ci_drivers.stage import Stage

TARGETS: Final = 7
VISITS: Final = 2
"""How often each target is visited from each side."""
UNEVEN: Final = 0.3
"""Displacement of targets from equal spacing, as a share of the spacing."""
GOLDEN: Final = 0.618034
RUN_UP_SHARE: Final = 0.08
"""Distance from which a target is approached, as a share of the travel; it must exceed the backlash."""
SPAN_SHARE: Final = 0.9
"""Share of the board's room in the frame that the camera's motion may use."""
SPAN_MIN_SHARE: Final = 0.1
"""Smallest travel, as a share of the frame's width at the board: less gives too little accuracy."""
EDGE_SHARE: Final = 0.05
"""Share of an axis's length kept clear at its ends, for a sweep's ramps."""
SWEEP_PICTURES: Final = 12
SWEEP_SPEED_SHARE: Final = 0.25
"""Speed of the sweep as a share of the axis's highest, unless the capture has its own."""
SWEEP_BLUR_PX: Final = 1.0
"""Largest motion during one exposure: uniform motion blurs symmetrically and displaces no corner."""
FRAMES: Final = 1


@dataclass(frozen=True)
class _Room:
    """The room for motion while the board stays in the frame.

    Args:
        span_mm: How far the camera may move to each side.
        mm_per_px: Size of a pixel at the board.
    """

    span_mm: float
    mm_per_px: float


def measure_stage(bench: Bench, known: Bundle) -> Section:
    """Measure direction, scale and precision of the camera's motion by each axis.

    Requests the board on a stand; moves all axes, one after another, as far as the board stays in view, and returns
    each to its former position.

    Args:
        bench: The bench.
        known: The bundle with its section `camera`.

    Raises:
        CalibrationError: No stage, no camera in the bundle, no light, the board not in every picture, an axis has no
            room, or it does not move, slips or moves differently than the rig file says.
        DriverError: A device failed.
    """
    stage = bench.stage(STEP)
    camera = camera_of(needed(known, "camera", bench, STEP))
    bench.please(Arrangement.FIXED_BOARD)
    pictures = Pictures(bench, STEP, Board(bench.options.board))
    exposure_s = pictures.suit_exposure()
    room = _room_to_move(pictures.take(exposure_s, FRAMES), camera)
    axes = stage.info.axes
    bench.progress.stage("pictures along the stage", len(axes) * (2 * TARGETS * VISITS + SWEEP_PICTURES))
    rest: list[StagePicture] = []
    sweeps: list[SweepPicture] = []
    for axis in axes.values():
        begin_mm = stage.positions_mm()[axis.name]
        low_mm, high_mm = _ends(axis, begin_mm, room)
        rest += _at_rest(pictures, stage, axis, (low_mm, high_mm), exposure_s, done=len(rest) + len(sweeps))
        sweeps += _sweep(pictures, axis, (low_mm, high_mm), exposure_s, room)
        bench.progress.step(len(rest) + len(sweeps))
        bench.move({axis.name: begin_mm})
    require_sharp(STEP, [picture.sighting for picture in rest])
    found = estimate_stage(rest, sweeps, camera, bench.directions)
    return _section(found, exposure_s, len(rest) + len(sweeps))


def _room_to_move(sighting: Sighting | None, camera: CameraEstimate) -> _Room:
    """Return how far the camera may move until the board leaves the frame.

    Raises:
        CalibrationError: The board is not seen, or fills the frame.
    """
    if sighting is None or sighting.collinear:
        raise CalibrationError(
            STEP,
            Reason.BOARD_NOT_SEEN,
            "the board is not in the first picture",
            remedy="fix the board before the camera with the stage in mid-travel, in focus and lit, and check "
            "[calibration.board] against its print",
        )
    distance_mm = float(find_places([sighting], camera.values).board_mm[0, 2])
    mm_per_px = distance_mm / float(camera.values[:2].mean())
    height, width = camera.size
    low, high = sighting.corners_px.min(axis=0), sighting.corners_px.max(axis=0)
    free_px = float(min(*low, width - high[0], height - high[1]))
    span_px = SPAN_SHARE * free_px
    if span_px < SPAN_MIN_SHARE * width:
        raise CalibrationError(
            STEP,
            Reason.DEGENERATE_VIEWS,
            f"the board's corners come as near as {free_px:.0f} px to the rim of the frame",
            allowed=f"{SPAN_MIN_SHARE / SPAN_SHARE * width:.0f} px or more",
            remedy="put the board into the middle of the view and further away, so that it fills half of it",
        )
    return _Room(span_px * mm_per_px, mm_per_px)


def _ends(axis: AxisInfo, begin_mm: float, room: _Room) -> tuple[float, float]:
    """Return the lowest and the highest position for pictures.

    Raises:
        CalibrationError: The axis has no room.
    """
    edge_mm = EDGE_SHARE * (axis.max_mm - axis.min_mm)
    low_mm = max(begin_mm - room.span_mm, axis.min_mm + edge_mm)
    high_mm = min(begin_mm + room.span_mm, axis.max_mm - edge_mm)
    if high_mm - low_mm < 100 * axis.step_mm or high_mm - low_mm < 5 * RUN_UP_SHARE * room.mm_per_px:
        raise CalibrationError(
            STEP,
            Reason.DEGENERATE_VIEWS,
            f"axis {axis.name} at {begin_mm:g} mm has no travel that the board allows",
            allowed=f"positions from {axis.min_mm + edge_mm:g} to {axis.max_mm - edge_mm:g} mm",
            remedy="move the stage to the middle of its travel first",
        )
    return low_mm, high_mm


def _at_rest(
    pictures: Pictures, stage: Stage, axis: AxisInfo, ends_mm: tuple[float, float], exposure_s: float, *, done: int
) -> list[StagePicture]:
    """Visit all targets upwards and downwards, `VISITS` times, and take a picture at each."""
    run_up_mm = RUN_UP_SHARE * (ends_mm[1] - ends_mm[0])
    targets = np.linspace(ends_mm[0] + run_up_mm, ends_mm[1] - run_up_mm, TARGETS)
    # Equal spacing could be a multiple of the screw's pitch, whose periodic error would then appear as a slope.
    targets += UNEVEN * (targets[1] - targets[0]) * (np.arange(TARGETS) * GOLDEN % 1 - 0.5)
    taken = []
    for visit in range(2 * VISITS):
        upwards = visit % 2 == 0
        pictures.bench.move({axis.name: ends_mm[0] if upwards else ends_mm[1]})
        for target in targets if upwards else targets[::-1]:
            asked = stage.check_targets({axis.name: float(target)})
            pictures.bench.move(asked)
            sighting = pictures.take(exposure_s, FRAMES)
            taken.append(StagePicture(axis.name, asked[axis.name], upwards, sighting))
            pictures.bench.progress.step(done + len(taken))
    return taken


def _sweep(
    pictures: Pictures, axis: AxisInfo, ends_mm: tuple[float, float], exposure_s: float, room: _Room
) -> list[SweepPicture]:
    """Take pictures while the axis crosses its range at constant speed."""
    bench = pictures.bench
    wanted = bench.capture.travel
    capture_mm_s = (
        abs(wanted.to_mm - wanted.from_mm) / (len(bench.capture.masks) * bench.capture.mask_s) if wanted else 0
    )
    speed_mm_s = min(
        capture_mm_s or SWEEP_SPEED_SHARE * axis.max_speed_mm_s,
        SWEEP_SPEED_SHARE * axis.max_speed_mm_s,
        SWEEP_BLUR_PX * room.mm_per_px / exposure_s,
    )
    length_mm = ends_mm[1] - ends_mm[0]
    inside_mm = 0.8 * length_mm
    shown_s = inside_mm / speed_mm_s / SWEEP_PICTURES
    longest_s = bench.devices.modulator.info.max_exposure_s
    if shown_s > longest_s:
        shown_s, inside_mm = longest_s, speed_mm_s * longest_s * SWEEP_PICTURES
    middle_mm = 0.5 * (ends_mm[0] + ends_mm[1])
    travel = Travel(axis.name, middle_mm - inside_mm / 2, middle_mm + inside_mm / 2)
    patterns = np.repeat(bench.flat_pattern(is_open=True)[None], SWEEP_PICTURES, axis=0)
    stack = bench.grab(patterns, frames=1, exposure_s=exposure_s, shown_s=shown_s, travel=travel)
    speed = stack.plan.sweep.speed_mm_s if stack.plan.sweep is not None else speed_mm_s
    since_s = stack.time_s[:, 0] - stack.time_s[0, 0]
    counted_mm = travel.from_mm + speed * since_s if stack.stage_mm is None else stack.stage_mm[:, 0]
    return [
        SweepPicture(axis.name, float(t), float(at), pictures.find(frame[0]))
        for t, at, frame in zip(since_s, counted_mm, stack.readings, strict=True)
    ]


def _section(found: dict[str, AxisEstimate], exposure_s: float, pictures: int) -> Section:
    """Return the bundle's section; `Estimate` checks that it contains no NaN."""
    estimates: dict[str, Estimate] = {}
    facts: dict[str, Any] = {"exposure_s": exposure_s, "pictures": pictures, "axes": list(found)}
    notes = []
    for name, axis in found.items():
        estimates |= {
            f"direction_{name}": Estimate(axis.direction, axis.direction_errors, "1"),
            f"scale_{name}": Estimate(axis.scale.value, axis.scale.standard_error, "mm/mm"),
            f"backlash_mm_{name}": Estimate(axis.backlash_mm.value, axis.backlash_mm.standard_error, "mm"),
            f"repeatability_mm_{name}": Estimate(
                axis.repeatability_mm.value, axis.repeatability_mm.standard_error, "mm"
            ),
        }
        if axis.speed_error is not None:
            estimates[f"velocity_error_{name}"] = Estimate(axis.speed_error.value, axis.speed_error.standard_error, "1")
        if axis.sweep_lag_s is not None:
            estimates[f"sweep_lag_s_{name}"] = Estimate(axis.sweep_lag_s.value, axis.sweep_lag_s.standard_error, "s")
        facts |= {f"linearity_mm_{name}": axis.linearity_mm, f"speed_ripple_mm_{name}": axis.speed_ripple_mm}
        notes.append(
            f"axis {name}: direction known to {axis.direction_error_deg:.3f} degrees, straight to "
            f"{1e3 * axis.linearity_mm:.1f} um (rms)"
        )
    return Section(name=STEP, estimates=estimates, facts=facts, notes=tuple(notes))
