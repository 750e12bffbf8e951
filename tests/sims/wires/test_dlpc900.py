"""The DLPC900's twin, spoken to in raw bytes: what its firmware refuses, remembers, overwrites and shows."""

from errno import EBUSY, ENODEV

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.dlpc900 import Dlpc900Twin
from gs2ci_sims.world import World


class Host:
    """Reports by hand, typed from the programmer's guide."""

    def __init__(self, dmd: int = 5, **options: float) -> None:
        self.world = World()
        self.faults = FaultSet()
        self.twin = Dlpc900Twin(self.world, self.faults, dmd=dmd, **options)
        self.port = self.twin.open()

    def send(self, message: str | bytes) -> None:
        data = bytes.fromhex(message) if isinstance(message, str) else message
        for at in range(0, len(data), 64):
            self.port.write(data[at : at + 64].ljust(64, b"\0"), 1.0)

    def ask(self, message: str | bytes) -> bytes:
        """Send and return the reply without padding."""
        self.send(message)
        reply = self.port.read(1.0)
        length = int.from_bytes(reply[2:4], "little")
        while len(reply) < 4 + length:
            reply += self.port.read(1.0)
        return reply[: 4 + length]

    def error(self) -> int:
        return self.ask("C0 77 02 00 00 01")[4]

    def image(self, index: int, block: bytes) -> None:
        self.send(bytes.fromhex("40 01 08 00 2A 1A") + index.to_bytes(2, "little") + len(block).to_bytes(4, "little"))
        for at in range(0, len(block), 504):
            chunk = block[at : at + 504]
            head = bytes([0, 1]) + (4 + len(chunk)).to_bytes(2, "little") + b"\x2b\x1a"
            self.send(head + len(chunk).to_bytes(2, "little") + chunk)

    def prepare(self, exposure_us: int = 1000, entries: int = 1, flags: int = 0x71) -> None:
        """Select on-the-fly mode and define entries that show bits 0, 1, ... of image 0."""
        self.ask("40 02 03 00 1B 1A 03")
        for i in range(entries):
            entry = bytes([i, 0, *exposure_us.to_bytes(3, "little"), flags, 0, 0, 0, 0, 0, i << 3])
            assert self.ask(bytes.fromhex("40 01 0E 00 34 1A") + entry)[0] == 0x40
        assert self.ask(bytes([0x40, 5, 8, 0, 0x31, 0x1A, entries, 0, entries, 0, 0, 0]))[0] == 0x40

    def all_on(self) -> bytes:
        """Return an ERLE block of 1024 × 768 pixels with every bit of byte 0 set, typed in."""
        rows = b"\x80\x08\x00\x00\xff\x00\x00" + b"\x00\x01\x80\x08\x00\x00" * 767 + b"\x00\x01\x00"
        size = len(rows).to_bytes(4, "little")
        return b"Spld\x00\x04\x00\x03" + size + b"\xff" * 8 + bytes(4) + b"\x01\x02\x01" + bytes(21) + rows

    def run(self) -> None:
        self.prepare()
        self.image(0, self.all_on())
        assert self.ask("40 03 03 00 24 1A 02")[0] == 0x40


@pytest.fixture
def host() -> Host:
    return Host()


def test_reads_echo_flags_and_sequence_and_carry_their_data(host: Host) -> None:
    assert host.ask("C0 04 02 00 0C 1A") == bytes.fromhex("C0 04 01 00 00")
    assert host.ask("C0 09 02 00 06 02")[:5] == bytes.fromhex("C0 09 21 00 05")
    assert len(host.ask("C0 05 02 00 01 01")) == 132


def test_a_refusal_sets_bit_5_and_its_code_stays_until_it_is_read(host: Host) -> None:
    assert host.ask("40 02 03 00 1B 1A 07") == bytes.fromhex("60 02 00 00")
    assert host.ask("40 03 02 00 99 99") == bytes.fromhex("60 03 00 00")
    assert host.error() == 6
    assert host.ask("C0 05 02 00 01 01")[4:].startswith(b"Invalid Parameter\0")
    assert host.error() == 0


def test_an_unfetched_reply_is_overwritten_by_the_next_request(host: Host) -> None:
    host.send("C0 01 02 00 06 02")
    host.send("C0 02 02 00 0C 1A")
    assert host.port.read(1.0)[:5] == bytes.fromhex("C0 02 01 00 00")
    assert host.port.read(0.1) == b""


def test_a_write_without_acknowledgement_is_not_answered(host: Host) -> None:
    host.send("00 02 03 00 1B 1A 03")
    assert host.port.read(0.5) == b""
    assert host.ask("C0 03 02 00 1B 1A")[4] == 3


