"""The SLM-200 class panel's twin, spoken to in raw frames."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gs2ci_sims.wires.display_slm import DisplaySlmTwin
from gs2ci_sims.world import World


class Host:
    """Frames by hand."""

    def __init__(self) -> None:
        self.world = World()
        self.twin = DisplaySlmTwin(self.world)
        self.port = self.twin.open()

    def word(self) -> str:
        self.port.write(b"SEND" + bytes.fromhex("0000 0002 00000000 00000000"), 1.0)
        frame = self.port.read(4096, 1.0)
        assert frame[:8] == b"SEND" + bytes.fromhex("00ff 0003")
        assert len(frame) == 1040
        return frame[16:].split(b"\0")[0].decode()

    def ask(self, text: bytes) -> str:
        self.port.write(b"SEND" + bytes.fromhex("00ff 0001 00000000 00000000") + text.ljust(1024, b"\0"), 1.0)
        self.world.clock.sleep_s(0.01)
        word = self.word()
        while word == "NO RESPONSE":  # another mode takes it 40 s
            self.world.clock.sleep_s(1.0)
            word = self.word()
        return word

    def image(self, level: int, total: int | None = None) -> str:
        row = struct.pack("<H", level) * 1920
        data = bytearray()
        for y in range(1200):
            data += (
                b"SEND" + bytes.fromhex("03bf 0004 00") + y.to_bytes(3, "little") + bytes(4) + row.ljust(4096, b"\0")
            )
        data[-4:] = struct.pack("<I", (level * 1200 * 1920 if total is None else total) % 2**32)
        self.port.write(bytes(data), 1.0)
        self.world.clock.sleep_s(0.2)
        return self.word()


@pytest.fixture
def host() -> Host:
    return Host()


def test_commands_are_answered_by_a_word_that_is_told_once(host: Host) -> None:
    assert host.ask(b"SN\n") == "2018021101"
    assert host.word() == ""


@pytest.mark.parametrize("text", [b"XX 1\n", b"MI 0\n", b"MI 129\n", b"GS 1024\n", b"VI 2\n", b"TM\n", b"DS 5\n"])
def test_what_does_not_exist_is_refused(host: Host, text: bytes) -> None:
    assert host.ask(text) == "NG"


def test_an_image_lands_in_its_slot_and_is_shown_from_memory(host: Host) -> None:
    assert host.ask(b"VI 0\n") == "OK"
    assert host.ask(b"MI 7\n") == "OK"
    assert host.image(700) == "OK"
    assert host.ask(b"TM 1\n") == "OK"
    assert host.ask(b"DS 7\n") == "OK"
    (shown,) = host.world.masks_between(0.0, host.world.clock.now_s())
    assert (shown.levels == 700).all()
    assert shown.top == 1023
    assert len(host.world.bus.rising("slm0.out")) == 1


@pytest.mark.parametrize(("level", "total"), [(700, 1), (1024, None)])
def test_an_image_whose_sum_or_levels_are_wrong_is_refused(host: Host, level: int, total: int | None) -> None:
    host.ask(b"MI 7\n")
    assert host.image(level, total) == "NG"


def test_a_uniform_grey_needs_no_slot(host: Host) -> None:
    assert host.ask(b"GS 512\n") == "OK"
    (shown,) = host.world.masks_between(0.0, host.world.clock.now_s() + 1.0)
    assert int(shown.levels[0, 0]) == 512


@settings(max_examples=60, deadline=None)
@given(st.lists(st.one_of(st.binary(max_size=60), st.binary(max_size=40).map(lambda b: b"SEND" + b)), max_size=8))
def test_no_bytes_whatever_bring_the_panel_down(pieces: list[bytes]) -> None:
    host = Host()
    for piece in pieces:
        host.port.write(piece, 1.0)
    for _ in range(5):  # the rest of a frame that was begun
        host.port.write(bytes(1024), 1.0)
    host.world.clock.sleep_s(0.5)
    while host.port.read(4096, 0.1):
        continue
    host.ask(b"SN\n")
    assert host.ask(b"SN\n") == "2018021101"
