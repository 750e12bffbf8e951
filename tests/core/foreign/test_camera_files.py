import json

import cv2
import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

# What reconstructs is not there in the tests of the newest Python (`tests.newest`).
pytest.importorskip("pycolmap", reason="pycolmap is not installed")

from gs2ci.api.shots import import_file
from gs2ci.core.colmap import pycolmap
from gs2ci.core.errors import InputError
from gs2ci.core.foreign.camera_files import is_camera_file, read_calibration, read_cameras, read_poses
from gs2ci.core.lens import distorted
from gs2ci.evaluate.cameras import nerfstudio_transforms, write_colmap_model

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


@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("SIMPLE_RADIAL", [70, 41, 29, 0.1]),
        ("RADIAL", [70, 41, 29, 0.1, -0.05]),
        ("OPENCV", [70, 72, 41, 29, 0.1, -0.05, 0.01, 0.02]),
    ],
)
def test_lenses_of_colmaps_models_bend_rays_as_colmap_does(tmp_path, model, params):
    """SIMPLE_RADIAL is what COLMAP takes by default."""
    found = read_calibration(colmap(tmp_path, model, params), SIZE)
    camera = pycolmap.Camera(model=model, width=SIZE[1], height=SIZE[0], params=params)
    slopes = np.random.default_rng(0).uniform(-0.4, 0.4, (9, 2))
    bent = np.c_[distorted(slopes, found.distortion[:5]), np.ones(9)] @ found.intrinsics.T
    np.testing.assert_allclose(camera.img_from_cam(np.c_[slopes, np.ones(9)]), bent[:, :2])


def test_distorted_and_several_cameras_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"distorted camera \(k1\)"):
        read_cameras(colmap(tmp_path, "SIMPLE_RADIAL", [70, 41, 29, 0.1]), 2, SIZE)
    with pytest.raises(InputError, match="holds a SIMPLE_RADIAL_FISHEYE camera"):
        read_cameras(colmap(tmp_path, "SIMPLE_RADIAL_FISHEYE", [70, 41, 29, 0.1]), 2, SIZE)
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


ROS = """image_width: 160
image_height: 120
camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [140., 0., 81.5, 0., 144., 57.5, 0., 0., 1.]
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: {count}
  data: {lens}
rectification_matrix:
  rows: 3
  cols: 3
  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]
projection_matrix:
  rows: 3
  cols: 4
  data: [140., 0., 81.5, 0., 0., 144., 57.5, 0., 0., 0., 1., 0.]
"""


def ros(folder, lens=(0.1, 0, 0, 0.01, 0), model="plumb_bob"):
    path = folder / "camera.yaml"
    path.write_text(ROS.format(lens=list(lens), count=len(lens), model=model))
    return path


def opencv(folder, ending, **matrices):
    path = folder / f"camera.{ending}"
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, values in matrices.items():
        file.write(name, values)
    file.release()
    return path


def test_a_calibration_of_ros_has_its_pixel_centres_moved_by_half_a_pixel_and_is_scaled(tmp_path):
    found = read_calibration(ros(tmp_path), SIZE)
    np.testing.assert_allclose(found.intrinsics, CAMERA)
    assert found.distortion.tolist() == [0.1, 0, 0, 0.01, 0]
    assert len(found.world_to_camera) == 0
    assert read_calibration(ros(tmp_path), None).intrinsics[0, 2] == 82


