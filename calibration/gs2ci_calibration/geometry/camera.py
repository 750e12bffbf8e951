"""The step `camera`: pictures of a ChArUco board in several poses, and the camera estimated from them.

Here: the pictures and the bundle's section, both ways. Not here: the estimate (`intrinsics`), corners (`board`).
"""

from typing import Any, Final

import numpy as np

from gs2ci_calibration.bench import Arrangement, Bench
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.geometry.board import Board
from gs2ci_calibration.geometry.intrinsics import PARAMETERS, STEP, CameraEstimate, estimate_camera
from gs2ci_calibration.geometry.pictures import Pictures, require_any, require_sharp

FRAMES: Final = 2
"""Frames averaged for a picture: with more, noise is no longer the main error of the corners."""


def measure_camera(bench: Bench, known: Bundle) -> Section:
    """Measure the intrinsics and the distortion.

    Requests the board `board_views` times, each time in another pose. Needs no other section.

    Args:
        bench: The bench.
        known: Not used.

    Raises:
        CalibrationError: No light, saturated, blurred, board not found, too few or degenerate views, or a bad fit.
        DriverError: A device failed.
    """
    del known
    pictures = Pictures(bench, STEP, Board(bench.options.board))
    views, sightings, exposure_s = bench.options.board_views, [], 0.0
    bench.progress.stage("pictures of the board", views)
    for index in range(views):
        bench.please(Arrangement.BOARD, index)
        exposure_s = exposure_s or pictures.suit_exposure()
        sightings.append(pictures.take(exposure_s, FRAMES))
        require_any(STEP, sightings)
        bench.progress.step(index + 1)
    blur_px = require_sharp(STEP, sightings)
    taken = {"exposure_s": exposure_s, "pictures": views, "blur_px": blur_px, "region": bench.region}
    return section_of(estimate_camera(sightings, bench.size), **taken)


def section_of(camera: CameraEstimate, **facts: Any) -> Section:
    """Return the bundle's section of a camera; `facts` holds the settings of the measurement."""
    fx, fy, cx, cy, *_ = camera.standard_errors
    return Section(
        name=STEP,
        estimates={
            "intrinsics": Estimate(camera.matrix, [[fx, 0, cx], [0, fy, cy], [0, 0, 0]], "px"),
            # OpenCV's order has a fifth coefficient, k3, which pictures of a flat board cannot separate from k1 and k2.
            "distortion": Estimate([*camera.distortion, 0.0], [*camera.standard_errors[4:], 0.0], "1"),
        },
        arrays={"covariance": camera.covariance},
        facts={
            "parameters": list(PARAMETERS),
            "height": camera.size[0],
            "width": camera.size[1],
            "corners": camera.corners,
            "residual_px": camera.residual_px,
            "residuals_px": [round(float(residual), 4) for residual in camera.residuals_px],
            "tilt_spread_deg": camera.tilt_spread_deg,
            **facts,
        },
        notes=(
            f"{camera.corners} corners in {len(camera.residuals_px)} pictures, "
            f"residual {camera.residual_px:.3f} px (rms)",
        ),
    )


def camera_of(section: Section) -> CameraEstimate:
    """Return the camera of a bundle's section."""
    matrix, facts = section.array("intrinsics"), section.facts
    return CameraEstimate(
        size=(int(facts["height"]), int(facts["width"])),
        values=np.array([*matrix[[0, 1, 0, 1], [0, 1, 2, 2]], *section.array("distortion")[:4]]),
        covariance=np.asarray(section.array("covariance"), dtype=np.float64),
        residual_px=float(facts["residual_px"]),
        residuals_px=np.asarray(facts["residuals_px"], dtype=np.float64),
        corners=int(facts["corners"]),
        tilt_spread_deg=float(facts["tilt_spread_deg"]),
    )
