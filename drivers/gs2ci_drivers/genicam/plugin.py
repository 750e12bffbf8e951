"""The record of GenICam cameras (`gs2ci_drivers.plugin`)."""

from typing import Final

from gs2ci_drivers.genicam.driver import GenicamSensor
from gs2ci_drivers.genicam.options import GenicamOptions
from gs2ci_drivers.links.gentl import GenTlPort
from gs2ci_drivers.plugin import DriverPlugin

GENICAM: Final = DriverPlugin(
    GenicamOptions,
    lambda device, _: GenTlPort(device),
    GenicamSensor,
    "camera",
    twin="gs2ci_sims.wires.genicam:simulated",
    access="gentl",
)
