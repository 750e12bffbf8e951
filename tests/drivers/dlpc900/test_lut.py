"""Sequence entries: the twelve bytes, and the bit that suppresses trigger output 2."""

import pytest

from gs2ci.core.errors import InputError
from gs2ci_drivers.dlpc900.lut import LutEntry


def test_the_reference_entry_is_these_twelve_bytes() -> None:
    assert LutEntry(5, 105, bit_position=5).encode() == bytes.fromhex("05 00 69 00 00 71 00 00 00 00 00 28")


def test_byte_nine_suppresses_trigger_output_2_so_an_entry_that_fires_has_it_clear() -> None:
    assert LutEntry(0, 105, trigger_out_2=True).encode()[9] == 0
    assert LutEntry(0, 105, trigger_out_2=False).encode()[9] == 1


def test_only_one_bit_patterns_carry_the_clear_bit() -> None:
    assert LutEntry(0, 105, depth_bits=1).encode()[5] & 1
    assert not LutEntry(0, 5000, depth_bits=8, bit_position=16).encode()[5] & 1


def test_every_field_sits_in_its_bits() -> None:
    entry = LutEntry(
        0x0123,
        0xABCDEF,
        dark_us=0x123456,
        depth_bits=8,
        image_index=255,
        bit_position=16,
        leds=2,
    )
    assert entry.encode() == bytes.fromhex("23 01 EF CD AB 2E 56 34 12 00 FF 80")


@pytest.mark.parametrize(
    "fields",
    [
        {"exposure_us": 0},
        {"exposure_us": 1 << 24},
        {"dark_us": 1 << 24},
        {"dark_us": -1},
        {"depth_bits": 9},
        {"depth_bits": 0},
        {"image_index": 256},
        {"bit_position": 24},
        {"depth_bits": 8, "bit_position": 17},
        {"leds": 8},
        {"index": 65536},
    ],
)
def test_a_field_that_does_not_fit_is_refused_by_name(fields: dict[str, int]) -> None:
    with pytest.raises(InputError, match=rf"{list(fields)[-1]} = .*allowed"):
        LutEntry(**{"index": 0, "exposure_us": 105, **fields})
