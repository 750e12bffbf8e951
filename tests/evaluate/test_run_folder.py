import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
import torch

from gs2ci.core.errors import InputError, NumericsError, StorageError
from gs2ci.core.storage import read_shot
from gs2ci.evaluate import run_folder
from gs2ci.evaluate.report import read_report
from gs2ci.evaluate.run_folder import write_run
from gs2ci.evaluate.whole_folder import check_destination, whole_folder
from gs2ci.reconstruct.registration.misfit import Misfit
from gs2ci.reconstruct.registration.register import Registered
from gs2ci.render.ply import read_ply


@pytest.fixture(autouse=True)
def quick_overview(monkeypatch):
    """Drawing is what takes the time; `test_overview.py` draws."""
    monkeypatch.setattr(run_folder, "write_overview", lambda path, *_: path.touch())


@pytest.fixture
def written(tmp_path, make_run, scene):
    shot, result = make_run()
    return write_run(tmp_path / "deep" / "run", shot, result, scene), shot, result


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_run_folder_holds_all_its_parts_and_nothing_lies_beside_it(written):
    folder, _, _ = written
    wanted = {
        "report.json",
        "report.html",
        "overview.png",
        "given.npz",
        "views.npy",
        "views",
        "decode.npy",
        "scene_views.npy",
        "views_error.npy",
        "depth.npy",
        "depth_error.npy",
        "disagreement.npy",
        "scene.ply",
        "cameras.json",
    }
    assert names(folder) == wanted | {"colmap"}
    assert names(folder.parent) == {"run"}


def test_a_corrected_measurement_is_kept_and_drawn(tmp_path, make_run, scene):
    shot, result = make_run()
    moved = replace(shot, masks=np.roll(shot.masks, 1, axis=2))
    found = Registered(moved, Misfit().moved(0.0, 1.0)).summary()
    folder = write_run(tmp_path / "run", shot, replace(result, registered=moved, registration=found), scene)
    assert {"registered.h5", "registration.png"} <= names(folder)
    np.testing.assert_array_equal(read_shot(folder / "registered.h5").masks, moved.masks)
    picture = cv2.imread(str(folder / "registration.png"))
    assert picture is not None
    assert np.ptp(picture) > 200


def test_a_run_is_written_though_masks_that_do_not_differ_determine_nothing_about_where_they_are(
    tmp_path, make_run, scene
):
    """Standard errors are infinite there; a report that refused them would lose the run after all its work."""
    shot, result = make_run()
    found = replace(Registered(shot), tried={"down_px": (0.0, np.inf), "scale": (0.1, 0.2)}).summary()
    folder = write_run(tmp_path / "run", shot, replace(result, registration=found), scene)
    assert read_report(folder).registration.not_let_in == {"down_px": [0.0, None], "scale": [0.1, 0.2]}


def test_views_are_the_recovered_ones(written):
    folder, _, result = written
    np.testing.assert_array_equal(np.load(folder / "views.npy"), result.views)
    np.testing.assert_array_equal(np.load(folder / "decode.npy"), result.decode)
    np.testing.assert_array_equal(np.load(folder / "depth.npy"), result.depth)
    np.testing.assert_array_equal(np.load(folder / "disagreement.npy"), result.disagreement)
    assert np.load(folder / "views.npy").dtype == np.float32


