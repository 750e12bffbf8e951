"""The record of modulators with the open command set (`gs2ci_drivers.plugin`)."""

from typing import Final

from gs2ci_drivers.links.serial_line import serial_line
from gs2ci_drivers.plugin import DriverPlugin
from gs2ci_drivers.scpi_modulator.driver import ScpiModulator
from gs2ci_drivers.scpi_modulator.options import ScpiOptions

SCPI: Final = DriverPlugin(
    ScpiOptions,
    serial_line,
    ScpiModulator,
    twin="gs2ci_sims.wires.scpi_modulator:simulated",
    size=(300, 400),  # the protocol's reference device
)
