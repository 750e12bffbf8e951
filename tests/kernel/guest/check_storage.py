"""Shots on a real disk that runs full, and under a limit on the size of files: what is written stays readable."""

import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gs2ci.core.errors import StorageError
from gs2ci.core.storage import CaptureHeader, ShotWriter, count_shots, read_shot, recover

ROW_BYTES = 480 * 640 * 2
WRITER = """
import resource, sys, numpy as np
from contextlib import suppress
from pathlib import Path
from gs2ci.core.errors import StorageError
from gs2ci.core.storage import CaptureHeader, ShotWriter
path, limit, how = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
masks = np.ones((2, 480, 640), np.float32)
writer = ShotWriter(path, CaptureHeader(40, 1, masks, np.ones(2, np.float32)), sync=how == "sync")
if limit:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, -1))
try:
    for row in range(40):
        writer.append(np.random.default_rng(row).integers(0, 4096, (480, 640)).astype(np.uint16))
        print(row, flush=True)
        if how == "fill" and row == 2:  # somebody else fills the disk
            with (path.parent / "other").open("wb", buffering=0) as other, suppress(OSError):
                while other.write(bytes(100_000)):
                    pass
except StorageError as error:
    print("refused:", error.problem, flush=True)
"""


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "disk"
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64m", "none", str(folder)], check=True)
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def write(path: Path, limit: int = 0, how: str = "") -> tuple[int, str]:
    """Write until it is refused, in a process of its own; return how many rows it told of, and the refusal."""
    words = [sys.executable, "-c", WRITER, str(path), str(limit), how]
    ended = subprocess.run(words, capture_output=True, text=True, check=False, timeout=300)
    assert ended.returncode == 0, ended.stderr
    *told, last = ended.stdout.splitlines()
    return len(told), last


def rows_of(path: Path) -> list[np.ndarray]:
    return [read_shot(path, row).measurement for row in range(count_shots(path))]


@pytest.mark.parametrize("sync", ["", "sync"])
def test_rows_survive_a_limit_on_the_size_of_files(tmp_path: Path, sync: str) -> None:
    told, last = write(tmp_path / "shot.h5", 6_000_000, sync)
    assert 1 <= told < 40
    assert "refused:" in last
    saved = recover(tmp_path / "shot.h5.partial", tmp_path / "saved.h5")
    assert count_shots(saved) == told
    assert len({row.tobytes() for row in rows_of(saved)}) == told


def test_rows_survive_a_disk_that_runs_full(small_disk: Path, tmp_path: Path) -> None:
    told, last = write(small_disk / "shot.h5", how="fill")
    assert 3 <= told < 40
    assert "refused:" in last
    saved = recover(small_disk / "shot.h5.partial", tmp_path / "saved.h5")
    assert count_shots(saved) == told


def test_rows_survive_a_process_that_is_killed(tmp_path: Path) -> None:
    words = [sys.executable, "-u", "-c", WRITER, str(tmp_path / "shot.h5"), "0", "sync"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for _ in range(3):
            process.stdout.readline()
        process.send_signal(signal.SIGKILL)
    saved = recover(tmp_path / "shot.h5.partial", tmp_path / "saved.h5")
    assert count_shots(saved) >= 3


def test_a_limit_that_leaves_no_room_for_a_row_is_told_at_the_first(tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    told, last = write(tmp_path / "shot.h5", ROW_BYTES // 2)
    assert (told, "refused:" in last) == (0, True)
    with pytest.raises(StorageError):
        recover(tmp_path / "shot.h5.partial", tmp_path / "saved.h5")
    assert resource.getrlimit(resource.RLIMIT_FSIZE) == before


def test_a_header_can_be_written_here(tmp_path: Path) -> None:
    """The file system itself takes what the tests above were refused."""
    masks = np.ones((2, 480, 640), np.float32)
    with ShotWriter(tmp_path / "shot.h5", CaptureHeader(1, 1, masks, np.ones(2, np.float32))) as writer:
        writer.append(np.zeros((480, 640), np.uint16))
        assert count_shots(writer.finish()) == 1