def test_every_report_costs_a_millisecond(host: Host) -> None:
    begin_s = host.world.clock.now_s()
    host.image(0, bytes(504 * 10))
    assert host.world.clock.now_s() - begin_s == pytest.approx(81e-3)


def test_the_decoded_planes_are_shown_for_their_time_with_their_pulses(host: Host) -> None:
    host.prepare(entries=9)
    host.image(0, host.all_on())
    begin_s = host.world.clock.now_s()
    host.ask("40 03 03 00 24 1A 02")
    host.world.clock.sleep_s(0.1)
    shown = host.world.masks_between(begin_s, host.world.clock.now_s())
    assert [interval.levels.min() for interval in shown] == [1] * 8 + [0]
    assert [interval.end_s - interval.start_s for interval in shown] == pytest.approx([1e-3] * 9)
    assert len(host.world.bus.rising("dmd0.out2")) == 9
    assert len(host.world.bus.rising("dmd0.out1")) == 1, "without dark time output 1 stays high"


def test_byte_9_bit_0_suppresses_output_2(host: Host) -> None:
    host.ask("40 02 03 00 1B 1A 03")
    host.ask("40 01 0E 00 34 1A 00 00 E8 03 00 71 00 00 00 01 00 00")
    host.ask("40 05 08 00 31 1A 01 00 01 00 00 00")
    host.image(0, host.all_on())
    host.ask("40 03 03 00 24 1A 02")
    host.world.clock.sleep_s(0.1)
    assert not host.world.bus.rising("dmd0.out2")
    assert host.world.bus.rising("dmd0.out1")


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("40 01 0E 00 34 1A 00 00 E8 03 00 71 00 00 00 00 00 00", 5),
        ("40 05 08 00 31 1A 01 00 01 00 00 00", 5),
        ("40 01 08 00 2A 1A 00 00 00 10 00 00", 5),
        ("40 02 03 00 1B 1A 03", 5),
        ("40 02 03 00 01 02 01", 5),
        ("40 03 03 00 24 1A 02", 5),
    ],
)
def test_settings_are_refused_while_a_sequence_runs(host: Host, message: str, code: int) -> None:
    host.run()
    host.ask("40 03 03 00 24 1A 00")
    host.ask("40 05 08 00 31 1A 01 00 00 00 00 00")
    host.ask("40 03 03 00 24 1A 02")
    assert host.ask("C0 04 02 00 0C 1A")[4] == 2
    assert host.ask(message)[0] == 0x60
    assert host.error() == code


@pytest.mark.parametrize(
    ("entry", "code"),
    [
        ("C0 03 E8 03 00 71 00 00 00 00 00 00", 15),
        ("00 00 00 00 00 71 00 00 00 00 00 00", 14),
        ("00 00 E8 03 00 7E 00 00 00 00 00 88", 10),
        ("00 00 E8 03 00 71 00 00 00 00 12 00", 17),
    ],
)
def test_entries_out_of_range_are_refused_with_their_code(host: Host, entry: str, code: int) -> None:
    host.ask("40 02 03 00 1B 1A 03")
    assert host.ask("40 01 0E 00 34 1A" + entry)[0] == 0x60
    assert host.error() == code


def test_more_entries_than_defined_and_entries_in_video_mode_are_refused(host: Host) -> None:
    assert host.ask("40 01 0E 00 34 1A 00 00 E8 03 00 71 00 00 00 00 00 00")[0] == 0x60
    assert host.error() == 5
    host.prepare()
    assert host.ask("40 05 08 00 31 1A 02 00 02 00 00 00")[0] == 0x60
    assert host.error() == 16


def test_a_chunk_too_much_too_early_or_too_few_is_error_9(host: Host) -> None:
    host.prepare()
    host.send("00 01 06 00 2B 1A 02 00 AA BB")
    assert host.error() == 9
    host.image(0, host.all_on())
    assert host.error() == 0
    host.send("00 01 06 00 2B 1A 02 00 AA BB")
    assert host.error() == 9
    host.send("40 01 08 00 2A 1A 00 00 00 10 00 00")
    host.send("00 01 06 00 2B 1A 02 00 AA BB")
    assert host.ask("40 03 03 00 24 1A 02")[0] == 0x60
    assert host.error() == 9


def test_a_damaged_image_is_error_9_and_cannot_be_started(host: Host) -> None:
    host.prepare()
    block = bytearray(host.all_on())
    block[60] ^= 0x40
    host.image(0, bytes(block))
    assert host.error() == 9
    assert host.ask("40 03 03 00 24 1A 02")[0] == 0x60
    assert host.error() == 16


