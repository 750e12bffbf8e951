"""Cameras from another program: a COLMAP model, nerfstudio's transforms.json; without poses, a calibration by OpenCV.

Here: reading them, as world-to-camera matrices with OpenCV axes in the order of the file names. Not here: writing
(`gs2ci.evaluate.cameras`), the geometry from them (`gs2ci.reconstruct.geometry.sources`), matrices alone (`camera`).

Both formats list pictures by name in any order; a coded measurement numbers its views. So views are taken in the
natural order of the names: view_2 before view_10, z_-1 before z_0.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import OPENCV_FROM_OPENGL, rigid
from gs2ci.core.errors import GeometryError, InputError
from gs2ci.core.foreign.camera import FEWEST_COEFFICIENTS
from gs2ci.core.foreign.container import Container, damage_as_input_error
from gs2ci.core.foreign.roles import names_of
from gs2ci.core.json_text import parse_json
from gs2ci.core.lens import COEFFICIENTS
from gs2ci.core.natural_order import natural_order
from gs2ci.core.records import are_rigid, check_intrinsics

_PINHOLES: Final = ("PINHOLE", "SIMPLE_PINHOLE")
# In COLMAP's order of parameters after the camera matrix, which is OpenCV's.
_LENSES: Final = {"SIMPLE_RADIAL": 1, "RADIAL": 2, "OPENCV": 4, "FULL_OPENCV": 8}
_MORE_COEFFICIENTS: Final = ("k4", "k5", "k6")
# Those models of a transforms.json that nerfstudio treats as a perspective with the lens of its coefficients
# (`CAMERA_MODEL_TO_TYPE` in nerfstudio/cameras/cameras.py).
_PERSPECTIVES: Final = (*_PINHOLES, "SIMPLE_RADIAL", "RADIAL", "OPENCV")
_OF_THE_CAMERA: Final = (
    *("camera_model", "is_fisheye", "w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x"),
    *COEFFICIENTS,
    *_MORE_COEFFICIENTS,
)
# Focal lengths written for each frame of one camera agree as closely as this; a phone's focus moves them by more.
_CAMERA_TOLERANCE: Final = 1e-4
# The coefficients of one lens agree up to the digits that a text file keeps.
_COEFFICIENT_TOLERANCE: Final = 1e-5
# OpenCV's files, in which ROS keeps its calibrations as well.
_CALIBRATIONS: Final = (".yml", ".yaml", ".xml")
_SIZES: Final = ("resolution", "cameraresolution", "imagesize", "imgsize", "framesize")
_OF_A_MODEL: Final = ("cameras.txt", "cameras.bin", "images.txt", "images.bin")
HALF_A_PIXEL: Final = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
_ALLOWED: Final = "the folder of a COLMAP model (cameras, images, points3D), or a transforms.json"
# Aspect ratios of a sensor and of its reduced pictures agree up to rounding to whole pixels.
_ASPECT_TOLERANCE: Final = 0.02


@dataclass(frozen=True)
class CameraFile:
    """Cameras read from a file.

    Args:
        world_to_camera: [N, 4, 4], OpenCV axes, in the order of the names.
        intrinsics: One camera matrix for all, [3, 3], in pixels of the measurement.
        distortion: Of their lens: k1 k2 p1 p2 k3 and more, [4 and more]; zeros for a pinhole.
        points: Of the scene, [P, 3]; P is 0 if the file has none.
        names: Of the pictures, in that order.
    """

    world_to_camera: F64
    intrinsics: F64
    distortion: F64
    points: F64
    names: tuple[str, ...]


def is_camera_file(path: Path) -> bool:
    """Tell whether a path may be a camera file by its name, not one of arrays."""
    return path.is_dir() or path.name in _OF_A_MODEL or path.suffix.lower() in (".json", *_CALIBRATIONS)


def read_poses(path: Path) -> F64:
    """Return the world-to-camera poses, [N, 4, 4], of a COLMAP model's folder or a transforms.json.

    Raises:
        InputError: It is none, or has none.
    """
    found = read_calibration(path, None)
    if not len(found.world_to_camera):
        raise InputError(f"{path} holds no poses", allowed=_ALLOWED)
    return found.world_to_camera


def read_calibration(path: Path, size: tuple[int, int] | None) -> CameraFile:
    """Read the camera of a file, with whatever poses it has.

    Args:
        path: A COLMAP model's folder or its project's, a transforms.json, or a calibration in OpenCV's or ROS's form.
        size: Height and width of the measurement, px; a camera of pictures of another size is scaled. None: it is not.

    Raises:
        InputError: No such file, it cannot be read, it holds several cameras or one of another kind.
    """
    if path.name in _OF_A_MODEL:
        path = path.parent
    if path.is_dir():
        inner = (path / one for one in ("", "sparse/0", "0", "sparse"))
        found = _colmap(next((one for one in inner if any((one / n).is_file() for n in _OF_A_MODEL)), path), size)
    elif not path.is_file():
        raise InputError(f"no camera file {path}", allowed=_ALLOWED)
    elif path.suffix.lower() in _CALIBRATIONS or b'"frames"' not in path.read_bytes():
        found = _calibration(path, size)
    else:
        found = _transforms(path, size)
    return found


def read_cameras(path: Path, views: int, size: tuple[int, int], distortion: F64 | None = None) -> CameraFile:
    """Read cameras for a measurement.

    Args:
        path: A COLMAP model's folder, or a transforms.json.
        views: How many there must be.
        size: Height and width of the measurement, px; cameras of pictures of another size are scaled.
        distortion: Known coefficients of the lens, [5]; None: a pinhole.

    Raises:
        InputError: No such file, it cannot be read, it holds another number of cameras, several, cameras with another
            distortion than the known one or none, or pictures of another shape.
    """
    found = read_calibration(path, size)
    if len(found.names) != views:
        raise InputError(
            f"{path} holds {len(found.names)} cameras for {views} views",
            allowed=f"{views} cameras, one for each mask, named in the order of exposure",
        )
    _check_lens(path, found.distortion, distortion)
    check_intrinsics(found.intrinsics)
    if not are_rigid(found.world_to_camera):
        raise InputError(f"{path} holds poses that are not rigid motions", remedy="check its matrices")
    return found


def _check_lens(path: Path, found: F64, known: F64 | None) -> None:
    """Accept a pinhole, for undistorted pictures, and the known lens; refuse any other."""
    expected = np.zeros(len(found)) if known is None else np.pad(known, (0, len(found) - len(known)))
    if not found.any() or np.allclose(found, expected, rtol=0, atol=_COEFFICIENT_TOLERANCE):
        return
    names = [name for name, value in zip((*COEFFICIENTS, *_MORE_COEFFICIENTS), found, strict=True) if value]
    raise InputError(
        f"{path} holds a distorted camera ({', '.join(names)})",
        allowed="a pinhole camera, or the lens that the shot is known to have",
        remedy="undistort the pictures and their cameras first, or import the shot with its distortion",
    )


def _calibration(path: Path, size: tuple[int, int] | None) -> CameraFile:
    """Read a matrix, the coefficients and the size of the pictures, under whatever names programs give them."""
    # A bench reads its patterns from arrays, without OpenCV.
    import cv2  # noqa: PLC0415

    numbers: dict[str, F64] = {}
    models: list[str] = []

    def collect(name: str, node: Any) -> None:
        named = {key: node.getNode(key) for key in node.keys()} if node.isMap() else {}  # noqa: SIM118 - no dictionary
        if node.isString() and name == "distortion_model":
            models.append(node.string())
        for key, part in named.items():
            collect(name if key == "data" else key, part)
        items = flat(node) if not named else []
        if items and all(item.isReal() or item.isInt() for item in items):
            values = np.array([item.real() for item in items])
            by_columns = len(values) == 9 and (values[2::3] == (0, 0, 1)).all()  # as Open3D and ARKit write
            numbers[name] = values.reshape(3, 3).T.ravel() if by_columns else values

    def flat(node: Any) -> list[Any]:
        return [one for k in range(node.size()) for one in flat(node.at(k))] if node.isSeq() else [node]

    try:
        told, flags = str(path), cv2.FILE_STORAGE_READ
        if path.suffix.lower() != ".xml" and path.suffix.lower() in _CALIBRATIONS:
            # PyYAML, with which Kalibr writes, does not indent lists, and breaks long ones; OpenCV stops at both.
            told = re.sub(r"(?m)^( *)(?=- )", r"\1  ", re.sub(r",\s+", ", ", path.read_text(encoding="utf-8-sig")))
            flags |= cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML
        file = cv2.FileStorage(told, flags)  # its nodes die with it
        collect("", file.root())
    except Exception as error:
        # What it raises of files of others, such as Metashape's, says nothing of them.
        raise InputError(
            f"{path} is not a transforms.json, nor a calibration as OpenCV writes it",
            allowed=_ALLOWED,
            remedy="Metashape and RealityCapture export OpenCV's calibrations and COLMAP's models as well",
        ) from error
    # Kalibr and EuRoC write fx fy cx cy.
    if len(four := numbers.get("intrinsics", np.empty(0))) == 4:
        numbers["intrinsics"] = np.array([four[0], 0, four[2], 0, four[1], four[3], 0, 0, 1])
    matrices = {name: n for name, n in numbers.items() if len(n) == 9 and (n[6:] == (0, 0, 1)).all()}
    matrices = {name: n for name, n in matrices.items() if not _is_rotation(n)}
    if len(matrices) != 1:
        raise InputError(
            f"{path} holds {len(matrices)} camera matrices{': ' * bool(matrices)}{', '.join(matrices)}",
            allowed="a calibration of one camera, as OpenCV, ROS and Kalibr write it; for poses " + _ALLOWED,
            remedy="give the matrix as --intrinsics fx fy cx cy, the lens as --distortion, poses as [N, 4, 4] (.npy)",
        )
    for model in models:
        _require_model(path, model, ("plumb_bob", "rational_polynomial", "radtan", "radial-tangential"))
    ((_, matrix),) = matrices.items()
    lenses = [
        n for name, n in numbers.items() if ("dist" in name.lower() or name in "dD") and len(n) >= FEWEST_COEFFICIENTS
    ]
    lens = lenses[0] if lenses else np.zeros(len(COEFFICIENTS))
    sides = [numbers.get(f"image_{side}", numbers.get(side)) for side in ("height", "width")]
    # Width and height in one: Kalibr; OpenCV's interactive calibration; a cv::Size written under the name it often has.
    for name, values in numbers.items():
        if name.lower().replace("_", "") in _SIZES and len(values) == 2:
            sides = list(values[::-1, None])
    have = None if sides[0] is None or sides[1] is None else (int(sides[0][0]), int(sides[1][0]))
    # In OpenCV pixel centres lie at whole numbers.
    centred = matrix.reshape(3, 3) + HALF_A_PIXEL
    return CameraFile(np.empty((0, 4, 4)), _scaled(centred, have, size, path), lens, np.empty((0, 3)), ())


def matlab_camera(container: Container, size: tuple[int, int]) -> CameraFile | None:
    """Read a camera of MATLAB's toolboxes, saved as toStruct(cameraParameters) or toStruct(cameraIntrinsics) give it.

    MATLAB counts pixels from 1, at their centres; before R2022b it has the matrix transposed; its size is [H, W].

    Args:
        container: The file.
        size: Height and width of the measurement, px; a camera of pictures of another size is scaled.

    Returns:
        The camera, without poses; None if the file holds none of that kind.

    Raises:
        InputError: It is of pictures of another shape, or its numbers are not as many as MATLAB writes.
    """
    by_name = names_of(container)

    def numbers(name: str, count: int) -> F64:
        loaded = container.load(by_name[name]).values if name in by_name else np.zeros(count)
        return np.asarray(loaded, np.float64).reshape(-1)

    if "radialdistortion" not in by_name:
        return None
    with damage_as_input_error(str(container.path)):
        if (key := next((name for name in ("k", "intrinsicmatrix") if name in by_name), None)) is not None:
            matrix = numbers(key, 9).reshape(3, 3)
            matrix = matrix if np.array_equal(matrix[2], (0, 0, 1)) else matrix.T
        elif {"focallength", "principalpoint"} <= by_name.keys():
            (fx, fy), (cx, cy) = numbers("focallength", 2), numbers("principalpoint", 2)
            matrix = np.array([[fx, numbers("skew", 1)[0], cx], [0, fy, cy], [0, 0, 1]])
        else:
            return None
        radial, (p1, p2) = numbers("radialdistortion", 2), numbers("tangentialdistortion", 2)
        k1, k2, k3 = np.pad(radial, (0, 3 - len(radial)))
        rows, columns = map(int, numbers("imagesize", 2))
    lens = np.array([k1, k2, p1, p2, k3])
    have = (rows, columns) if rows and columns else None
    scaled = _scaled(matrix - HALF_A_PIXEL, have, size, container.path)
    return CameraFile(np.empty((0, 4, 4)), scaled, lens, np.empty((0, 3)), ())


def _is_rotation(values: F64) -> bool:
    """Tell the matrix of a rectification, which turns about no more than the axis, from that of a camera."""
    return bool(np.allclose(values.reshape(3, 3) @ values.reshape(3, 3).T, np.eye(3)))


def _colmap(folder: Path, size: tuple[int, int] | None) -> CameraFile:
    # It takes a third of a second, which most imports need not wait for.
    from gs2ci.core.colmap import pycolmap  # noqa: PLC0415

    try:
        model = pycolmap.Reconstruction(str(folder))
    except GeometryError as error:
        raise InputError(f"{folder}: {error.problem}", allowed="a transforms.json") from error
    except Exception as error:
        # pycolmap raises whatever its C++ side threw.
        raise InputError(f"{folder} is not a COLMAP model: {str(error).splitlines()[0]}", allowed=_ALLOWED) from error
    stored = [image for image in model.images.values() if image.has_pose]
    images = [stored[index] for index in _order(folder, [image.name for image in stored])]
    cameras = {image.camera_id for image in images}
    if len(cameras) != 1:
        raise InputError(
            f"{folder} holds {len(cameras)} cameras with pictures",
            allowed="one camera for all views",
            remedy="COLMAP's feature_extractor takes one for all with --ImageReader.single_camera 1",
        )
    camera = model.cameras[cameras.pop()]
    _require_model(folder, camera.model_name, (*_PINHOLES, *_LENSES))
    bent = _LENSES.get(camera.model_name, 0)
    lens = np.zeros(len(COEFFICIENTS) + len(_MORE_COEFFICIENTS))
    lens[:bent] = np.asarray(camera.params)[len(camera.params) - bent :]
    matrices = np.array([image.cam_from_world().matrix() for image in images])
    points = np.array([point.xyz for point in model.points3D.values()], np.float64).reshape(-1, 3)
    return CameraFile(
        rigid(matrices[:, :, :3], matrices[:, :, 3]),
        _scaled(camera.calibration_matrix(), (camera.height, camera.width), size, folder),
        lens,
        points,
        tuple(image.name for image in images),
    )


def _transforms(path: Path, size: tuple[int, int] | None) -> CameraFile:
    try:
        held = parse_json(path.read_text())
        stored = list(held["frames"])
        frames = [stored[index] for index in _order(path, [str(frame["file_path"]) for frame in stored])]
        camera_to_world = np.array([_whole(frame["transform_matrix"]) for frame in frames]).reshape(-1, 4, 4)
        common = _common(path, held, frames)
        rows, columns = size or (0, 0)
        width, height = int(common.get("w", columns)), int(common.get("h", rows))
        fx = float(common["fl_x"]) if "fl_x" in common else 0.5 * width / np.tan(0.5 * float(common["camera_angle_x"]))
        matrix = np.array(
            [
                [fx, 0, float(common.get("cx", width / 2))],
                [0, float(common.get("fl_y", fx)), float(common.get("cy", height / 2))],
                [0, 0, 1],
            ]
        )
        lens = np.array([float(common.get(key, 0)) for key in (*COEFFICIENTS, *_MORE_COEFFICIENTS)])
        poses = OPENCV_FROM_OPENGL @ np.linalg.inv(camera_to_world)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, np.linalg.LinAlgError) as error:
        raise InputError(
            f"{path} is not a transforms.json: {type(error).__name__}: {error}",
            allowed="frames with file_path and transform_matrix, and fl_x or camera_angle_x for all or for each",
            remedy="poses without a camera matrix, such as a trajectory, are for `gs2ci import --stage`",
        ) from error
    _require_model(path, common.get("camera_model", _PERSPECTIVES[0]), _PERSPECTIVES)
    if common.get("is_fisheye", False):
        _require_model(path, "fisheye", _PERSPECTIVES)
    names = tuple(str(frame["file_path"]) for frame in frames)
    return CameraFile(poses, _scaled(matrix, (height, width), size, path), lens, np.empty((0, 3)), names)


def _whole(matrix: Any) -> F64:
    """Return a pose as [4, 4]; its last row may be left out, and it may be written column by column, as ARKit does."""
    values = np.array(matrix, np.float64)
    if values.shape == (3, 4):
        values = np.vstack([values, (0, 0, 0, 1)])
    values = values.reshape(4, 4)
    last = (0, 0, 0, 1)
    return values.T if np.array_equal(values[:, 3], last) and not np.array_equal(values[3], last) else values


def _common(path: Path, held: dict[str, Any], frames: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the camera that all frames share, whether it is written once or in each of them.

    Raises:
        InputError: Frames have different cameras.
    """
    common = {}
    for key in _OF_THE_CAMERA:
        values = [frame.get(key, held.get(key)) for frame in frames or [held]]
        known = [value for value in values if value is not None]
        if not known:
            continue
        if len(known) < len(values) or not all(_alike(value, known[0]) for value in known):
            raise InputError(
                f"{path}: frames of different cameras ({key}: {known[0]!r} and others)",
                allowed="one camera for all views",
                remedy="scale and crop pictures and cameras to a common one, or leave the camera file out",
            )
        common[key] = known[0]
    return common


