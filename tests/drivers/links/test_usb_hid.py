"""HID reports over pyusb: endpoints, timeouts, errors."""

import errno
from typing import Any

import pytest
import usb.core

from gs2ci_drivers.links.usb_device import timeout_ms
from gs2ci_drivers.links.usb_hid import UsbHid
from gs2ci_drivers.ports import HidPort


@pytest.fixture
def port(fake: Any) -> UsbHid:
    return UsbHid("dmd0", 0x0451, 0xC900, find=lambda **_: [fake])


def test_a_report_goes_to_endpoint_1_without_a_report_id(fake: Any, port: UsbHid) -> None:
    assert isinstance(port, HidPort)
    port.write(bytes(range(64)), 0.25)
    assert fake.sent == [(0x01, bytes(range(64)), 250)]


def test_a_report_comes_as_bytes_and_silence_as_none(fake: Any, port: UsbHid) -> None:
    fake.replies.append(bytes(range(64)))
    assert port.read(1.0) == bytes(range(64))
    assert port.read(1.0) == b""


def test_a_short_report_is_handed_on_as_it_came(fake: Any, port: UsbHid) -> None:
    fake.replies.append(b"\xc0\x01")
    assert port.read(1.0) == b"\xc0\x01"


def test_draining_does_not_wait_for_ever(fake: Any, port: UsbHid) -> None:
    port.read(0.0)
    assert fake.calls[-1] == "read 1"
    assert [timeout_ms(s) for s in (-1.0, 0.0, 1e-9, 0.0011, 10.0)] == [1, 1, 1, 2, 10000]


def test_a_report_of_another_length_is_a_programming_error(port: UsbHid) -> None:
    with pytest.raises(ValueError, match="65"):
        port.write(bytes(65), 1.0)


def test_a_write_that_is_not_taken_times_out(fake: Any, port: UsbHid) -> None:
    fake.fail["write"] = usb.core.USBTimeoutError("timed out", -7, errno.ETIMEDOUT)
    with pytest.raises(TimeoutError) as caught:
        port.write(bytes(64), 0.5)
    assert caught.value.args[1] == 0.5


def test_an_unplugged_device_is_enodev_both_ways(fake: Any, port: UsbHid) -> None:
    gone = usb.core.USBError("No such device", -4, errno.ENODEV)
    fake.fail["write"] = gone
    fake.replies.append(gone)
    for call in (lambda: port.write(bytes(64), 1.0), lambda: port.read(1.0)):
        with pytest.raises(OSError, match="No such device") as caught:
            call()
        assert caught.value.errno == errno.ENODEV


def test_half_a_report_is_an_input_output_error(fake: Any, port: UsbHid) -> None:
    fake.takes = 32
    with pytest.raises(OSError, match="only 32 bytes"):
        port.write(bytes(64), 1.0)


def test_a_closed_port_is_closed_and_may_be_closed_again(fake: Any, port: UsbHid) -> None:
    port.close()
    port.close()
    for call in (lambda: port.write(bytes(64), 1.0), lambda: port.read(1.0)):
        with pytest.raises(OSError, match="closed"):
            call()
    assert fake.calls.count("release") == 1
