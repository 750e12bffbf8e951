"""The file below HDF5: what the disk takes is on disk, what it refuses is remembered and read back from memory."""

import os
import subprocess
import sys

import h5py
import numpy as np
import pytest

from gs2ci.core.storage.guarded_file import GuardedFile
from gs2ci.core.storage.padding import PaddedFile, stored_end


def read(file, start, count):
    buffer = bytearray(count)
    file.seek(start)
    return bytes(buffer[: file.readinto(memoryview(buffer))])


@pytest.fixture
def refusing(tmp_path, monkeypatch):
    """A file of ten bytes whose disk takes four more and then refuses."""
    file = GuardedFile(tmp_path / "file")
    file.write(b"0123456789")
    real, left = os.pwrite, [4]

    def pwrite(handle, data, offset):
        if not left[0]:
            raise OSError(28, "No space left on device")
        taken = min(left[0], len(data))
        left[0] -= taken
        return real(handle, data[:taken], offset)

    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", pwrite)
        yield file
    file.close()


def test_what_is_written_is_on_disk_and_read_back(tmp_path):
    file = GuardedFile(tmp_path / "file")
    file.write(b"0123456789")
    file.seek(2)
    file.write(b"ab")
    assert read(file, 0, 20) == b"01ab456789"
    file.truncate(12)
    assert read(file, 8, 20) == b"89\0\0"
    assert file.seek(0, os.SEEK_END) == file.tell() == 12
    assert file.readable()
    assert file.writable()
    assert file.seekable()
    file.sync()
    file.check()
    file.close()
    file.close()
    assert (tmp_path / "file").read_bytes() == b"01ab456789\0\0"


def test_a_refused_write_is_remembered_and_read_back_and_nothing_more_reaches_the_disk(refusing, tmp_path):
    refusing.seek(8)
    assert refusing.write(b"abcdefgh") == 8
    with pytest.raises(OSError, match="No space left") as told:
        refusing.check()
    assert told.value.errno == 28
    with pytest.raises(OSError, match="No space left"):
        refusing.sync()
    refusing.seek(0)
    refusing.write(b"XY")
    assert read(refusing, 0, 99) == b"XY234567abcdefgh"
    assert read(refusing, 11, 3) == b"def"
    refusing.truncate(14)
    assert read(refusing, 0, 99) == b"XY234567abcdef"
    assert (tmp_path / "file").read_bytes() == b"01234567abcd"


def test_a_length_that_the_disk_refuses_is_remembered(tmp_path, monkeypatch):
    def refuse(handle, size):
        raise OSError(27, "File too large")

    file = GuardedFile(tmp_path / "file")
    with monkeypatch.context() as patch:
        patch.setattr(os, "ftruncate", refuse)
        assert file.truncate(7) == 7
    with pytest.raises(OSError, match="File too large"):
        file.check()
    assert read(file, 0, 99) == bytes(7)
    file.close()


def test_a_file_that_exists_is_left_alone(tmp_path):
    (tmp_path / "file").write_bytes(b"mine")
    with pytest.raises(FileExistsError):
        GuardedFile(tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == b"mine"


def test_a_refused_file_goes_without_a_word(tmp_path):
    (tmp_path / "file").touch()
    words = """
import sys
from pathlib import Path
from gs2ci.core.storage.guarded_file import GuardedFile
try:
    GuardedFile(Path(sys.argv[1]))
except FileExistsError:
    print("refused")
"""
    # Only then does Python before 3.13 tell of errors in closing.
    command = [sys.executable, "-X", "dev", "-W", "ignore", "-c", words, str(tmp_path / "file")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("refused\n", "")


def test_a_reader_in_another_process_is_refused_meanwhile(tmp_path):
    file = GuardedFile(tmp_path / "file")
    words = "import fcntl, sys; fcntl.flock(open(sys.argv[1]), fcntl.LOCK_SH | fcntl.LOCK_NB)"
    ended = subprocess.run([sys.executable, "-c", words, str(tmp_path / "file")], capture_output=True, check=False)
    assert b"BlockingIOError" in ended.stderr
    file.close()


def test_a_file_system_that_knows_no_locks_is_written_to_all_the_same(tmp_path, monkeypatch):
    def refuse(number):
        def flock(handle, operation):
            raise OSError(number, "refused")

        return flock

    monkeypatch.setattr("fcntl.flock", refuse(95))
    GuardedFile(tmp_path / "unlocked").close()
    monkeypatch.setattr("fcntl.flock", refuse(11))
    with pytest.raises(OSError, match="refused"):
        GuardedFile(tmp_path / "locked")


def test_a_short_file_is_read_as_if_its_end_were_zeros(tmp_path):
    (tmp_path / "file").write_bytes(b"0123456789")
    file = PaddedFile(tmp_path / "file", 14)
    assert file.seek(0, os.SEEK_END) == 14
    assert read(file, 8, 99) == b"89\0\0\0\0"
    assert read(file, 11, 2) == b"\0\0"
    assert file.seek(-1, os.SEEK_CUR) == 12
    assert file.tell() == 12
    assert file.readable()
    assert file.seekable()
    assert not file.writable()
    file.close()
    file.close()


@pytest.mark.parametrize("libver", ["earliest", "v108", "latest"])
def test_the_length_that_a_file_states_is_its_length(tmp_path, libver):
    with h5py.File(tmp_path / "file.h5", "w", libver=libver) as file:
        file["x"] = np.arange(100)
    assert stored_end(tmp_path / "file.h5") == (tmp_path / "file.h5").stat().st_size


@pytest.mark.parametrize("change", [{0: 0}, {8: 9}, {13: 4}], ids=["signature", "version", "offsets"])
def test_a_file_that_does_not_state_its_length_in_a_known_way_states_none(tmp_path, change):
    with h5py.File(tmp_path / "file.h5", "w") as file:
        file["x"] = 1
    data = bytearray((tmp_path / "file.h5").read_bytes())
    for at, value in change.items():
        data[at] = value
    (tmp_path / "file.h5").write_bytes(data)
    assert stored_end(tmp_path / "file.h5") is None
    (tmp_path / "file.h5").write_bytes(data[:20])
    assert stored_end(tmp_path / "file.h5") is None
