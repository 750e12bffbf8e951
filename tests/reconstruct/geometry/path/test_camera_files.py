import json

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import InputError
from gs2ci.evaluate.cameras import nerfstudio_transforms, write_colmap_model
from gs2ci.reconstruct.geometry.path.camera_files import read_cameras

SIZE = (60, 80)
CAMERA = np.array([[70.0, 0, 41], [0, 72, 29], [0, 0, 1]])


def poses(count):
    rng = np.random.default_rng(count)
    made = np.tile(np.eye(4), (count, 1, 1))
    made[:, :3, :3] = Rotation.random(count, random_state=count).as_matrix()
    made[:, :3, 3] = rng.normal(size=(count, 3))
    return made


def transforms(folder, count=12, **changed):
    path = folder / "transforms.json"
    path.write_text(json.dumps({**nerfstudio_transforms(poses(count), CAMERA, SIZE), **changed}))
    return path


def test_cameras_that_we_wrote_come_back(tmp_path):
    found = read_cameras(transforms(tmp_path), 12, SIZE)
    np.testing.assert_allclose(found.world_to_camera, poses(12), atol=1e-12)
    np.testing.assert_allclose(found.intrinsics, CAMERA)
    assert found.points.shape == (0, 3)


def test_a_colmap_model_comes_back_with_its_points(tmp_path):
    points = np.random.default_rng(0).normal(size=(7, 3)).astype(np.float32)
    write_colmap_model(tmp_path, poses(12), CAMERA, SIZE, points=points, colors=np.zeros((7, 3), np.float32))
    found = read_cameras(tmp_path, 12, SIZE)
    np.testing.assert_allclose(found.world_to_camera, poses(12), atol=1e-12)
    np.testing.assert_allclose(found.intrinsics, CAMERA)
    np.testing.assert_allclose(np.sort(found.points, axis=0), np.sort(points, axis=0), atol=1e-6)


def test_views_follow_the_numbers_in_their_names_not_their_place_in_the_file(tmp_path):
    held = nerfstudio_transforms(poses(12), CAMERA, SIZE)
    for i, frame in enumerate(held["frames"]):
        frame["file_path"] = f"view_{i}.png"
    held["frames"] = held["frames"][::-1]
    found = read_cameras(transforms(tmp_path, frames=held["frames"]), 12, SIZE)
    np.testing.assert_allclose(found.world_to_camera, poses(12), atol=1e-12)
    assert found.names[:3] == ("view_0.png", "view_1.png", "view_2.png")


def test_cameras_of_larger_pictures_are_scaled(tmp_path):
    found = read_cameras(transforms(tmp_path, w=160, h=120), 12, SIZE)
    np.testing.assert_allclose(found.intrinsics, np.diag([0.5, 0.5, 1]) @ CAMERA)


def test_a_field_of_view_is_as_good_as_a_focal_length(tmp_path):
    path = transforms(tmp_path)
    held = json.loads(path.read_text())
    for key in ("fl_x", "fl_y", "cx", "cy"):
        del held[key]
    path.write_text(json.dumps({**held, "camera_angle_x": float(2 * np.arctan(40 / 70))}))
    np.testing.assert_allclose(read_cameras(path, 12, SIZE).intrinsics, [[70, 0, 40], [0, 70, 30], [0, 0, 1]])


LENS = np.array([-0.2, 0.03, 1e-3, -2e-3, 0.01])


def test_the_lens_that_is_known_comes_back_from_both_formats(tmp_path):
    held = nerfstudio_transforms(poses(12), CAMERA, SIZE, LENS)
    found = read_cameras(transforms(tmp_path, **held), 12, SIZE, LENS)
    np.testing.assert_allclose(found.distortion[:5], LENS)
    model, nothing = tmp_path / "model", np.zeros((0, 3), np.float32)
    model.mkdir()
    write_colmap_model(model, poses(12), CAMERA, SIZE, points=nothing, colors=nothing, distortion=LENS)
    found = read_cameras(model, 12, SIZE, LENS)
    np.testing.assert_allclose(found.distortion, [*LENS, 0, 0, 0])
    np.testing.assert_allclose(found.intrinsics, CAMERA)
    for path in (transforms(tmp_path, **held), model):
        for known in (None, 1.1 * LENS):
            with pytest.raises(InputError, match=r"distorted camera \(k1, k2, p1, p2, k3\)"):
                read_cameras(path, 12, SIZE, known)


