"""Interfaces of a USB device by pyusb: found, claimed, written and read, and returned to the kernel's driver.

Here: what the HID and the bulk link share. Not here: endpoints and their contents (`usb_hid`, `usb_bulk`).
"""

import errno
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final

import usb.core
import usb.util

from gs2ci_drivers.failures import AccessError
from gs2ci_drivers.ports import port_errors

Find = Callable[..., Any]
RELATIVES: Final = {
    (0x0451, 0x6401): "DLPC350 (LightCrafter 4500)",
    (0x0451, 0x7540): "DLPC6540",
}
"""Controllers that are taken for one with a driver (SivyerLab/pyCrafter4500 0d17dd6a, connect_usb; TI's DLP471TPEVM by
those who use one): the first takes patterns by video or from its flash only (its set_pattern_input_source)."""


def udev_rules(vendor_id: int, product_id: int) -> str:
    """Return the udev rules that let members of group `plugdev` and the locally logged-in user use a USB device."""
    ids = f'ATTRS{{idVendor}}=="{vendor_id:04x}", ATTRS{{idProduct}}=="{product_id:04x}"'
    access = 'MODE="0660", GROUP="plugdev", TAG+="uaccess"'
    return f'SUBSYSTEM=="usb", {ids}, {access}\nSUBSYSTEM=="hidraw", {ids}, {access}\n'


def bus_port(port: str) -> str:
    """Return the bus address of a USB device: the part after "usb:", "" if there is none."""
    return port.removeprefix("usb").removeprefix(":")


class ClaimedInterfaces:
    """Interfaces of a USB device that this process holds until `close`.

    The kernel's own driver (usbhid) is detached for that time and attached again afterwards. Nothing is reset and
    no configuration is set, unless the device has none yet.

    Args:
        device: Name of the device in the rig file, for messages.
        vendor_id: USB vendor.
        product_id: USB product.
        interfaces: Numbers of the interfaces to claim.
        bus_port: Which one, if several are plugged in: "1-2.3" as in /sys/bus/usb/devices; "" for the only one.
        find: pyusb's search, replaceable in tests.

    Raises:
        AccessError: Not found, found more than once, no permission, in use, or libusb is missing.
        DisconnectedError: It went away meanwhile.
    """

    def __init__(
        self,
        device: str,
        vendor_id: int,
        product_id: int,
        *,
        interfaces: Sequence[int] = (0,),
        bus_port: str = "",
        find: Find = usb.core.find,
    ) -> None:
        self._claimed: list[int] = []
        self._detached: list[int] = []
        with port_errors(device, "open"):
            self.usb: Any = _find_one(device, vendor_id, product_id, bus_port, find)
            try:
                for interface in interfaces:
                    self._claim(interface)
            except usb.core.USBError as error:
                self.close()
                if error.errno in (errno.EACCES, errno.EPERM):
                    raise AccessError(
                        device,
                        f"no permission for USB device {vendor_id:04x}:{product_id:04x} ({error})",
                        asked="open",
                        remedy="write these udev rules to /etc/udev/rules.d/60-gs2ci.rules, run `udevadm control "
                        f"--reload`, and plug the device in again:\n{udev_rules(vendor_id, product_id)}",
                    ) from error
                raise as_os_error(error) from error

    def _claim(self, interface: int) -> None:
        # Not every backend supports this query; on systems whose backend does not, no kernel driver is to be detached.
        with suppress(NotImplementedError):
            if self.usb.is_kernel_driver_active(interface):
                self.usb.detach_kernel_driver(interface)
                self._detached.append(interface)
        usb.util.claim_interface(self.usb, interface)
        self._claimed.append(interface)

    def write(self, endpoint: int, data: bytes, timeout_s: float) -> int:
        """Send data to an endpoint; return how many bytes were taken.

        Raises:
            TimeoutError: None in time.
            OSError: The port is closed (ENODEV), or the transfer failed.
        """
        return int(self._transfer(self.usb.write, endpoint, data, timeout_s))

    def read(self, endpoint: int, most_bytes: int, timeout_s: float) -> bytes:
        """Receive the data that an endpoint has ready.

        Raises:
            TimeoutError: Nothing in time.
            OSError: The port is closed (ENODEV), or the transfer failed.
        """
        return bytes(self._transfer(self.usb.read, endpoint, most_bytes, timeout_s))

    def _transfer(self, call: Callable[..., Any], endpoint: int, what: bytes | int, timeout_s: float) -> Any:
        if not self.is_open:
            raise OSError(errno.ENODEV, "the port is closed")
        try:
            return call(endpoint, what, timeout_ms(timeout_s))
        except usb.core.USBTimeoutError as error:
            raise TimeoutError(str(error), timeout_s) from error
        except usb.core.USBError as error:
            raise as_os_error(error) from error

    def close(self) -> None:
        """Release the interfaces and give them back to the kernel's driver; a second call does nothing."""
        for interface in self._claimed:
            with suppress(usb.core.USBError):
                usb.util.release_interface(self.usb, interface)
        for interface in self._detached:
            with suppress(usb.core.USBError):
                self.usb.attach_kernel_driver(interface)
        self._claimed, self._detached = [], []
        usb.util.dispose_resources(self.usb)

    @property
    def is_open(self) -> bool:
        """Get whether any interface is claimed."""
        return bool(self._claimed)


def timeout_ms(timeout_s: float) -> int:
    """Return a timeout for libusb: at least 1 ms, because 0 would mean endless."""
    return max(math.ceil(timeout_s * 1e3), 1)


def as_os_error(error: usb.core.USBError) -> OSError:
    """Return the error with an errno: EIO if the backend gives none."""
    return OSError(error.errno if error.errno is not None else errno.EIO, str(error))


def _find_one(device: str, vendor_id: int, product_id: int, bus_port: str, find: Find) -> Any:
    name = f"USB device {vendor_id:04x}:{product_id:04x}"
    try:
        found = list(find(find_all=True, idVendor=vendor_id, idProduct=product_id))
    except usb.core.NoBackendError as error:
        raise AccessError(
            device, "libusb is not installed", asked="open", remedy="install it: `apt install libusb-1.0-0`"
        ) from error
    places = {_bus_port(one): one for one in found}
    if bus_port:
        found = [places[bus_port]] if bus_port in places else []
    if not found:
        where, remedy = f" at {bus_port}" if bus_port else "", "check power and cable; `lsusb` must list it"
        for (vendor, product), relative in RELATIVES.items():
            if vendor == vendor_id and not places and list(find(find_all=True, idVendor=vendor, idProduct=product)):
                where = f", but a {relative}, which takes no patterns by USB here"
                remedy = 'connect it as a second display and set kind = "video" in [modulator] (docs/bench.md)'
        raise AccessError(device, f"no {name}{where}", asked="open", allowed=", ".join(sorted(places)), remedy=remedy)
    if len(found) > 1:
        raise AccessError(
            device,
            f"{len(found)} of {name} are connected",
            asked="open",
            allowed=", ".join(sorted(places)),
            remedy=f'set port = "usb:{min(places)}" for one of them, in its table of the rig file',
        )
    return found[0]


def _bus_port(one: Any) -> str:
    return f"{one.bus}-{'.'.join(str(number) for number in one.port_numbers or ())}"
