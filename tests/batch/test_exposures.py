import os
from pathlib import Path

import h5py
import numpy as np
import pytest

from gs2ci.batch.exposures import largest_pixels, list_exposures
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.records import Shot
from gs2ci.core.storage import write_shots


def file_of(path, count=1, side_px=4):
    path.parent.mkdir(exist_ok=True)
    masks = np.ones((2, side_px, side_px), np.float32)
    one = Shot(measurement=np.ones((side_px, side_px, 1), np.float32), masks=masks, weights=np.ones(2, np.float32))
    return write_shots(path, [one] * count)


def damaged(path, *rows):
    with h5py.File(path, "r+") as file:
        for row in rows:
            file["meas"][row] = np.nan
    return path


def test_every_exposure_of_every_file_has_a_name_of_its_own(tmp_path):
    found = list_exposures([file_of(tmp_path / "a.h5", 2), file_of(tmp_path / "b.h5")], every=True)
    assert [(one.name, one.index) for one in found] == [("a-000", 0), ("a-001", 1), ("b-000", 0)]


def test_without_every_it_is_the_same_one_of_each(tmp_path):
    files = [file_of(tmp_path / "a.h5", 2), file_of(tmp_path / "b.h5", 2)]
    assert [(one.name, one.index) for one in list_exposures(files, every=False, index=1)] == [
        ("a-001", 1),
        ("b-001", 1),
    ]


def test_files_of_one_name_are_told_apart_by_their_folders(tmp_path):
    files = [file_of(tmp_path / day / "shot.h5") for day in ("monday", "tuesday")]
    assert [one.name for one in list_exposures(files, every=True)] == ["monday-shot-000", "tuesday-shot-000"]


def test_names_that_differ_in_capitals_alone_are_told_apart_as_some_disks_would_not(tmp_path):
    files = [file_of(tmp_path / "x" / "A.h5"), file_of(tmp_path / "y" / "a.h5")]
    assert [one.name for one in list_exposures(files, every=True)] == ["x-A-000", "y-a-000"]


def test_a_name_is_fit_for_a_shell_and_an_address(tmp_path):
    (one,) = list_exposures([file_of(tmp_path / "first try (2).h5")], every=True)
    assert one.name == "first_try_2_-000"


def test_a_path_that_is_not_utf_8_is_refused_before_the_work(tmp_path):
    file = file_of(tmp_path / "a.h5").rename(os.fsdecode(os.fsencode(tmp_path) + b"/m\xe4.h5"))
    with pytest.raises(InputError, match=r"not UTF-8.*rename"):
        list_exposures([file], every=True)


def test_a_file_that_is_named_twice_counts_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = file_of(tmp_path / "a.h5")
    assert len(list_exposures([file, Path("a.h5")], every=True)) == 1


def test_files_whose_names_cannot_be_told_apart_are_refused(tmp_path):
    with pytest.raises(InputError, match="differ in spaces"):
        list_exposures([file_of(tmp_path / "a b.h5"), file_of(tmp_path / "a_b.h5")], every=True)


def test_no_file_at_all_is_refused():
    with pytest.raises(InputError, match="no shot file"):
        list_exposures([], every=True)


def test_an_index_beyond_a_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="has no exposure 1"):
        list_exposures([file_of(tmp_path / "a.h5")], every=False, index=1)


def test_a_file_without_exposures_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("gs2ci.batch.exposures.count_shots", lambda _: 0)
    with pytest.raises(InputError, match="holds no exposure"):
        list_exposures([file_of(tmp_path / "a.h5")], every=True)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(StorageError, match=r"none\.h5"):
        list_exposures([tmp_path / "none.h5"], every=True)


@pytest.mark.parametrize(("bad", "pixels"), [((), 2 * 8 * 8), ((0,), 2 * 8 * 8), ((0, 1), 2 * 4 * 4)])
def test_the_largest_exposure_of_all_files_is_found_past_damaged_ones(tmp_path, bad, pixels):
    files = [file_of(tmp_path / "a.h5"), damaged(file_of(tmp_path / "b.h5", 2, side_px=8), *bad)]
    assert largest_pixels(list_exposures(files, every=True)) == pixels


def test_the_largest_of_damaged_exposures_alone_is_nothing(tmp_path):
    assert largest_pixels(list_exposures([damaged(file_of(tmp_path / "a.h5"), 0)], every=True)) == 0
