"""The log of a user's own stage beside a measurement: poses, and what is no such log."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.foreign.stage_log import USUAL_WAYS, stage_poses

PLACES = np.array([[0, 0, 0], [1, 0.5, 0], [2, 1, -0.5], [3, 1.5, -1.0]])


def log(tmp_path, text, name="stage.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def rows(places, mark=",", form="{:g}"):
    return "\n".join(mark.join(form.format(value) for value in place) for place in places) + "\n"


def centres(given):
    return np.linalg.inv(given.values)[:, :3, 3]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x_mm,y_mm,z_mm\n" + rows(PLACES), "x_mm = x, in mm"),
        ("x,y,z\n" + rows(PLACES), "x = x, of no named unit"),
        ("X [mm];Y [mm];Z [mm]\n" + rows(PLACES, ";").replace(".", ","), "X [mm] = x, in mm"),
        ("x_um\ty_um\tz_um\n" + rows(1000 * PLACES, "\t"), "x_um = x, in um"),
        ("x_microns,y [micrometers],Z Position (µm)\n" + rows(1000 * PLACES), "y [micrometers] = y, in micrometers"),
        ("x_millimeters,y_metres,z_inches\n" + rows(PLACES / (1, 1000, 25.4)), "y_metres = y, in metres"),
        ("x (m), y (m), z (m)\n" + rows(PLACES / 1000), "y (m) = y, in m"),
        ("# x y z\n" + rows(PLACES, " ", "{:.6e}"), "x = x"),
        (rows(PLACES, "   "), "columns without names, taken for x, y, z"),
        ("time_s,z_mm,x_mm,y_mm\n" + rows(np.c_[[0, 1, 2, 3], PLACES[:, [2, 0, 1]]]), "not used: time_s"),
        ("\ufeffx_mm,y_mm,z_mm,yaw_deg\n" + rows(np.c_[PLACES, np.ones(4)]), "not used: yaw_deg"),
    ],
)
def test_a_table_of_positions_becomes_poses_of_a_camera_that_does_not_turn(tmp_path, text, words):
    guesses = []
    given = stage_poses(log(tmp_path, text), USUAL_WAYS, guesses)
    assert np.allclose(centres(given), PLACES)
    assert np.array_equal(given.values[:, :3, :3], np.tile(np.eye(3), (4, 1, 1)))
    assert any(words in guess for guess in guesses)
    assert any("right as x grows, down as y grows, ahead as z grows" in guess for guess in guesses)


@pytest.mark.parametrize("text", ["position_mm\n0\n1\n2\n3\n", "0\n1\n2\n3\n", "frame,pos\n1,0\n2,1\n3,2\n4,3\n"])
def test_the_positions_of_a_single_axis_are_those_of_x(tmp_path, text):
    given = stage_poses(log(tmp_path, text), ("left", "down", "ahead"), [])
    assert np.allclose(centres(given), np.outer([0, -1, -2, -3], [1, 0, 0]))


def test_the_axes_of_the_log_go_where_the_user_says(tmp_path):
    given = stage_poses(log(tmp_path, "x,y,z\n" + rows(PLACES)), ("up", "ahead", "left"), [])
    assert np.allclose(centres(given), np.c_[-PLACES[:, 2], -PLACES[:, 0], PLACES[:, 1]])


@pytest.mark.parametrize("shown", ["places", "one axis", "a column", "poses"])
def test_an_array_holds_positions_or_poses(tmp_path, shown):
    poses, along = np.tile(np.eye(4), (4, 1, 1)), np.arange(4.0)
    poses[:, 0, 3] = -along
    forms = {"places": np.outer(along, [1, 0, 0]), "one axis": along, "a column": along[:, None], "poses": poses}
    np.save(tmp_path / "stage.npy", forms[shown])
    assert np.allclose(stage_poses(tmp_path / "stage.npy", USUAL_WAYS, []).values, poses)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no rows"),
        ("x,y,z\n", "names, and no rows"),
        ("x,y,z\n0,0,0\n1,oh,0\n", "row 2 is no row of numbers"),
        ("x,y,z\n0,0,0\n1,0\n", "row 2 is no row of numbers"),
        ("x,y\n0,0,0\n1,0,0\n", "2 names for 3 columns"),
        ("0,0\n1,0\n", "2 columns without names"),
        ("x_mm,x_um\n0,0\n1,1000\n", "two columns for x"),
        ("time_s,temperature\n0,20\n1,21\n", "columns time_s, temperature, none of them a position"),
        ("x,yaw_deg\n0,0\n1,3.4\n", "column yaw_deg turns the camera"),
        ("x,stage_yaw\n0,0\n1,3.4\n", "column stage_yaw turns the camera"),
        ("x,CamRotX\n0,0\n1,3.4\n", "column CamRotX turns the camera"),
        ("x,y,alt,heading\n0,0,0,0\n1,0,0,5\n", "column heading turns the camera"),
        ("x,y,z,Omega,Phi,Kappa\n0,0,0,0,0,0\n1,0,0,5,0,0\n", "column Omega turns the camera"),
        ("X,Y,Z,U,V,W\n0,0,0,0,0,0\n1,0,0,0,0.5,0\n", "column V turns the camera"),
        ("x,y,z,r11,r12,r13\n0,0,0,1,0,0\n1,0,0,0.9,0.1,0.2\n", "column r11 turns the camera"),
        ("x\n0\nnan\n", "position 2 holds NaN or infinity"),
        ("x\n5\n5\n", "all 2 positions are the same"),
    ],
)
def test_what_is_no_log_of_positions_is_refused(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        stage_poses(log(tmp_path, text), USUAL_WAYS, [])


def test_columns_beside_positions_that_turn_nothing_are_named(tmp_path):
    """pandas 3.1.1 writes an index without a name before them."""
    guesses = []
    text = ",x_mm,temp_degC,V,pitch_um\n0,0,20.1,3,5\n1,2.5,20.4,4,5\n"
    assert centres(stage_poses(log(tmp_path, text), USUAL_WAYS, guesses))[1].tolist() == [2.5, 0, 0]
    assert "stage.csv: not used: temp_degC, V, pitch_um" in guesses


def test_a_log_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        stage_poses(tmp_path / "none.csv", USUAL_WAYS, [])
    (tmp_path / "bytes.csv").write_bytes(b"x,y\n\xff\xfe\x00\n")
    with pytest.raises(InputError, match=r"bytes\.csv"):
        stage_poses(tmp_path / "bytes.csv", USUAL_WAYS, [])
    np.save(tmp_path / "two.npy", np.zeros((4, 2)))
    with pytest.raises(InputError, match=r"an array of shape \[4, 2\]"):
        stage_poses(tmp_path / "two.npy", USUAL_WAYS, [])


@pytest.mark.parametrize("ways", [("right", "left", "ahead"), ("right", "down"), ("right", "down", "north"), ()])
def test_ways_that_are_not_three_at_right_angles_are_refused(tmp_path, ways):
    with pytest.raises(InputError, match=r"--stage-axes.*three of right, left, down, up, ahead, back"):
        stage_poses(log(tmp_path, "x\n0\n1\n"), ways, [])


@pytest.mark.parametrize("form", ["[R, 3, 4]", "[4, 4, R]", "[3, 4, R]", "[R, 16]", "by columns", "4 of [4, 4, R]"])
def test_poses_are_read_in_every_order_of_axes(tmp_path, form):
    """[4, 4, R] were "4 positions for 8 masks"."""
    poses = np.tile(np.eye(4), (4 if form.startswith("4") else 8, 1, 1))
    poses[:, :3, 3] = np.random.default_rng(0).normal(size=(len(poses), 3))
    poses[1:, :3, :3] = Rotation.from_rotvec([0.1, 0.2, -0.3]).as_matrix()
    stored = {
        "[R, 3, 4]": poses[:, :3],
        "[4, 4, R]": np.moveaxis(poses, 0, -1),
        "[3, 4, R]": np.moveaxis(poses[:, :3], 0, -1),
        "[R, 16]": poses.reshape(-1, 16),
        "by columns": poses.transpose(0, 2, 1),
        "4 of [4, 4, R]": np.moveaxis(poses, 0, -1),
    }[form]
    np.save(tmp_path / "poses.npy", stored)
    assert np.array_equal(stage_poses(tmp_path / "poses.npy", USUAL_WAYS, []).values, poses)


CENTRES = np.random.default_rng(1).normal(size=(4, 3))
TURNS = Rotation.from_rotvec(np.random.default_rng(2).normal(size=(4, 3)))
OTHERS = {
    "EuRoC": "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_x",
    "rosbag": "time,.header.stamp,.header.frame_id,.pose.position.x,.pose.position.y,.pose.position.z,"
    ".pose.orientation.w,.pose.orientation.x,.pose.orientation.y,.pose.orientation.z",
    "PlotJuggler": "__time,/odom/pose/pose/position/x,/odom/pose/pose/position/y,/odom/pose/pose/position/z,"
    "/odom/pose/pose/orientation/w,/odom/pose/pose/orientation/x,/odom/pose/pose/orientation/y,"
    "/odom/pose/pose/orientation/z",
    "ZED": "timestamp,tx,ty,tz,ow,ox,oy,oz",
    "Motive": "Time (Seconds),Position X,Position Y,Position Z,Rotation W,Rotation X,Rotation Y,Rotation Z",
    "tf": "t,transform.translation.x,transform.translation.y,transform.translation.z,transform.rotation.w,"
    "transform.rotation.x,transform.rotation.y,transform.rotation.z",
}


@pytest.mark.parametrize("program", OTHERS)
def test_trajectories_of_other_programs_are_read_by_the_names_of_their_columns(tmp_path, program):
    """Refused: EuRoC's names begin with blanks, ROS's have points, slashes, a column of text; ZED's did not turn."""
    numbers = np.c_[CENTRES, TURNS.as_quat(scalar_first=True)]
    rows = [",".join(f"{value:.12g}" for value in row) for row in numbers]
    before, after = {"rosbag": ("2026/11/30 10:00:00,{},map,", ""), "EuRoC": ("{},", ",0.5")}.get(program, ("{},", ""))
    text = "\n".join([OTHERS[program], *(before.format(k) + row + after for k, row in enumerate(rows))])
    given = stage_poses(log(tmp_path, text), USUAL_WAYS, []).values
    assert np.allclose(np.linalg.inv(given)[:, :3, 3], CENTRES)
    assert np.allclose(np.linalg.inv(given)[:, :3, :3], TURNS.as_matrix())


