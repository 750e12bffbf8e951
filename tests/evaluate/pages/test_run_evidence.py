import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from gs2ci.api.runs import open_run
from gs2ci.core.errors import InputError, StorageError
from gs2ci.evaluate.pages import run_evidence as module
from gs2ci.evaluate.pages.run_evidence import check_same_shot, read_run, write_given
from gs2ci.evaluate.pages.run_page import write_run_page


def test_what_was_written_reads_back(whole_run, make_run):
    shot, result = make_run(count=8, size=(48, 64))
    found = read_run(whole_run)
    np.testing.assert_array_equal(found.views, result.views)
    np.testing.assert_array_equal(found.decode, result.decode)
    np.testing.assert_array_equal(found.scene_views, result.scene_views)
    np.testing.assert_array_equal(found.depth, result.depth)
    np.testing.assert_allclose(found.world_to_camera, result.world_to_camera, atol=1e-9)
    np.testing.assert_array_equal(found.true_world_to_camera, shot.truth.world_to_camera)
    np.testing.assert_array_equal(found.stage_world_to_camera, shot.truth.world_to_camera)
    np.testing.assert_allclose(found.true_views / 255, shot.truth.views, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(found.intrinsics, result.intrinsics)
    assert found.report.name == "waves"


def test_the_measurement_is_shown_up_to_its_brightest_samples(whole_run):
    measurement = read_run(whole_run).measurement
    assert measurement.max() == 255
    assert np.median(measurement) > 20


def test_a_dark_measurement_stays_dark(tmp_path, make_run):
    shot, _ = make_run()
    write_given(tmp_path / "given.npz", replace(shot, measurement=0 * shot.measurement))
    assert np.load(tmp_path / "given.npz")["measurement"].max() == 0


@pytest.mark.parametrize("name", ["report.json", "views.npy", "decode.npy", "scene_views.npy", "cameras.json"])
def test_a_part_that_is_missing_is_one_typed_error(own_run, name):
    (own_run / name).unlink()
    with pytest.raises(StorageError, match=r"cannot be read"):
        read_run(own_run)


@pytest.mark.parametrize(
    ("name", "field"), [("depth.npy", "depth"), ("disagreement.npy", "disagreement"), ("given.npz", "true_views")]
)
def test_a_part_that_may_be_missing_is_none(own_run, name, field):
    (own_run / name).unlink()
    assert getattr(read_run(own_run), field) is None


@pytest.mark.parametrize("keep", [0, 1, 40, 0.5, 0.999])
@pytest.mark.parametrize(
    "name",
    [
        "report.json",
        "views.npy",
        "decode.npy",
        "scene_views.npy",
        "depth.npy",
        "disagreement.npy",
        "cameras.json",
        "given.npz",
    ],
)
def test_a_part_cut_short_is_one_typed_error(own_run, name, keep):
    path = own_run / name
    content = path.read_bytes()
    path.write_bytes(content[: keep if keep >= 1 or not keep else int(keep * len(content))])
    with pytest.raises(StorageError):
        read_run(own_run)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("views.npy", np.zeros((8, 48, 64, 4), np.float32)),
        ("views.npy", np.zeros((0, 48, 64, 3), np.float32)),
        ("views.npy", np.zeros((8, 48, 64), np.float32)),
        ("views.npy", np.zeros((8, 48, 64, 3), np.int32)),
        ("decode.npy", np.zeros((7, 48, 64, 3), np.float32)),
        ("scene_views.npy", np.zeros((8, 48, 63, 3), np.float32)),
        ("depth.npy", np.zeros((8, 48, 63), np.float32)),
        ("depth.npy", np.zeros((8, 48, 64, 1), np.float32)),
        ("disagreement.npy", np.zeros((7, 48, 64), np.float32)),
    ],
)
def test_arrays_that_do_not_fit_together_are_refused(own_run, name, array):
    np.save(own_run / name, array)
    with pytest.raises(StorageError, match=name):
        read_run(own_run)