def test_images_must_come_from_the_last_to_the_first(host: Host) -> None:
    host.ask("40 02 03 00 1B 1A 03")
    for i in range(2):
        host.ask(bytes.fromhex("40 01 0E 00 34 1A") + bytes([i, 0, 0xE8, 3, 0, 0x71, 0, 0, 0, 0, i, 0]))
    host.ask("40 05 08 00 31 1A 02 00 02 00 00 00")
    assert host.ask("40 01 08 00 2A 1A 00 00 00 10 00 00")[0] == 0x60
    assert host.error() == 17


@pytest.mark.parametrize(
    ("change", "keeps"),
    [
        ("40 01 0E 00 34 1A 00 00 D0 07 00 71 00 00 00 01 00 00", True),
        ("40 05 08 00 31 1A 01 00 07 00 00 00", True),
        ("40 01 0E 00 34 1A 00 00 E8 03 00 71 00 00 00 00 00 08", False),
        ("40 01 0E 00 34 1A 00 00 E8 03 00 71 00 00 00 00 01 00", False),
    ],
)
def test_times_keep_the_images_and_places_lose_them(host: Host, change: str, keeps: bool) -> None:
    host.run()
    host.ask("40 03 03 00 24 1A 00")
    assert host.ask(change)[0] == 0x40
    assert (host.ask("40 03 03 00 24 1A 02")[0] == 0x40) is keeps


def test_a_new_entry_count_loses_the_images(host: Host) -> None:
    host.prepare(entries=2)
    host.image(0, host.all_on())
    host.ask("40 05 08 00 31 1A 01 00 01 00 00 00")
    assert host.ask("40 03 03 00 24 1A 02")[0] == 0x60


def test_inversion_clears_the_table_and_inverts_what_is_shown(host: Host) -> None:
    host.prepare()
    assert host.ask("40 03 03 00 30 1A 01")[0] == 0x40
    host.prepare()
    host.image(0, host.all_on())
    host.ask("40 03 03 00 24 1A 02")
    host.world.clock.sleep_s(0.1)
    (shown,) = host.world.masks_between(0.0, host.world.clock.now_s())
    assert shown.levels.max() == 0


def test_a_pause_goes_on_with_the_current_mask_and_a_stop_with_the_first(host: Host) -> None:
    host.prepare(entries=9, exposure_us=10000)
    host.image(0, host.all_on())
    host.ask("40 03 03 00 24 1A 02")
    host.world.clock.sleep_s(0.025)
    host.ask("40 03 03 00 24 1A 01")
    assert host.ask("C0 04 02 00 0C 1A")[4] == 0
    begin_s = host.world.clock.now_s()
    host.ask("40 03 03 00 24 1A 02")
    host.world.clock.sleep_s(1.0)
    assert len(host.world.masks_between(begin_s, host.world.clock.now_s())) == 7
    begin_s = host.world.clock.now_s()
    host.ask("40 03 03 00 24 1A 02")
    host.world.clock.sleep_s(1.0)
    assert len(host.world.masks_between(begin_s, host.world.clock.now_s())) == 9


def test_an_entry_that_waits_is_advanced_by_trigger_input_1(host: Host) -> None:
    host.prepare(entries=2)
    host.ask("40 01 0E 00 34 1A 01 00 E8 03 00 F1 00 00 00 00 00 08")
    host.ask("40 03 05 00 35 1A C8 00 00")
    host.image(0, host.all_on())
    host.ask("40 03 03 00 24 1A 02")
    host.world.clock.sleep_s(0.05)
    assert host.ask("C0 04 02 00 0C 1A")[4] == 2
    begin_s = host.world.clock.now_s()
    host.world.bus.drive("dmd0.in1", True)
    host.world.clock.sleep_s(0.05)
    (shown,) = host.world.masks_between(begin_s, host.world.clock.now_s())
    assert shown.start_s - begin_s == pytest.approx(200e-6)
    assert host.ask("C0 04 02 00 0C 1A")[4] == 0


@pytest.mark.parametrize(
    ("setting", "accepted"),
    [("00 EC FF 20 4E", True), ("00 EB FF 00 00", False), ("00 05 00 00 00", False), ("01 05 00 00 00", True)],
)
def test_trigger_delays_out_of_range_are_error_13(host: Host, setting: str, accepted: bool) -> None:
    reply = host.ask("40 03 07 00 1E 1A" + setting)
    assert (reply[0] == 0x40) is accepted
    assert host.error() == (0 if accepted else 13)


