"""Whether a V4L2 camera exposes its rows at once: no control tells, the name of the sensor's kernel driver does.

Behind a rolling shutter each row begins one line time after the one above it. Masks that change meanwhile reach the
last rows of a frame for another time than the first ones, however long the exposure is. Imported by `setup`.
"""

from typing import Final

from gs2ci_drivers.ports import SysPort
from gs2ci_drivers.v4l2.options import V4l2Options

ROLLING: Final = frozenset({"imx219", "imx290", "imx335", "imx477", "imx500", "imx708", "ov5647"})
"""Kernel drivers of rolling sensors: the IMX219 (docs.zephyrproject.org, Camera Module 2: "rolling shutter"), the
IMX335 (Balluff CA-UB, sensors), the IMX477 (wiki.kurokesu.com, 477x-CSI) and the IMX378, which imx477.c also drives
(docs.luxonis.com, Shutter Type), the IMX462, which imx290.c drives with the IMX290 and IMX327 (docs.luxonis.com), and
those of all Raspberry Pi cameras but the Global Shutter Camera (their documentation, Rolling or Global shutter?)."""
GLOBAL: Final = frozenset({"imx296", "ov9282", "ov7251", "ar0234"})
"""Of sensors that expose all rows at once (Balluff CA-UB for the IMX296; docs.luxonis.com for the others)."""
BOUND: Final = "/sys/bus/i2c/drivers/{driver}/*-*"
"""What the kernel shows of a driver that has a sensor: an entry by bus and address."""

ROLLS: Final = (
    "the sensor has a rolling shutter, its rows begin within {:.3g} ms one after the other: a plan refuses masks that "
    "are short beside that"
)


def rolls(port: SysPort, options: V4l2Options) -> bool:
    """Return whether the rows of a frame begin one after the other, by the rig file or by the sensor's kernel driver.

    False if neither tells, or if sensors of both kinds are there.
    """
    if options.shutter is not None:
        return options.shutter == "rolling"
    if options.trigger_adapter == "module":
        return options.trigger_module in ROLLING
    there = {driver for driver in ROLLING | GLOBAL if port.list_nodes(BOUND.format(driver=driver))}
    return bool(there) and there <= ROLLING