def test_a_lens_of_four_coefficients_is_one_of_five(tmp_path):
    model = colmap(tmp_path, "OPENCV", [70, 72, 41, 29, *LENS[:4]])
    known = np.append(LENS[:4], 0.0)
    np.testing.assert_allclose(read_cameras(model, 2, SIZE, known).distortion[:5], known)


def test_undistorted_pictures_are_taken_whatever_the_lens(tmp_path):
    assert not read_cameras(transforms(tmp_path), 12, SIZE, LENS).distortion.any()


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        ({"frames": []}, "holds 0 cameras for 12 views"),
        ({"w": 60, "h": 80}, "is of pictures of 80 x 60 pixels"),
        ({"k1": 0.1}, r"distorted camera \(k1\)"),
        ({"k4": 0.1}, r"distorted camera \(k4\)"),
        ({"camera_model": "EQUIRECTANGULAR"}, "holds a EQUIRECTANGULAR camera"),
        ({"camera_model": "OPENCV_FISHEYE"}, "holds a OPENCV_FISHEYE camera"),
        ({"fl_x": "wide"}, "is not a transforms.json"),
        ({"frames": [{"file_path": "a.png"}]}, "is not a transforms.json: KeyError"),
        ({"frames": 3}, "is not a transforms.json"),
        ({"fl_x": -1.0}, "intrinsics"),
    ],
)
def test_a_file_that_does_not_fit_is_named(tmp_path, changed, problem):
    with pytest.raises(InputError, match=problem):
        read_cameras(transforms(tmp_path, **changed), 12, SIZE)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda m: m * 2,
        lambda m: m * [[-1], [1], [1], [1]],
        lambda m: m * np.nan,
        lambda m: m * [[1], [1], [1], [2]],  # a last row of 0 0 0 2
        lambda m: m + np.outer([1, 1, 1, 0], [0, 0, 0, 1e13]),  # that far away, float32 has no digits for the scene
    ],
)
def test_matrices_that_are_no_rigid_motions_are_refused(tmp_path, spoil):
    held = nerfstudio_transforms(poses(2), CAMERA, SIZE)
    frame = held["frames"][1]
    frame["transform_matrix"] = np.asarray(spoil(np.array(frame["transform_matrix"]))).tolist()
    with pytest.raises(InputError, match="not rigid motions"):
        read_cameras(transforms(tmp_path, frames=held["frames"]), 2, SIZE)


def test_a_file_that_is_not_there_or_no_model_is_named(tmp_path):
    with pytest.raises(InputError, match="no camera file"):
        read_cameras(tmp_path / "absent", 2, SIZE)
    with pytest.raises(InputError, match="is not a COLMAP model"):
        read_cameras(tmp_path, 2, SIZE)
    (tmp_path / "notes.json").write_text("no json")
    with pytest.raises(InputError, match=r"is not a transforms\.json"):
        read_cameras(tmp_path / "notes.json", 2, SIZE)


def colmap(folder, model, params, cameras=1):
    made = pycolmap.Reconstruction()
    for camera in range(1, cameras + 1):
        made.add_camera_with_trivial_rig(
            pycolmap.Camera(camera_id=camera, model=model, width=SIZE[1], height=SIZE[0], params=params)
        )
    for i, pose in enumerate(poses(2)):
        image = pycolmap.Image(name=f"{i}.png", camera_id=1 + i % cameras, image_id=i + 1)
        made.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    made.write_binary(folder)
    return folder


def test_one_focal_length_for_both_axes_is_a_pinhole(tmp_path):
    found = read_cameras(colmap(tmp_path, "SIMPLE_PINHOLE", [70, 41, 29]), 2, SIZE)
    np.testing.assert_allclose(found.intrinsics, [[70, 0, 41], [0, 70, 29], [0, 0, 1]])


