"""The record of the Linux kernel's cameras (`gs2ci_drivers.plugin`)."""

from typing import Final

from gs2ci_drivers.links.v4l2_sys import KernelSysPort
from gs2ci_drivers.plugin import DriverPlugin
from gs2ci_drivers.v4l2.driver import V4l2Sensor
from gs2ci_drivers.v4l2.options import V4l2Options

V4L2: Final = DriverPlugin(
    V4l2Options, lambda *_: KernelSysPort(), V4l2Sensor, "sys", twin="gs2ci_sims.wires.v4l2:simulated", access="video"
)
