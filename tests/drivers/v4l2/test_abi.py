"""The structures and request numbers against those that a C program printed on 64-bit Linux."""

import ctypes

import pytest

from gs2ci_drivers.v4l2 import abi

SIZES = {
    abi.Capability: 104,
    abi.FormatDescription: 64,
    abi.PixFormat: 48,
    abi.PixFormatMplane: 192,
    abi.Format: 208,
    abi.RequestBuffers: 20,
    abi.Buffer: 88,
    abi.Plane: 64,
    abi.QueryExtCtrl: 232,
    abi.QueryMenu: 44,
    abi.ExtControl: 20,
    abi.ExtControls: 32,
    abi.V4l2Event: 136,
    abi.EventSubscription: 32,
    abi.SubdevFormat: 88,
    abi.Selection: 64,
    abi.SubdevSelection: 64,
}
OFFSETS = {
    (abi.Format, "fmt"): 8,
    (abi.Buffer, "index"): 0,
    (abi.Buffer, "type"): 4,
    (abi.Buffer, "bytesused"): 8,
    (abi.Buffer, "flags"): 12,
    (abi.Buffer, "field"): 16,
    (abi.Buffer, "timestamp"): 24,
    (abi.Buffer, "timecode"): 40,
    (abi.Buffer, "sequence"): 56,
    (abi.Buffer, "memory"): 60,
    (abi.Buffer, "m"): 64,
    (abi.Buffer, "length"): 72,
    (abi.Buffer, "request_fd"): 80,
    (abi.V4l2Event, "u"): 8,
    (abi.V4l2Event, "pending"): 72,
    (abi.V4l2Event, "sequence"): 76,
    (abi.V4l2Event, "timestamp"): 80,
    (abi.V4l2Event, "id"): 96,
    (abi.Plane, "m"): 8,
    (abi.Plane, "data_offset"): 16,
    (abi.QueryExtCtrl, "minimum"): 40,
    (abi.QueryExtCtrl, "flags"): 72,
    (abi.ExtControls, "controls"): 24,
    (abi.Selection, "r"): 12,
    (abi.SubdevSelection, "r"): 16,
}
REQUESTS = {
    "QUERYCAP": 0x80685600,
    "ENUM_FMT": 0xC0405602,
    "G_FMT": 0xC0D05604,
    "S_FMT": 0xC0D05605,
    "TRY_FMT": 0xC0D05640,
    "REQBUFS": 0xC0145608,
    "QUERYBUF": 0xC0585609,
    "QBUF": 0xC058560F,
    "DQBUF": 0xC0585611,
    "STREAMON": 0x40045612,
    "STREAMOFF": 0x40045613,
    "QUERY_EXT_CTRL": 0xC0E85667,
    "QUERYMENU": 0xC02C5625,
    "G_EXT_CTRLS": 0xC0205647,
    "S_EXT_CTRLS": 0xC0205648,
    "DQEVENT": 0x80885659,
    "SUBSCRIBE_EVENT": 0x4020565A,
    "G_SELECTION": 0xC040565E,
    "S_SELECTION": 0xC040565F,
}


@pytest.mark.parametrize(("layout", "size"), SIZES.items(), ids=lambda v: getattr(v, "__name__", None))
def test_structures_are_as_large_as_the_kernels(layout: type[ctypes.Structure], size: int) -> None:
    assert ctypes.sizeof(layout) == size


def test_members_lie_where_the_kernel_has_them() -> None:
    assert {where: getattr(where[0], where[1]).offset for where in OFFSETS} == OFFSETS


def test_requests_have_the_kernels_numbers() -> None:
    assert {request.name: int(request) for request in abi.Ioctl} == REQUESTS
    assert abi.SUBDEV_S_FMT == 0xC0585605


@pytest.mark.parametrize(
    ("name", "code"), [("GREY", 0x59455247), ("Y10 ", 0x20303159), ("pRAA", 0x41415270), ("Y16", 0x20363159)]
)
def test_four_character_codes_are_little_endian_and_padded_with_blanks(name: str, code: int) -> None:
    assert abi.fourcc(name) == code
    assert abi.fourcc_name(code) == name.ljust(4)


def test_a_four_character_code_of_rubbish_can_be_printed() -> None:
    assert abi.fourcc_name(0x80000000 | abi.fourcc("Y16 ")) == "Y16 "
    assert abi.fourcc_name(0x000A0D00) == "????"


def test_every_packed_structure_names_the_layout_that_later_pythons_require() -> None:
    """Python 3.14 warns of `_pack_` without `_layout_`, 3.19 refuses it; before `_fields_`, or it has no effect."""
    kinds = [one for one in vars(abi).values() if isinstance(one, type) and hasattr(one, "_fields_")]
    packed = [one for one in kinds if "_pack_" in vars(one)]
    assert len(packed) == 6
    for one in packed:
        assert vars(one)["_layout_"] == "ms"
        names = list(vars(one))
        assert names.index("_layout_") < names.index("_fields_")
        assert not any(len(field) > 2 for field in one._fields_), "bit fields would lie elsewhere"
