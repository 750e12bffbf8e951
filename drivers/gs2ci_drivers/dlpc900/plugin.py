"""The record of DLPC900 controllers (`gs2ci_drivers.plugin`)."""

from typing import Final

from gs2ci_drivers.dlpc900.driver import Dlpc900
from gs2ci_drivers.dlpc900.options import Dlpc900Options
from gs2ci_drivers.dlpc900.packets import PRODUCT_ID, VENDOR_ID
from gs2ci_drivers.links.usb_device import bus_port
from gs2ci_drivers.links.usb_hid import UsbHid
from gs2ci_drivers.plugin import DriverPlugin


def _hid(device: str, table: Dlpc900Options) -> UsbHid:
    return UsbHid(device, VENDOR_ID, PRODUCT_ID, bus_port=bus_port(table.port))


DLPC900: Final = DriverPlugin(
    Dlpc900Options,
    _hid,
    Dlpc900,
    "hid",
    twin="gs2ci_sims.wires.dlpc900:simulated",
    size=(1080, 1920),  # a DLP6500
    pulse_line="out2",
    gate_line="out1",
    access="usb",
    usb_ids=(VENDOR_ID, PRODUCT_ID),
)
