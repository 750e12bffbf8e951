"""Camera and stage calibrated on simulated benches of known truth, drawn at random.

Every bench is calibrated completely: drivers, twins, rendered boards, the steps `camera` and `stage`. The last line
compares the corner finder with OpenCV's `cornerSubPix`.
"""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.rig.calibrating import bench_of, operator_of
from gs2ci.rig.config import RigTable
from gs2ci.rig.opening import Rig
from gs2ci.rig.simulated import build_bench
from gs2ci_calibration.bench import Arrangement, Bench
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.geometry.board import Board
from gs2ci_calibration.geometry.camera import measure_camera
from gs2ci_calibration.geometry.pictures import Pictures
from gs2ci_calibration.geometry.stage import measure_stage
from gs2ci_sims.bench_light import BenchLight
from gs2ci_sims.targets import board_scene

Rows = dict[str, list[tuple[float, float]]]

BENCHES = 24
SIZE = (160, 200)
AXES = ("x", "y")
WINDOWS = (2, 3, 4, 5)


@dataclass(frozen=True)
class Truth:
    """What is true of one bench.

    Args:
        intrinsics: [3, 3].
        distortion: k1, k2.
        per_mm: The camera's motion per mm of each axis, [3].
        backlash_mm: Of each axis, in its own mm.
        repeatability_mm: The same, in mm of the camera.
        speed_error: Relative, of each axis.
    """

    intrinsics: F64
    distortion: tuple[float, float]
    per_mm: dict[str, F64]
    backlash_mm: dict[str, float]
    repeatability_mm: dict[str, float]
    speed_error: dict[str, float]


def random_bench(
    seed: int, size: tuple[int, int] = SIZE, axes: tuple[str, ...] = AXES, **changes: Any
) -> tuple[Bench, Rig, Truth]:
    """Draw a bench: focal length, axis and distortion of the lens, mounting and mechanics of the stage, light.

    Args:
        seed: Of all that.
        size: Of the sensor.
        axes: Of the stage; none leaves it out.
        changes: Keys of [world] to be set otherwise; the truth does not know of them.
    """
    rng = np.random.default_rng((seed, 5))
    height, width = size
    focal = rng.uniform(0.8, 1.6) * width
    principal = 0.5 * np.array([width, height]) + rng.uniform(-0.03, 0.03, 2) * width
    k1 = float(rng.uniform(-0.06, 0.06) / (0.5 * np.hypot(*size) / focal) ** 2)
    directions = {axis: _tilted(rng, np.eye(3)[i]) for i, axis in enumerate("xyz")}
    mechanics: dict[str, dict[str, Any]] = {
        axis: {
            "scale": float(rng.uniform(0.98, 1.02)),
            "backlash_mm": float(rng.uniform(0, 0.2)),
            "repeatability_mm": float(rng.uniform(0, 0.02)),
            "ripple_mm": float(rng.uniform(0, 0.005)),
            "speed_error": float(rng.uniform(-0.01, 0.01)),
            "seed": int(rng.integers(1 << 30)),
        }
        for axis in axes
    }
    table = RigTable.model_validate(
        {
            "modulator": {"kind": "dlpc900", "trigger_out_2_bit": "disables"},
            "sensor": {"kind": "v4l2", "height": height, "width": width, "format": "Y12", "black_level_dn": 64.0},
            "stage": _stage(axes),
            "capture": {"masks": 2},
            "registration": {"superpixel": 2},
            "optics": {"full_scale_e_per_s": float(10 ** rng.uniform(4.5, 6))},
            "world": {
                "devices": "ideal",
                "height": height,
                "width": width,
                "seed": seed,
                "scene_units_per_mm": 0.02,
                "effects": {"lens_distortion": {"k1": k1}, "modulator_psf": {"sigma_px": float(rng.uniform(0.1, 0.6))}},
                "mechanics": mechanics,
                "mount": {axis: tuple(map(float, way)) for axis, way in directions.items()},
            }
            | changes,
        }
    )
    rig = Rig(table, "", Path(), build_bench(table))
    assert rig.bench is not None
    light = rig.bench.world.light
    assert isinstance(light, BenchLight)
    intrinsics = np.array([[focal, 0, principal[0]], [0, focal, principal[1]], [0, 0, 1.0]])
    light.scene = replace(light.scene, intrinsics=intrinsics)
    devices = rig.open()
    bench = bench_of(rig, devices, operator_of(rig, print))
    truth = Truth(
        intrinsics,
        (k1, 0.0),
        {axis: mechanics[axis]["scale"] * directions[axis] for axis in axes},
        {axis: mechanics[axis]["backlash_mm"] for axis in axes},
        {axis: mechanics[axis]["repeatability_mm"] for axis in axes},
        {axis: mechanics[axis]["speed_error"] for axis in axes},
    )
    return bench, rig, truth


def _stage(axes: tuple[str, ...]) -> dict[str, Any] | None:
    if not axes:
        return None
    numbers = {axis: i + 1 for i, axis in enumerate(axes)}
    return {"kind": "zaber", "axes": numbers, "microstep_mm": dict.fromkeys(axes, 0.000047625)}


def _tilted(rng: np.random.Generator, way: F64) -> F64:
    """Return a unit vector some degrees off."""
    off = way + rng.normal(0, np.radians(4), 3)
    return np.asarray(off / np.linalg.norm(off))


