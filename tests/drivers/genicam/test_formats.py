"""Unpacking of PFNC formats against their definition, bit by bit, and what it refuses."""

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_drivers.genicam.formats import PFNC_FORMATS, unpack_pfnc
from tests.twins.genicam import pack_pfnc

NAMES = sorted(PFNC_FORMATS)


def by_definition(data: bytes, name: str, count: int) -> list[int]:
    """Read `count` values one bit at a time, as PFNC's figures draw them."""
    form = PFNC_FORMATS[name]
    bits = np.unpackbits(np.frombuffer(data, np.uint8), bitorder="little")

    def value(places):
        return sum(int(bits[place]) << i for i, place in enumerate(places))

    if not name.endswith("Packed"):
        size = form.bits_in_memory
        return [value(range(i * size, i * size + form.bits)) for i in range(count)]
    low, found = form.bits - 8, []
    for i in range(count):
        triple, second = 24 * (i // 2), i % 2
        middle = triple + 8 + 4 * second
        high = triple + 16 * second
        found.append(value([*range(middle, middle + low), *range(high, high + 8)]))
    return found


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("size", [(4, 8), (3, 5), (1, 1)])
@pytest.mark.parametrize("padding", [0, 3])
def test_every_format_is_read_as_it_is_defined(name, size, padding):
    height, width = size
    pixels = np.random.default_rng(1).integers(0, PFNC_FORMATS[name].top + 1, size).astype(np.uint16)
    data = pack_pfnc(pixels, name, padding)
    np.testing.assert_array_equal(unpack_pfnc(data, PFNC_FORMATS[name], height, width, padding), pixels)
    if not padding:
        assert by_definition(data, name, height * width) == pixels.ravel().tolist()
        assert len(data) == PFNC_FORMATS[name].payload_bytes(height, width)


@pytest.mark.parametrize(
    ("name", "data", "values"),
    [
        ("Mono12p", [0xBC, 0x3A, 0x12], [0xABC, 0x123]),  # PFNC 2.4, figure of Mono12p
        ("Mono12Packed", [0xAB, 0x3C, 0x12], [0xABC, 0x123]),  # GigE Vision 1.2, figure of GVSP_PIX_MONO12_PACKED
        ("Mono10Packed", [0xFF, 0x12, 0x00], [0x3FE, 0x001]),
        ("Mono10p", [0x01, 0x08, 0x30, 0x00, 0x01], [1, 2, 3, 4]),
        ("Mono12", [0xBC, 0x0A, 0x23, 0x01], [0xABC, 0x123]),
    ],
)
def test_bytes_written_out_by_hand(name, data, values):
    found = unpack_pfnc(bytes(data), PFNC_FORMATS[name], 1, len(values))
    assert found.tolist() == [values]


def test_what_is_too_short_or_too_large_is_refused():
    form = PFNC_FORMATS["Mono12"]
    with pytest.raises(InputError, match="10 bytes for 4 x 4 Mono12"):
        unpack_pfnc(bytes(10), form, 4, 4)
    with pytest.raises(InputError, match=r"Mono12 pixel reads 65520.*Mono16"):
        unpack_pfnc(b"\xf0\xff" * 16, form, 4, 4)
    with pytest.raises(InputError, match="image of 4 x 0 pixels"):
        unpack_pfnc(b"", form, 0, 4)
