"""The row-by-row writer: raw counts, order of writes, refusals, and the death of the process."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.records import Truth
from gs2ci.core.storage import (
    CaptureHeader,
    FrameRow,
    ShotWriter,
    count_shots,
    layout,
    read_shot,
    recover,
    sealing,
    write_shots,
)
from gs2ci.core.storage.guarded_file import GuardedFile
from gs2ci.core.storage.padding import stored_end
from tests.manifests import assert_manifest_fits


@pytest.fixture
def header():
    masks = np.ones((2, 6, 8), np.float32)
    return CaptureHeader(
        rows=3,
        channels=1,
        masks=masks,
        weights=np.ones(2, np.float32),
        offset_dn=100.0,
        scale_dn=1000.0,
        saturation_dn=4095.0,
        stage_axes=1,
        telemetry=True,
        truth_views="u1",
        truth_poses=True,
        saturated_map=True,
        calibration={"calib/dark": np.full((6, 8), 3.5, np.float32)},
        name="bench",
    )


def test_counts_become_full_scales_of_one_view_and_clipped_ones_are_marked(tmp_path, header):
    counts = np.full((6, 8), 1100, np.uint16)
    counts[2, 3] = 4095
    with ShotWriter(tmp_path / "shot.h5", header) as writer:
        writer.append(counts)
        writer.finish()
    shot = read_shot(tmp_path / "shot.h5")
    assert shot.measurement.shape == (6, 8, 1)
    assert shot.measurement[0, 0, 0] == 1.0
    assert np.argwhere(shot.saturated).tolist() == [[2, 3]]
    assert shot.name == "bench"
    with h5py.File(tmp_path / "shot.h5") as file:
        assert file["calib/dark"][0, 0] == 3.5


def per_pixel(header, **changes):
    flat = np.full((6, 8), 0.5, np.float32)
    maps = {"calib/dark": np.full((6, 8), 50.0, np.float32), "calib/flat": flat, **changes}
    return replace(header, per_pixel=True, calibration=maps)


def test_each_pixels_own_dark_and_sensitivity_are_used_where_the_header_says_so(tmp_path, header):
    with ShotWriter(tmp_path / "shot.h5", per_pixel(header)) as writer:
        writer.append(np.full((6, 8), 1050, np.uint16))
        writer.finish()
    assert read_shot(tmp_path / "shot.h5").measurement == pytest.approx(1000 / (0.5 * 1000))


def test_the_lens_is_in_the_file_and_survives_a_recovery(tmp_path, header):
    camera, lens = np.array([[9.0, 0, 4], [0, 9, 3], [0, 0, 1]]), np.array([-0.1, 0.01, 1e-3, -2e-3, 0.0])
    bent = replace(header, intrinsics=camera, distortion=lens)
    with ShotWriter(tmp_path / "shot.h5", bent) as writer:
        writer.append(np.full((6, 8), 1100, np.uint16))
    recover(tmp_path / "shot.h5.partial", tmp_path / "saved.h5")
    with h5py.File(tmp_path / "saved.h5") as file:
        assert file["camera/distortion"].dtype == "f8"
    shot = read_shot(tmp_path / "saved.h5")
    assert np.array_equal(shot.distortion, lens)
    assert np.array_equal(shot.intrinsics, camera)


def test_a_lens_without_a_camera_matrix_makes_no_file(tmp_path, header):
    with pytest.raises(InputError, match="without intrinsics"):
        ShotWriter(tmp_path / "shot.h5", replace(header, distortion=np.zeros(5)))
    assert list(tmp_path.iterdir()) == []


def test_per_pixel_maps_survive_a_recovery_and_are_checked_on_reading(tmp_path, header):
    with ShotWriter(tmp_path / "shot.h5", per_pixel(header)) as writer:
        writer.append(np.full((6, 8), 1050, np.uint16))
    recover(tmp_path / "shot.h5.partial", tmp_path / "saved.h5")
    assert read_shot(tmp_path / "saved.h5").measurement == pytest.approx(2.0)
    for spoil in (0.0, np.nan):
        with h5py.File(tmp_path / "saved.h5", "r+") as file:
            file["calib/flat"][2, 3] = spoil
        with pytest.raises(StorageError, match="per_pixel"):
            read_shot(tmp_path / "saved.h5")
    with h5py.File(tmp_path / "saved.h5", "r+") as file:
        del file["calib/flat"]
    with pytest.raises(StorageError, match="per_pixel"):
        read_shot(tmp_path / "saved.h5")


@pytest.mark.parametrize(
    "changes",
    [
        {"calib/flat": np.zeros((6, 8), np.float32)},
        {"calib/dark": np.full((6, 8), np.nan, np.float32)},
        {"calib/flat": np.ones((6, 7), np.float32)},
    ],
)
def test_per_pixel_maps_that_cannot_be_used_are_refused_before_the_capture(tmp_path, header, changes):
    with pytest.raises(StorageError, match="per-pixel dark and flat"):
        ShotWriter(tmp_path / "shot.h5", per_pixel(header, **changes))
    assert list(tmp_path.iterdir()) == []


def test_a_row_carries_everything_said_about_it(tmp_path, header):
    views = np.full((2, 6, 8, 1), 51 / 255, np.float32)
    poses = np.tile(np.eye(4), (2, 1, 1))
    frame = FrameRow(7, 11, 13, 1, 5, np.array([[1.25], [1.5]]), np.array([1.0]))
    clipped = np.eye(6, 8, dtype=bool)
    depth = np.linspace(0, 3, 2 * 6 * 8, dtype=np.float32).reshape(2, 6, 8)
    with ShotWriter(tmp_path / "shot.h5", replace(header, truth_depth=True)) as writer:
        writer.event("armed", exposure_s=0.01)
        writer.append(
            np.zeros((6, 8, 1), np.uint16),
            frame=frame,
            telemetry_world_to_camera=poses,
            truth=Truth(views, 2 * poses, depth),
            saturated=clipped,
            name="first",
            provenance={"camera": "twin"},
        )
        writer.append(np.zeros((6, 8), np.uint16))
        writer.finish()
    shot, bare = (read_shot(tmp_path / "shot.h5", k) for k in (0, 1))
    assert np.array_equal(shot.truth.views, views)
    assert np.array_equal(shot.truth.world_to_camera, 2 * poses)
    assert np.array_equal(shot.truth.depth, depth)
    assert np.array_equal(shot.telemetry_world_to_camera, poses)
    assert np.array_equal(shot.saturated, clipped)
    assert (shot.name, shot.provenance) == ("first", {"camera": "twin"})
    assert set(vars(bare.truth).values()) == {None}
    assert bare.telemetry_world_to_camera is None
    assert not bare.saturated.any()
    with h5py.File(tmp_path / "shot.h5") as file:
        assert file["frames/sequence"][0] == 7
        assert file["frames/trigger_index"][0] == 5
        assert file["frames/stage_pos"][0].tolist() == [[1.25], [1.5]]
        assert file["frames/stage_target"][0].tolist() == [[1.0], [1.0]]
        assert b"exposure_s" in file["events"][0]


def test_only_finished_rows_count(tmp_path, header):
    with ShotWriter(tmp_path / "shot.h5", header) as writer:
        writer.append(np.zeros((6, 8), np.uint16))
        writer.finish()
    assert count_shots(tmp_path / "shot.h5") == 1


def test_a_row_can_be_read_back_before_the_file_is_finished(tmp_path, header):
    writer = ShotWriter(tmp_path / "shot.h5", header)
    with writer:
        for value in (100, 1100):
            writer.append(np.full((6, 8), value, np.uint16))
        assert [float(writer.shot(row).measurement.mean()) for row in (0, 1)] == [0.0, 1.0]
        for row in (2, -1):
            with pytest.raises(StorageError, match=f"row {row} of 2 written"):
                writer.shot(row)
        before = writer.shot(1)
        writer.finish()
    np.testing.assert_array_equal(read_shot(tmp_path / "shot.h5", 1).measurement, before.measurement)
    with pytest.raises(StorageError, match="closed"):
        writer.shot(0)


def test_leaving_without_finish_keeps_the_rows_in_the_partial(tmp_path, header):
    with ShotWriter(tmp_path / "shot.h5", header) as writer:
        writer.append(np.full((6, 8), 600, np.uint16))
    assert [p.name for p in tmp_path.iterdir()] == ["shot.h5.partial"]
    with pytest.raises(StorageError, match=r"interrupted before its end.*gs2ci recover"):
        read_shot(tmp_path / "shot.h5.partial")
    recover(tmp_path / "shot.h5.partial", tmp_path / "saved.h5")
    assert read_shot(tmp_path / "saved.h5").measurement[0, 0, 0] == 0.5


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"reading": np.zeros((6, 8), np.float32)}, "reading: dtype float32"),
        ({"reading": np.zeros((8, 6), np.uint16)}, r"reading: shape \[8, 6\]"),
        ({"telemetry_world_to_camera": np.eye(4)}, r"telemetry/world_to_camera: shape"),
        ({"telemetry_world_to_camera": np.full((2, 4, 4), np.nan)}, "NaN or infinite"),
        ({"truth": Truth(np.full((2, 6, 8, 1), 0.123, np.float32))}, "between the steps of 1/255"),
        ({"saturated": np.zeros((2, 2), bool)}, "saturated: shape"),
        ({"frame": FrameRow(stage_pos_mm=np.zeros(3))}, "stage_pos: shape"),
    ],
)
def test_a_row_that_does_not_fit_is_refused_and_does_not_count(tmp_path, header, row, message):
    with ShotWriter(tmp_path / "shot.h5", header) as writer:
        with pytest.raises(StorageError, match=message):
            writer.append(**{"reading": np.zeros((6, 8), np.uint16), **row})
        assert writer.rows_written == 0
        writer.append(np.zeros((6, 8), np.uint16))
        writer.finish()


def test_parts_that_the_header_did_not_announce_are_refused(tmp_path):
    bare = CaptureHeader(1, 1, np.ones((1, 2, 2), np.float32), np.ones(1, np.float32))
    with ShotWriter(tmp_path / "shot.h5", bare) as writer, pytest.raises(StorageError, match="not announced"):
        writer.append(np.zeros((2, 2), np.uint16), saturated=np.zeros((2, 2), bool))


def test_the_writer_refuses_more_rows_than_announced_and_any_after_the_end(tmp_path, header):
    zero = np.zeros((6, 8), np.uint16)
    with ShotWriter(tmp_path / "shot.h5", header) as writer:
        with pytest.raises(StorageError, match="no row was written"):
            writer.finish()
        for _ in range(3):
            writer.append(zero)
        with pytest.raises(StorageError, match="row 3 in a file laid out for 3"):
            writer.append(zero)
        writer.finish()
        with pytest.raises(StorageError, match="closed"):
            writer.append(zero)
        with pytest.raises(StorageError, match="closed"):
            writer.event("late")


def test_what_json_cannot_say_is_an_input_error(tmp_path, header):
    with ShotWriter(tmp_path / "shot.h5", header) as writer:
        with pytest.raises(InputError, match="JSON"):
            writer.event("odd", value=object())
        with pytest.raises(InputError, match="JSON"):
            writer.append(np.zeros((6, 8), np.uint16), provenance={"x": float("nan")})
        writer.append(np.zeros((6, 8), np.uint16), provenance={"x": np.float32(1.5), "y": np.arange(2)})
        writer.finish()
    assert read_shot(tmp_path / "shot.h5").provenance == {"x": 1.5, "y": [0, 1]}


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"rows": 0}, StorageError, "capture of 0 rows"),
        ({"scale_dn": 0.0}, StorageError, "positive scale"),
        ({"offset_dn": float("nan")}, StorageError, "finite offset"),
        ({"calibration": {"calib/gain": np.zeros((6, 8))}}, StorageError, "calib/gain"),
        ({"masks": np.zeros((2, 6, 8), np.float32)}, InputError, "all masks are zero"),
        ({"masks": np.zeros((6, 8), np.float32)}, InputError, "masks have shape"),
    ],
)
def test_a_header_that_contradicts_itself_leaves_nothing_behind(tmp_path, header, changes, error, message):
    broken = CaptureHeader(**{**header.__dict__, **changes})
    with pytest.raises(error, match=message):
        ShotWriter(tmp_path / "shot.h5", broken)
    assert list(tmp_path.iterdir()) == []


def test_a_capture_never_replaces_a_finished_file_or_an_unfinished_one(tmp_path, header, make_shot):
    write_shots(tmp_path / "shot.h5", [make_shot()])
    with pytest.raises(StorageError, match="already exists"):
        ShotWriter(tmp_path / "shot.h5", header)
    (tmp_path / "folder.h5").mkdir()
    with pytest.raises(StorageError, match=r"folder\.h5: is a folder; allowed: the name of a file"):
        write_shots(tmp_path / "folder.h5", [make_shot()])
    with ShotWriter(tmp_path / "other.h5", header):
        pass
    with pytest.raises(StorageError, match=r"unfinished capture.*gs2ci recover"):
        write_shots(tmp_path / "other.h5", [make_shot()])


@pytest.mark.parametrize("name", ["missing/shot.h5", "shot", "shot.json", "shot.npz", "shot.h5.partial"])
def test_impossible_names_are_refused(tmp_path, make_shot, name):
    with pytest.raises(StorageError):
        write_shots(tmp_path / name, [make_shot()])
    assert list(tmp_path.iterdir()) == []


def test_a_foreign_json_file_beside_the_capture_is_not_overwritten(tmp_path, make_shot):
    (tmp_path / "shot.json").write_text("{}")
    with pytest.raises(StorageError, match="manifest belongs there"):
        write_shots(tmp_path / "shot.h5", [make_shot()])
    assert (tmp_path / "shot.json").read_text() == "{}"


def test_shots_of_different_masks_share_a_file_that_holds_each_mask_once(tmp_path, make_shot):
    one = make_shot()
    shots = [one, make_shot(masks=one.masks[::-1]), make_shot(masks=1 - one.masks), make_shot(masks=one.masks)]
    path = write_shots(tmp_path / "shot.h5", shots)
    assert [np.array_equal(read_shot(path, i).masks, shot.masks) for i, shot in enumerate(shots)] == [True] * 4
    with h5py.File(path) as file:
        count = len(one.masks)
        assert len(file["masks/calib"]) == 2 * count
        assert file["masks/order"][:3].tolist() == [
            list(range(count)),
            list(range(count))[::-1],
            list(range(count, 2 * count)),
        ]
    again = recover(path, tmp_path / "again.h5")
    assert [np.array_equal(read_shot(again, i).masks, shot.masks) for i, shot in enumerate(shots)] == [True] * 4


@pytest.mark.parametrize("order", [None, [0], [0, 2], [0, -1]])
def test_an_order_of_masks_that_there_are_not_is_refused(tmp_path, header, order):
    with ShotWriter(tmp_path / "shot.h5", replace(header, mask_order=True)) as writer:
        with pytest.raises(StorageError, match="row 0, masks/order"):
            writer.append(np.zeros((6, 8), np.uint16), mask_order=order)
        assert writer.rows_written == 0


def test_an_order_of_masks_that_was_not_announced_is_refused(tmp_path, header):
    with (
        ShotWriter(tmp_path / "shot.h5", header) as writer,
        pytest.raises(StorageError, match=r"masks/order.*allowed: what the header announces"),
    ):
        writer.append(np.zeros((6, 8), np.uint16), mask_order=list(range(header.views)))


def test_shots_of_different_cameras_do_not_share_a_file(tmp_path, make_shot):
    one = make_shot()
    for other, word in [
        (make_shot(masks=one.masks[1:], weights=one.weights[1:], truth=Truth()), "number of masks"),
        (make_shot(weights=one.weights * 0.5), "weights"),
        (make_shot(intrinsics=None), "intrinsics"),
        (make_shot(distortion=np.array([-0.1, 0, 0, 0, 0])), "distortion"),
        (make_shot(channels=1), "channels"),
    ]:
        with pytest.raises(StorageError, match=word):
            write_shots(tmp_path / "shot.h5", [one, other])
    with pytest.raises(StorageError, match="no shots"):
        write_shots(tmp_path / "shot.h5", [])
    assert list(tmp_path.iterdir()) == []


def test_an_error_on_the_way_leaves_nothing_half_written(tmp_path, make_shot):
    with pytest.raises(InputError, match="JSON"):
        write_shots(tmp_path / "shot.h5", [make_shot(), make_shot(provenance={"x": object()})])
    assert list(tmp_path.iterdir()) == []


def test_a_refusing_disk_is_a_storage_error_that_names_the_row(tmp_path, header, monkeypatch):
    with ShotWriter(tmp_path / "shot.h5", header) as writer:

        def full() -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(writer._file, "flush", full, raising=False)
        with pytest.raises(StorageError, match="row 0 cannot be written") as refused:
            writer.append(np.zeros((6, 8), np.uint16))
        assert refused.value.remedy == "free the disk"  # there is no row that could be saved
        with pytest.raises(StorageError, match=r"event 'fault' cannot be written.*free the disk"):
            writer.event("fault")
        assert writer.rows_written == 0


def test_a_disk_without_room_is_refused_before_hdf5_meets_it(tmp_path, header, make_shot, monkeypatch):
    """A write that fails inside HDF5 ends the process by a segmentation fault."""
    free = SimpleNamespace(free=1_000_000)
    monkeypatch.setattr(sealing.shutil, "disk_usage", lambda _: free)
    with pytest.raises(StorageError, match=r"the disk has 1\.0 MB free; allowed: 1\.1 MB or more"):
        write_shots(tmp_path / "shot.h5", [make_shot()])
    assert list(tmp_path.iterdir()) == []
    free.free = 10_000_000
    with ShotWriter(tmp_path / "shot.h5", header) as writer:
        writer.append(np.zeros((6, 8), np.uint16))
        free.free = 1_000_000
        with pytest.raises(StorageError, match="the disk has"):
            writer.append(np.zeros((6, 8), np.uint16))
    free.free = 10_000_000
    assert count_shots(recover(tmp_path / "shot.h5.partial", tmp_path / "saved.h5")) == 1


FULL_AFTER_ALL = """
import os, resource, sys, numpy as np
from pathlib import Path
from gs2ci.core.errors import StorageError
from gs2ci.core.storage import CaptureHeader, ShotWriter
masks = np.ones((2, 480, 640), np.float32)
writer = ShotWriter(Path(sys.argv[1]), CaptureHeader(9, 1, masks, np.ones(2, np.float32)))
resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, -1))
try:
    for row in range(9):
        writer.append(np.full((480, 640), row, np.uint16))
