"""The FIFO of an FTDI FT600/FT601 USB 3 bridge as a `BytePort`, by pyusb: the link of Santec SLM-200 class panels.

Here: the bridge's read requests and the blocks that follow. Not here: finding, claiming and transfers (`usb_device`),
any protocol.

Experimental: written from public knowledge of the bridge (data on 0x02/0x82 of interface 1; before data flows in,
the host asks for it with a 20-byte request on 0x01 of interface 0: `struct ft60x_ctrlreq` of Lambdaconcept's Linux
driver), not confirmed on hardware.
"""

import struct
from typing import Final

import usb.core

from gs2ci_drivers.links.usb_device import ClaimedInterfaces, Find

VENDOR_ID: Final = 0x0403
PRODUCT_ID: Final = 0x601F
_CONTROL_OUT: Final = 0x01
_DATA_OUT: Final = 0x02
_DATA_IN: Final = 0x82
_READ: Final = 1
_REQUEST: Final = struct.Struct("<IBBHIII")
_BLOCK_BYTES: Final = 4096


class UsbFifo:
    """A bridge's first channel that keeps the rules of `BytePort`.

    Args:
        device: Name of the device in the rig file, for messages.
        bus_port: Which one, if several are plugged in: "1-2.3" as in /sys/bus/usb/devices.
        find: pyusb's search, replaceable in tests.

    Raises:
        AccessError: Not found, found more than once, no permission, in use, or libusb is missing.
        DisconnectedError: It went away meanwhile.
    """

    def __init__(self, device: str, *, bus_port: str = "", find: Find = usb.core.find) -> None:
        self._claimed = ClaimedInterfaces(
            device, VENDOR_ID, PRODUCT_ID, interfaces=(0, 1), bus_port=bus_port, find=find
        )
        self._requested = False
        self._requests = 0
        self._received = b""

    def write(self, data: bytes, timeout_s: float) -> None:
        """Send all of `data`; see `BytePort.write`."""
        written = self._claimed.write(_DATA_OUT, data, timeout_s)
        if written != len(data):
            raise TimeoutError(f"only {written} of {len(data)} bytes were taken", timeout_s)

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        """Receive what there is; see `BytePort.read`."""
        if not self._received:
            self._received = self._fetch(timeout_s)
        data, self._received = self._received[:max_bytes], self._received[max_bytes:]
        return data

    def _fetch(self, timeout_s: float) -> bytes:
        try:
            if not self._requested:
                self._requests += 1
                request = _REQUEST.pack(self._requests, _DATA_IN, _READ, 0, _BLOCK_BYTES, 0, 0)
                self._claimed.write(_CONTROL_OUT, request, timeout_s)
                self._requested = True  # until data comes: a second request would queue behind the first
            data = self._claimed.read(_DATA_IN, _BLOCK_BYTES, timeout_s)
        except TimeoutError:
            return b""
        self._requested = False
        return data

    def close(self) -> None:
        """Release the bridge; a second call does nothing."""
        self._claimed.close()
