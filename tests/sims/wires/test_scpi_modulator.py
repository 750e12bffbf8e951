"""The open protocol's reference device, typed to by hand."""

import zlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gs2ci_sims.wires.scpi_modulator import ScpiModulatorTwin, ScpiPanel
from gs2ci_sims.world import World


class Terminal:
    """A person at a terminal."""

    def __init__(self, panel: ScpiPanel | None = None) -> None:
        self.world = World()
        self.twin = ScpiModulatorTwin(self.world, panel=panel or ScpiPanel(height=2, width=9))
        self.port = self.twin.open()

    def type(self, line: bytes) -> str:
        self.port.write(line, 1.0)
        self.world.clock.sleep_s(0.02)
        return self.port.read(300, 0.0).decode("ascii").strip()

    def error(self) -> int:
        return int(self.type(b"SYST:ERR?\n").split(",")[0])

    def load(self, index: int, data: bytes) -> None:
        crc = zlib.crc32(b"%d:" % index + data)
        self.type(b"SEQ:DATA %d,%08X,#%d%d" % (index, crc, len(str(len(data))), len(data)) + data + b"\n")


@pytest.fixture
def terminal() -> Terminal:
    return Terminal()


def test_plain_queries_are_answered_and_plain_commands_are_not(terminal: Terminal) -> None:
    assert terminal.type(b"*idn?\r\n") == "GS2CI,SCPI-TWIN,0001,1.0"
    assert terminal.type(b"SEQ:STOP\n") == ""
    assert terminal.type(b"\n\n") == ""
    assert terminal.error() == 0


def test_errors_queue_in_order_and_are_cleared(terminal: Terminal) -> None:
    terminal.type(b"HELLO\n")
    terminal.type(b"SEQ:ARM\n")
    assert [terminal.error() for _ in range(3)] == [-113, -221, 0]
    terminal.type(b"HELLO\n")
    terminal.type(b"*CLS\n")
    assert terminal.error() == 0


def test_a_full_queue_ends_with_an_overflow(terminal: Terminal) -> None:
    for _ in range(20):
        terminal.type(b"HELLO\n")
    codes = [terminal.error() for _ in range(17)]
    assert codes == [-113] * 15 + [-350, 0]


@pytest.mark.parametrize("line", [b"@1 *IDN?*00\n", b"@1 *IDN?\n", b"@x *IDN?*00\n", b"@\n"])
def test_a_tagged_line_with_a_wrong_check_is_not_answered_but_noted(terminal: Terminal, line: bytes) -> None:
    assert terminal.type(line) == ""
    assert terminal.error() == -102


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (b"SEQ:NEW 0,1\n", -222),
        (b"SEQ:NEW 65,1\n", -222),
        (b"SEQ:NEW 2,3\n", -222),
        (b"SEQ:NEW 2\n", -102),
        (b"SEQ:NEW a,b\n", -102),
        (b"SEQ:TIME 500,0,0\n", -221),
        (b"SEQ:OUT LASER\n", -222),
        (b"SEQ:REP x\n", -102),
        (b"SEQ:END\n", -221),
        (b"SEQ:START\n", -221),
        (b"MOD:MIN? 5\n", -222),
        (b"x" * 200 + b"\n", -113),
        (b"x" * 200, -363),
    ],
)
def test_what_cannot_be_done_is_refused_with_its_code(terminal: Terminal, line: bytes, code: int) -> None:
    terminal.type(line)
    terminal.world.clock.sleep_s(0.6)
    assert terminal.error() == code


def test_masks_are_unpacked_rows_first_and_the_highest_bit_leftmost(terminal: Terminal) -> None:
    terminal.type(b"SEQ:NEW 1,1\n")
    terminal.load(0, b"\xa0\x80\x50\x00")
    terminal.type(b"SEQ:TIME 500,0,0\n")
    terminal.type(b"SEQ:END\n")
    terminal.type(b"SEQ:ARM\n")
    terminal.type(b"*TRG\n")
    assert terminal.error() == 0
    (shown,) = terminal.world.masks_between(0.0, terminal.world.clock.now_s())
    assert shown.levels.tolist() == [[1, 0, 1, 0, 0, 0, 0, 0, 1], [0, 1, 0, 1, 0, 0, 0, 0, 0]]
    assert terminal.type(b"SEQ:SHOWN?\n") == "1"


def test_a_block_with_line_feeds_inside_is_one_block(terminal: Terminal) -> None:
    terminal.type(b"SEQ:NEW 1,8\n")
    terminal.load(0, b"\n" * 18)
    assert terminal.error() == 0
    assert int(terminal.twin._masks[0][0, 0]) == 10


@pytest.mark.parametrize(
    "block",
    [
        b"SEQ:DATA 0,00000000,#14\xa0\x80\x50\x00\n",
        b"SEQ:DATA 0,00000000,#13\xa0\x80\x50\n",
        b"SEQ:DATA 0,00000000,#0\n",
        b"SEQ:DATA 0,00000000,#14\xa0\x80\x50\x00\x00",
    ],
)
def test_a_block_that_does_not_fit_is_refused_and_the_next_line_works_after_a_silence(
    terminal: Terminal, block: bytes
) -> None:
    terminal.type(b"SEQ:NEW 1,1\n")
    terminal.type(block)
    terminal.world.clock.sleep_s(0.6)
    assert terminal.error() == -160
    terminal.load(0, b"\xa0\x80\x50\x00")
    assert terminal.error() == 0


def test_a_mask_without_a_sequence_or_beyond_it_is_refused(terminal: Terminal) -> None:
    terminal.load(0, b"\xa0\x80\x50\x00")
    terminal.world.clock.sleep_s(0.6)
    assert terminal.error() == -221
    terminal.type(b"SEQ:NEW 1,1\n")
    terminal.load(1, b"\xa0\x80\x50\x00")
    assert terminal.error() == -222


def test_an_unfinished_line_is_dropped_after_half_a_second(terminal: Terminal) -> None:
    terminal.type(b"SEQ:ST")
    terminal.world.clock.sleep_s(0.6)
    assert terminal.type(b"MOD:SIZE?\n") == "2,9"
    assert terminal.error() == -363


def test_a_faulty_device_refuses_to_start_but_not_to_stop(terminal: Terminal) -> None:
    terminal.twin.fault = "over-temperature"
    assert terminal.type(b"MOD:STATE?\n") == 'FAULT,"over-temperature"'
    terminal.type(b"SEQ:ARM\n")
    assert terminal.error() == -240
    terminal.type(b"SEQ:STOP\n")
    assert terminal.error() == 0


lines = st.sampled_from(
    [b"SEQ:NEW 2,1\n", b"SEQ:TIME 500,0,0\n", b"SEQ:END\n", b"SEQ:ARM\n", b"SEQ:START\n", b"SEQ:DATA 0,12345678,#14"]
)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.one_of(lines, st.binary(max_size=40)), max_size=15))
def test_no_bytes_whatever_bring_the_device_down(pieces: list[bytes]) -> None:
    terminal = Terminal()
    for piece in pieces:
        terminal.port.write(piece, 1.0)
    terminal.world.clock.sleep_s(0.6)
    terminal.type(b"\n")
    terminal.port.read(4096, 0.1)
    assert terminal.type(b"SYST:VERS?\n") == "GS2CI-MOD,1"
