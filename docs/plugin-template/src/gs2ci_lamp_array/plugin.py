"""What gs2ci is told of the driver; the entry point `gs2ci.modulators` names `LAMP_ARRAY`."""

from typing import Any

from gs2ci_drivers.links.serial_line import SerialLine
from gs2ci_drivers.plugin import DriverPlugin
from gs2ci_lamp_array.driver import COLUMNS, ROWS, LampArray
from gs2ci_lamp_array.settings import LampArrayOptions


def _port(device: str, settings: LampArrayOptions) -> SerialLine:
    return SerialLine(device, settings.port, settings.baud)


def _twin(world: Any, settings: LampArrayOptions) -> Any:
    from gs2ci_lamp_array.twin import LampArrayTwin  # a real bench does without the simulator

    return LampArrayTwin(world, settings)


LAMP_ARRAY = DriverPlugin(
    settings=LampArrayOptions, port=_port, driver=LampArray, port_kind="bytes", twin=_twin, size=(ROWS, COLUMNS)
)
