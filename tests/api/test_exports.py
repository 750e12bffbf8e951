"""Exports of a run, each opened by somebody else's reader."""

import base64
import gzip
import json
import re
import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import cv2
import gsply
import h5py
import imageio.v3 as imageio
import jsonschema
import numpy as np
import pycolmap
import pytest
import trimesh
from PIL import Image, ImageSequence

import gs2ci
from gs2ci.api import exports
from gs2ci.core.errors import InputError, StorageError
from gs2ci.evaluate import points as points_module
from gs2ci.evaluate.cameras import nerfstudio_transforms
from gs2ci.evaluate.exports import depth_files, nexus, orbit
from gs2ci.evaluate.whole_folder import write_pictures
from gs2ci.render.ply import read_ply, write_ply
from tests.core.test_whole_file import small_files
from tests.evaluate.pages.conftest import tab
from tests.evaluate.reports import a_geometry

__all__ = ["tab"]


@pytest.fixture
def run(examples):
    return gs2ci.open_run("run")


def test_gaussians_for_viewers_and_as_they_were_fitted(run):
    heard = gs2ci.Silent()
    points = trimesh.load(gs2ci.export(run, "ply", progress=heard))
    np.testing.assert_allclose(points.vertices, run.scene.means, atol=1e-6)
    assert re.search(r"colours within 0 to 1: .*dB where opacities are kept", heard.sentences[0])
    shown = read_ply("scene.ply")
    assert 0 <= shown.colours.min() <= shown.colours.max() <= 1
    gs2ci.export(run, "ply", "own.ply", as_fitted=True)
    assert Path("own.ply").read_bytes() == (run.folder / "scene.ply").read_bytes()
    gs2ci.export(run, "ply", "whole.ply", as_fitted=True, f_rest=True)
    assert b"property float f_rest_44" in Path("whole.ply").read_bytes()


def test_gaussians_as_spz_sog_and_glb(run):
    sizes = {to: gs2ci.export(run, to, as_fitted=True).stat().st_size for to in ("spz", "sog", "glb")}
    assert sizes["spz"] < 2000
    two = gs2ci.export(run, "spz", "two.spz", as_fitted=True, spz_version=2)
    assert [gzip.decompress(path.read_bytes())[4] for path in (Path("scene.spz"), two)] == [3, 2]
    assert Path("scene.glb").read_bytes()[:4] == b"glTF"
    with zipfile.ZipFile("scene.sog") as archive:
        assert json.loads(archive.read("meta.json"))["count"] == len(run.scene)
    with pytest.raises(InputError, match=r"version 4 of SPZ"):
        gs2ci.export(run, "spz", "four.spz", as_fitted=True, spz_version=4)