except StorageError as error:
    print(writer.rows_written, error.problem, error.remedy, flush=True)
"""


@pytest.mark.parametrize("end", ["", "writer.close()", "writer.event('failed')", "writer.finish()"])
def test_a_write_that_the_disk_refuses_after_all_is_an_error_and_no_valid_row(tmp_path, end):
    """A limit on the size of files, as a quota sets one, is met in the middle of a row; the process ends as usual."""
    closing = f"try:\n    {end}\nexcept StorageError as error:\n    print(error.problem)\n" if end else ""
    words = [sys.executable, "-c", FULL_AFTER_ALL + closing, str(tmp_path / "shot.h5")]
    ended = subprocess.run(words, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert not ended.stderr
    assert ended.stdout.startswith("3 ")
    assert "row 3 cannot be written" in ended.stdout
    assert "File too large allow larger files (`ulimit -f`); save the rows before it" in ended.stdout
    assert f"gs2ci recover {tmp_path / 'shot.h5.partial'}" in ended.stdout
    if end:
        assert len(ended.stdout.splitlines()) == 2
    recover(tmp_path / "shot.h5.partial", tmp_path / "saved.h5")
    assert [read_shot(tmp_path / "saved.h5", row).measurement.max() for row in range(3)] == [0, 1, 2]
    assert count_shots(tmp_path / "saved.h5") == 3


@pytest.mark.parametrize("cut", [1, 1000, 614_404, 614_405, 1_800_000])
def test_rows_before_a_missing_end_are_saved_from_a_file_that_hdf5_refuses(tmp_path, cut):
    masks, size = np.ones((2, 480, 640), np.float32), (480, 640)
    with ShotWriter(tmp_path / "shot.h5", CaptureHeader(6, 1, masks, np.ones(2, np.float32))) as writer:
        for row in range(6):
            writer.append(np.full(size, row + 1, np.uint16))
    partial = tmp_path / "shot.h5.partial"
    whole = partial.stat().st_size
    os.truncate(partial, whole - cut)
    with pytest.raises(OSError, match="truncated"):
        h5py.File(partial)
    recover(partial, tmp_path / "saved.h5")
    assert partial.stat().st_size == whole - cut
    saved = count_shots(tmp_path / "saved.h5")
    assert saved == 6 - -(-cut // 614_404)  # a reading and its checksum
    # The zeros that stand for the missing end are nobody's reading.
    for row in range(saved):
        assert np.unique(read_shot(tmp_path / "saved.h5", row).measurement) == [row + 1]


def test_a_file_that_claims_to_lack_more_than_any_disk_holds_is_damaged(tmp_path, header):
    with ShotWriter(tmp_path / "shot.h5", header) as writer:
        writer.append(np.zeros((6, 8), np.uint16))
    partial = tmp_path / "shot.h5.partial"
    data = bytearray(partial.read_bytes())
    assert stored_end(partial) == len(data)
    data[40:48] = (2**60).to_bytes(8, "little")
    partial.write_bytes(data)
    with pytest.raises(StorageError, match="truncated, damaged or locked"):
        recover(partial, tmp_path / "saved.h5")


def test_rows_are_synchronised_with_the_storage_device_where_that_is_asked_for(tmp_path, header, monkeypatch):
    synchronised = []

    def sync_it(file):
        synchronised.append(file)

    monkeypatch.setattr(GuardedFile, "sync", sync_it)
    for sync in (False, True):
        with ShotWriter(tmp_path / "shot.h5", header, replace=True, sync=sync) as writer:
            writer.append(np.zeros((6, 8), np.uint16))
            writer.append(np.zeros((6, 8), np.uint16))
        writer.partial.unlink()
        assert len(synchronised) == 2 * sync


def test_a_disk_that_refuses_the_rename_is_a_storage_error(tmp_path, header, monkeypatch):
    def refuse(source: object, target: object) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "replace", refuse)
    with ShotWriter(tmp_path / "shot.h5", header) as writer:
        writer.append(np.zeros((6, 8), np.uint16))
        with pytest.raises(StorageError, match="cannot be finished"):
            writer.finish()
    assert (tmp_path / "shot.h5.partial").exists()


def test_a_file_that_cannot_be_created_or_laid_out_is_a_storage_error(tmp_path, header, monkeypatch):
    tmp_path.joinpath("locked").mkdir()

    def refuse(*_: object, **__: object) -> None:
        raise OSError(13, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", refuse)
        with pytest.raises(StorageError, match=r"cannot be created: .*Permission denied"):
            ShotWriter(tmp_path / "locked" / "shot.h5", header)
    with monkeypatch.context() as patch:
        patch.setattr(layout, "create", refuse)
        with pytest.raises(StorageError, match="cannot be laid out"):
            ShotWriter(tmp_path / "locked" / "shot.h5", header)
    assert list((tmp_path / "locked").iterdir()) == []


def test_whatever_else_goes_wrong_in_laying_out_leaves_no_file(tmp_path, header, monkeypatch):
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(layout, "create", stop)
    with pytest.raises(KeyboardInterrupt):
        ShotWriter(tmp_path / "shot.h5", header)
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_refuses_the_end_is_a_storage_error(tmp_path, header, monkeypatch):
    def full() -> None:
        raise OSError(28, "No space left on device")

    for method, message in (("flush", "cannot be finished"), ("close", "cannot be closed")):
        writer = ShotWriter(tmp_path / f"{method}.h5", header)
        writer.append(np.zeros((6, 8), np.uint16))
        file = writer._file
        with monkeypatch.context() as patch:
            patch.setattr(file, method, full, raising=False)
            with pytest.raises(StorageError, match=message):
                writer.finish()
        file.close()


def test_an_unreadable_file_in_the_manifests_place_is_not_overwritten(tmp_path, make_shot):
    (tmp_path / "shot.json").write_bytes(b"\xff\xfe\xff")
    with pytest.raises(StorageError, match="manifest belongs there"):
        write_shots(tmp_path / "shot.h5", [make_shot()])


WRITER = """
import sys, numpy as np
from pathlib import Path
from gs2ci.core.storage import CaptureHeader, ShotWriter, FrameRow
masks = np.ones((2, 48, 64), np.float32)
header = CaptureHeader(5000, 1, masks, np.ones(2, np.float32), telemetry=True)
writer = ShotWriter(Path(sys.argv[1]), header)
for row in range(5000):
    writer.append(
        np.full((48, 64), row, np.uint16), frame=FrameRow(sequence=row, trigger_index=row),
        telemetry_world_to_camera=np.full((2, 4, 4), row, float), provenance={"row": row},
    )
    writer.event("fired", index=row)
    print(row, flush=True)
