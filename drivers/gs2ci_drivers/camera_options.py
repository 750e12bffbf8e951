"""What the [sensor] tables of all cameras have in common.

Here: `CameraOptions`. Not here: what each kind of camera adds (`v4l2/options.py`, `genicam/options.py`).
"""

from typing import Annotated

from pydantic import Field

from gs2ci.core.config import ConfigTable, NotNegative, Positive


class CameraOptions(ConfigTable):
    """Picture size, warm-up and data sheet of a camera."""

    height: Annotated[int, Field(ge=0)] = 0
    """Rows; 0 takes the largest."""
    width: Annotated[int, Field(ge=0)] = 0
    """Columns; 0 takes the largest."""
    left: Annotated[int, Field(ge=0)] | None = None
    """First column of the region of interest."""
    warm_up_frames: Annotated[int, Field(ge=0, le=10_000)] = 0
    """Frames to discard after a start."""
    black_level_dn: NotNegative = 0.0
    """Reading without light."""
    full_well_e: Positive | None = None
    """Electrons at the top of the scale."""
    electrons_per_dn: Positive | None = None
    """Electrons per step of the reading."""