def test_distorted_and_several_cameras_are_refused(tmp_path):
    with pytest.raises(InputError, match="SIMPLE_RADIAL"):
        read_cameras(colmap(tmp_path, "SIMPLE_RADIAL", [70, 41, 29, 0.1]), 2, SIZE)
    with pytest.raises(InputError, match="holds 2 cameras"):
        read_cameras(colmap(tmp_path, "SIMPLE_PINHOLE", [70, 41, 29], cameras=2), 2, SIZE)


def frames_of(count=12, **each):
    """Frames as Polycam and ns-process-data write them: with the camera in each."""
    held = nerfstudio_transforms(poses(count), CAMERA, SIZE)
    camera = {key: held[key] for key in ("w", "h", "fl_x", "fl_y", "cx", "cy")}
    return [{**frame, **camera, **each} for frame in held["frames"]]


def bare(folder, frames, **common):
    path = folder / "transforms.json"
    path.write_text(json.dumps({"frames": frames, **common}))
    return path


def test_a_camera_that_is_written_in_each_frame_is_read(tmp_path):
    """F9: "not a transforms.json: KeyError"."""
    found = read_cameras(bare(tmp_path, frames_of()), 12, SIZE)
    np.testing.assert_allclose(found.world_to_camera, poses(12), atol=1e-12)
    np.testing.assert_allclose(found.intrinsics, CAMERA)


def test_the_camera_of_a_frame_counts_before_that_of_the_file(tmp_path):
    found = read_cameras(bare(tmp_path, frames_of(), fl_x=1.0, cx=3.0), 12, SIZE)
    np.testing.assert_allclose(found.intrinsics, CAMERA)


@pytest.mark.parametrize("change", [{"fl_x": 71.0}, {"camera_model": "OPENCV"}, {"k1": 0.1}])
def test_frames_of_different_cameras_are_refused(tmp_path, change):
    frames = frames_of()
    frames[5].update(change)
    with pytest.raises(InputError, match=r"frames of different cameras \((fl_x|camera_model|k1)"):
        read_cameras(bare(tmp_path, frames), 12, SIZE)


def test_matrices_without_their_last_row_are_whole(tmp_path):
    """F9: "not rigid"."""
    frames = frames_of()
    for frame in frames:
        frame["transform_matrix"] = frame["transform_matrix"][:3]
    np.testing.assert_allclose(read_cameras(bare(tmp_path, frames), 12, SIZE).world_to_camera, poses(12), atol=1e-12)


@pytest.mark.parametrize("where", ["file", "frames"])
def test_a_fisheye_is_refused_whatever_its_coefficients(tmp_path, where):
    """F9: taken as a pinhole."""
    frames = frames_of(is_fisheye=True) if where == "frames" else frames_of()
    path = bare(tmp_path, frames, **({"is_fisheye": True} if where == "file" else {}))
    with pytest.raises(InputError, match="holds a fisheye camera"):
        read_cameras(path, 12, SIZE)
    assert len(read_cameras(bare(tmp_path, frames_of(is_fisheye=False)), 12, SIZE).names) == 12


@pytest.mark.parametrize(
    "names", [[f"z_{k}mm.png" for k in range(-6, 6)], [f"images/{k / 4}mm.png" for k in range(-6, 6)]]
)
def test_positions_in_names_have_signs_and_points(tmp_path, names):
    """F6: order 4 5 6 7 3 2 1 0."""
    frames = frames_of()
    for frame, name in zip(frames, names, strict=True):
        frame["file_path"] = name
    found = read_cameras(bare(tmp_path, frames[::-1]), 12, SIZE)
    assert found.names == tuple(names)
    np.testing.assert_allclose(found.world_to_camera, poses(12), atol=1e-12)


def test_an_order_that_depends_on_how_a_point_is_read_is_refused(tmp_path):
    frames = frames_of()
    for k, frame in enumerate(frames):
        frame["file_path"] = f"run1.{k}.png"
    with pytest.raises(InputError, match="the order of its pictures is doubtful"):
        read_cameras(bare(tmp_path, frames), 12, SIZE)
