"""The real system calls, on what every Linux has: a terminal, a pipe's worth of waiting, and a file to map."""

import errno
import fcntl
import os
import select
import struct
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gs2ci_drivers.links.v4l2_sys import KernelSysPort
from gs2ci_drivers.ports import SysPort

PORT = KernelSysPort()


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    near, far = os.openpty()
    yield near, far
    os.close(near)
    os.close(far)


def test_it_is_a_sys_port() -> None:
    assert isinstance(PORT, SysPort)


def test_opening_is_non_blocking_and_errors_keep_their_errno(terminal: tuple[int, int]) -> None:
    fd = PORT.open(os.ttyname(terminal[1]))
    assert fcntl.fcntl(fd, fcntl.F_GETFL) & os.O_NONBLOCK
    PORT.close(fd)
    PORT.close(fd)
    with pytest.raises(OSError, match="No such file") as caught:
        PORT.open("/dev/there-is-no-such-node")
    assert caught.value.errno == errno.ENOENT


def test_ioctl_reads_and_writes_in_place(terminal: tuple[int, int]) -> None:
    size = bytearray(struct.pack("<4H", 31, 77, 0, 0))
    assert PORT.ioctl(terminal[0], termios.TIOCSWINSZ, size) == 0
    answer = bytearray(8)
    assert PORT.ioctl(terminal[1], termios.TIOCGWINSZ, answer, bytearray(4)) == 0
    assert answer == size


def test_an_ioctl_that_the_node_does_not_know_is_enotty(terminal: tuple[int, int]) -> None:
    with pytest.raises(OSError, match="ioctl") as caught:
        PORT.ioctl(terminal[0], 0x80685600, bytearray(104))
    assert caught.value.errno in (errno.ENOTTY, errno.EINVAL)


def test_an_ioctl_cut_off_by_a_signal_is_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = iter([InterruptedError(errno.EINTR, "signal"), 5])

    def interrupted(*args: object) -> int:
        answer = next(answers)
        if isinstance(answer, OSError):
            raise answer
        return answer

    monkeypatch.setattr(fcntl, "ioctl", interrupted)
    assert PORT.ioctl(0, 0, bytearray(4)) == 5


def test_poll_tells_what_came_and_zero_in_time(terminal: tuple[int, int]) -> None:
    near, far = terminal
    begin = time.monotonic()
    assert PORT.poll(near, select.POLLIN, 0.02) == 0
    assert time.monotonic() - begin >= 0.015
    os.write(far, b"x\n")
    assert PORT.poll(near, select.POLLIN, 5.0) & select.POLLIN
    assert PORT.poll(near, select.POLLIN, -1.0) & select.POLLIN


def test_mapped_memory_is_shared_and_copied_out(tmp_path: Path) -> None:
    path = tmp_path / "buffer"
    path.write_bytes(bytes(range(256)) * 32)
    fd = PORT.open(str(path))
    mapping = PORT.mmap(fd, 4096, 4096)
    copy = PORT.copy_out(mapping, 300)
    assert copy == (bytes(range(256)) * 2)[:300]
    mapping[0] = 99
    mapping.close()
    PORT.close(fd)
    assert path.read_bytes()[4096] == 99
    assert copy[0] == 0


def test_small_files_nodes_and_the_clock(tmp_path: Path) -> None:
    path = str(tmp_path / "video7")
    PORT.write_file(path, b"1\n")
    assert PORT.read_file(path) == b"1\n"
    assert PORT.list_nodes(str(tmp_path / "video*")) == [path]
    before_ns = time.monotonic_ns()
    assert before_ns <= PORT.clock_ns() <= time.monotonic_ns()