def _alike(one: Any, other: Any) -> bool:
    """Tell whether two values agree up to the digits that a text file keeps and no more."""
    if isinstance(one, str | bool) or isinstance(other, str | bool):
        return bool(one == other)
    return bool(np.isclose(float(one), float(other), rtol=_CAMERA_TOLERANCE, atol=_COEFFICIENT_TOLERANCE))


def _order(path: Path, names: list[str]) -> tuple[int, ...]:
    """Return the order of exposure: that of the numbers in the names.

    Raises:
        InputError: Whole numbers and decimal ones give different orders, or there are none and the file has another.
    """
    order = natural_order(names)
    if len({tuple(re.findall(r"\d+", name)) for name in names}) == 1 and sorted(names) != names:
        raise InputError(
            f"{path}: the order of its pictures is doubtful: their names, such as {names[0]!r}, differ in no number",
            allowed="names with numbers in the order of exposure",
            remedy="rename the pictures in the order of exposure: 000.png, 001.png, ...",
        )
    if order.is_doubtful:
        raise InputError(
            f"{path}: the order of its pictures is doubtful: is {names[order.indices[0]]!r} before "
            f"{names[order.indices[-1]]!r}, by whole numbers or by decimal ones?",
            allowed="names whose numbers are whole, signed, or followed by a unit",
            remedy="rename the pictures in the order of exposure: 000.png, 001.png, ...",
        )
    return order.indices


def _require_model(path: Path, model: str, allowed: tuple[str, ...]) -> None:
    if model not in allowed:
        raise InputError(
            f"{path} holds a {model} camera",
            allowed=" or ".join(allowed),
            remedy="undistort the pictures and their cameras first",
        )


def _scaled(matrix: F64, have: tuple[int, int] | None, want: tuple[int, int] | None, path: Path) -> F64:
    """Scale a camera matrix from pictures of one size to those of another; unknown ones are taken for the same."""
    if have is None or want is None:
        return matrix
    rows, columns = want[0] / max(have[0], 1), want[1] / max(have[1], 1)
    if abs(rows / columns - 1) > _ASPECT_TOLERANCE:
        raise InputError(
            f"{path} is of pictures of {have[0]} x {have[1]} pixels",
            allowed=f"the shape of the measurement, {want[0]} x {want[1]}, at any scale",
            remedy="cropped pictures need the camera matrix of the crop",
        )
    scaled: F64 = np.diag([columns, rows, 1.0]) @ np.asarray(matrix, np.float64)
    return scaled