@pytest.mark.parametrize("is_body", [True, False])
def test_poses_of_a_body_that_a_file_of_ros_names_are_doubted(tmp_path, is_body):
    # nav_msgs/Odometry as `rostopic echo -p` writes it: by REP 103 the child frame has x ahead, y left, z up.
    numbers = np.c_[CENTRES, TURNS.as_quat()]
    names = [f"field.pose.pose.{part}" for part in ("position.x", "position.y", "position.z")]
    names += [f"field.pose.pose.orientation.{axis}" for axis in "xyzw"]
    before = "%time,field.header.frame_id," + "field.child_frame_id," * is_body
    lines = [before + ",".join(names)]
    lines += [f"{k},odom," + "base_link," * is_body + ",".join(map(str, row)) for k, row in enumerate(numbers)]
    guesses: list[str] = []
    given = stage_poses(log(tmp_path, "\n".join(lines)), USUAL_WAYS, guesses).values
    assert np.allclose(np.linalg.inv(given)[:, :3, 3], CENTRES)
    assert any("x ahead, y left, z up" in guess and guess.startswith("WARNING") for guess in guesses) == is_body


def test_an_array_of_poses_is_of_the_direction_that_its_name_says(tmp_path):
    """Camera-to-world poses were taken for the reverse without a word; an array without a name still is, with one."""
    inverse = np.tile(np.eye(4), (4, 1, 1))
    inverse[:, :3, :3], inverse[:, :3, 3] = TURNS.as_matrix(), CENTRES
    for key, stored in (("c2w", inverse), ("world_to_camera", np.linalg.inv(inverse))):
        np.savez(tmp_path / "poses.npz", K=np.eye(3), **{key: stored})
        assert np.allclose(stage_poses(tmp_path / "poses.npz", USUAL_WAYS, []).values, np.linalg.inv(inverse))
    np.savetxt(tmp_path / "poses.txt", inverse.reshape(4, 16))
    np.save(tmp_path / "poses.npy", inverse)
    guesses: list[str] = []
    assert np.allclose(stage_poses(tmp_path / "poses.txt", USUAL_WAYS, guesses).values, inverse)
    assert "poses.txt: poses of OpenCV's axes" in guesses.pop()
    assert np.array_equal(stage_poses(tmp_path / "poses.npy", USUAL_WAYS, guesses).values, inverse)
    assert guesses == [
        f"{tmp_path / 'poses.npy'}: poses of OpenCV's axes (x right, y down, z ahead), taken for world-to-camera"
    ]


