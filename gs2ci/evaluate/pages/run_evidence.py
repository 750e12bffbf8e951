"""The contents of a run folder, read as untrusted input.

Here: `FinishedRun` and its reading; `write_given`, the pictures and poses of the shot that the page needs; whether a
run is of a shot. Not here: a trade-off record beside it (`gs2ci.evaluate.tradeoff.record`), the page (`run_page.py`).
"""

import math
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64, U8
from gs2ci.core.errors import Gs2ciError, InputError, StorageError, reason_with_file
from gs2ci.core.json_text import parse_json
from gs2ci.core.lens import COEFFICIENTS
from gs2ci.core.records import Shot, are_rigid
from gs2ci.core.storage import read_shot
from gs2ci.evaluate.cameras import poses_of_transforms
from gs2ci.evaluate.pages.pictures import media_type, to_eight_bit
from gs2ci.evaluate.report import EXPOSED_NAME, MOTION_PICTURE_NAME, REGISTERED_NAME, Report, read_report
from gs2ci.evaluate.scales import white_level

GIVEN_NAME: Final = "given.npz"
# An archive may claim any size; those of runs contain a few images.
LIMIT_BYTES: Final = 2**30
MOST_PICTURE_BYTES: Final = 2**23


@dataclass(frozen=True)
class FinishedRun:
    """A run folder's content; arrays are read-only, and stay on the disk until they are used.

    Args:
        folder: The folder.
        report: `report.json`.
        views: Recovered, [N, H, W, 3].
        decode: Decoded without a scene, the same shape.
        scene_views: Rendered from the Gaussians alone, the same shape.
        exposed: The light integrated during each mask's time, the same shape, if the views show the middle of it.
        depth: [N, H, W], 0 at pixels without a depth; None if no depth was found.
        depth_spread: [N, H, W] as in `RunResult`; None in runs of earlier versions.
        depth_confidence: Likewise.
        disagreement: [N, H, W], difference between several fits, full scale 1; None if there was one.
        world_to_camera: Recovered, [N, 4, 4], OpenCV axes.
        intrinsics: [3, 3], px.
        distortion: Distortion of the lens, [5] as in `Shot`; None for a pinhole.
        views_error: Standard error of the views' values, [N, H, W]; None if the run has none.
        depth_error: Standard error of depth, in its unit, [N, H, W]; None likewise.
        motion_picture: The bytes of `motion.png`; None if nothing moves.
        measurement: For display, [H, W, 1 or 3]; None in a folder without `given.npz`, as the fields below.
        true_views: For display, [N, H, W, 1 or 3].
        true_world_to_camera: [N, 4, 4]; None as well if they are no rigid motions.
        stage_world_to_camera: Likewise.
    """

    folder: Path
    report: Report
    views: NDArray[Any]
    decode: NDArray[Any]
    scene_views: NDArray[Any]
    exposed: NDArray[Any] | None
    depth: NDArray[Any] | None
    depth_spread: NDArray[Any] | None
    depth_confidence: NDArray[Any] | None
    disagreement: NDArray[Any] | None
    world_to_camera: F64
    intrinsics: F64
    distortion: F64 | None
    views_error: NDArray[Any] | None
    depth_error: NDArray[Any] | None
    motion_picture: bytes | None
    measurement: U8 | None = None
    true_views: U8 | None = None
    true_world_to_camera: F64 | None = None
    stage_world_to_camera: F64 | None = None

    @cached_property
    def registered(self) -> Shot | None:
        """Get the measurement as corrected by the run's registration; None if it corrected nothing.

        Raises:
            StorageError: The file is damaged.
        """
        path = self.folder / REGISTERED_NAME
        return read_shot(path) if path.is_file() else None


def write_given(path: Path, shot: Shot) -> None:
    """Write the parts of the shot that a page shows: 8-bit pictures of measurement and truth, poses."""
    arrays: dict[str, NDArray[Any] | None] = {
        "measurement": _shown_measurement(shot),
        "true_views": None if shot.truth.views is None else np.stack([to_eight_bit(one) for one in shot.truth.views]),
        "true_world_to_camera": shot.truth.world_to_camera,
        "stage_world_to_camera": shot.telemetry_world_to_camera,
    }
    np.savez_compressed(path, **{name: array for name, array in arrays.items() if array is not None})  # type: ignore[arg-type]


def read_run(folder: Path) -> FinishedRun:
    """Read a run folder.

    Raises:
        StorageError: It is no run folder, or its parts are missing, damaged, too large or contradict each other.
    """
    folder = Path(folder)
    report = read_report(folder)
    try:
        return _read(folder, report)
    except Gs2ciError:
        raise
    except Exception as error:
        # Damage raises almost any exception: numpy's headers are Python, and archives bring errors of their own.
        raise StorageError(
            f"{folder} cannot be read as a run: {reason_with_file(error)}",
            allowed="a folder that `gs2ci reconstruct` wrote, whole",
            remedy="copy it again, or reconstruct again",
        ) from error


def check_same_shot(folder: Path, shot: Shot) -> None:
    """Refuse a run folder that is not of this shot.

    Raises:
        InputError: Its run is of another measurement.
        StorageError: It is no run folder, or a part of it is damaged.
    """
    evidence = read_run(folder)
    same = evidence.views.shape[:3] == shot.masks.shape
    if same and evidence.measurement is not None:
        shown = _shown_measurement(shot)
        same = evidence.measurement.shape == shown.shape and bool(
            # Another version may round the same reading to the next level.
            (np.abs(evidence.measurement.astype(np.int16) - shown) <= 1).all()
        )
    if not same:
        raise InputError(
            f"{folder} is a run of another measurement than {shot.name!r}",
            allowed="a run that `gs2ci reconstruct` made of the same shot",
            remedy="check the file and --index",
        )


