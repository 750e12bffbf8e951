"""Finding, claiming and giving back a USB interface."""

import errno
from typing import Any

import pytest
import usb.core

from gs2ci_drivers.failures import AccessError, DisconnectedError
from gs2ci_drivers.links.usb_device import ClaimedInterfaces, as_os_error, udev_rules


def finder(*devices: Any) -> Any:
    def find(*, find_all: bool, idVendor: int, idProduct: int) -> Any:
        assert (find_all, idVendor) == (True, 0x0451)
        return iter(devices if idProduct == 0xC900 else ())

    return find


def claim(*devices: Any, bus_port: str = "") -> ClaimedInterfaces:
    return ClaimedInterfaces("dmd0", 0x0451, 0xC900, bus_port=bus_port, find=finder(*devices))


def test_the_kernels_driver_is_detached_and_attached_again_and_nothing_is_reset(fake: Any) -> None:
    claimed = claim(fake)
    assert fake.calls == ["is_kernel_driver_active", "detach", "claim"]
    assert claimed.is_open
    claimed.close()
    claimed.close()
    assert fake.calls[3:6] == ["release", "attach", "dispose"]
    assert fake.kernel_driver[0]
    assert not claimed.is_open


def test_no_kernel_driver_is_attached_where_none_was(fake: Any) -> None:
    fake.kernel_driver[0] = False
    claim(fake).close()
    assert "attach" not in fake.calls


def test_a_backend_that_knows_no_kernel_drivers_is_fine(fake: Any) -> None:
    fake.fail["is_kernel_driver_active"] = NotImplementedError()
    assert claim(fake).is_open


@pytest.mark.parametrize("code", [errno.EACCES, errno.EPERM])
def test_missing_permission_comes_with_the_udev_rules(fake: Any, code: int) -> None:
    fake.fail["detach"] = usb.core.USBError("Access denied", -3, code)
    with pytest.raises(AccessError, match=r'(?s)dmd0.*no permission.*udev.*ATTRS\{idVendor\}=="0451"'):
        claim(fake)
    assert "dispose" in fake.calls


def test_a_busy_interface_is_named_and_given_back(fake: Any) -> None:
    fake.fail["claim"] = usb.core.USBError("Resource busy", -6, errno.EBUSY)
    with pytest.raises(AccessError, match="cannot be used"):
        claim(fake)
    assert fake.kernel_driver[0]


def test_a_device_that_goes_away_meanwhile_is_disconnected(fake: Any) -> None:
    fake.fail["detach"] = usb.core.USBError("No such device", -4, errno.ENODEV)
    with pytest.raises(DisconnectedError, match="gone"):
        claim(fake)


def test_none_or_several_devices_are_refused_with_those_there_are(fake: Any) -> None:
    with pytest.raises(AccessError, match=r"no USB device 0451:c900.*lsusb"):
        claim()
    other = type(fake)(bus=3, port_numbers=(1,))
    with pytest.raises(AccessError, match=r"2 of USB device.*1-2\.3, 3-1.*set port = .usb:1-2\.3"):
        claim(fake, other)
    with pytest.raises(AccessError, match=r"at 9-9.*1-2\.3, 3-1"):
        claim(fake, other, bus_port="9-9")
    assert claim(fake, other, bus_port="3-1").usb is other


def test_a_relative_without_a_driver_is_named_with_the_way_there_is(fake: Any) -> None:
    def find(*, find_all: bool, idVendor: int, idProduct: int) -> Any:
        return iter([fake] if idProduct == 0x6401 else [])

    with pytest.raises(AccessError, match=r'no USB device 0451:c900, but a DLPC350 .*kind = "video" in \[modulator\]'):
        ClaimedInterfaces("dmd0", 0x0451, 0xC900, find=find)


def test_missing_libusb_is_said_with_the_package_to_install() -> None:
    def find(**_: Any) -> Any:
        raise usb.core.NoBackendError("No backend available")

    with pytest.raises(AccessError, match=r"libusb-1\.0-0"):
        ClaimedInterfaces("dmd0", 0x0451, 0xC900, find=find)


def test_udev_rules_cover_usb_and_hidraw() -> None:
    rules = udev_rules(0x0451, 0xC900).splitlines()
    assert [rule.split(",")[0] for rule in rules] == ['SUBSYSTEM=="usb"', 'SUBSYSTEM=="hidraw"']
    assert all('ATTRS{idProduct}=="c900"' in rule and "uaccess" in rule for rule in rules)


def test_an_error_without_a_number_becomes_an_input_output_error() -> None:
    assert as_os_error(usb.core.USBError("pipe")).errno == errno.EIO
    assert as_os_error(usb.core.USBError("gone", -4, errno.ENODEV)).errno == errno.ENODEV
