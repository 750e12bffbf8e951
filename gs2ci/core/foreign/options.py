"""What the user may fix about a foreign file before anything is guessed."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from gs2ci.core.foreign.container import Array
from gs2ci.core.foreign.curves import CurveName
from gs2ci.core.foreign.pixels import BadPixels
from gs2ci.core.foreign.stage_log import USUAL_WAYS
from gs2ci.core.records import CfaPattern

MaskAxis = Literal["auto", "first", "last"]
Layout = Literal["auto", "rgb", "stack"]


@dataclass(frozen=True)
class ImportOptions:
    """What the user states; None, "auto" and "" mean: infer it from the numbers.

    Args:
        meas_key: Key of the measurement.
        mask_key: Key of the masks.
        truth_key: Key of the true views; "none": leave them out.
        mask_axis: Whether masks are counted along the first or the last axis.
        meas_layout: Whether three images are one RGB measurement or a stack of three.
        views: Use only the first so many masks (for files that hold more than were exposed).
        reverse_masks: Whether the masks, with their weights, were exposed in the opposite order.
        mask_scale: Reading of a fully open mask.
        scale: Reading of a white scene under one open mask, above the offset.
        offset: Reading without light.
        saturation: Readings at or above it are clipped; 0: none is.
        cfa: Colour filter array of a single-channel measurement.
        intrinsics: Camera matrix, [3, 3], or fx fy cx cy, in pixels; or a file of it (`camera_files`, or one array).
        focal_px: Focal length in pixels, principal point at the centre.
        distortion: Of the lens, OpenCV's k1 k2 p1 p2 k3.
        world_to_camera: True poses, [N, 4, 4], or a file of them (`stage_log`), for scoring only.
        truth: True views, for scoring only.
        stage: Log of the stage (`stage_log`): one position for each mask.
        stage_axes: Which way the camera goes as x, y and z of the log grow.
        stage_error: Standard error of these positions, in their unit (mm if it is named).
        stage_turn_error_deg: By how much the stage may turn the camera from the first position to the last.
        telemetry: The poses of the log, world-to-camera [N, 4, 4], once it is read.
        white_key: Key of frames of an even light; "none": leave them out.
        dark_key: Key of frames without light; "none": leave them out.
        bad_pixels: What to do with NaN in the measurement.
        curve: How readings are stored; "auto": as they show.
    """

    meas_key: str | None = None
    mask_key: str | None = None
    truth_key: str | None = None
    white_key: str | None = None
    dark_key: str | None = None
    mask_axis: MaskAxis = "auto"
    meas_layout: Layout = "auto"
    views: int | None = None
    reverse_masks: bool = False
    mask_scale: float | None = None
    scale: float | None = None
    offset: float | None = None
    saturation: float | None = None
    cfa: CfaPattern | None = None
    intrinsics: Array | Path | None = None
    focal_px: float | None = None
    distortion: Array | None = None
    world_to_camera: Array | Path | None = None
    truth: Array | None = None
    stage: Path | None = None
    stage_axes: tuple[str, ...] = USUAL_WAYS
    stage_error: float | None = None
    stage_turn_error_deg: float | None = None
    telemetry: Array | None = None
    bad_pixels: BadPixels = "refuse"
    curve: CurveName = "auto"