def test_lengths_that_spz_cannot_hold_are_said_to_be_rescaled(run, gs2ci, capsys):
    scene = run.scene
    scene.means *= 1e5
    scene.log_scales += np.log(1e5)
    (run.folder / "scene.ply").unlink()
    write_ply(run.folder / "scene.ply", scene)
    assert gs2ci("export", "run", "--to", "spz", "--as-fitted", "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    (told,) = answer["notes"]
    scale = float(re.search(r"are (\S+) times those of the run", told)[1])
    np.testing.assert_allclose(
        gsply.read_spz("scene.spz").means / scale, scene.means.numpy() * (1, -1, -1), rtol=0, atol=2.0
    )


def test_gaussians_too_far_away_for_spz_are_brought_nearer_and_said_to_be(run):
    scene = run.scene
    direction = scene.means[0] / scene.means[0].norm()
    scene.means[0], scene.log_scales[0] = 1e9 * direction, scene.log_scales[0] + 10
    heard = gs2ci.Silent()
    write_ply(run.folder / "scene.ply", scene)
    gs2ci.export("run", "spz", as_fitted=True, progress=heard)
    assert heard.sentences[0].startswith(f"1 of {len(scene)} Gaussians lie so much farther away")
    found = gsply.read_spz("scene.spz").means * (1, -1, -1)
    np.testing.assert_allclose(found[0] / np.linalg.norm(found[0]), direction, atol=0.01)
    scene.log_scales[1], scene.log_scales[2] = 16, -18
    write_ply(run.folder / "scene.ply", scene)
    with pytest.raises(InputError, match="under one scale for all"):
        gs2ci.export("run", "spz", "none.spz", as_fitted=True)


def test_a_known_unit_stands_in_a_glb_files_node(run):
    told = replace(run, _scene=run.scene)
    geometry = a_geometry(unit_of="stage")
    report = run.report.model_copy(update={"provenance": {"source": "rig"}, "geometry": geometry})
    told.__dict__["report"] = report
    whole = gs2ci.export(told, "glb", as_fitted=True).read_bytes()
    assert _json_of(whole)["nodes"][0]["scale"] == [1e-3] * 3


def _json_of(glb):
    return json.loads(glb[20 : 20 + int.from_bytes(glb[12:16], "little")])


@pytest.mark.parametrize(
    ("source", "space"),
    [
        ("rig", "lin_rec709_display"),
        ("simulated rig", "lin_rec709_display"),
        ("", "lin_rec709_display"),  # with the simulator's plan in the report
        ("kobe.mat", "srgb_rec709_display"),
    ],
)
def test_a_glb_file_calls_colours_light_where_readings_are_known_to_be(run, source, space):
    told = replace(run, _scene=run.scene)
    report = run.report.model_copy(update={"provenance": {"source": source}, "simulation": None if source else {}})
    told.__dict__["report"] = report
    heard = gs2ci.Silent()
    whole = gs2ci.export(told, "glb", as_fitted=True, progress=heard).read_bytes()
    (primitive,) = _json_of(whole)["meshes"][0]["primitives"]
    assert primitive["extensions"]["KHR_gaussian_splatting"]["colorSpace"] == space
    assert any(space in line for line in heard.sentences)


def test_a_folder_for_nerfstudio_is_what_its_parser_reads(run):
    """As nerfstudio's own parser goes through a folder; what it asks of a transforms.json stands in the schema."""
    folder = gs2ci.export(run, "nerfstudio", "studio")
    transforms = json.loads((folder / "transforms.json").read_text())
    schema = json.loads(Path(__file__).with_name("nerfstudio.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(transforms, schema)
    for wrong in ({"camera_model": "PINHOLES"}, {"w": 32.5}, {"frames": []}, {"val_filenames": "views/a.png"}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({**transforms, **wrong}, schema)
    with pytest.raises(jsonschema.ValidationError, match="dependency"):
        jsonschema.validate({key: value for key, value in transforms.items() if key != "val_filenames"}, schema)
    for frame in transforms["frames"]:
        assert (folder / frame["file_path"]).is_file()
        rotation = np.array(frame["transform_matrix"])[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(rotation) > 0
    # It takes the points through the same transform as the poses: they lie before the cameras, whose axes are OpenGL's.
    points = np.asarray(trimesh.load(folder / transforms["ply_file_path"]).vertices)
    seen = np.linalg.inv(np.array(transforms["frames"][1]["transform_matrix"])) @ np.c_[points, np.ones(len(points))].T
    assert (seen[2] < 0).all()
    across = transforms["fl_x"] * seen[0] / -seen[2] + transforms["cx"]
    assert np.median(np.abs(across / transforms["w"] - 0.5)) < 0.5


def test_nerfstudio_finds_depth_in_the_unit_of_the_poses_and_a_split(run):
    """Its own split has no view to judge by below ten (E4); it multiplies what it reads by a thousandth."""
    folder = gs2ci.export(run, "nerfstudio", "studio")
    transforms = json.loads((folder / "transforms.json").read_text())
    read = np.stack([np.load(folder / frame["depth_file_path"]) * 1e-3 for frame in transforms["frames"]])
    np.testing.assert_allclose(read, run.depth, rtol=1e-6)
    files = {frame["file_path"] for frame in transforms["frames"]}
    trained, judged = set(transforms["train_filenames"]), set(transforms["val_filenames"])
    assert (len(judged), trained | judged, trained & judged) == (1, files, set())
    assert transforms["test_filenames"] == transforms["val_filenames"]


@pytest.mark.parametrize(("unit", "place"), [(1e-3, 0.0), (1.0, 300.0), (1e6, -2e7)])
def test_instant_ngps_box_holds_the_scene_in_any_unit(run, unit, place):
    """As it reads a folder: places times `scale` plus `offset`, within a cube round a half (E5)."""
    path = run.path.copy()
    path[:, :3, 3] = unit * path[:, :3, 3] - path[:, :3, :3] @ np.full(3, place)
    moved = replace(run, path=path, depth=run.depth * np.float32(unit))
    moved.__dict__["report"] = run.report
    cameras = nerfstudio_transforms(path, run.intrinsics, (24, 32), None)
    (run.folder / "cameras.json").write_text(json.dumps(cameras))
    folder = gs2ci.export(moved, "instant-ngp", f"ngp{unit}")
    transforms = json.loads((folder / "transforms.json").read_text())
    points = points_module.surface_points(moved.depth, exports._cameras(moved), run.depth_confidence)
    eyes = np.array([frame["transform_matrix"] for frame in transforms["frames"]])[:, :3, 3]
    for places, least in ((points, 0.99), (eyes, 1.0)):
        inside = np.abs(places * transforms["scale"] + transforms["offset"] - 0.5) <= transforms["aabb_scale"] / 2
        assert inside.all(axis=1).mean() >= least
    assert transforms["aabb_scale"] in (1, 2, 4, 8, 16, 32, 64, 128)
    assert "k3" not in transforms
    assert all((folder / frame["file_path"]).is_file() for frame in transforms["frames"])


def test_a_k3_that_instant_ngp_knows_not_is_said(run):
    heard = gs2ci.Silent()
    bent = replace(run, distortion=np.array([0, 0, 0, 0, 0.01]))
    gs2ci.export(bent, "instant-ngp", progress=heard)
    assert heard.sentences == ["instant-ngp knows no k3; that of this lens, 0.01, is left out."]


def test_a_colmap_model_of_distorted_pictures_says_who_needs_them_straight(run):
    heard = gs2ci.Silent()
    gs2ci.export(replace(run, distortion=np.array([0.1, 0, 0, 0, 0])), "colmap", progress=heard)
    assert [("image_undistorter" in sentence) for sentence in heard.sentences] == [True]


def test_cameras_and_pictures_for_colmap_and_nerfstudio_tell_the_same(run):
    model = pycolmap.Reconstruction(str(gs2ci.export(run, "colmap", "model") / "sparse" / "0"))
    folder = gs2ci.export(run, "nerfstudio", "studio")
    transforms = json.loads((folder / "transforms.json").read_text())
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
    provenance = {"metadata": told, "taken_at": "2026-11-23T01:02:03+00:00", "source": "rig"}
    geometry = a_geometry(unit_of="stage")
    report = run.report.model_copy(update={"provenance": provenance, "geometry": geometry})
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
            # UDUNITS knows neither scene units nor pixels nor full scales: "" is no unit, "1" a share.
            assert entry["depth/depth"].attrs["units"] == ("" if opened is plain else "mm")
            assert f"in {'scene units' if opened is plain else 'mm'}" in entry["depth/depth"].attrs["long_name"]
            assert [data[name].attrs["units"] for name in ("views", "x", "y", "view")] == ["1", "", "", ""]
            (notes,) = by_class(entry, "NXnote")
            assert notes["type"].asstr()[()] == "application/json"
            assert json.loads(notes["data"].asstr()[()])["name"] == run.report.name
            assert entry["title"].asstr()[()] == run.report.name
            cameras = entry["instrument/detector/cameras"]
            np.testing.assert_array_equal(cameras["world_to_camera"], run.path)
            unit = "scene units" if opened is plain else "mm"
            assert cameras["world_to_camera"].attrs["description"].endswith(f"lengths in {unit}")
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


@pytest.mark.parametrize(
    "to", ["gif", "mp4", "nexus", "ply", "spz", "sog", "glb", "colmap", "nerfstudio", "instant-ngp"]
)
def test_a_disk_that_fills_up_is_told_by_the_name_of_the_output_and_leaves_nothing(run, tmp_path, to):
    folder = tmp_path / "full"
    folder.mkdir()
    target = folder / exports.FORMATS[to].name
    with small_files(), pytest.raises(StorageError, match="cannot be written") as told:
        gs2ci.export(run, to, target)
    assert told.value.problem.startswith(str(target))
    assert f"{folder}/." not in told.value.problem
    assert told.value.problem.count(str(folder)) <= 2  # of a folder, also the file in it
    assert list(folder.iterdir()) == []


def test_a_picture_that_the_disk_cuts_is_told(tmp_path):
    """OpenCV's own writing says that it is written."""
    views = np.random.default_rng(0).random((2, 64, 64, 3), np.float32)
    with small_files(), pytest.raises(StorageError, match=r"view_000\.png cannot be written: File too large"):
        write_pictures(tmp_path / "views", views)
    with small_files(), pytest.raises(StorageError, match=r"depth_000\.png cannot be written: File too large"):
        depth_files.write_depth_png(tmp_path, views[..., 0], "mm")


def test_depth_as_png_and_exr(run):
    folder = gs2ci.export(run, "depth-png", "png")
    told = json.loads((folder / "depth.json").read_text())
    step = told["unit_per_step"]
    assert told["unit"] == "scene units"
    read = np.stack([cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted(folder.glob("*.png"))])
    assert read.dtype == np.uint16
    np.testing.assert_allclose(read * step, run.depth, atol=0.51 * step)
    OpenEXR = pytest.importorskip("OpenEXR")
    maps = sorted(gs2ci.export(run, "depth-exr", "exr").glob("*.exr"))
    read = np.stack([OpenEXR.File(str(path)).channels()["Z"].pixels for path in maps])
    np.testing.assert_array_equal(read, run.depth)
    header = OpenEXR.File(str(maps[0])).header()
    assert (header["unit"], header["unknownDepth"]) == ("scene units", 0.0)
    assert "0: no depth" in header["comments"]
    texts = imageio.immeta(folder / "depth_000.png")
    assert (texts["unit"], texts["unknown"]) == ("scene units", "0")
    assert float(texts["unit_per_step"]) == step


def test_what_is_not_seen_has_a_reading_of_its_own(tmp_path):
    depth = np.float32([[[0.0, 1e-9, 5.0]]])
    depth_files.write_depth_png(tmp_path, depth, "mm")
    assert json.loads((tmp_path / "depth.json").read_text())["unit"] == "mm"
    assert cv2.imread(str(tmp_path / "depth_000.png"), cv2.IMREAD_UNCHANGED).tolist() == [[0, 1, 65535]]
    with pytest.raises(StorageError, match="cannot be written"):
        depth_files.write_depth_png(tmp_path / "nowhere", depth, "mm")
    with pytest.raises(StorageError, match="cannot be written"):
        depth_files.write_depth_exr(tmp_path / "nowhere", depth)


def test_a_pixel_near_infinity_leaves_the_steps_of_the_others_short(tmp_path):
    depth = np.linspace(190, 210, 400, dtype=np.float32).reshape(1, 20, 20)
    depth[0, 0, 0], depth[0, 0, 1] = 9e6, 0
    step = depth_files.write_depth_png(tmp_path, depth, "mm")
    told = json.loads((tmp_path / "depth.json").read_text())
    read = cv2.imread(str(tmp_path / "depth_000.png"), cv2.IMREAD_UNCHANGED)
    assert (read[0, 0], read[0, 1]) == (told["this_or_farther"], told["unknown"])
    np.testing.assert_allclose(read.flat[2:] * step, depth.flat[2:], rtol=2e-3)


def test_exr_without_its_package_says_what_to_do(run, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "OpenEXR", None)
    with pytest.raises(InputError, match=r"needs the package OpenEXR.*depth-png.*gs2ci\[exr\]"):
        gs2ci.export(run, "depth-exr")


LEVELS = np.linspace(0, 1, 6)


@pytest.fixture
def film(run, monkeypatch):
    """An MP4 of six even frames from black to white, whose odd last row and column are shown twice."""
    frames = np.float32(LEVELS)[:, None, None, None] * np.ones((6, 25, 33, 3), np.float32)
    monkeypatch.setattr(exports, "orbit", lambda run: frames)
    return gs2ci.export(run, "mp4")


def test_ffprobe_reads_a_film(film):
    if shutil.which("ffprobe") is None:
        pytest.skip("no ffprobe on this machine")
    wanted = "stream=codec_name,width,height,pix_fmt,avg_frame_rate,nb_read_frames,color_space,color_primaries,"
    wanted += "color_transfer:format=format_name,duration"
    asked = ["ffprobe", "-v", "error", "-count_frames", "-show_entries", wanted, "-of", "json", film]
    told = json.loads(subprocess.run(asked, capture_output=True, check=True).stdout)
    (stream,) = told["streams"]
    assert (stream["codec_name"], stream["width"], stream["height"]) == ("vp9", 34, 26)
    assert (stream["pix_fmt"], stream["avg_frame_rate"], stream["nb_read_frames"]) == ("yuv420p", "24/1", "6")
    assert "mp4" in told["format"]["format_name"].split(",")
    colours = [stream[name] for name in ("color_space", "color_primaries", "color_transfer")]
    assert colours == ["smpte170m", "bt709", "iec61966-2-1"]
    assert float(told["format"]["duration"]) == pytest.approx(6 / 24, abs=0.01)


def test_a_browser_plays_a_film(film, tab, tmp_path):
    page, held = tmp_path / "film.html", base64.b64encode(film.read_bytes()).decode()
    # Within the page: a script may not read the pixels of another file.
    page.write_text(f'<video src="data:video/mp4;base64,{held}" muted preload="auto"></video>')
    tab.open(page, 400)
    show = """(async () => {
        const film = document.querySelector("video");
        if (film.readyState < 2) await new Promise((done, no) => { film.onloadeddata = done; film.onerror = no; });
        const paint = Object.assign(document.createElement("canvas"), {width: 1, height: 1}).getContext("2d");
        const levels = [];
        const level = () => {
            paint.drawImage(film, 0, 0, 1, 1);
            return paint.getImageData(0, 0, 1, 1).data[0] / 255;
        };
        for (let frame = 0; frame < 6; frame++) {
            film.currentTime = (frame + 0.5) / 24;
            await new Promise(done => { film.onseeked = done; });
            // A busy browser may have found a frame before it can paint it: every frame has a level of its own.
            for (let tries = 0; frame > 0 && tries < 100 && Math.abs(level() - levels[frame - 1]) < 0.05; tries++)
                await new Promise(done => setTimeout(done, 20));
            levels.push(level());
        }
        return [film.videoWidth, film.videoHeight, film.duration, levels];
    })()"""
    width, height, duration_s, levels = tab.run(show)
    assert (width, height) == (34, 26)
    assert duration_s == pytest.approx(6 / 24, abs=0.01)
    np.testing.assert_allclose(levels, LEVELS, atol=0.06)


def test_films_of_an_orbit(run, film):
    path, frames = film, exports.orbit(run)
    read = imageio.imread(gs2ci.export(run, "gif"), index=None)
    assert read.shape == (6, 25, 33, 3)
    np.testing.assert_allclose(read.mean(axis=(1, 2, 3)) / 255, LEVELS, atol=0.02)
    reader = cv2.VideoCapture(str(path))
    levels = []
    while (read := reader.read())[0]:
        assert read[1].shape == (26, 34, 3)
        levels.append(read[1].mean() / 255)
    np.testing.assert_allclose(levels, LEVELS, atol=0.06)
    with pytest.raises(InputError, match=r"\.gif or \.mp4"):
        orbit.write_film(path.with_suffix(".avi"), frames)
    with pytest.raises(InputError, match="cannot be encoded or written"):
        orbit.write_film(path.parent / "nowhere" / "o.mp4", frames)
    with pytest.raises(StorageError):
        orbit.write_film(path.parent / "nowhere" / "o.gif", frames)


@pytest.mark.parametrize("count", [1, 5, 24, 48])
def test_a_gif_lasts_as_long_as_its_frames_at_their_rate(tmp_path, count):
    """Delays of a GIF are hundredths of a second: 24 frames a second played at 25 (E6)."""
    draws = np.random.default_rng(1)
    path = orbit.write_film(tmp_path / "film.gif", draws.random((count, 7, 9, 3), np.float32))
    with Image.open(path) as film:
        lasts = [frame.info["duration"] for frame in ImageSequence.Iterator(film)] if count > 1 else [40]
    assert sum(lasts) == pytest.approx(1000 * count / 24, abs=5)
    assert set(lasts) <= {40, 50}


@pytest.mark.parametrize("size", [(24, 32), (25, 32), (24, 33), (7, 9)])
def test_a_film_keeps_the_last_row_and_column(tmp_path, size):
    frames = np.zeros((3, *size, 3), np.float32)
    frames[:, -1:], frames[:, :, -1:] = 1, 1
    held = cv2.VideoCapture(str(orbit.write_film(tmp_path / "film.mp4", frames))).read()[1]
    assert held.shape[0] >= size[0]
    assert held[size[0] - 1, : size[1] // 2].mean() > 120
    assert held[: size[0] // 2, size[1] - 1].mean() > 120


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
    errors = trimesh.load("m.ply").metadata["_ply_raw"]["vertex"]["data"]["standard_error"]
    assert errors.min() > 0
    assert gs2ci("mesh", "run", "--voxels", 24, "-o", "m.ply") == 2
    assert "--overwrite" in capsys.readouterr().err


def with_geometry(folder, **changes):
    """The same run, as if its report said something else."""
    report = json.loads((folder / "report.json").read_text())
    report["geometry"].update(changes)
    (folder / "report.json").write_text(json.dumps(report))
    return gs2ci.open_run(folder)


def test_depth_without_a_camera_path_is_not_handed_on(run, examples):
    still = with_geometry(examples / "run", verdict="rotation_only")
    for to in ("depth-png", "depth-exr"):
        with pytest.raises(InputError, match="no camera path was found"):
            gs2ci.export(still, to, "there")
    with pytest.raises(InputError, match="no camera path was found"):
        gs2ci.mesh(still, "there.ply")
    with pytest.raises(InputError, match="no camera path was found"):
        gs2ci.measure(still, (8, 12), (24, 12))
    assert not (examples / "there").exists()
    with h5py.File(gs2ci.export(still, "nexus")) as file:
        assert "depth" not in file["entry"]


def test_the_mesh_of_a_moving_scene_is_what_the_middle_view_sees(run, examples):
    report = json.loads((examples / "run" / "report.json").read_text())
    own = dict.fromkeys(("explained", "blocks", "gaussians_share", "pixels_share", "median_px", "most_px"))
    moves = {"asked": "auto", "tried": True, "moves": True, "heldout_rms": {}, "chosen": "moving", **own}
    (examples / "run" / "report.json").write_text(json.dumps({**report, "motion": moves}))
    # A thing that is nearest in the middle view, the third.
    np.save(examples / "run" / "depth.npy", run.depth * np.float32([2, 2, 1, 2])[:, None, None])
    ahead = trimesh.load(gs2ci.mesh("run", "moving.ply", voxels=32)).vertices @ run.path[2, 2, :3] + run.path[2, 2, 3]
    assert ahead.max() < 1.05 * run.depth[2].max()


def test_places_that_are_taken_and_parts_that_are_missing_are_refused(run, gs2ci, capsys, examples):
    assert gs2ci("export", "run", "--to", "colmap", "-o", "there") == 0
    (examples / "there" / "images" / "view_007.png").touch()
    assert gs2ci("export", "run", "--to", "colmap", "-o", "there") == 2
    assert "--overwrite" in capsys.readouterr().err
    assert gs2ci("export", "run", "--to", "colmap", "-o", "there", "--overwrite") == 0
    assert not (examples / "there" / "images" / "view_007.png").exists()
    assert not list(examples.glob(".there*"))
    with pytest.raises(InputError, match="no depth"):
        exports.mesh(replace(run, depth=None), "none.ply")
    with pytest.raises(InputError, match="no folder yet"):
        exports.export(replace(run, folder=None), "ply")
    with pytest.raises(InputError, match="holds no Gaussian"):
        exports.orbit(replace(run, _scene=run.scene.map(lambda tensor: tensor[:0])))
    with pytest.raises(InputError, match="--to obj"):
        exports.export(run, "obj")
    shutil.rmtree(examples / "run" / "colmap")
    with pytest.raises(StorageError, match="cannot be written"):
        exports.export(run, "colmap", "x")


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


FOLDERS = ["colmap", "nerfstudio", "instant-ngp", "depth-png", "depth-exr"]


@pytest.mark.parametrize("to", FOLDERS)
@pytest.mark.parametrize("other", ["mine.txt", "images/holiday.png", "sparse/0/project.ini", "views/a/view_000.png"])
def test_a_folder_that_holds_anything_but_an_earlier_export_is_not_replaced(run, examples, to, other):
    kept = examples / "precious" / other
    kept.parent.mkdir(parents=True)
    kept.write_text("years of work")
    before = contents(examples)
    with pytest.raises(StorageError, match=r"holds something other than an export.*choose another place"):
        gs2ci.export("run", to, "precious", overwrite=True)
    assert contents(examples) == before


@pytest.mark.parametrize("to", FOLDERS)
def test_an_earlier_export_and_an_empty_folder_are_replaced(run, examples, to):
    if to == "depth-exr":
        pytest.importorskip("OpenEXR")
    (examples / "place").mkdir()
    first = contents(gs2ci.export("run", to, "place", overwrite=True))
    (examples / "place" / max(first)).write_bytes(b"")
    assert contents(gs2ci.export("run", to, "place", overwrite=True)) == first
    with pytest.raises(StorageError, match="place exists"):
        gs2ci.export("run", to, "place")


@pytest.mark.parametrize("end", [OSError, KeyboardInterrupt])
def test_an_earlier_export_stays_if_the_new_one_cannot_take_its_place(run, examples, monkeypatch, end):
    first = contents(gs2ci.export("run", "colmap", "place"))
    rename = Path.rename

    def refused(self, target):
        if self.name == "place" and self.parent != Path():
            raise end("refused")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refused)
    with pytest.raises(end if end is KeyboardInterrupt else StorageError, match="refused"):
        gs2ci.export("run", "colmap", "place", overwrite=True)
    assert contents(Path("place")) == first


@pytest.mark.parametrize("to", exports.FORMATS)
@pytest.mark.parametrize("place", ["run", "link", "run/views", "run/colmap", "run/scene.ply", "run/report.json"])
def test_a_run_is_not_replaced_by_its_export(run, examples, to, place):
    (examples / "link").symlink_to("run")
    before = contents(examples)
    with pytest.raises((InputError, StorageError)):
        gs2ci.export("run", to, place, overwrite=True)
    with pytest.raises(StorageError, match="belongs to the run folder"):
        gs2ci.mesh("run", place, overwrite=True)
    assert contents(examples) == before


def test_a_new_file_in_the_run_folder_is_written_once(run):
    assert gs2ci.export("run", "spz", "run/scene.spz").is_file()
    with pytest.raises(StorageError, match=r"belongs to the run folder.*replaces nothing"):
        gs2ci.export("run", "spz", "run/scene.spz", overwrite=True)


def test_a_folder_is_not_replaced_by_a_file_nor_a_file_by_a_folder(run, examples):
    (examples / "folder").mkdir()
    (examples / "file").write_text("mine")
    with pytest.raises(StorageError, match="folder is not a file, and is not replaced"):
        gs2ci.export("run", "spz", "folder", overwrite=True)
    with pytest.raises(StorageError, match="file is not a folder, and is not replaced"):
        gs2ci.export("run", "colmap", "file", overwrite=True)
    assert (examples / "file").read_text() == "mine"
    assert gs2ci.export("run", "spz", "file", overwrite=True).stat().st_size > 100


def test_a_name_with_the_ending_of_another_format_is_refused(run, examples):
    before = contents(examples)
    for to, name in (("gif", "b.mp4"), ("mp4", "a.gif"), ("spz", "s.ply"), ("nexus", "n.spz"), ("colmap", "c.ply")):
        with pytest.raises(
            InputError, match=rf"--to {to} into {name}; allowed: a name like {exports.FORMATS[to].name}"
        ):
            gs2ci.export("run", to, name)
    with pytest.raises(InputError, match=r"--to ply into s\.SPLAT; allowed: a name like scene\.ply"):
        gs2ci.export("run", "ply", "s.SPLAT")
    with pytest.raises(InputError, match=r"a mesh, which is PLY, into m\.obj; allowed: a name like mesh\.ply"):
        gs2ci.mesh("run", "m.obj")
    assert contents(examples) == before


def test_a_folder_that_does_not_exist_is_named(run):
    for write in (lambda: gs2ci.export("run", "spz", "new/dir/s.spz"), lambda: gs2ci.mesh("run", "new/dir/m.ply")):
        with pytest.raises(StorageError, match=r"there is no folder new/dir; what to do: create it"):
            write()


def test_damaged_parts_are_not_copied(run, examples):
    for picture in (examples / "run" / "views").iterdir():
        picture.write_bytes(b"")
    for to, inside in (("nerfstudio", "views"), ("colmap", "images")):
        for path, view in zip(sorted((gs2ci.export("run", to) / inside).iterdir()), run.views, strict=True):
            np.testing.assert_array_equal(imageio.imread(path), np.round(255 * np.clip(view, 0, 1)).astype(np.uint8))
    scene = examples / "run" / "scene.ply"
    scene.write_bytes(scene.read_bytes()[:600])
    for to in ("ply", "spz"):
        with pytest.raises(InputError, match=r"scene\.ply"):
            gs2ci.export("run", to, f"x.{to}")
    scene.unlink()
    with pytest.raises(InputError, match=r"scene\.ply"):
        gs2ci.export("run", "ply", "x.ply")
    assert not list(examples.glob("x.*"))
