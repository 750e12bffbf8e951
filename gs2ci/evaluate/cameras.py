"""Cameras as other programs read them: nerfstudio's transforms.json and a COLMAP model.

Both name the pictures in the run folder's `views/`. Not here: images, Gaussians.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.cameras import OPENCV_FROM_OPENGL
from gs2ci.core.colmap import pycolmap
from gs2ci.core.errors import StorageError
from gs2ci.core.lens import COEFFICIENTS
from gs2ci.evaluate.whole_folder import view_names

CAMERA_ID: Final = 1
_POINTS_NAME: Final = "points3D.bin"
# A point without observations: number, x y z, colour, error, length of its track (COLMAP's scripts/python/
# read_write_model.py); before all of them their count.
_POINT_BYTES: Final = 8 + 3 * 8 + 3 + 8 + 8


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
) -> None:
    """Write a sparse COLMAP model (binary) of one camera, N images and a cloud without observations.

    Args:
        folder: An existing folder; usually `colmap/sparse/0`.
        world_to_camera: [N, 4, 4], OpenCV axes (COLMAP's own).
        intrinsics: [3, 3], pixels.
        size: Height and width.
        points: [P, 3], scene units.
        colors: [P, 3], clamped to [0, 1].
        distortion: As for `nerfstudio_transforms`; with it the camera is a FULL_OPENCV one, otherwise a PINHOLE.

    Raises:
        StorageError: The disk refuses.
    """
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
        model.add_image_with_trivial_frame(
            pycolmap.Image(name=name, camera_id=CAMERA_ID, image_id=image_id), pycolmap.Rigid3d(pose[:3])
        )
    _add_points(model, points.astype(np.float64), np.round(255 * np.clip(colors, 0, 1)).astype(np.uint8))
    model.write_binary(folder)
    # pycolmap does not say that the disk has refused; the points are written last.
    if (folder / _POINTS_NAME).stat().st_size != 8 + _POINT_BYTES * len(points):
        raise StorageError(
            f"{folder / _POINTS_NAME} cannot be written: not all of its {len(points)} points are in it",
            remedy="check the free space and the permissions",
        )


def _add_points(model: Any, points: F64, colors: Sequence[Any] | Any) -> None:
    for point, color in zip(points, colors, strict=True):
        model.add_point3D(point, pycolmap.Track(), color)
