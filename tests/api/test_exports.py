"""Exports of a run, each opened by somebody else's reader."""

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import cv2
import h5py
import imageio.v3 as imageio
import numpy as np
import pycolmap
import pytest
import trimesh

import gs2ci
from gs2ci.api import exports
from gs2ci.core.errors import InputError, StorageError
from gs2ci.evaluate.exports import depth_files, nexus, orbit


@pytest.fixture
def run(examples):
    return gs2ci.open_run("run")


def test_gaussians_as_ply_and_spz(run):
    points = trimesh.load(gs2ci.export(run, "ply"))
    np.testing.assert_allclose(points.vertices, run.scene.means, atol=1e-6)
    assert gs2ci.export(run, "spz").stat().st_size < 2000


def test_cameras_and_pictures_for_colmap_and_nerfstudio_tell_the_same(run):
    model = pycolmap.Reconstruction(str(gs2ci.export(run, "colmap", "model") / "sparse" / "0"))
    folder = gs2ci.export(run, "nerfstudio", "studio")
    transforms = json.loads((folder / "transforms.json").read_text())
    # What nerfstudio's parser asks for (docs.nerf.studio, "Data conventions"): these keys, OpenGL axes, and its files.
    assert {"fl_x", "fl_y", "cx", "cy", "w", "h", "camera_model", "frames"} <= set(transforms)
    assert len(transforms["frames"]) == len(model.images) == 4
    for image in model.images.values():
        (frame,) = [one for one in transforms["frames"] if one["file_path"].endswith(image.name)]
        shown = imageio.imread(folder / frame["file_path"])
        np.testing.assert_array_equal(shown, imageio.imread(f"model/images/{image.name}"))
        assert shown.shape == (transforms["h"], transforms["w"], 3)
        axes = np.diag([1.0, -1, -1, 1])
        wanted = np.linalg.inv(np.array(frame["transform_matrix"]) @ axes)
        np.testing.assert_allclose(image.cam_from_world().matrix(), wanted[:3], atol=1e-9)
    assert len(trimesh.load(folder / transforms["ply_file_path"]).vertices) > 0


def by_class(group, kind):
    return [child for child in group.values() if child.attrs.get("NX_class") == kind]


def test_a_nexus_file_leads_a_reader_to_what_is_to_be_plotted(run):
    """As a NeXus viewer goes: default, default, signal, axes (manual.nexusformat.org, "Find the plottable data")."""
    told = {"operator": "A. Name", "sample": "fern", "institution": "U", "experiment": 7, "humidity_percent": 41.5}
    provenance = {"metadata": told, "taken_at": "2026-11-23T01:02:03+00:00"}
    report = run.report.model_copy(update={"provenance": provenance})
    nexus.write_nexus(Path("told.nxs"), report, run.views, run.depth, exports._cameras(run))
    with h5py.File(gs2ci.export(run, "nexus")) as plain, h5py.File("told.nxs") as file:
        for opened in (plain, file):
            entry = opened[opened.attrs["default"]]
            assert (opened.attrs["NX_class"], entry.attrs["NX_class"]) == ("NXroot", "NXentry")
            data = entry[entry.attrs["default"]]
            assert data.attrs["NX_class"] == "NXdata"
            signal = data[data.attrs["signal"]]
            np.testing.assert_array_equal(signal, run.views)
            axes = list(data.attrs["axes"])
            assert [len(data[axis]) for axis in axes] == list(signal.shape)
            assert [int(data.attrs[f"{axis}_indices"]) for axis in axes] == [0, 1, 2, 3]
            np.testing.assert_array_equal(entry["depth/depth"], run.depth)
            assert entry["title"].asstr()[()] == run.report.name
            cameras = entry["instrument/detector/cameras"]
            np.testing.assert_array_equal(cameras["world_to_camera"], run.path)
        assert not by_class(plain["entry"], "NXuser")
        assert "start_time" not in plain["entry"]
        (user,), (sample,) = by_class(file["entry"], "NXuser"), by_class(file["entry"], "NXsample")
        assert [user[name].asstr()[()] for name in ("name", "affiliation")] == ["A. Name", "U"]
        assert sample["name"].asstr()[()] == "fern"
        assert file["entry/experiment_identifier"].asstr()[()] == "7"
        assert dict(file["entry/metadata"].attrs)["humidity_percent"] == 41.5
        assert file["entry/start_time"].asstr()[()].startswith("2026-11-23")


def test_a_nexus_file_that_cannot_be_written_is_told(run):
    with pytest.raises(StorageError, match="cannot be written"):
        nexus.write_nexus(Path("nowhere/x.nxs"), run.report, run.views, None, exports._cameras(run))


def test_depth_as_png_and_exr(run):
    folder = gs2ci.export(run, "depth-png", "png")
    step = json.loads((folder / "depth.json").read_text())["unit_per_step"]
    read = np.stack([cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted(folder.glob("*.png"))])
    assert read.dtype == np.uint16
    np.testing.assert_allclose(read * step, run.depth, atol=0.51 * step)
    OpenEXR = pytest.importorskip("OpenEXR")
    maps = sorted(gs2ci.export(run, "depth-exr", "exr").glob("*.exr"))
    read = np.stack([OpenEXR.File(str(path)).channels()["Z"].pixels for path in maps])
    np.testing.assert_array_equal(read, run.depth)


