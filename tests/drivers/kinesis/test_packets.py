"""Bytes of the APT protocol, as Thorlabs' document prints them in its examples."""

import pytest

from gs2ci_drivers.kinesis.packets import (
    CUBE,
    FIRST_BAY,
    Message,
    find_message,
    move_absolute,
    parse_info,
    parse_stage_memory,
    set_overshoot,
    set_speed,
    short,
)
from gs2ci_drivers.kinesis.stages import STAGES

BAY_2 = FIRST_BAY + 1


def test_a_move_is_the_documents_example():
    """ "Move the bay 2 stage to 10 mm (200,000 encoder counts)"."""
    assert move_absolute(BAY_2, 200_000) == bytes.fromhex("53 04 06 00 A2 01 01 00 40 0D 03 00")


def test_a_speed_is_the_documents_example():
    """ "Set ... acceleration 1 m/s/s, max velocity 99 mm/s" has 13744 and 13421773 for an MLS203."""
    stage = STAGES["MLS203-X"]
    acceleration, speed = round(1000.0 / stage.acceleration_unit_mm_s2), round(100.0 / stage.speed_unit_mm_s)
    assert (acceleration, speed) == (13744, 13421773)
    assert set_speed(BAY_2, acceleration, speed) == bytes.fromhex(
        "13 04 0E 00 A2 01 01 00 00 00 00 00 B0 35 00 00 CD CC CC 00"
    )


def test_a_backlash_distance_is_a_channel_and_counts():
    """MGMSG_MOT_SET_GENMOVEPARAMS, 0x043A: six bytes, "HI" of channel and distance; a request is 3B 04 01 00 50 01."""
    assert set_overshoot(CUBE, 200_000) == bytes.fromhex("3A 04 06 00 D0 01 01 00 40 0D 03 00")
    assert short(Message.MOT_REQ_GENMOVEPARAMS, CUBE) == bytes.fromhex("3B 04 01 00 50 01")


def test_a_stages_memory_is_read_in_the_order_of_thorlabs_header():
    """Channel, then as in MOT_StageAxisParameters: stage, axis, part[16], serial, counts per unit, least, highest."""
    data = bytes.fromhex("01 00 05 00 01 00") + b"MLS203".ljust(16, b"\0")
    data += bytes.fromhex("15 CD 5B 07 20 4E 00 00 00 00 00 00 C0 91 21 00") + bytes(36)
    assert len(data) == 0x4A
    found = parse_stage_memory(data)
    assert (found.part, found.counts_per_unit, found.travel) == ("MLS203", 20000, 110.0)
    assert parse_stage_memory(bytes(74)) is None
    assert short(Message.MOT_REQ_PMDSTAGEAXISPARAMS, BAY_2) == bytes.fromhex("F1 04 01 00 22 01")


@pytest.mark.parametrize(
    ("model", "per_mm_s", "per_mm_s2"),
    [
        ("MTS50-Z8", 772981.3692, 263.8443072),
        ("DDSM100", 13421.77, 1.374),
        ("LTS150", 21987328.0, 4506.0),
    ],
)
def test_units_are_those_of_the_documents_table(model, per_mm_s, per_mm_s2):
    assert 1 / STAGES[model].speed_unit_mm_s == pytest.approx(per_mm_s, rel=1e-5)
    assert 1 / STAGES[model].acceleration_unit_mm_s2 == pytest.approx(per_mm_s2, rel=5e-4)


def test_positions_are_rounded_to_counts():
    stage = STAGES["MTS50-Z8"]
    assert stage.counts(1.0) == 34555
    assert stage.mm(34555) == pytest.approx(1.0, abs=2e-6)


def test_a_request_without_data_has_its_parameters_in_the_header():
    assert short(Message.MOT_MOVE_STOP, CUBE, 1, 2) == bytes.fromhex("65 04 01 02 50 01")


def test_messages_are_found_behind_noise_and_in_pieces():
    whole = bytes.fromhex("12 04 06 00 81 50 01 00 40 0D 03 00")
    sources = frozenset({CUBE})
    for cut in range(len(whole)):
        message, left, passed = find_message(b"\xff\x00" + whole[:cut], sources)
        assert message is None
        message, left, passed = find_message(left + whole[cut:] + b"\x64", sources)
        assert (message.ident, message.source, message.data) == (0x0412, CUBE, whole[6:])
        assert left == b"\x64"
    assert find_message(whole, frozenset({BAY_2}))[0] is None  # another unit's
    homed, left, passed = find_message(b"\x00" + bytes.fromhex("44 04 01 00 01 50"), sources)
    assert (homed.params, homed.data, left, passed) == ((1, 0), b"", b"", 1)


def test_what_a_unit_is_needs_all_its_bytes():
    data = (27250123).to_bytes(4, "little") + b"KDC101\0\0" + b"\x10\x00" + bytes([2, 3, 1, 0]) + bytes(64) + b"\x01\0"
    info = parse_info(data)
    assert (info.serial, info.model, info.firmware, info.channels) == (27250123, "KDC101", "1.3.2", 1)
    assert parse_info(data[:-1]) is None
