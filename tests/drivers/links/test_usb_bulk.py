"""The FT601 FIFO over pyusb: read requests, blocks, timeouts."""

import errno
from typing import Any

import pytest
import usb.core

from gs2ci_drivers.links.usb_bulk import UsbFifo
from gs2ci_drivers.ports import BytePort


@pytest.fixture
def port(fake: Any) -> UsbFifo:
    return UsbFifo("slm0", find=lambda **_: [fake])


def test_data_goes_to_endpoint_2(fake: Any, port: UsbFifo) -> None:
    assert isinstance(port, BytePort)
    assert fake.claimed == {0, 1}
    port.write(b"SEND", 1.0)
    assert fake.sent == [(0x02, b"SEND", 1000)]


def test_data_is_asked_for_once_until_it_comes(fake: Any, port: UsbFifo) -> None:
    assert port.read(10, 0.1) == b""
    assert port.read(10, 0.1) == b""
    fake.replies.append(b"abcdef")
    assert port.read(4, 0.1) == b"abcd"
    assert port.read(4, 0.1) == b"ef"
    assert port.read(4, 0.1) == b""
    requests = [data for endpoint, data, _ in fake.sent if endpoint == 0x01]
    assert requests == [
        bytes.fromhex("01000000 82 01 0000 00100000 00000000 00000000"),
        bytes.fromhex("02000000 82 01 0000 00100000 00000000 00000000"),
    ]


def test_errors_are_those_of_a_port(fake: Any, port: UsbFifo) -> None:
    fake.takes = 3
    with pytest.raises(TimeoutError, match="3 of 4"):
        port.write(b"SEND", 1.0)
    fake.takes = None
    fake.fail["write"] = usb.core.USBTimeoutError("timed out", -7, errno.ETIMEDOUT)
    with pytest.raises(TimeoutError):
        port.write(b"SEND", 1.0)
    fake.fail["write"] = usb.core.USBError("No such device", -4, errno.ENODEV)
    for call in (lambda: port.write(b"SEND", 1.0), lambda: port.read(4, 1.0)):
        with pytest.raises(OSError, match="No such device"):
            call()
    port.close()
    port.close()
    with pytest.raises(OSError, match="closed"):
        port.read(4, 0.0)
