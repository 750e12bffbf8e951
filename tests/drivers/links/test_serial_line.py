"""A serial line over a pseudo terminal of this computer."""

import os
import termios
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial

from gs2ci_drivers.failures import AccessError
from gs2ci_drivers.links import serial_line
from gs2ci_drivers.links.serial_line import SerialLine


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    far, near = os.openpty()
    tty.setraw(near)
    yield far, os.ttyname(near)
    os.close(near)
    os.close(far)


def read_exactly(read: Callable[[], bytes], count: int) -> bytes:
    """A terminal may hand bytes over in pieces."""
    data = b""
    while len(data) < count:
        data += read()
    return data


def test_bytes_pass_both_ways(terminal: tuple[int, str]) -> None:
    far, path = terminal
    line = SerialLine("stage0", path)
    line.write(b"/1 0 1\n", 1.0)
    assert read_exactly(lambda: os.read(far, 100), 7) == b"/1 0 1\n"
    os.write(far, b"@01 0 OK\r\n")
    assert read_exactly(lambda: line.read(100, 5.0), 10) == b"@01 0 OK\r\n"
    line.close()


def test_the_line_keeps_dtr_up_when_it_is_closed(terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """What resets an Arduino Uno is DTR rising; a pseudo terminal has none, but the flag that lets it fall."""
    asked: list[bool] = []
    monkeypatch.setattr(serial.Serial, "_update_dtr_state", lambda port: asked.append(port._dtr_state))
    line = SerialLine("stage0", terminal[1])
    with open(terminal[1], "rb", buffering=0) as near:
        assert not termios.tcgetattr(near.fileno())[2] & termios.HUPCL
    line.close()
    assert asked == [True]


def test_silence_ends_in_time_with_nothing(terminal: tuple[int, str]) -> None:
    line = SerialLine("stage0", terminal[1])
    begin = time.monotonic()
    assert line.read(10, 0.03) == b""
    assert line.read(10, 0.0) == b""
    assert time.monotonic() - begin >= 0.03
    line.close()


def test_a_line_that_another_program_holds_is_in_use_and_not_gone(terminal: tuple[int, str]) -> None:
    line = SerialLine("stage0", terminal[1])
    with pytest.raises(AccessError, match="in use by another program"):
        SerialLine("stage1", terminal[1])
    line.close()
    SerialLine("stage1", terminal[1]).close()


def test_a_line_that_is_not_there_and_a_rate_that_cannot_be_are_access_errors(terminal: tuple[int, str]) -> None:
    with pytest.raises(AccessError, match="stage0"):
        SerialLine("stage0", "/dev/there-is-no-such-line")
    with pytest.raises(AccessError, match="baud rate -1"):
        SerialLine("stage0", terminal[1], -1)


def test_an_adapter_that_brltty_has_taken_is_missing_with_that_cause_and_with_those_that_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A CH340 is attached to ttyUSB0 and detached half a second later, by arduino-ide issue 1788."""
    missing = str(tmp_path / "ttyUSB0")
    monkeypatch.setattr(serial_line, "ADAPTERS", (str(tmp_path / "ttyUSB*"),))
    with pytest.raises(AccessError, match="none is there now") as caught:
        SerialLine("stage0", missing)
    assert "claimed by ch341 (or cp210x) while 'brltty' sets config" in str(caught.value)
    (tmp_path / "ttyUSB1").touch()
    with pytest.raises(AccessError, match=r"allowed: .*ttyUSB1"):
        SerialLine("stage0", missing)


def test_a_closed_line_says_so_and_may_be_closed_again(terminal: tuple[int, str]) -> None:
    line = SerialLine("stage0", terminal[1])
    line.close()
    line.close()
    with pytest.raises(OSError, match="closed"):
        line.write(b"x", 0.1)
    with pytest.raises(OSError, match="closed"):
        line.read(1, 0.1)


def test_a_line_that_takes_nothing_is_a_timeout(terminal: tuple[int, str]) -> None:
    line = SerialLine("stage0", terminal[1])
    with pytest.raises(TimeoutError):
        line.write(bytes(1 << 20), 0.05)  # nobody reads at the other end
    line.close()


def test_a_line_that_is_closed_while_it_is_read_is_gone(
    terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    line = SerialLine("stage0", terminal[1])

    def closed(count: int) -> bytes:
        raise TypeError("'NoneType' object cannot be interpreted as an integer")

    monkeypatch.setattr(line._port, "read", closed)
    with pytest.raises(OSError, match="closed"):
        line.read(10, 0.01)
    line.close()
