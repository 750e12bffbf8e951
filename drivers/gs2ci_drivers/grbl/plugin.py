"""The record of GRBL controllers (`gs2ci_drivers.plugin`)."""

from typing import Final

from gs2ci_drivers.grbl.driver import GrblStage
from gs2ci_drivers.grbl.options import GrblOptions
from gs2ci_drivers.links.serial_line import serial_line
from gs2ci_drivers.plugin import DriverPlugin

GRBL: Final = DriverPlugin(GrblOptions, serial_line, GrblStage, twin="gs2ci_sims.wires.grbl:simulated")