def _shown_measurement(shot: Shot) -> U8:
    return to_eight_bit(shot.measurement / white_level(shot.measurement))


def _read(folder: Path, report: Report) -> FinishedRun:
    views = _array(folder / "views.npy", axes=4)
    shape = views.shape
    if shape[3] != 3 or 0 in shape:
        raise _contradiction(folder / "views.npy", shape, "[N, H, W, 3]")
    if shape[:3] != (report.views, *report.size):
        raise _contradiction(folder / "views.npy", shape, f"{[report.views, *report.size, 3]}, as its report says")
    path = folder / "cameras.json"
    transforms = parse_json(path.read_text(encoding="utf-8"))
    focal_x_px, focal_y_px = (_positive(path, transforms[name]) for name in ("fl_x", "fl_y"))
    lens = np.array([float(transforms.get(name, 0.0)) for name in COEFFICIENTS])
    exposed = folder / EXPOSED_NAME
    maps = ("depth", "depth_spread", "depth_confidence", "disagreement", "views_error", "depth_error")
    return FinishedRun(
        folder=folder,
        report=report,
        views=views,
        decode=_array_of_shape(folder / "decode.npy", shape),
        scene_views=_array_of_shape(folder / "scene_views.npy", shape),
        exposed=_array_of_shape(exposed, shape) if exposed.is_file() else None,
        world_to_camera=_poses(path, poses_of_transforms(transforms), len(views)),
        intrinsics=np.array([[focal_x_px, 0, transforms["cx"]], [0, focal_y_px, transforms["cy"]], [0, 0, 1.0]]),
        distortion=lens if lens.any() else None,
        motion_picture=_picture(folder / MOTION_PICTURE_NAME),
        **{name: _map(folder / f"{name}.npy", shape) for name in maps},
        **_given(folder / GIVEN_NAME, shape),
    )


def _picture(path: Path) -> bytes | None:
    """Read a PNG; None if the folder has no such file, or the file is no PNG."""
    if not path.is_file() or path.stat().st_size > MOST_PICTURE_BYTES:
        return None
    content = path.read_bytes()
    return content if media_type(content) == "image/png" else None


def _map(path: Path, shape: tuple[int, ...]) -> NDArray[Any] | None:
    """Read a number for each pixel of each view, [N, H, W]; None if the folder has no such file."""
    return _array_of_shape(path, shape[:3]) if path.is_file() else None


def _given(path: Path, shape: tuple[int, ...]) -> dict[str, Any]:
    if not path.is_file():
        return {}
    with zipfile.ZipFile(path) as archive:
        claimed = sum(entry.file_size for entry in archive.infolist())
    if claimed > LIMIT_BYTES:
        raise StorageError(f"{path} claims {claimed} bytes", allowed=f"at most {LIMIT_BYTES}")
    found: dict[str, Any] = {}
    with np.load(path, allow_pickle=False) as arrays:
        for name, wanted in (("measurement", shape[1:3]), ("true_views", shape[:3])):
            if name in arrays:
                found[name] = _pictures(path, name, arrays[name], wanted)
        for name in ("true_world_to_camera", "stage_world_to_camera"):
            if name in arrays:
                poses = _poses(path, arrays[name], shape[0])
                # The geometry uses none of a stage that are no rigid motions, and there are no cameras to draw.
                found[name] = poses if are_rigid(poses) else None
    return found


def _array(path: Path, axes: int) -> NDArray[Any]:
    """Map an array; a header that claims more data than the file has is refused before memory is allocated."""
    array: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
    if array.dtype.kind != "f" or array.ndim != axes or math.prod(array.shape) * array.itemsize > LIMIT_BYTES * 4:
        raise _contradiction(path, array.shape, f"{axes} axes of floating-point numbers")
    return array


def _array_of_shape(path: Path, shape: tuple[int, ...]) -> NDArray[Any]:
    array = _array(path, axes=len(shape))
    if array.shape != shape:
        raise _contradiction(path, array.shape, str(list(shape)))
    return array


def _pictures(path: Path, name: str, array: NDArray[Any], wanted: tuple[int, ...]) -> U8:
    if array.dtype != np.uint8 or array.shape[:-1] != wanted or array.shape[-1] not in (1, 3):
        raise _contradiction(path, array.shape, f"{name}: {list(wanted)} with 1 or 3 channels, uint8")
    return array


def _poses(path: Path, poses: NDArray[Any], count: int) -> F64:
    if poses.shape != (count, 4, 4) or not np.isfinite(poses).all():
        raise _contradiction(path, poses.shape, f"[{count}, 4, 4], finite")
    return np.asarray(poses, np.float64)


def _positive(path: Path, value: Any) -> float:
    if not isinstance(value, int | float) or not 0 < value < math.inf:
        raise StorageError(
            f"{path} has a focal length of {value!r}", allowed="a number above 0", remedy="reconstruct again"
        )
    return float(value)


def _contradiction(path: Path, shape: tuple[int, ...], allowed: str) -> StorageError:
    return StorageError(
        f"{path} has shape {list(shape)}, or holds numbers that are none", allowed=allowed, remedy="reconstruct again"
    )