def test_what_is_not_seen_has_a_reading_of_its_own(tmp_path):
    depth = np.float32([[[0.0, 1e-9, 5.0]]])
    depth_files.write_depth_png(tmp_path, depth)
    assert cv2.imread(str(tmp_path / "depth_000.png"), cv2.IMREAD_UNCHANGED).tolist() == [[0, 1, 65535]]
    with pytest.raises(StorageError, match="cannot be written"):
        depth_files.write_depth_png(tmp_path / "nowhere", depth)
    with pytest.raises(StorageError, match="cannot be written"):
        depth_files.write_depth_exr(tmp_path / "nowhere", depth)


def test_exr_without_its_package_says_what_to_do(run, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "OpenEXR", None)
    with pytest.raises(InputError, match=r"needs the package OpenEXR.*depth-png.*gs2ci\[exr\]"):
        gs2ci.export(run, "depth-exr")


def test_films_of_an_orbit(run, monkeypatch):
    frames = np.linspace(0, 1, 6, dtype=np.float32)[:, None, None, None] * np.ones((6, 25, 33, 3), np.float32)
    monkeypatch.setattr(exports, "orbit", lambda run: frames)
    film = imageio.imread(gs2ci.export(run, "gif"), index=None)
    assert film.shape == (6, 25, 33, 3)
    np.testing.assert_allclose(film.mean(axis=(1, 2, 3)) / 255, np.linspace(0, 1, 6), atol=0.02)
    path = gs2ci.export(run, "mp4")
    reader = cv2.VideoCapture(str(path))
    levels = []
    while (read := reader.read())[0]:
        assert read[1].shape == (24, 32, 3)
        levels.append(read[1].mean() / 255)
    np.testing.assert_allclose(levels, np.linspace(0, 1, 6), atol=0.06)
    if shutil.which("ffprobe"):
        told = subprocess.run(
            ["ffprobe", "-v", "error", "-show_entries", "stream=codec_name", "-of", "csv=p=0", path],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert told.stdout.strip() == "vp9"
    with pytest.raises(InputError, match=r"\.gif or \.mp4"):
        orbit.write_film(path.with_suffix(".avi"), frames)
    with pytest.raises(InputError, match="cannot be encoded or written"):
        orbit.write_film(path.parent / "nowhere" / "o.mp4", frames)
    with pytest.raises(StorageError):
        orbit.write_film(path.parent / "nowhere" / "o.gif", frames)


def test_an_orbit_goes_round_what_it_looks_at_and_comes_back(run):
    poses = orbit.orbit_poses(run.path, 5.0, 16)
    middle = np.linalg.inv(run.path[2])
    target = middle[:3, 3] + 5.0 * middle[:3, 2]
    local = poses[:, :3, :3] @ target + poses[:, :3, 3]
    np.testing.assert_allclose(local[:, :2], 0, atol=1e-9)  # it stays in the middle of the picture
    assert (local[:, 2] > 4.9).all()
    np.testing.assert_allclose(
        poses[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (16, 1, 1)), atol=1e-9
    )
    centres = np.linalg.inv(poses)[:, :3, 3]
    np.testing.assert_allclose(centres.mean(axis=0), middle[:3, 3], atol=1e-9)
    steps = np.linalg.norm(centres - np.roll(centres, 1, axis=0), axis=1)
    assert steps[0] == pytest.approx(steps[8])  # the last step is like any other: the film goes on
    frames = exports.orbit(run)
    assert frames.shape == (orbit.FRAMES, 24, 32, 3)
    assert np.abs(frames[0] - frames[orbit.FRAMES // 2]).max() > 0.01


def test_a_mesh_from_the_command_line(run, gs2ci, capsys):
    assert gs2ci("mesh", "run", "--voxels", 24, "-o", "m.ply") == 0
    assert "m.ply" in capsys.readouterr().out
    assert len(trimesh.load("m.ply").faces) > 50
    assert gs2ci("mesh", "run", "--voxels", 24, "-o", "m.ply") == 2
    assert "--overwrite" in capsys.readouterr().err


def test_places_that_are_taken_and_parts_that_are_missing_are_refused(run, gs2ci, capsys, examples):
    assert gs2ci("export", "run", "--to", "colmap", "-o", "there") == 0
    (examples / "there" / "mine.txt").touch()
    assert gs2ci("export", "run", "--to", "colmap", "-o", "there") == 2
    assert "--overwrite" in capsys.readouterr().err
    assert gs2ci("export", "run", "--to", "colmap", "-o", "there", "--overwrite") == 0
    assert not (examples / "there" / "mine.txt").exists()
    assert not list(examples.glob(".there*"))
    with pytest.raises(InputError, match="no depth"):
        exports.mesh(replace(run, depth=None), "none.ply")
    with pytest.raises(InputError, match="no folder yet"):
        exports.export(replace(run, folder=None), "ply")
    with pytest.raises(InputError, match="holds no Gaussian"):
        exports.orbit(replace(run, _scene=run.scene.map(lambda tensor: tensor[:0])))
    with pytest.raises(InputError, match="--to obj"):
        exports.export(run, "obj")
    (examples / "run" / "scene.ply").unlink()
    with pytest.raises(StorageError, match="cannot be written"):
        exports.export(run, "ply", "x.ply")