"""


@pytest.mark.parametrize("delay_s", [0.0, 0.013, 0.031, 0.077])
def test_a_killed_writer_leaves_every_finished_row_readable(tmp_path, delay_s):
    path = tmp_path / "shot.h5"
    process = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(delay_s)
    process.send_signal(signal.SIGKILL)
    reported = int((["0", *process.stdout.read().split()])[-1])
    process.stdout.close()
    process.wait()
    partial = tmp_path / "shot.h5.partial"
    before = partial.read_bytes()
    recover(partial, tmp_path / "saved.h5")
    assert partial.read_bytes() == before
    assert_manifest_fits(tmp_path / "saved.h5")
    count = count_shots(tmp_path / "saved.h5")
    assert count >= reported + 1
    for row in range(0, count, max(1, count // 5)):
        shot = read_shot(tmp_path / "saved.h5", row)
        assert (shot.measurement == row).all()
        assert (shot.telemetry_world_to_camera == row).all()
        assert shot.provenance == {"row": row}
    with h5py.File(tmp_path / "saved.h5") as file:
        assert b'"recovered"' in file["events"][-1]
        assert len(file["events"]) >= count


def test_a_manifest_that_the_disk_refuses_leaves_the_whole_file_and_nothing_half_written(
    tmp_path, make_shot, monkeypatch
):
    done = os.replace

    def full(source, target):
        if str(target).endswith(".json"):
            raise OSError(28, "No space left on device")
        done(source, target)

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(StorageError, match=r"shot.json cannot be written.*the rows are in .*shot.h5"):
        write_shots(tmp_path / "shot.h5", [make_shot()])
    assert [path.name for path in tmp_path.iterdir()] == ["shot.h5"]
    assert count_shots(tmp_path / "shot.h5") == 1
