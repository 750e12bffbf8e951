"""Cameras as other programs read them: transforms.json of nerfstudio and of instant-ngp, and a COLMAP model.

All name the pictures in the run folder's `views/`. Not here: images, Gaussians.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.cameras import OPENCV_FROM_OPENGL, camera_centres
from gs2ci.core.colmap import pycolmap
from gs2ci.core.errors import StorageError
from gs2ci.core.lens import COEFFICIENTS
from gs2ci.evaluate.points import SAME_SURFACE, Cameras
from gs2ci.evaluate.whole_folder import view_names

CAMERA_ID: Final = 1
_POINTS_NAME: Final = "points3D.bin"
# Without observations a point takes: number, x y z, colour, error, length of its track (COLMAP's scripts/python/
# read_write_model.py); before all of them their count.
_POINT_BYTES: Final = 8 + 3 * 8 + 3 + 8 + 8
_OBSERVATION_BYTES: Final = 4 + 4
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
) -> None:
    """Write a sparse COLMAP model (binary) of one camera, N images and a cloud, with tracks where depth is known.

    Args:
        folder: An existing folder; usually `colmap/sparse/0`.
        world_to_camera: [N, 4, 4], OpenCV axes (COLMAP's own).
        intrinsics: [3, 3], pixels.
        size: Height and width.
        points: [P, 3], scene units.
        colors: [P, 3], clamped to [0, 1].
        distortion: As for `nerfstudio_transforms`; with it the camera is a FULL_OPENCV one, otherwise a PINHOLE.
        depth: Of each view, [N, H, W], 0 where it is not known. Views in whose depth a point lies observe it; programs
            for dense stereo choose their pairs of pictures by such tracks. None writes none.

    Raises:
        StorageError: The disk refuses.
    """
    pixels, seen = _observed(Cameras(world_to_camera, intrinsics, distortion), points.astype(np.float64), size, depth)
    # The last three parameters of FULL_OPENCV are k4 k5 k6, the denominator of a rational model.
    bent = [] if distortion is None else [*distortion, 0.0, 0.0, 0.0]
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(
            camera_id=CAMERA_ID,
            model="PINHOLE" if distortion is None else "FULL_OPENCV",
            width=size[1],
            height=size[0],
            params=[intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2], *bent],
        )
    )
    for image_id, (name, pose) in enumerate(
        zip(view_names(len(world_to_camera)), world_to_camera, strict=True), start=1
    ):
        own = pixels[image_id - 1][seen[image_id - 1]]
        image = pycolmap.Image(name=name, camera_id=CAMERA_ID, image_id=image_id, keypoints=own)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    _add_points(model, points.astype(np.float64), np.round(255 * np.clip(colors, 0, 1)).astype(np.uint8), seen)
    model.update_point_3d_errors()
    model.write_binary(folder)
    # pycolmap does not say that the disk has refused; the points are written last.
    wanted = 8 + _POINT_BYTES * len(points) + _OBSERVATION_BYTES * int(seen.sum())
    if (folder / _POINTS_NAME).stat().st_size != wanted:
        raise StorageError(
            f"{folder / _POINTS_NAME} cannot be written: not all of its {len(points)} points are in it",
            remedy="check the free space and the permissions",
        )


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


def _add_points(model: Any, points: F64, colors: Sequence[Any] | Any, seen: Bool) -> None:
    # A view's observations are numbered in the order of the points.
    numbers = np.cumsum(seen, axis=1) - 1
    for index, (point, color) in enumerate(zip(points, colors, strict=True)):
        track = pycolmap.Track()
        for view in np.flatnonzero(seen[:, index]):
            track.add_element(int(view) + 1, int(numbers[view, index]))
        model.add_point3D(point, track, color)