def test_true_poses_come_from_the_same_files(tmp_path, scene):
    """A text with w first, which its names say, was read as if w were last."""
    made = scene(channels=1)
    count = len(made.masks)
    turns = Rotation.from_rotvec(np.random.default_rng(2).normal(size=(count, 3)))
    rows = np.c_[np.arange(count), np.random.default_rng(1).normal(size=(count, 3)), turns.as_quat(scalar_first=True)]
    np.savetxt(tmp_path / "true.csv", rows, "%.12g", ",", header="t,tx,ty,tz,qw,qx,qy,qz", comments="")
    np.savez(tmp_path / "shot.npz", meas=made.meas[..., 0], masks=made.masks)
    (shot,) = import_shots(tmp_path / "shot.npz", None, ImportOptions(world_to_camera=tmp_path / "true.csv")).shots
    inverse = np.linalg.inv(shot.truth.world_to_camera)
    assert np.allclose(inverse[:, :3, :3], turns.as_matrix())
    assert np.allclose(inverse[:, :3, 3], rows[:, 1:4])


@pytest.mark.parametrize("lost", ["nan nan nan nan nan nan nan", "1 2 3 0 0 0 0"])
def test_a_row_without_a_pose_is_named(tmp_path, lost):
    """It was "damaged or not what its name says"."""
    with pytest.raises(InputError, match="row 2 holds no pose"):
        stage_poses(log(tmp_path, f"0 0 0 0 0 0 0 1\n1 {lost}\n2 1 0 0 0 0 0 1\n"), USUAL_WAYS, [])