def test_pictures_are_the_views_in_eight_bits(written):
    folder, _, result = written
    picture = cv2.imread(str(folder / "views" / "view_007.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    np.testing.assert_allclose(picture / 255, np.clip(result.views[7], 0, 1), atol=0.5 / 255 + 1e-6)
    assert len(names(folder / "views")) == 8


def test_mono_views_are_stored_thrice_and_pictured_grey(tmp_path, make_run, scene):
    shot, result = make_run(channels=1)
    folder = write_run(tmp_path / "run", shot, result, scene)
    views = np.load(folder / "views.npy")
    assert views.shape == (8, 48, 64, 3)
    np.testing.assert_array_equal(views[..., 2], result.views[..., 0])
    assert cv2.imread(str(folder / "views" / "view_000.png"), cv2.IMREAD_UNCHANGED).ndim == 2


def test_where_the_decode_is_better_both_are_kept(tmp_path, make_run, scene):
    shot, result = make_run()
    folder = write_run(
        tmp_path / "run",
        shot,
        replace(result, verdict="decode", views=result.decode, depth=None, disagreement=None),
        scene,
    )
    np.testing.assert_array_equal(np.load(folder / "views.npy"), result.decode)
    np.testing.assert_array_equal(np.load(folder / "scene_views.npy"), result.scene_views)
    assert not {"depth.npy", "disagreement.npy"} & names(folder)


def test_cameras_are_those_of_nerfstudio(written):
    folder, _, result = written
    cameras = json.loads((folder / "cameras.json").read_text())
    assert (cameras["w"], cameras["h"], cameras["camera_model"]) == (64, 48, "OPENCV")
    assert cameras["fl_x"] == pytest.approx(result.intrinsics[0, 0])
    assert len(cameras["frames"]) == 8
    for frame, pose in zip(cameras["frames"], result.world_to_camera, strict=True):
        assert (folder / frame["file_path"]).is_file()
        opengl = np.array(frame["transform_matrix"])
        # A point two units along the OpenGL camera's own -z axis lies two units along the OpenCV camera's +z axis.
        ahead = opengl @ [0, 0, -2, 1]
        np.testing.assert_allclose(pose @ ahead, [0, 0, 2, 1], atol=1e-12)
        up = opengl @ [0, 1, 0, 1]
        np.testing.assert_allclose(pose @ up, [0, -1, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("k3", "model", "number"), [(0.002, "FULL_OPENCV", 12), (0.0, "OPENCV", 8)], ids=["with k3", "without"]
)
def test_the_lens_of_the_pictures_is_told_with_the_cameras(tmp_path, make_run, scene, k3, model, number):
    """nerfstudio's and gsplat's readers of COLMAP's models know OPENCV, and stop at FULL_OPENCV."""
    shot, result = make_run()
    lens = np.array([-0.1, 0.01, 1e-3, -1e-3, k3])
    folder = write_run(tmp_path / "run", shot, replace(result, distortion=lens), scene)
    cameras = json.loads((folder / "cameras.json").read_text())
    assert [cameras[key] for key in ("k1", "k2", "p1", "p2", "k3")] == lens.tolist()
    camera = pycolmap.Reconstruction(folder / "colmap" / "sparse" / "0").cameras[1]
    assert (camera.model_name, len(camera.params)) == (model, number)
    np.testing.assert_array_equal(camera.params[4:9], lens[: number - 4])


def test_the_colmap_model_reads_back_in_pycolmap(written, scene):
    folder, _, result = written
    model = pycolmap.Reconstruction(folder / "colmap" / "sparse" / "0")
    assert (model.num_cameras(), model.num_reg_images(), model.num_points3D()) == (1, 8, 50)
    for image in model.images.values():
        assert (folder / "views" / image.name).is_file()
        index = int(image.name.removeprefix("view_").removesuffix(".png"))
        np.testing.assert_allclose(image.cam_from_world().matrix(), result.world_to_camera[index, :3], atol=1e-9)
    camera = model.cameras[1]
    assert camera.model.name == "PINHOLE"
    assert (camera.width, camera.height) == (64, 48)
    np.testing.assert_allclose(camera.params, result.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]])
    first = model.points3D[min(model.points3D)]
    brightest = int(scene.opacity_logits.argmax())
    np.testing.assert_allclose(first.xyz, scene.means[brightest], atol=1e-6)
    np.testing.assert_allclose(first.color / 255, scene.colours[brightest].clamp(0, 1), atol=0.5 / 255 + 1e-6)


def test_the_colmap_cloud_is_thinned_to_the_most_opaque(tmp_path, make_run, scene, monkeypatch):
    monkeypatch.setattr(run_folder, "COLMAP_POINTS", 7)
    folder = write_run(tmp_path / "run", *make_run(), scene)
    model = pycolmap.Reconstruction(folder / "colmap" / "sparse" / "0")
    kept = np.array([point.xyz for point in model.points3D.values()])
    wanted = scene.means[scene.opacity_logits.argsort(descending=True)[:7]]
    np.testing.assert_allclose(np.sort(kept, axis=0), np.sort(wanted, axis=0), atol=1e-6)


def points_seen(folder):
    header = (folder / "points.ply").read_bytes().partition(b"end_header")[0].decode()
    return int(header.split("element vertex")[1].split()[0])


def test_surface_points_are_of_one_moment_if_things_move_and_none_without_a_path(tmp_path, make_run, scene):
    shot, result = make_run(count=4)
    sure = np.full(result.depth.shape, 0.9, np.float32)
    flat = replace(result, depth=np.full_like(sure, 4), depth_spread=1 - sure, depth_confidence=sure)
    inner = 46 * 62
    assert points_seen(write_run(tmp_path / "still", shot, flat, scene)) == 3 * inner
    # Confident in the middle view alone, so that the points can come from no other.
    middle = np.where(np.arange(4)[:, None, None] == 2, sure, 0)
    moving = replace(scene, motion=torch.zeros(len(scene), 1, 3))
    shifted = replace(flat, depth_confidence=middle, displacement=np.zeros((48, 64, 2), np.float32))
    assert points_seen(write_run(tmp_path / "moving", shot, shifted, moving)) == inner
    everywhere = replace(flat, displacement=np.zeros((48, 64, 2), np.float32))
    assert points_seen(write_run(tmp_path / "moving_too", shot, everywhere, moving)) == inner
    at_rest = replace(flat, geometry=replace(flat.geometry, verdict="static"))
    assert not (write_run(tmp_path / "rest", shot, at_rest, scene) / "points.ply").exists()


def test_an_empty_scene_is_written_too(tmp_path, make_run, scene):
    folder = write_run(tmp_path / "run", *make_run(), scene.map(lambda tensor: tensor[:0]))
    assert pycolmap.Reconstruction(folder / "colmap" / "sparse" / "0").num_points3D() == 0


def test_the_scene_reads_back(written, scene):
    folder, _, _ = written
    torch.testing.assert_close(read_ply(folder / "scene.ply").means, scene.means)


def test_the_report_is_readable_and_strict(written):
    folder, _, _ = written
    text = (folder / "report.json").read_text()
    assert "NaN" not in text
    assert "Infinity" not in text
    assert read_report(folder).name == "waves"


def test_a_run_is_not_replaced_unless_asked(written, scene):
    folder, shot, result = written
    with pytest.raises(StorageError, match="not empty"):
        write_run(folder, shot, result, scene)
    (folder / "marker").touch()
    write_run(folder, replace(shot, name="second"), result, scene, overwrite=True)
    assert read_report(folder).name == "second"
    assert "marker" not in names(folder)
    assert names(folder.parent) == {"run"}


def test_a_run_that_another_command_wrote_meanwhile_is_not_replaced_unless_asked(tmp_path):
    folder = tmp_path / "run"
    refused = pytest.raises(StorageError, match=r"run cannot be written: Directory not empty.*choose another")
    with refused, whole_folder(folder) as slower:
        (slower / "report.json").write_text("2")
        folder.mkdir()  # by another process
        (folder / "report.json").write_text("1")
    assert (folder / "report.json").read_text() == "1"
    assert names(tmp_path) == {"run"}


def test_an_empty_folder_is_filled(tmp_path, make_run, scene):
    (tmp_path / "run").mkdir()
    assert "report.json" in names(write_run(tmp_path / "run", *make_run(), scene))


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_of_other_things_is_never_replaced(tmp_path, overwrite):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(StorageError, match=r"not empty|other than a run"):
        check_destination(tmp_path, overwrite=overwrite)
    assert names(tmp_path) == {"thesis.tex"}


def test_a_file_in_the_way_is_refused(tmp_path):
    (tmp_path / "run").touch()
    with pytest.raises(StorageError, match="not a folder"):
        check_destination(tmp_path / "run", overwrite=True)


def test_a_place_that_cannot_be_written_is_refused_before_the_work(tmp_path):
    (tmp_path / "notes.txt").touch()
    with pytest.raises(StorageError, match=r"cannot be written: .*notes\.txt is not a folder"):
        check_destination(tmp_path / "notes.txt" / "run")


def test_a_mounted_volume_is_refused_before_the_work_and_a_folder_in_it_proposed(tmp_path, monkeypatch):
    (tmp_path / "out").mkdir()
    monkeypatch.setattr(Path, "is_mount", lambda path: path.name == "out")
    with pytest.raises(StorageError, match=r"mounted.*-o .*out/run"):
        check_destination(tmp_path / "out")
    check_destination(tmp_path / "out" / "run")


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_nothing_half_written_is_left_when_writing_fails(tmp_path, make_run, scene, monkeypatch, error):
    def fail(*_):
        raise error

    monkeypatch.setattr(run_folder, "write_overview", fail)
    with pytest.raises(error):
        write_run(tmp_path / "run", *make_run(), scene)
    assert names(tmp_path) == set()


def test_an_earlier_run_survives_a_failure(written, scene, monkeypatch):
    folder, shot, result = written
    monkeypatch.setattr(run_folder, "write_ply", lambda *_, **__: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(StorageError, match="disk full"):
        write_run(folder, replace(shot, name="second"), result, scene, overwrite=True)
    assert read_report(folder).name == "waves"
    assert names(folder.parent) == {"run"}


def test_an_earlier_run_is_put_back_when_the_new_one_cannot_take_its_place(tmp_path, monkeypatch):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "report.json").write_text('{"schema": "gs2ci.report/1"}')
    rename = Path.rename

    def refuse_partial(self, target):
        if self.name.endswith(".partial"):
            raise OSError("refused")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refuse_partial)
    with pytest.raises(StorageError, match="refused"), whole_folder(folder, overwrite=True) as partial:
        (partial / "new").touch()
    assert names(folder) == {"report.json"}
    assert names(tmp_path) == {"run"}


