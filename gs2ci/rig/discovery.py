"""Devices plugged into this computer that a rig could use.

Here: listing them, opening a device only if its name cannot be read otherwise. Not here: using them.
"""

import usb.core
from serial.tools import list_ports

from gs2ci_drivers.dlpc900.packets import PRODUCT_ID, VENDOR_ID
from gs2ci_drivers.failures import DriverError
from gs2ci_drivers.links.gentl import GenTlPort
from gs2ci_drivers.links.sdl_screen import SdlScreen
from gs2ci_drivers.links.v4l2_sys import KernelSysPort
from gs2ci_drivers.ports import SysPort
from gs2ci_drivers.v4l2.driver import list_cameras


def find_devices(port: SysPort | None = None) -> list[tuple[str, str, str]]:
    """Return kind, port for the rig file, and name of each device found.

    Args:
        port: The system calls used to look for cameras; None takes this computer's.
    """
    cameras = [
        ("sensor", path, f"{identity.card} ({identity.driver})")
        for path, identity in list_cameras(port or KernelSysPort())
    ]
    cameras += _genicam()
    serial_ports = [("serial", info.device, info.description) for info in sorted(list_ports.comports())]
    return [*_modulators(), *_screens(), *cameras, *serial_ports]


def _genicam() -> list[tuple[str, str, str]]:
    """List the cameras of the installed GenTL producers; none without the extra `genicam`."""
    port = GenTlPort("sensor")
    try:
        found = port.list_cameras("")
    except (DriverError, OSError):  # no bindings, or no producer
        return []
    finally:
        port.close()
    return [("sensor", one.serial, f"{one.vendor} {one.model} (GenICam, {one.transport})") for one in found]


def _screens() -> list[tuple[str, str, str]]:
    """List the video outputs; none without the extra `video`, or without a display."""
    port = SdlScreen("modulator")
    try:
        found = port.list_outputs()
    except (DriverError, OSError):
        return []
    finally:
        port.close()
    return [("screen", one.name, f"video output, {one.width} x {one.height} at {one.refresh_hz:g} Hz") for one in found]


def _modulators() -> list[tuple[str, str, str]]:
    try:
        found = list(usb.core.find(find_all=True, idVendor=VENDOR_ID, idProduct=PRODUCT_ID))
    except (usb.core.NoBackendError, usb.core.USBError):
        return []  # without libusb nothing can be seen; `gs2ci doctor` says so
    return [
        ("modulator", f"usb:{one.bus}-{'.'.join(str(n) for n in one.port_numbers or ())}", "TI DLPC900")
        for one in found
    ]
