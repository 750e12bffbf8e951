"""Cameras as other programs read them: transforms.json of nerfstudio and of instant-ngp, and a COLMAP model.

All name the pictures in the run folder's `views/`. Not here: images, Gaussians.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.cameras import OPENCV_FROM_OPENGL, SAME_SURFACE, camera_centres
from gs2ci.core.lens import COEFFICIENTS
from gs2ci.core.whole_file import write_whole
from gs2ci.evaluate.points import Cameras
from gs2ci.evaluate.whole_folder import view_names

# COLMAP's binary files (its documentation, "Output Format"): numbers without padding, least byte first.
# Each model with how many of OpenCV's coefficients it has; programs that read COLMAP's models often stop at the last.
_MODELS: Final = {0: 1, 4: 4, 8: 6}
_CAMERA: Final = np.dtype([("id", "<i4"), ("model", "<i4"), ("width", "<u8"), ("height", "<u8")])
_CAMERA_ID: Final = 1
_IMAGE: Final = np.dtype([("id", "<u4"), ("turn", "<f8", 4), ("shift", "<f8", 3), ("camera", "<u4")])
_OBSERVED: Final = np.dtype([("pixel", "<f8", 2), ("point", "<i8")])
_POINT: Final = np.dtype([("id", "<u8"), ("place", "<f8", 3), ("colour", "u1", 3), ("error", "<f8"), ("views", "<u8")])
_SIGHTING: Final = np.dtype([("image", "<u4"), ("index", "<u4")])
# One view of so many is left to judge by.
_EVERY: Final = 8
# instant-ngp's box: its unit cube holds what lies between these quantiles, filled to this share.
_INNER: Final = (0.02, 0.98)
_FILLED: Final = 0.9
_BOXES: Final = tuple(2**k for k in range(8))


def nerfstudio_transforms(
    world_to_camera: F64, intrinsics: F64, size: tuple[int, int], distortion: F64 | None = None
) -> dict[str, Any]:
    """Describe cameras as nerfstudio's `transforms.json` does: OpenGL camera-to-world, pixel centres at +0.5.

    Args:
        world_to_camera: [N, 4, 4], OpenCV axes.
        intrinsics: [3, 3], pixels; without skew.
        size: Height and width.
        distortion: Distortion of the views, OpenCV's k1 k2 p1 p2 k3; None for a pinhole.
    """
    bent = np.zeros(len(COEFFICIENTS)) if distortion is None else distortion
    coefficients = {name: float(value) for name, value in zip(COEFFICIENTS, bent, strict=True)}
    camera_to_world = np.linalg.inv(world_to_camera) @ OPENCV_FROM_OPENGL
    return {
        "camera_model": "OPENCV",
        "fl_x": float(intrinsics[0, 0]),
        "fl_y": float(intrinsics[1, 1]),
        "cx": float(intrinsics[0, 2]),
        "cy": float(intrinsics[1, 2]),
        "w": size[1],
        "h": size[0],
        **coefficients,
        "frames": [
            {"file_path": f"views/{name}", "transform_matrix": pose.tolist()}
            for name, pose in zip(view_names(len(camera_to_world)), camera_to_world, strict=True)
        ],
    }


def split_of(files: Sequence[str]) -> dict[str, list[str]]:
    """Say which pictures nerfstudio trains with and which it judges by: one of eight, and of fewer the middle one.

    Its own split has no picture to judge by where there are fewer than ten, and stops with a ValueError.
    """
    judged = [name for index, name in enumerate(files) if index % _EVERY == min(_EVERY, len(files)) // 2]
    trained = [name for name in files if name not in judged] or list(files)
    return {"train_filenames": trained, "val_filenames": judged, "test_filenames": judged}


def ngp_box(points: F64, world_to_camera: F64) -> dict[str, Any]:
    """Return what places a scene in instant-ngp's box: `scale`, `offset` and `aabb_scale`.

    It multiplies places by the scale and adds the offset, turns the axes in a circle, and traces rays within a cube of
    side `aabb_scale` round (½, ½, ½). Its own defaults are for scenes of a few units round the origin.

    Args:
        points: On the surfaces, [P, 3]; may be none.
        world_to_camera: [N, 4, 4].
    """
    eyes = camera_centres(world_to_camera)
    known = np.concatenate([points, eyes])
    inner = np.concatenate([np.quantile(points, _INNER, axis=0), eyes]) if len(points) else eyes
    low, high = inner.min(axis=0), inner.max(axis=0)
    size, middle = float((high - low).max()), (low + high) / 2
    scale = _FILLED / size if size > 0 else 1.0
    reach = 2 * scale * float(np.abs(known - middle).max())
    box = next((one for one in _BOXES if one >= reach), _BOXES[-1])
    return {"scale": scale, "offset": (0.5 - scale * middle).tolist(), "aabb_scale": box}


def poses_of_transforms(transforms: dict[str, Any]) -> F64:
    """Read the poses back from the output of `nerfstudio_transforms`: world-to-camera, [N, 4, 4], OpenCV axes.

    Raises:
        KeyError, ValueError, LinAlgError: It has another content.
    """
    frames = [np.asarray(frame["transform_matrix"], np.float64) for frame in transforms["frames"]]
    return np.asarray(np.linalg.inv(np.stack(frames) @ OPENCV_FROM_OPENGL), np.float64)


def write_colmap_model(
    folder: Path,
    world_to_camera: F64,
    intrinsics: F64,
    size: tuple[int, int],
    *,
    points: F32,
    colors: F32,
    distortion: F64 | None = None,
    depth: F32 | None = None,
    views: F32 | None = None,
) -> None:
    """Write a sparse COLMAP model (binary) of one camera, N images and a cloud, with tracks where depth is known.

    Args:
        folder: An existing folder; usually `colmap/sparse/0`.
        world_to_camera: [N, 4, 4], OpenCV axes (COLMAP's own).
        intrinsics: [3, 3], pixels.
        size: Height and width.
        points: [P, 3], scene units.
        colors: [P, 3], clamped to [0, 1].
        distortion: As for `nerfstudio_transforms`; with it the camera is an OPENCV one, with a k3 a FULL_OPENCV one,
            otherwise a PINHOLE.
        depth: Of each view, [N, H, W], 0 where it is not known. Views in whose depth a point lies observe it; programs
            for dense stereo choose their pairs of pictures by such tracks. None writes none.
        views: [N, H, W, 1 or 3]: points that they observe have the mean of what they show there, as COLMAP's have.

    Raises:
        StorageError: The disk refuses.

    Written here and not by pycolmap, of which there is none for Linux on ARM; tests read it with pycolmap.
    """
    pixels, seen = _observed(Cameras(world_to_camera, intrinsics, distortion), points.astype(np.float64), size, depth)
    if views is not None:
        colors = _as_seen(views, pixels, seen, colors)
    # The last three parameters of FULL_OPENCV are k4 k5 k6, the denominator of a rational model.
    bent = np.trim_zeros([] if distortion is None else [*distortion], "b")
    known = next(number for number in _MODELS if number >= len(bent))
    lens = [intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2], *bent, *[0.0] * (known - len(bent))]
    camera = np.array((_CAMERA_ID, _MODELS[known], size[1], size[0]), _CAMERA)
    files = {
        "cameras.bin": [_count(1), camera.tobytes(), np.array(lens, "<f8").tobytes()],
        "images.bin": [_count(len(world_to_camera)), *_images(world_to_camera, pixels, seen)],
        "points3D.bin": [_count(len(points)), _points(points, colors, seen)],
    }
    for name, parts in files.items():
        write_whole(folder / name, b"".join(parts))


def _count(number: int) -> bytes:
    return number.to_bytes(8, "little")


def _images(world_to_camera: F64, pixels: F64, seen: Bool) -> Iterator[bytes]:
    """Encode each view: its pose, its name, and where it observes which points, in their order."""
    turns = Rotation.from_matrix(world_to_camera[:, :3, :3]).as_quat(canonical=True, scalar_first=True)
    names = view_names(len(world_to_camera))
    for number, (name, turn, pose) in enumerate(zip(names, turns, world_to_camera, strict=True)):
        numbers = np.flatnonzero(seen[number])
        observed = np.zeros(len(numbers), _OBSERVED)
        observed["pixel"], observed["point"] = pixels[number, numbers], numbers + 1
        yield np.array((number + 1, turn, pose[:3, 3], _CAMERA_ID), _IMAGE).tobytes() + name.encode() + b"\0"
        yield _count(len(numbers)) + observed.tobytes()


def _as_seen(views: F32, pixels: F64, seen: Bool, colors: F32) -> F32:
    """Return the colours of points, [P, 3]: the mean of the views' where they observe them, as given elsewhere.

    A Gaussian's own colour is none of a surface: others in front of it and behind it make what a view shows.
    """
    view, point = np.nonzero(seen)
    column, row = pixels[view, point].astype(int).T
    total = np.zeros(colors.shape)
    np.add.at(total, point, np.clip(views[view, row, column], 0, 1))
    count = seen.sum(axis=0)[:, None]
    return np.where(count > 0, total / np.maximum(count, 1), colors).astype(np.float32)


def _points(points: F32, colors: F32, seen: Bool) -> bytes:
    """Encode each point and its track: the views that see it, and which of their observations it is."""
    table = np.zeros(len(points), _POINT)
    table["id"], table["place"] = np.arange(len(points)) + 1, points
    table["colour"] = np.round(255 * np.clip(colors, 0, 1))
    # Observations are where the points are projected to: their error is zero.
    table["views"] = seen.sum(axis=0)
    of_point, view = np.nonzero(seen.T)
    tracks = np.zeros(len(view), _SIGHTING)
    tracks["image"], tracks["index"] = view + 1, (np.cumsum(seen, axis=1) - 1)[view, of_point]
    # Each point is followed by its track.
    before = np.concatenate([[0], np.cumsum(table["views"], dtype=np.int64)])
    content = np.empty(table.nbytes + tracks.nbytes, np.uint8)
    for records, places in (
        (table, np.arange(len(table)) * table.itemsize + before[:-1] * tracks.itemsize),
        (tracks, (of_point + 1) * table.itemsize + np.arange(len(tracks)) * tracks.itemsize),
    ):
        bytes_of = records.view(np.uint8).reshape(len(records), records.itemsize)
        content[places[:, None] + np.arange(records.itemsize)] = bytes_of
    return content.tobytes()


def _observed(cameras: Cameras, points: F64, size: tuple[int, int], depth: F32 | None) -> tuple[F64, Bool]:
    """Return where each view sees each point, [N, P, 2] px, and whether it does, [N, P]; two views or none do."""
    count = len(cameras.world_to_camera)
    pixels, seen = np.zeros((count, len(points), 2)), np.zeros((count, len(points)), bool)
    if depth is None or not len(points):
        return pixels, seen
    for view in range(count):
        inside, ahead, pixels[view] = cameras.seen(points, view, size)
        column, row = pixels[view][inside].astype(int).T
        known = depth[view, row, column]
        seen[view, inside] = (known > 0) & (np.abs(ahead[inside] - known) <= SAME_SURFACE * known)
    seen &= seen.sum(axis=0) > 1
    return pixels, seen