@pytest.mark.parametrize("ending", ["yml", "xml"])
def test_a_calibration_of_opencv_is_read_under_any_names(tmp_path, ending):
    path = opencv(tmp_path, ending, mtx=CAMERA, dist=np.array([[0.1, 0, 0, 0]]), error=0.2)
    assert is_camera_file(path)
    found = read_calibration(path, SIZE)
    np.testing.assert_allclose(found.intrinsics - CAMERA, [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    assert found.distortion.tolist() == [0.1, 0, 0, 0]


MESSAGE = (
    "header:\n  frame_id: cam\nheight: {h}\nwidth: {w}\ndistortion_model: plumb_bob\nd: {lens}\n"
    "k: [{0}, 0.0, {2}, 0.0, {1}, {3}, 0.0, 0.0, 1.0]\nr: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]\n"
)
OTHERS = {
    "CameraInfo": MESSAGE,
    "CameraInfo of ROS 1": MESSAGE.replace("\nd:", "\nD:").replace("\nk:", "\nK:").replace("\nr:", "\nR:"),
    "Kalibr": "cam0:\n  camera_model: pinhole\n  distortion_coeffs: {lens}\n  distortion_model: radtan\n"
    "  intrinsics: [{0}, {1}, {2}, {3}]\n  resolution: [{w}, {h}]\n",
    "Kalibr with poses": "cam0:\n  T_cam_imu:\n  - [1.0, 0.0, 0.0,\n    0.0]\n  - [0.0, 1.0, 0.0, 0.0]\n"
    "  distortion_coeffs: {lens}\n  intrinsics: [{0}, {1}, {2}, {3}]\n  resolution: [{w}, {h}]\n",
    "PyYAML": "camera_matrix:\n- - {0}\n  - 0.0\n  - {2}\n- - 0.0\n  - {1}\n  - {3}\n- - 0.0\n  - 0.0\n  - 1.0\n"
    "dist_coeff: {lens}\nimage_width: {w}\nimage_height: {h}\n",
    "EuRoC": "T_BS:\n  cols: 4\n  rows: 1\n  data: [1.0, 0.0, 0.0, 0.0]\nresolution: [{w}, {h}]\n"
    "intrinsics: [{0}, {1}, {2}, {3}]\ndistortion_model: radial-tangential\ndistortion_coefficients: {lens}\n",
    # How cv::FileStorage (OpenCV 5.0) writes a cv::Size; the first name is of OpenCV's interactive calibration.
    **{
        name: "%YAML:1.0\n---\n" + name + ": [ {w}, {h} ]\ncameraMatrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n"
        "   dt: d\n   data: [ {0}, 0., {2}, 0., {1}, {3}, 0., 0., 1. ]\ndist_coeffs: {lens}\n"
        for name in ("cameraResolution", "imageSize", "image_size")
    },
}


@pytest.mark.parametrize("name", OTHERS)
def test_calibrations_of_other_programs_are_read_with_lens_and_size(tmp_path, name):
    """ROS's message lost its lens and its size without a word; Kalibr's held "0 camera matrices"."""
    path, lens = tmp_path / "camera.yaml", [-0.2, 0.05, 0.001, -0.002]
    numbers = (2 * CAMERA[0, 0], 2 * CAMERA[1, 1], 2 * CAMERA[0, 2] - 0.5, 2 * CAMERA[1, 2] - 0.5)
    path.write_text(OTHERS[name].format(*map(float, numbers), lens=lens, w=2 * SIZE[1], h=2 * SIZE[0]))
    found = read_calibration(path, SIZE)
    np.testing.assert_allclose(found.intrinsics, CAMERA)
    np.testing.assert_allclose(found.distortion[:4], lens)


def test_a_calibration_as_json_is_read(tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({"camera_matrix": CAMERA.tolist(), "dist_coeff": [[0.1, 0, 0, 0, 0]]}))
    found = read_calibration(path, SIZE)
    np.testing.assert_allclose(found.intrinsics - CAMERA, [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    assert found.distortion[0] == 0.1
    # Open3D's, by columns.
    path.write_text(json.dumps({"width": SIZE[1], "height": SIZE[0], "intrinsic_matrix": CAMERA.T.ravel().tolist()}))
    assert np.array_equal(read_calibration(path, SIZE).intrinsics, found.intrinsics)


def test_calibrations_that_are_none_of_one_camera_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"holds 2 camera matrices: M1, M2.*--intrinsics fx fy cx cy"):
        read_calibration(opencv(tmp_path, "yml", M1=CAMERA, M2=CAMERA), SIZE)
    with pytest.raises(InputError, match="holds 0 camera matrices"):
        read_calibration(opencv(tmp_path, "yml", R=np.eye(3)), SIZE)
    with pytest.raises(InputError, match="holds a equidistant camera"):
        read_calibration(ros(tmp_path, model="equidistant"), SIZE)
    (tmp_path / "broken.xml").write_text("<opencv_storage><a")
    with pytest.raises(InputError, match=r"nor a calibration as OpenCV writes it.*Metashape"):
        read_calibration(tmp_path / "broken.xml", SIZE)
    (tmp_path / "path.json").write_text(json.dumps({"camera_path": [{"camera_to_world": np.eye(4).ravel().tolist()}]}))
    with pytest.raises(InputError, match=r"holds 0 camera matrices.*for poses.*transforms\.json"):
        read_calibration(tmp_path / "path.json", SIZE)
    with pytest.raises(InputError, match="no camera file"):
        read_calibration(tmp_path / "nothing.yml", SIZE)


def test_poses_need_no_size_and_a_calibration_has_none(tmp_path):
    np.testing.assert_allclose(read_poses(transforms(tmp_path)), poses(12), atol=1e-12)
    write_colmap_model(tmp_path, poses(12), CAMERA, SIZE, points=np.zeros((0, 3)), colors=np.zeros((0, 3)))
    assert is_camera_file(tmp_path / "cameras.bin")
    np.testing.assert_allclose(read_poses(tmp_path / "cameras.bin"), poses(12), atol=1e-12)
    with pytest.raises(InputError, match="holds no poses; allowed: the folder of a COLMAP model"):
        read_poses(ros(tmp_path))


@pytest.mark.parametrize("within", ["sparse/0", "0", "sparse"])
def test_the_folder_of_a_colmap_project_is_as_good_as_its_models(tmp_path, within):
    """`gs2ci export --to colmap` writes such a one, and it was "not a COLMAP model"."""
    (tmp_path / within).mkdir(parents=True)
    write_colmap_model(tmp_path / within, poses(3), CAMERA, SIZE, points=np.zeros((0, 3)), colors=np.zeros((0, 3)))
    np.testing.assert_allclose(read_poses(tmp_path), poses(3), atol=1e-12)


def test_a_shot_takes_camera_lens_and_poses_from_files(tmp_path):
    rng = np.random.default_rng(0)
    np.savez(tmp_path / "shot.npz", meas=rng.random((*SIZE, 3)), masks=rng.random((12, *SIZE)) < 0.5)
    known = {"intrinsics": ros(tmp_path), "poses": transforms(tmp_path), "stage": transforms(tmp_path)}
    (shot,) = import_file(tmp_path / "shot.npz", **known).shots
    np.testing.assert_allclose(shot.intrinsics, CAMERA)
    assert shot.distortion.tolist() == [0.1, 0, 0, 0.01, 0]
    np.testing.assert_allclose(shot.truth.world_to_camera, poses(12), atol=1e-12)
    np.testing.assert_allclose(shot.telemetry_world_to_camera, poses(12), atol=1e-12)
    np.savetxt(tmp_path / "camera.txt", CAMERA)
    (shot,) = import_file(tmp_path / "shot.npz", intrinsics=tmp_path / "camera.txt").shots
    assert np.array_equal(shot.intrinsics, CAMERA)
    assert shot.distortion is None
    (shot,) = import_file(tmp_path / "shot.npz", intrinsics=transforms(tmp_path)).shots
    assert shot.distortion is None
    with pytest.raises(InputError, match=r"distortion \[0\.1, 0\.0, 0\.0, 0\.01, 0\.0, 0\.2.*allowed: OpenCV's"):
        import_file(
            tmp_path / "shot.npz", intrinsics=ros(tmp_path, (0.1, 0, 0, 0.01, 0, 0.2, 0, 0), "rational_polynomial")
        )


def test_matrices_that_are_written_column_by_column_are_turned_before_anything_else(tmp_path):
    """ARKit's are; turned at the end they were other rigid motions."""
    held = nerfstudio_transforms(poses(12), CAMERA, SIZE)
    for frame in held["frames"]:
        frame["transform_matrix"] = np.array(frame["transform_matrix"]).T.ravel().tolist()
    found = read_cameras(transforms(tmp_path, frames=held["frames"]), 12, SIZE)
    np.testing.assert_allclose(found.world_to_camera, poses(12), atol=1e-12)


def test_names_that_differ_in_no_number_are_refused_unless_the_file_has_their_order(tmp_path):
    held = nerfstudio_transforms(poses(3), CAMERA, SIZE)
    for name, frame in zip(("run1/one.png", "run1/two.png", "run1/three.png"), held["frames"], strict=True):
        frame["file_path"] = name
    with pytest.raises(InputError, match=r"such as .run1/one\.png., differ in no number"):
        read_cameras(transforms(tmp_path, 3, frames=held["frames"]), 3, SIZE)
    for name, frame in zip("abc", held["frames"], strict=True):
        frame["file_path"] = f"{name}.png"
    found = read_cameras(transforms(tmp_path, 3, frames=held["frames"]), 3, SIZE)
    np.testing.assert_allclose(found.world_to_camera, poses(3), atol=1e-12)


@pytest.mark.parametrize("apart", [True, False])
def test_the_arrays_of_opencvs_tutorial_are_camera_and_lens(tmp_path, apart):
    """np.savez(mtx=..., dist=..., rvecs=..., tvecs=...): refused as --intrinsics, unknown beside."""
    rng = np.random.default_rng(0)
    arrays = {"meas": rng.random((*SIZE, 3)), "masks": rng.random((12, *SIZE)) < 0.5}
    views = {"rvecs": np.zeros((5, 3, 1)), "tvecs": np.ones((5, 3, 1))}
    camera = {"mtx": CAMERA - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]], "dist": [[0.1, 0, 0, 0.01, 0]], **views}
    np.savez(tmp_path / "shot.npz", **arrays if apart else arrays | camera)
    np.savez(tmp_path / "camera.npz", **camera)
    (shot,) = import_file(tmp_path / "shot.npz", intrinsics=tmp_path / "camera.npz" if apart else None).shots
    np.testing.assert_allclose(shot.intrinsics, CAMERA)
    assert shot.distortion.tolist() == [0.1, 0, 0, 0.01, 0]


def test_what_no_lens_and_no_camera_of_that_size_has_is_doubted(tmp_path):
    """A fisheye's k1 k2 k3 k4, which OpenCV saves as D beside K, came as k1 k2 p1 p2; twice the size as it was."""
    rng = np.random.default_rng(0)
    np.savez(tmp_path / "shot.npz", meas=rng.random((*SIZE, 3)), masks=rng.random((12, *SIZE)) < 0.5)
    for lens, camera, doubts in (
        ((-0.2, 0.05, 0.001, -0.002), CAMERA, []),
        ((-0.05, 0.03, -0.04, 0.02), CAMERA, ["p1 and p2 are unusually large"]),
        ((-0.2, 0.05, 0.001, -0.002), np.diag([0.5, 0.5, 1]) @ CAMERA, ["lies far from the middle"]),
    ):
        known = {"intrinsics": opencv(tmp_path, "yml", K=camera, D=np.array(lens)[:, None])}
        told = [one for one in import_file(tmp_path / "shot.npz", **known).guesses if one.startswith("WARNING: ")]
        told = [one for one in told if "p1" in one or "principal" in one]
        assert [doubt in one for doubt, one in zip(doubts, told, strict=True)] == [True] * len(doubts)


def test_a_lens_under_a_name_that_is_not_known_is_told(tmp_path):
    """It was left out without a word. Bouguet's toolbox has KK and kc, with pixel centres at whole numbers."""
    rng = np.random.default_rng(0)
    np.savez(tmp_path / "shot.npz", meas=rng.random((*SIZE, 3)), masks=rng.random((12, *SIZE)) < 0.5)
    np.savez(tmp_path / "camera.npz", K=CAMERA, bent=[0.1, 0, 0, 0.01])
    imported = import_file(tmp_path / "shot.npz", intrinsics=tmp_path / "camera.npz")
    assert imported.shots[0].distortion is None
    assert any("no lens under a known name; not used: 'bent' [4]" in one for one in imported.guesses)
    np.savez(tmp_path / "camera.npz", KK=CAMERA, kc=[[0.1], [0], [0], [0.01], [0]], fc=[[1.0], [1.0]])
    (shot,) = import_file(tmp_path / "shot.npz", intrinsics=tmp_path / "camera.npz").shots
    assert shot.distortion.tolist() == [0.1, 0, 0, 0.01, 0]
    np.testing.assert_allclose(shot.intrinsics - CAMERA, [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])


@pytest.mark.parametrize("form", ["IntrinsicMatrix", "K", "FocalLength"])
def test_cameras_of_matlab_lie_half_a_pixel_beside_and_keep_their_lens(tmp_path, form):
    """toStruct of cameraParameters before and since R2022b, and of cameraIntrinsics: refused, or without the lens.

    MATLAB's first pixel centre is (1, 1) (cameraIntrinsicsToOpenCV subtracts 1), that of gs2ci (0.5, 0.5).
    """
    rng = np.random.default_rng(0)
    np.savez(tmp_path / "shot.npz", meas=rng.random((*SIZE, 3)), masks=rng.random((12, *SIZE)) < 0.5)
    twice = np.diag([2, 2, 1]) @ CAMERA + [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
    stored = {
        "IntrinsicMatrix": {"IntrinsicMatrix": twice.T},
        "K": {"K": twice},
        "FocalLength": {"FocalLength": np.diag(twice)[:2], "PrincipalPoint": twice[:2, 2], "Skew": 0.0},
    }[form]
    stored |= {"ImageSize": [2.0 * side for side in SIZE], "RadialDistortion": [0.1, 0.02, 0.003]}
    savemat(tmp_path / "camera.mat", {"params": {**stored, "TangentialDistortion": [0.001, -0.002]}})
    imported = import_file(tmp_path / "shot.npz", intrinsics=tmp_path / "camera.mat")
    (shot,) = imported.shots
    np.testing.assert_allclose(shot.intrinsics, CAMERA)
    assert shot.distortion.tolist() == [0.1, 0.02, 0.001, -0.002, 0.003]
    assert any("counts pixels from 1" in guess for guess in imported.guesses)
    savemat(tmp_path / "camera.mat", {"params": {**stored, "TangentialDistortion": [0.001]}})
    with pytest.raises(InputError, match=r"camera\.mat"):
        import_file(tmp_path / "shot.npz", intrinsics=tmp_path / "camera.mat")


@pytest.mark.parametrize("name", ["D", "dist_coeff", "distortion_coeffs"])
def test_a_lens_beside_the_matrix_of_an_array_file_is_read(tmp_path, name):
    rng = np.random.default_rng(0)
    np.savez(tmp_path / "shot.npz", meas=rng.random((*SIZE, 3)), masks=rng.random((12, *SIZE)) < 0.5, d=3.0)
    np.savez(tmp_path / "camera.npz", K=CAMERA, **{name: [[0.1, 0.01, 0.001, 0.002, 0.003]]})
    (shot,) = import_file(tmp_path / "shot.npz", intrinsics=tmp_path / "camera.npz").shots
    assert shot.distortion.tolist() == [0.1, 0.01, 0.001, 0.002, 0.003]
    np.testing.assert_allclose(shot.intrinsics, CAMERA)