def test_pickled_objects_are_never_loaded(own_run):
    np.save(own_run / "views.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(StorageError):
        read_run(own_run)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("measurement", np.zeros((48, 64, 2), np.uint8)),
        ("measurement", np.zeros((48, 64, 3), np.float32)),
        ("true_views", np.zeros((7, 48, 64, 3), np.uint8)),
        ("true_world_to_camera", np.zeros((7, 4, 4))),
        ("stage_world_to_camera", np.full((8, 4, 4), np.nan)),
    ],
)
def test_given_parts_that_do_not_fit_are_refused(own_run, name, array):
    np.savez(own_run / "given.npz", **{name: array})
    with pytest.raises(StorageError, match=r"given\.npz"):
        read_run(own_run)


@pytest.mark.parametrize("name", ["true_world_to_camera", "stage_world_to_camera"])
@pytest.mark.parametrize("poses", [np.zeros((8, 4, 4)), np.tile(np.diag([2.0, 2, 2, 1]), (8, 1, 1))])
def test_poses_that_are_no_rigid_motions_are_not_drawn(own_run, name, poses):
    # The geometry had refused those of a stage and found a path without them; a singular matrix then ended the page.
    np.savez(own_run / "given.npz", **{name: poses})
    assert getattr(read_run(own_run), name) is None
    assert "<svg" in write_run_page(own_run).read_text()


@pytest.mark.parametrize("name", ["views.npy", "decode.npy", "depth.npy"])
def test_a_damaged_header_is_one_typed_error_whatever_numpy_raises(own_run, name):
    content = (own_run / name).read_bytes()
    # An open bracket: numpy's tokeniser raises an error that is none of ValueError, OSError and EOFError.
    (own_run / name).write_bytes(content.replace(b"), }", b" , ("))
    for read in (read_run, open_run):
        with pytest.raises(StorageError, match="cannot be read as a run"):
            read(own_run)


def test_a_damaged_archive_is_one_typed_error(own_run):
    content = bytearray((own_run / "given.npz").read_bytes())
    content[60:90] = bytes([255]) * 30
    (own_run / "given.npz").write_bytes(bytes(content))
    with pytest.raises(StorageError, match="cannot be read as a run"):
        read_run(own_run)


def test_an_archive_that_claims_too_much_is_refused_before_it_is_unpacked(own_run, monkeypatch):
    monkeypatch.setattr(module, "LIMIT_BYTES", 200_000)
    with zipfile.ZipFile(own_run / "given.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("measurement.npy", bytes(1_000_000))
    with pytest.raises(StorageError, match="claims 1000000 bytes"):
        read_run(own_run)


@pytest.mark.parametrize("focal", [0, -1, "long", None])
def test_a_focal_length_that_is_none_is_refused(own_run, focal):
    transforms = json.loads((own_run / "cameras.json").read_text())
    transforms["fl_y"] = focal
    (own_run / "cameras.json").write_text(json.dumps(transforms))
    with pytest.raises(StorageError, match="focal length"):
        read_run(own_run)


@pytest.mark.parametrize("matrix", [[[0] * 4] * 4, [[1, 2]], "text", None])
def test_poses_that_are_none_are_refused(own_run, matrix):
    transforms = json.loads((own_run / "cameras.json").read_text())
    transforms["frames"][3]["transform_matrix"] = matrix
    (own_run / "cameras.json").write_text(json.dumps(transforms))
    with pytest.raises(StorageError):
        read_run(own_run)


@pytest.mark.parametrize("content", ["[]", "{}", '{"schema": "other/1"}', "\xff"])
def test_a_report_of_something_else_is_refused(own_run, content):
    (own_run / "report.json").write_text(content, encoding="latin-1")
    with pytest.raises(StorageError, match=r"report\.json"):
        read_run(own_run)


@pytest.fixture
def same_shot(make_run):
    """The shot of `whole_run`."""
    return make_run(count=8, size=(48, 64))[0]


def test_a_run_is_known_for_that_of_its_shot(own_run, same_shot):
    check_same_shot(own_run, same_shot)
    (own_run / "given.npz").unlink()  # as in a folder of an older version
    check_same_shot(own_run, same_shot)


def test_a_run_of_another_shot_is_refused(own_run, same_shot, make_run):
    other = replace(same_shot, measurement=same_shot.measurement[::-1].copy())
    for shot in (other, make_run(count=7, size=(48, 64))[0], make_run(count=8, size=(48, 64), channels=1)[0]):
        with pytest.raises(InputError, match="of another measurement"):
            check_same_shot(own_run, shot)
    with pytest.raises(StorageError, match="cannot be read"):
        check_same_shot(own_run / "views", same_shot)
