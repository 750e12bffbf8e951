"""A small file appears whole or not at all, whatever the disk, the user or another writer does meanwhile."""

import os
import resource
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from errno import EACCES, ENOSPC, EROFS
from pathlib import Path

import pytest

from gs2ci.core import whole_file
from gs2ci.core.errors import StorageError, reason_of
from gs2ci.core.whole_file import check_earlier, check_place, write_whole


@pytest.fixture
def path(tmp_path):
    """A file with content, alone in its folder."""
    path = tmp_path / "page.html"
    path.write_bytes(b"old")
    return path


@pytest.fixture
def umask():
    """Set the umask for one test."""
    before = os.umask(0o022)
    yield os.umask
    os.umask(before)


@contextmanager
def small_files():
    """Let no file grow beyond 1000 bytes: the first are written, then the disk refuses.

    Around the one call that is asked, since pytest's own output may be a file. Meanwhile Python keeps nothing of what
    it imports, of which versions before 3.14 would leave files that are cut.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    kept, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = kept


def held(folder):
    """Get the names in a folder."""
    return sorted(entry.name for entry in folder.iterdir())


def test_bytes_are_written_as_they_are_and_replace_the_old_ones(path):
    assert write_whole(path, b"\x00\r\n\xff") == path
    assert path.read_bytes() == b"\x00\r\n\xff"
    assert held(path.parent) == ["page.html"]


def test_a_text_is_utf_8_and_keeps_its_line_ends(tmp_path):
    path = write_whole(str(tmp_path / "new.txt"), "one ±\ntwo\n")
    assert path.read_bytes() == b"one \xc2\xb1\ntwo\n"


def test_nothing_at_all_is_a_content(path):
    write_whole(path, "")
    assert path.read_bytes() == b""


def test_old_content_stays_when_the_disk_refuses_midway(path):
    with small_files(), pytest.raises(StorageError, match=r"page\.html cannot be written: File too large") as caught:
        write_whole(path, bytes(100_000))
    assert path.read_bytes() == b"old"
    assert held(path.parent) == ["page.html"]
    assert "free space" in caught.value.remedy
    assert ".partial" not in str(caught.value)


def test_no_file_appears_when_the_first_write_fails(tmp_path):
    with small_files(), pytest.raises(StorageError):
        write_whole(tmp_path / "deep" / "new", bytes(100_000), parents=True)
    assert held(tmp_path / "deep") == []


@pytest.mark.parametrize("error", [OSError(ENOSPC, "No space left on device"), KeyboardInterrupt(), MemoryError()])
def test_whatever_stops_a_write_leaves_the_old_file_alone(path, monkeypatch, error):
    def stop(_descriptor):
        raise error

    monkeypatch.setattr(os, "fsync", stop)
    with pytest.raises(StorageError if isinstance(error, OSError) else type(error)):
        write_whole(path, "new")
    assert path.read_bytes() == b"old"
    assert held(path.parent) == ["page.html"]


def test_the_content_is_on_the_disk_before_the_name_is(path, monkeypatch):
    seen = []
    real = os.fsync

    def look(descriptor):
        seen.append((os.fstat(descriptor).st_size, path.read_bytes()))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", look)
    write_whole(path, "newer")
    assert seen == [(5, b"old")]


@pytest.mark.parametrize(("mask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_permissions_are_what_the_umask_leaves(path, umask, mask, mode):
    path.chmod(0o400)
    umask(mask)
    for written in (write_whole(path, "new"), write_whole(path.with_name("other"), "new")):
        assert written.stat().st_mode & 0o777 == mode


def test_the_umask_is_never_set(path, monkeypatch):
    monkeypatch.delattr(os, "umask")
    write_whole(path, "new")


def test_a_second_writer_in_the_midst_of_the_first_disturbs_neither(path, monkeypatch):
    real = os.fsync

    def overtake(descriptor):
        monkeypatch.setattr(os, "fsync", real)
        write_whole(path, "second")
        assert path.read_text() == "second"
        real(descriptor)

    monkeypatch.setattr(os, "fsync", overtake)
    write_whole(path, "first")
    assert path.read_text() == "first"
    assert held(path.parent) == ["page.html"]


def test_readers_never_see_a_mixture_of_two_writers(path):
    contents = [bytes([letter]) * 50_000 for letter in b"ab"]
    write_whole(path, contents[0])
    with ThreadPoolExecutor(2) as pool:
        writers = [pool.submit(lambda one: [write_whole(path, one) for _ in range(20)], one) for one in contents]
        while not all(writer.done() for writer in writers):
            assert path.read_bytes() in contents
        for writer in writers:
            writer.result()
    assert held(path.parent) == ["page.html"]


def test_missing_folders_are_made_only_where_asked(tmp_path):
    path = tmp_path / "a" / "b" / "file"
    with pytest.raises(StorageError, match="there is no folder"):
        write_whole(path, "new")
    assert held(tmp_path) == []
    assert write_whole(path, "new", parents=True).read_text() == "new"


@pytest.mark.parametrize("parents", [False, True])
@pytest.mark.parametrize("name", ["page.html/file", "page.html/deep/file"])
def test_a_file_where_a_folder_should_be_is_a_clear_error(path, name, parents):
    with pytest.raises(StorageError, match="there is no folder") as caught:
        write_whole(path.parent / name, "new", parents=parents, remedy="turn round")
    assert caught.value.remedy == "turn round"
    assert path.read_bytes() == b"old"


def test_a_folder_that_may_not_be_written_is_a_clear_error(path, monkeypatch):
    def refuse(self, *_):
        raise PermissionError(EACCES, "Permission denied", str(self))

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(StorageError, match=r"page\.html cannot be written: Permission denied") as caught:
        write_whole(path, "new")
    assert ".partial" not in str(caught.value)
    assert held(path.parent) == ["page.html"]


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo])
def test_what_is_no_file_is_never_replaced(tmp_path, make):
    path = tmp_path / "thing"
    make(path)
    with pytest.raises(StorageError, match="something other than a file") as caught:
        write_whole(path, "new")
    assert "move it away" in caught.value.remedy
    assert not path.is_file()
    assert held(tmp_path) == ["thing"]


def test_a_link_is_replaced_and_its_target_left_alone(path):
    link = path.with_name("link")
    link.symlink_to(path)
    write_whole(link, "new")
    assert not link.is_symlink()
    assert (link.read_text(), path.read_text()) == ("new", "old")


def test_a_name_as_long_as_names_may_be_is_written(tmp_path):
    path = write_whole(tmp_path / ("ü" * 127 + "x"), "new")
    assert path.read_text() == "new"


def test_a_name_too_long_is_a_clear_error(tmp_path):
    with pytest.raises(StorageError, match="File name too long"):
        write_whole(tmp_path / ("x" * 256), "new")
    assert held(tmp_path) == []


def test_a_text_that_utf_8_cannot_hold_is_a_clear_error(path):
    with pytest.raises(StorageError, match=r"holds '\\udcff'") as caught:
        write_whole(path, "python -m tests.tables \udcff.npz")
    assert "not UTF-8" in caught.value.remedy
    assert path.read_bytes() == b"old"


def test_a_place_is_fit_before_the_work_and_left_as_it_was(tmp_path):
    check_place(tmp_path / "run")
    check_place(tmp_path / "missing" / "deeper" / "run")
    assert held(tmp_path) == []


def test_a_place_where_nothing_can_be_made_is_refused_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(StorageError, match=r"file/run cannot be written: .*file is not a folder; what to do: .*-o"):
        check_place(tmp_path / "file" / "run")

    def refuse(**_):
        raise OSError(EROFS, "Read-only file system")

    monkeypatch.setattr(whole_file.tempfile, "mkdtemp", refuse)
    with pytest.raises(StorageError, match=r"run cannot be written: .*Read-only file system"):
        check_place(tmp_path / "missing" / "run")


@pytest.mark.parametrize("name", ["a" * 250, "測" * 82, "a" * 300])
@pytest.mark.parametrize("place", ["{}", "missing/{}", "{}/run"])
def test_too_long_a_name_is_refused_before_the_work(tmp_path, name, place):
    with pytest.raises(StorageError, match=r"cannot be written: .*File name too long; what to do: .* shorter name"):
        check_place(tmp_path / place.format(name))
    assert held(tmp_path) == []


@pytest.mark.parametrize("content", [b"", b"mine", b"\x89HDF\r\n", b" " * 5000 + b"made by us"])
def test_only_an_earlier_file_of_the_kind_may_be_replaced(path, content):
    check_earlier(path.with_name("new"), b"made by us", "a table")
    path.write_bytes(b"<!-- made by us --> and more")
    check_earlier(path, b"made by us", "a table")
    path.write_bytes(content)
    with pytest.raises(StorageError, match=r"page\.html exists and is not a table of gs2ci.*move the file away"):
        check_earlier(path, b"made by us", "a table")
    link = path.with_name("link")
    link.symlink_to(path)
    with pytest.raises(StorageError, match="link exists and is not a table"):
        check_earlier(link, b"made by us", "a table")


def test_a_folder_a_pipe_and_what_cannot_be_read_may_not_be_replaced(path):
    os.mkfifo(path.with_name("pipe"))
    for place in (path.parent, path.with_name("pipe")):
        with pytest.raises(StorageError, match="is not a table of gs2ci"):
            check_earlier(place, b"made by us", "a table")
    with pytest.raises(StorageError, match="cannot be read: File name too long"):
        check_earlier(path.with_name("x" * 300), b"made by us", "a table")


def test_a_disk_that_took_a_part_of_an_array_is_said_to_be_full():
    told = reason_of(OSError("163840 requested and 102368 written"))  # by numpy's tofile
    assert told.startswith("the disk took only a part of the values (163840 requested")
    assert reason_of(OSError(28, "No space left on device", "x.npy")) == "No space left on device"