def test_a_column_of_text_is_no_position(tmp_path):
    with pytest.raises(InputError, match="position 1 holds NaN"):
        stage_poses(log(tmp_path, "x,y\n1 mm,0\n2 mm,1\n"), USUAL_WAYS, [])
    guesses = []
    given = stage_poses(log(tmp_path, "picture,x_in\na.png,0\nb.png,1\n"), USUAL_WAYS, guesses)
    assert np.allclose(centres(given)[1], [25.4, 0, 0])
    assert "stage.csv: not used: picture" in guesses


def test_positions_may_be_counted_last(tmp_path):
    np.save(tmp_path / "places.npy", PLACES.T)
    assert np.array_equal(stage_poses(tmp_path / "places.npy", USUAL_WAYS, []).values[:, :3, 3], -PLACES)
    np.save(tmp_path / "turned.npy", np.zeros((8, 7)))
    with pytest.raises(InputError, match=r"shape \[8, 7\].*make matrices of quaternions"):
        stage_poses(tmp_path / "turned.npy", USUAL_WAYS, [])


@pytest.mark.parametrize(
    "names", ["stage_x_mm,stage_y_mm", "X Position (mm),Y Position (mm)", "PosX [mm],PosY [mm]", "XPos/mm,YPos/mm"]
)
def test_columns_are_known_by_the_letter_of_their_axis(tmp_path, names):
    path = tmp_path / "log.csv"
    path.write_text(f"{names},x velocity (mm/s)\n0,5,1\n3,4,2\n")
    guesses: list[str] = []
    assert stage_poses(path, USUAL_WAYS, guesses).values[:, :2, 3].tolist() == [[0, -5], [-3, -4]]
    assert any("not used: x velocity (mm/s)" in guess for guess in guesses)


def test_poses_have_axes_of_their_own(tmp_path):
    np.save(tmp_path / "poses.npy", np.tile(np.eye(4), (4, 1, 1)))
    with pytest.raises(InputError, match=r"--stage-axes with .*poses\.npy, which holds poses"):
        stage_poses(tmp_path / "poses.npy", ("left", "down", "ahead"), [])


def test_a_log_beside_a_measurement_is_its_telemetry(scene, take, said, tmp_path):
    made = scene(n=4)
    options = ImportOptions(stage=log(tmp_path, "x_mm,y_mm,z_mm\n" + rows(PLACES)), stage_error=0.02)
    imported = take(options, meas=made.meas, mask=made.masks)
    (shot,) = imported.shots
    assert np.allclose(np.linalg.inv(shot.telemetry_world_to_camera)[:, :3, 3], PLACES)
    assert shot.provenance["telemetry"] == {"position_error": 0.02}
    assert said(imported, "stage.csv: poses of the stage")
    assert shot.truth.world_to_camera is None