@pytest.mark.parametrize("end", [KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("done", [False, True])
@pytest.mark.parametrize("moved", ["run", "partial"])
def test_an_interruption_while_the_folders_change_places_leaves_one_whole(tmp_path, monkeypatch, end, done, moved):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "report.json").write_text('{"schema": "gs2ci.report/1"}')
    rename = Path.rename

    def interrupted(self, target):
        if not self.name.endswith(moved) or self.name.endswith(".old"):
            return rename(self, target)
        monkeypatch.setattr(Path, "rename", rename)
        if done:
            rename(self, target)
        raise end

    monkeypatch.setattr(Path, "rename", interrupted)
    with pytest.raises(end), whole_folder(folder, overwrite=True) as partial:
        (partial / "new").touch()
    assert names(folder) == ({"new"} if done and moved == "partial" else {"report.json"})
    assert names(tmp_path) == {"run"}


def test_a_picture_that_cannot_be_written_is_an_error(tmp_path, make_run, scene, monkeypatch):
    def full(path: Path, content: bytes) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(StorageError, match=r"view_000\.png cannot be written"):
        write_run(tmp_path / "run", *make_run(), scene)
    assert names(tmp_path) == set()


def test_results_that_are_not_finite_or_do_not_fit_never_reach_a_file(tmp_path, make_run, scene):
    shot, result = make_run()
    views = result.views.copy()
    views[0, 0, 0, 0] = np.nan
    with pytest.raises(NumericsError):
        write_run(tmp_path / "run", shot, replace(result, views=views), scene)
    with pytest.raises(InputError):
        write_run(tmp_path / "run", shot, replace(result, decode=result.decode[:3]), scene)
    assert names(tmp_path) == set()


def test_a_link_to_a_folder_leads_to_it(tmp_path, make_run, scene):
    (tmp_path / "store").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "store")
    write_run(tmp_path / "run", *make_run(), scene)
    assert "report.json" in names(tmp_path / "store")
    assert (tmp_path / "run").is_symlink()