def camera_errors(section: Section, truth: Truth) -> dict[str, tuple[float, float]]:
    """Return error and standard error of each figure of a camera."""
    found, expected = section.estimates["intrinsics"], truth.intrinsics
    pairs = {
        name: (found, expected, at) for name, at in {"fx": (0, 0), "fy": (1, 1), "cx": (0, 2), "cy": (1, 2)}.items()
    }
    errors = {name: _error(estimate, true, at) for name, (estimate, true, at) in pairs.items()}
    true = np.array([*truth.distortion, 0.0, 0.0, 0.0])
    return errors | {name: _error(section.estimates["distortion"], true, (i,)) for i, name in enumerate(("k1", "k2"))}


def stage_errors(section: Section, truth: Truth, axis: str) -> dict[str, tuple[float, float]]:
    """Return error and standard error of each figure of an axis; the direction's is an angle in degrees."""
    per_mm = truth.per_mm[axis]
    length = float(np.linalg.norm(per_mm))
    direction = section.estimates[f"direction_{axis}"]
    cosine = float(np.clip(direction.value @ per_mm / length, -1, 1))
    across = float(np.degrees(np.linalg.norm(direction.standard_error)))
    true = {
        "scale": length,
        "backlash_mm": truth.backlash_mm[axis],
        # The twin goes astray in mm of the camera; what is measured is in mm of the axis.
        "repeatability_mm": truth.repeatability_mm[axis] / length,
        "velocity_error": truth.speed_error[axis],
    }
    errors = {name: _error(section.estimates[f"{name}_{axis}"], np.array(value), ()) for name, value in true.items()}
    return errors | {"direction_deg": (float(np.degrees(np.arccos(cosine))), across)}


def _error(estimate: Estimate, true: F64, at: tuple[int, ...]) -> tuple[float, float]:
    return float(estimate.value[at] - true[at]), float(np.broadcast_to(estimate.standard_error, true.shape)[at])


def corner_errors(bench: Bench, rig: Rig, truth: Truth) -> tuple[float, float]:
    """Return the rms error of our corners and of OpenCV's in one picture of the board on its stand, in pixels.

    OpenCV's is that of its best window; it starts within half a pixel of the truth.
    """
    assert rig.bench is not None
    light: Any = rig.bench.world.light
    bench.please(Arrangement.FIXED_BOARD)
    board = Board(bench.options.board)
    exposure_s = Pictures(bench, "camera", board).suit_exposure()
    frame = bench.grab(bench.flat_pattern(is_open=True)[None], frames=4, exposure_s=exposure_s).readings[0].mean(axis=0)
    sighting = board.find(frame)
    if sighting is None:
        raise ValueError("the board on its stand was not found")
    plane = rig_board(rig)
    _, drawn = board_scene(light.scene, plane, 0, light._seed, fixed=True)
    assert drawn.world_from_board is not None
    pose = light.scene.world_to_camera @ drawn.world_from_board
    points = sighting.corners_mm * plane.square / bench.options.board.square_mm
    coefficients = np.array([*truth.distortion, 0, 0])
    at, _ = cv2.projectPoints(points, cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3], truth.intrinsics, coefficients)
    at = at.reshape(-1, 2)
    stretched = np.clip((frame - frame.min()) / np.ptp(frame) * 255, 0, 255).astype(np.uint8)
    start = (at - 0.5 + np.random.default_rng(0).uniform(-0.5, 0.5, at.shape)).astype(np.float32).reshape(-1, 1, 2)
    ending = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
    theirs = min(
        _rms(cv2.cornerSubPix(stretched, start.copy(), (side, side), (-1, -1), ending).reshape(-1, 2) + 0.5 - at)
        for side in WINDOWS
    )
    return _rms(sighting.corners_px - at), theirs


def _rms(errors: F64) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def rig_board(rig: Rig) -> Any:
    """Return the board that the simulated operator holds."""
    operator: Any = operator_of(rig, print)
    return operator._board


def measure(seed: int) -> Rows:
    """Calibrate one bench; return error and standard error of each figure, and both corner finders' rms errors."""
    bench, rig, truth = random_bench(seed)
    rows: Rows = {"corners": [corner_errors(bench, rig, truth)]}
    camera = measure_camera(bench, Bundle())
    focal = truth.intrinsics[0, 0]
    for name, (error, stated) in camera_errors(camera, truth).items():
        of_focal = name in ("fx", "fy")
        scale = 100 / focal if of_focal else 1.0
        rows[f"{name}, %" if of_focal else name] = [(error * scale, stated * scale)]
    stage = measure_stage(bench, Bundle().with_section(camera))
    for axis in AXES:
        for name, pair in stage_errors(stage, truth, axis).items():
            rows.setdefault(f"stage {name}", []).append(pair)
    bench.devices.close()
    return rows


def show(benches: list[Rows]) -> None:
    """Print what came of some benches."""
    print(f"{len(benches)} random benches of {SIZE[0]} x {SIZE[1]} px, {len(AXES)} axes each")
    print("| figure | rms error | largest | within two standard errors |")
    print("|---|---:|---:|---:|")
    for name in benches[0]:
        pairs = [pair for rows in benches for pair in rows[name]]
        error, stated = np.abs(np.array(pairs)).T
        if name == "corners":
            print(f"| corners, px | {_rms(error):.4f} | {error.max():.4f} | cornerSubPix: {_rms(stated):.4f} rms |")
        else:
            inside = np.mean(error <= 2 * stated)
            print(f"| {name} | {_rms(error):.4g} | {error.max():.4g} | {100 * inside:.0f} % |")


def run() -> None:
    """Calibrate all benches and print what came of it."""
    benches = []
    for seed in range(BENCHES):
        benches.append(measure(seed))
        print(f"bench {seed + 1} of {BENCHES} done", file=sys.stderr, flush=True)
    show(benches)
