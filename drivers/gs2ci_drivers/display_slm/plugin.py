"""The record of Santec SLM-200 class panels (`gs2ci_drivers.plugin`)."""

from typing import Final

from gs2ci_drivers.display_slm.driver import DisplaySlm
from gs2ci_drivers.display_slm.options import DisplaySlmOptions
from gs2ci_drivers.links.usb_bulk import PRODUCT_ID, VENDOR_ID, UsbFifo
from gs2ci_drivers.links.usb_device import bus_port
from gs2ci_drivers.plugin import DriverPlugin


def _fifo(device: str, table: DisplaySlmOptions) -> UsbFifo:
    return UsbFifo(device, bus_port=bus_port(table.port))


SANTEC: Final = DriverPlugin(
    DisplaySlmOptions,
    _fifo,
    DisplaySlm,
    twin="gs2ci_sims.wires.display_slm:simulated",
    size=(1200, 1920),
    access="usb",
    usb_ids=(VENDOR_ID, PRODUCT_ID),
)
