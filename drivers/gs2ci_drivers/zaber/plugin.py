"""The record of Zaber stages (`gs2ci_drivers.plugin`)."""

from typing import Final

from gs2ci_drivers.links.serial_line import serial_line
from gs2ci_drivers.plugin import DriverPlugin
from gs2ci_drivers.zaber.driver import ZaberStage
from gs2ci_drivers.zaber.options import ZaberOptions

ZABER: Final = DriverPlugin(ZaberOptions, serial_line, ZaberStage, twin="gs2ci_sims.wires.zaber:simulated")
