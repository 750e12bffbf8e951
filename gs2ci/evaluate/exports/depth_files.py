"""Depth maps as other programs read them: 16-bit PNG with the length of its step and its unit, or EXR.

Here: `write_depth_png`, `write_depth_exr`, `write_nerfstudio_depth`. Each file says its unit and what stands for no
depth. Not here: where depth comes from.
"""

import io
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.json_text import as_json
from gs2ci.core.whole_file import write_whole
from gs2ci.evaluate.whole_folder import write_png

TOP: Final = 65_535
SCALE_NAME: Final = "depth.json"
# Depths beyond so many median ones are all written as the last reading: steps that reach a single pixel near infinity
# would be longer than the scene.
_FARTHEST: Final = 100.0
_PNG: Final = b"\x89PNG\r\n\x1a\n"
_THOUSAND: Final = 1000.0


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
    told = {"unit_per_step": step, "unit": unit, "unknown": 0, "this_or_farther": TOP, "views": len(depth)}
    for index, view in enumerate(depth):
        # A depth keeps a reading above 0, however small it is.
        reading = np.where(view > 0, np.clip(np.round(view / step), 1, TOP), 0).astype(np.uint16)
        path = folder / f"depth_{index:03d}.png"
        write_png(path, reading)
        write_whole(path, _with_text(path.read_bytes(), {key: str(value) for key, value in told.items()}))
    (folder / SCALE_NAME).write_text(as_json(told))
    return step


def _with_text(png: bytes, told: Mapping[str, str]) -> bytes:
    """Add texts to a PNG, which stand between its first chunk and the others (PNG specification, 11.3.3)."""
    first = len(_PNG) + 12 + struct.unpack(">I", png[len(_PNG) : len(_PNG) + 4])[0]
    chunks = b""
    for key, value in told.items():
        held = b"tEXt" + key.encode("latin-1") + b"\0" + value.encode("latin-1", "replace")
        chunks += struct.pack(">I", len(held) - 4) + held + struct.pack(">I", zlib.crc32(held))
    return png[:first] + chunks + png[first:]


def write_nerfstudio_depth(folder: Path, depth: F32) -> list[str]:
    """Write each view's depth as nerfstudio reads it; return the files' names in the folder.

    Arrays of 32-bit floats, since nerfstudio multiplies what it reads by a thousandth if it is not told otherwise, as
    for millimetres and poses in metres: so they hold a thousand times the depth, and nothing has to be told.

    Args:
        folder: An existing folder.
        depth: [N, H, W], 0 at pixels without a depth, as there.

    Raises:
        StorageError: The disk refuses.
    """
    (folder / "depth").mkdir()
    names = [f"depth/depth_{index:03d}.npy" for index in range(len(depth))]
    for name, view in zip(names, depth, strict=True):
        held = io.BytesIO()
        np.save(held, (_THOUSAND * view).astype(np.float32))
        write_whole(folder / name, held.getvalue())
    return names


def write_depth_exr(folder: Path, depth: F32, unit: str = "") -> None:
    """Write each view's depth as an EXR file with one float channel Z, as renderers name it; 0 where nothing is seen.

    Args:
        folder: Is there.
        depth: [N, H, W].
        unit: Of depth, as `Report.length_unit` says it; "" for one that is not known.

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
    comments = f"Z: distance along the optical axis in {unit or 'an unknown unit'}; 0: no depth is known"
    for index, view in enumerate(depth):
        header: dict[str, object] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        header |= {"unit": unit or "unknown", "unknownDepth": 0.0, "comments": comments}
        channels = {"Z": np.ascontiguousarray(view, np.float32)}
        try:
            OpenEXR.File(header, channels).write(str(folder / f"depth_{index:03d}.exr"))
        except (OSError, RuntimeError) as error:
            raise StorageError(f"{folder} cannot be written: {error}", remedy="check the free space") from error