def test_in_standby_only_normal_power_is_accepted_and_it_takes_three_seconds(host: Host) -> None:
    host.ask("40 03 03 00 00 02 01")
    assert host.ask("C0 04 02 00 0C 1A")[4] == 1
    assert host.ask("40 02 03 00 1B 1A 03")[0] == 0x60
    assert host.ask("40 03 03 00 00 02 00")[0] == 0x40
    assert host.ask("40 02 03 00 1B 1A 03")[0] == 0x60
    host.world.clock.sleep_s(3.0)
    assert host.ask("40 02 03 00 1B 1A 03")[0] == 0x40


def test_idling_must_last_three_seconds(host: Host) -> None:
    assert host.ask("40 03 03 00 01 02 01")[0] == 0x60  # not in video mode
    host.ask("40 02 03 00 1B 1A 03")
    assert host.ask("40 03 03 00 01 02 01")[0] == 0x40
    assert host.ask("40 03 03 00 01 02 00")[0] == 0x60
    host.world.clock.sleep_s(3.0)
    assert host.ask("40 03 03 00 01 02 00")[0] == 0x40


def test_fewer_blocks_show_a_part_of_the_mirrors_and_allow_shorter_times() -> None:
    host = Host(dmd=1)
    host.ask("40 02 03 00 1B 1A 03")
    assert host.ask("40 01 0E 00 34 1A 00 00 18 00 00 71 00 00 00 00 00 00")[0] == 0x60
    assert host.ask("40 01 04 00 40 1A 03 01")[0] == 0x40
    assert host.ask("40 01 0E 00 34 1A 00 00 18 00 00 71 00 00 00 00 00 00")[0] == 0x40
    assert host.ask("40 01 04 00 40 1A 03 0F")[0] == 0x60


def test_a_dual_controller_says_so_and_a_single_one_has_no_secondary(host: Host) -> None:
    assert Host(dmd=2).ask("C0 04 02 00 0A 1A")[4] == 0x11
    assert host.ask("C0 04 02 00 0A 1A")[4] == 0x01
    host.prepare()
    assert host.ask("40 01 08 00 2C 1A 00 00 00 10 00 00")[0] == 0x60


def test_unplugging_and_opening_are_the_operating_systems_errors(host: Host) -> None:
    with pytest.raises(OSError, match="busy") as caught:
        host.twin.open()
    assert caught.value.errno == EBUSY
    host.twin.unplug()
    for call in (lambda: host.port.write(bytes(64), 1.0), lambda: host.port.read(1.0), host.twin.open):
        with pytest.raises(OSError, match="No such device") as caught:
            call()
        assert caught.value.errno == ENODEV
    host.twin.plug_in()
    host.port = host.twin.open()
    assert host.error() == 0


def test_a_power_cycle_forgets_everything(host: Host) -> None:
    host.run()
    host.twin.power_cycle()
    host.twin.plug_in()
    host.port = host.twin.open()
    assert host.ask("C0 03 02 00 1B 1A")[4] == 0
    assert not host.twin.firmware.table


def test_a_report_of_another_length_is_a_programming_error(host: Host) -> None:
    with pytest.raises(ValueError, match="65 bytes"):
        host.port.write(bytes(65), 1.0)


COMMANDS = "1B1A 241A 2A1A 2B1A 301A 311A 341A 1D1A 351A 361A 401A 0002 0102"
requests = st.builds(
    lambda flags, command, data: bytes([flags, 7]) + (2 + len(data)).to_bytes(2, "little") + command + data,
    st.sampled_from([0xC0, 0x40, 0x00]),
    st.sampled_from([bytes.fromhex(c) for c in COMMANDS.split()]),
    st.binary(max_size=16),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.one_of(requests, st.binary(min_size=64, max_size=64)), max_size=12))
def test_no_reports_whatever_bring_the_firmware_down(reports: list[bytes]) -> None:
    host = Host()
    for report in reports:
        host.send(report)
    host.world.clock.sleep_s(0.1)
    for _ in range(9):  # the rest of a message that was begun
        host.send(bytes(64))
    assert host.ask("C0 04 02 00 0A 1A")[:2] == b"\xc0\x04"


def test_a_sequence_begins_as_late_as_the_twin_is_told() -> None:
    def began_s(start_s: float) -> float:
        host = Host(start_latency_s=start_s)
        edges: list[float] = []
        host.world.bus.listen("dmd0.out2", lambda edge: edges.append(edge.when_s) if edge.level else None)
        host.ask("40 06 0A 00 1E 1A 00 00 00 00 00 00 00 00")
        host.run()
        host.world.clock.sleep_s(start_s + 2e-3)
        return edges[0]

    assert began_s(8e-3) - began_s(0.0) == pytest.approx(8e-3, abs=1e-9)
