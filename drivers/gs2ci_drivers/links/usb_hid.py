"""A USB HID interface with 64-byte reports as a `HidPort`, by pyusb (libusb, no hidraw, no report ids).

Here: the reports. Not here: finding, claiming and transfers (`usb_device`), any protocol.
"""

import errno
from typing import Final

import usb.core

from gs2ci_drivers.links.usb_device import ClaimedInterfaces, Find
from gs2ci_drivers.ports import HID_REPORT_BYTES

# Addresses of the interrupt endpoints to the device and from it.
_ENDPOINT_OUT: Final = 0x01
_ENDPOINT_IN: Final = 0x81


class UsbHid:
    """A HID interface that keeps the rules of `HidPort`.

    Args:
        device: Name of the device in the rig file, for messages.
        vendor_id: USB vendor.
        product_id: USB product.
        bus_port: Which one, if several are plugged in: "1-2.3" as in /sys/bus/usb/devices.
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
        bus_port: str = "",
        find: Find = usb.core.find,
    ) -> None:
        self._claimed = ClaimedInterfaces(device, vendor_id, product_id, bus_port=bus_port, find=find)

    def write(self, report: bytes, timeout_s: float) -> None:
        """Send one report; see `HidPort.write`."""
        if len(report) != HID_REPORT_BYTES:
            raise ValueError(f"a HID report of {len(report)} bytes instead of {HID_REPORT_BYTES}")
        written = self._claimed.write(_ENDPOINT_OUT, report, timeout_s)
        if written != HID_REPORT_BYTES:
            raise OSError(errno.EIO, f"only {written} bytes of a report were sent")

    def read(self, timeout_s: float) -> bytes:
        """Receive one report; see `HidPort.read`."""
        try:
            return self._claimed.read(_ENDPOINT_IN, HID_REPORT_BYTES, timeout_s)
        except TimeoutError:
            return b""

    def close(self) -> None:
        """Give the interface back to the kernel; a second call does nothing."""
        self._claimed.close()
