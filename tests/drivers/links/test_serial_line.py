"""The real serial port, on a pseudo-terminal of the computer's own kernel."""

import os
import pty
import time

import pytest

from gs2ci_drivers.failures import AccessError
from gs2ci_drivers.links.serial_line import SerialLine


@pytest.fixture
def line():
    master, slave = pty.openpty()
    line = SerialLine("dev0", os.ttyname(slave))
    yield master, line
    line.close()
    for fd in (master, slave):
        try:
            os.close(fd)
        except OSError:
            continue


def test_bytes_go_through_both_ways_as_they_are(line):
    master, port = line
    port.write(b"/01 0 get pos\n", 1.0)
    assert os.read(master, 100) == b"/01 0 get pos\n"
    os.write(master, bytes(range(256)))
    received = b""
    while len(received) < 256:
        received += port.read(100, 1.0)
    assert received == bytes(range(256))


def test_reading_returns_what_is_there_and_does_not_wait_for_more(line):
    master, port = line
    os.write(master, b"abc")
    begin = time.monotonic()
    assert port.read(100, 5.0)[:1] == b"a"
    assert time.monotonic() - begin < 2.0


def test_silence_ends_at_the_timeout(line):
    _, port = line
    begin = time.monotonic()
    assert port.read(100, 0.1) == b""
    assert port.read(100, 0.0) == b""
    assert 0.05 < time.monotonic() - begin < 2.0


def test_a_line_whose_other_end_is_gone_is_an_os_error(line):
    master, port = line
    os.close(master)

    def talk():
        for _ in range(3):
            port.read(10, 0.1)
            port.write(b"x", 0.1)

    with pytest.raises(OSError):  # noqa: PT011 - any errno means that the port is gone
        talk()


def test_a_closed_line_refuses_and_may_be_closed_again(line):
    _, port = line
    port.close()
    port.close()
    for call in (lambda: port.read(1, 0.0), lambda: port.write(b"x", 0.1)):
        with pytest.raises(OSError, match="closed"):
            call()


def test_a_line_in_use_is_an_access_error(line):
    _, port = line
    with pytest.raises(AccessError, match="use"):
        SerialLine("dev1", port._port.port)


def test_a_line_that_is_not_there_is_an_access_error_that_names_the_doctor():
    with pytest.raises(AccessError, match=r"dev0: open /dev/nowhere.*gs2ci doctor"):
        SerialLine("dev0", "/dev/nowhere")