def test_poses_of_another_program_are_told_with_their_order(tmp_path):
    frames = [
        {"file_path": f"images/{k}.png", "transform_matrix": [[1, 0, 0, k], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}
        for k in (10, 9, 2, 1)
    ]
    camera = {"w": 64, "h": 48, "fl_x": 90, "fl_y": 90, "cx": 32, "cy": 24}
    told = []
    found = stage_poses(log(tmp_path, json.dumps({**camera, "frames": frames}), "t.json"), USUAL_WAYS, told)
    assert np.allclose(centres(found)[:, 0], [1, 2, 9, 10])
    assert told == ["t.json: poses in the order of the numbers in the pictures' names"]


def test_each_of_several_exposures_takes_its_part_of_the_log(scene, take, tmp_path):
    made = [scene(n=4, seed=seed) for seed in (0, 1)]
    options = ImportOptions(stage=log(tmp_path, rows(np.concatenate([PLACES, PLACES + 7]))))
    shots = take(options, meas=np.stack([one.meas for one in made]), masks=np.stack([one.masks for one in made])).shots
    assert len(shots) == 2
    assert np.allclose(np.linalg.inv(shots[1].telemetry_world_to_camera)[:, :3, 3], PLACES + 7)


def test_a_log_of_another_number_of_positions_is_refused(scene, take, tmp_path):
    made = scene(n=5)
    options = ImportOptions(stage=log(tmp_path, rows(PLACES)))
    with pytest.raises(InputError, match=r"stage\.csv: 4 positions for 5 masks; allowed: one for each mask"):
        take(options, meas=made.meas, mask=made.masks)


@pytest.mark.parametrize("head", ["", "# timestamp tx ty tz qx qy qz qw\n", "t,tx,ty,tz,qx,qy,qz,qw\n"])
def test_a_trajectory_of_tum_is_taken_with_its_turns(tmp_path, head):
    half = np.sqrt(0.5)
    rows_ = [[k, *place, 0, half, 0, half] for k, place in enumerate(PLACES)]
    given = stage_poses(
        log(tmp_path, head + rows(rows_, "," if "," in head else " ", "{:.9g}")), USUAL_WAYS, guesses := []
    )
    assert np.allclose(centres(given), PLACES)
    assert np.allclose(given.values[0, :3, :3], [[0, 0, -1], [0, 1, 0], [1, 0, 0]])
    assert any("TUM's: time, place and quaternion" in guess for guess in guesses)


@pytest.mark.parametrize(
    ("names", "order"),
    [
        ("t,tx,ty,tz,qw,qx,qy,qz", (0, 1, 2, 3, 7, 4, 5, 6)),
        (
            "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []",
            (0, 1, 2, 3, 7, 4, 5, 6),
        ),
        ("quat_x,quat_y,quat_z,quat_w,pos_x,pos_y,pos_z", (4, 5, 6, 7, 1, 2, 3)),
    ],
    ids=["COLMAP's order", "EuRoC's", "no time, places last"],
)
def test_the_columns_of_a_trajectory_are_taken_by_their_names(tmp_path, names, order):
    half = np.sqrt(0.5)
    rows_ = np.array([[k, *place, 0, half, 0, half] for k, place in enumerate(PLACES)])
    given = stage_poses(log(tmp_path, names + "\n" + rows(rows_[:, order], ",", "{:.9g}")), USUAL_WAYS, [])
    assert np.allclose(centres(given), PLACES)
    assert np.allclose(given.values[0, :3, :3], [[0, 0, -1], [0, 1, 0], [1, 0, 0]])


def test_eight_named_columns_are_no_trajectory(tmp_path):
    text = "n,t,x_mm,y_mm,z_mm,a,b,c\n" + rows([[k, k, *place, 1, 1, 1] for k, place in enumerate(PLACES)])
    assert np.allclose(centres(stage_poses(log(tmp_path, text), USUAL_WAYS, [])), PLACES)


@pytest.mark.parametrize("coding", ["utf-16", "latin-1"])
def test_a_log_may_be_written_as_spreadsheets_do(tmp_path, coding):
    (tmp_path / "stage.csv").write_bytes(("x_µm,y_µm,z_µm\n" + rows(1000 * PLACES)).encode(coding))
    assert np.allclose(centres(stage_poses(tmp_path / "stage.csv", USUAL_WAYS, [])), PLACES)


def test_rows_of_tum_whose_times_do_not_grow_are_refused(tmp_path):
    turn = np.tile([0.0, 0, 0, 1], (4, 1))
    with pytest.raises(InputError, match="times that do not grow"):
        stage_poses(log(tmp_path, rows(np.c_[[0, 2, 1, 3], PLACES, turn], " "), "tum.txt"), USUAL_WAYS, [])


def test_a_quaternion_that_seems_to_begin_with_w_is_doubted(tmp_path):
    guesses = []
    turn = np.tile([1.0, 0, 0, 0], (4, 1))
    stage_poses(log(tmp_path, rows(np.c_[np.arange(4), PLACES, turn], " "), "tum.txt"), USUAL_WAYS, guesses)
    assert any("TUM's last one is w" in guess for guess in guesses)
    named = stage_poses(
        log(tmp_path, "t,x,y,z,qw,qx,qy,qz\n" + rows(np.c_[np.arange(4), PLACES, turn])), USUAL_WAYS, []
    )
    assert np.allclose(named.values[:, :3, :3], np.eye(3))
