"""Depth maps as other programs read them: 16-bit PNG with the length of its step and its unit, or EXR.

Here: `write_depth_png`, `write_depth_exr`. Not here: where depth comes from.
"""

from pathlib import Path
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.json_text import as_json
from gs2ci.evaluate.whole_folder import write_png

TOP: Final = 65_535
SCALE_NAME: Final = "depth.json"
# Depths beyond so many median ones are all written as the last reading: steps that reach a single pixel near infinity
# would be longer than the scene.
_FARTHEST: Final = 100.0


def write_depth_png(folder: Path, depth: F32, unit: str) -> float:
    """Write each view's depth as a 16-bit PNG, and beside them the length of one step and its unit, in `depth.json`.

    Args:
        folder: An existing folder.
        depth: [N, H, W], 0 at pixels without a depth.
        unit: Of depth, as `Report.length_unit` says it.

    Returns:
        The step, in the unit of depth: depth = step × reading; a reading of 0 means no depth, and the last, 65535, this
        depth or a larger one.

    Raises:
        StorageError: The disk refuses.
    """
    known = depth[depth > 0].astype(np.float64)
    top = min(float(known.max()), _FARTHEST * float(np.median(known))) if known.size else 1.0
    step = max(top, 1e-30) / TOP
    for index, view in enumerate(depth):
        # A depth keeps a reading above 0, however small it is.
        reading = np.where(view > 0, np.clip(np.round(view / step), 1, TOP), 0).astype(np.uint16)
        write_png(folder / f"depth_{index:03d}.png", reading)
    told = {"unit_per_step": step, "unit": unit, "unknown": 0, "this_or_farther": TOP, "views": len(depth)}
    (folder / SCALE_NAME).write_text(as_json(told))
    return step


def write_depth_exr(folder: Path, depth: F32) -> None:
    """Write each view's depth as an EXR file with one float channel Z, as renderers name it; 0 where nothing is seen.

    Args:
        folder: Is there.
        depth: [N, H, W].

    Raises:
        InputError: The package OpenEXR is not installed.
        StorageError: The disk refuses.
    """
    try:
        import OpenEXR  # noqa: PLC0415  an extra
    except ImportError as error:
        raise InputError(
            "depth as EXR needs the package OpenEXR",
            allowed="--to depth-png without it",
            remedy="pip install 'gs2ci[exr]'",
        ) from error
    for index, view in enumerate(depth):
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        channels = {"Z": np.ascontiguousarray(view, np.float32)}
        try:
            OpenEXR.File(header, channels).write(str(folder / f"depth_{index:03d}.exr"))
        except (OSError, RuntimeError) as error:
            raise StorageError(f"{folder} cannot be written: {error}", remedy="check the free space") from error
