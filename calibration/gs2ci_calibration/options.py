"""The options of calibration: the table [calibration] of a rig file, and the procedures' options.

Here: `CalibrationOptions`, `BoardSpec`. Not here: the rest of a bench that a procedure uses (`bench`).
"""

from typing import Annotated, Literal

from pydantic import Field

from gs2ci.core.config import ConfigTable, Positive

Orientation = Literal[
    "upright",
    "mirrored left to right",
    "mirrored top to bottom",
    "upside down",
    "turned clockwise",
    "turned anticlockwise",
    "mirrored along its diagonal",
    "mirrored along its other diagonal",
    "any",
]


class BoardSpec(ConfigTable):
    """[calibration.board]: the ChArUco board of `gs2ci calibrate camera`, in OpenCV's terms."""

    columns: Annotated[int, Field(ge=3)] = 7
    """Squares across."""
    rows: Annotated[int, Field(ge=3)] = 5
    """Squares down."""
    square_mm: Positive = 30.0
    """Side of a square, as measured on the print."""
    marker_mm: Positive = 21.0
    """Side of a marker, likewise."""
    dictionary: str = "DICT_4X4_50"
    """OpenCV's name of the markers' dictionary."""


class CalibrationOptions(ConfigTable):
    """[calibration]: options of `gs2ci calibrate`, and the bundle that `gs2ci capture` uses."""

    bundle: str = ""
    """A calibration bundle beside the rig file, used by `gs2ci capture`; "" takes the masks as drawn."""
    max_age_days: Positive = 30.0
    """A bundle older than this is refused."""
    frames: Annotated[int, Field(ge=2)] = 32
    """Frames of the dark and of the flat stack."""
    mask_frames: Annotated[int, Field(ge=2)] = 8
    """Frames of each mask, at least."""
    mask_accuracy: Annotated[float, Field(gt=0, lt=0.5)] = 0.01
    """Required standard error of masks, rms over the pixels; more frames are taken if necessary."""
    orientation: Orientation = "upright"
    """Orientation of the modulator's image on the sensor; another one is refused, unless this is "any"."""
    board: BoardSpec = BoardSpec()
    board_views: Annotated[int, Field(ge=3)] = 12
    """Pictures of the board, each in another pose."""
    temperature_c: float | None = None
    """Temperature of the sensor, if known, for the bundle."""
