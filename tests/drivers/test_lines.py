import errno

import pytest

from gs2ci_drivers.failures import AccessError, BadReplyError, DisconnectedError, NoAnswerError
from gs2ci_drivers.lines import LONGEST_LINE, LineChannel
from gs2ci_drivers.ports import port_errors
from gs2ci_sims.world import VirtualClock


class Pieces:
    """A port that gives out prepared pieces, then silence or an error."""

    def __init__(self, clock, *pieces, error=None):
        self.clock, self.pieces, self.error, self.closed = clock, list(pieces), error, False

    def write(self, data, timeout_s):
        if self.error:
            raise self.error

    def read(self, max_bytes, timeout_s):
        if self.pieces:
            return self.pieces.pop(0)
        if self.error:
            raise self.error
        self.clock.sleep_s(timeout_s)
        return b""

    def close(self):
        self.closed = True


def channel(*pieces, error=None):
    clock = VirtualClock()
    port = Pieces(clock, *pieces, error=error)
    return clock, port, LineChannel("dev0", port, clock)


def test_lines_are_put_together_from_any_pieces():
    clock, _, lines = channel(b"o", b"k\r", b"\nsecond\nthi", b"rd\r\n")
    assert [lines.line(clock.now_s() + 1, "x") for _ in range(3)] == [b"ok", b"second", b"third"]


def test_noise_and_empty_lines_between_lines_are_dropped():
    clock, _, lines = channel(b"\x00\xff\x00\r\n\r\n\xff\xffok\x00\r\n")
    assert lines.line(clock.now_s() + 1, "x") == b"ok"


def test_waiting_ends_at_the_deadline():
    clock, _, lines = channel(b"half a li")
    begin_s = clock.now_s()
    with pytest.raises(NoAnswerError, match=r"dev0: ask: no answer within 0\.5 s"):
        lines.line(begin_s + 0.5, "ask")
    assert clock.now_s() == pytest.approx(begin_s + 0.5)


def test_bytes_without_any_end_of_line_are_a_bad_reply_not_memory():
    clock, _, lines = channel(*[b"x" * 100] * (LONGEST_LINE // 100 + 2))
    with pytest.raises(BadReplyError, match="no end of line"):
        lines.line(clock.now_s() + 1, "ask")


@pytest.mark.parametrize(
    ("piece", "expected"), [(b"", False), (b"\x00\xff\r\n", False), (b"Grb", True), (b"ok\r\n", True)]
)
def test_whether_a_line_has_begun_is_known_without_waiting(piece, expected):
    clock, _, lines = channel(piece, b"l 1.1\n")
    begin_s = clock.now_s()
    assert lines.begun("x") == expected
    assert clock.now_s() == begin_s
    assert lines.line(begin_s + 1, "x") == (b"ok" if b"ok" in piece else piece.strip(b"\x00\xff\r\n") + b"l 1.1")


def test_whether_a_line_has_begun_cannot_be_known_of_a_port_that_is_gone():
    _, _, lines = channel(error=OSError(errno.ENODEV, "gone"))
    with pytest.raises(DisconnectedError, match="dev0: x"):
        lines.begun("x")


def test_draining_throws_away_what_waits_and_counts_it():
    clock, _, lines = channel(b"first\nsec", b"ond")
    assert lines.line(clock.now_s() + 1, "x") == b"first"
    assert lines.drain() == 6


def test_draining_a_port_that_never_stops_ends():
    _, port, lines = channel(*[b"x" * 256] * 1000)
    assert lines.drain() == 64 * 256
    lines.close()
    assert port.closed


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (OSError(errno.EIO, "gone"), DisconnectedError),
        (OSError(errno.ENODEV, "gone"), DisconnectedError),
        (OSError(errno.EACCES, "no"), AccessError),
        (OSError(errno.EBUSY, "busy"), AccessError),
        (TimeoutError("stuck"), NoAnswerError),
    ],
)
def test_what_a_port_raises_becomes_a_typed_error(error, expected):
    _, _, lines = channel(error=error)
    with pytest.raises(expected, match="dev0"):
        lines.send(b"x", "ask")


def test_the_guard_lets_everything_else_pass():
    with pytest.raises(KeyError), port_errors("dev0", "ask"):
        raise KeyError("not a port's error")


class Babbler(Pieces):
    """A port on which there is always something, as fast as it is read."""

    def __init__(self, clock, text):
        super().__init__(clock)
        self.text, self.reads = text, 0

    def read(self, max_bytes, timeout_s):
        self.clock.sleep_s(1e-3)
        self.reads += 1
        assert self.reads < 5000, "this goes on for ever"
        return self.text


def wait_for_ok(lines, deadline_s):
    while lines.line(deadline_s, "ask") != b"ok":
        continue


@pytest.mark.parametrize("text", [b"\r\n", b"hello\r\n"], ids=["empty lines", "lines that nobody asked for"])
def test_a_device_that_babbles_without_end_does_not_hold_the_driver_beyond_its_deadline(text):
    clock = VirtualClock()
    port = Babbler(clock, text)
    lines = LineChannel("dev0", port, clock)
    for _ in range(2):  # a second exchange has as much patience as the first
        lines.send(b"?", "ask")
        deadline_s = clock.now_s() + 0.5
        with pytest.raises(NoAnswerError, match="dev0: ask: no answer"):
            wait_for_ok(lines, deadline_s)
        assert deadline_s <= clock.now_s() < deadline_s + 0.1
