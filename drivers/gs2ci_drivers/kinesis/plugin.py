"""The record of Thorlabs motion controllers (`gs2ci_drivers.plugin`)."""

from typing import Final

from gs2ci_drivers.kinesis.driver import KinesisStage
from gs2ci_drivers.kinesis.options import KinesisOptions
from gs2ci_drivers.links.serial_line import SerialLine
from gs2ci_drivers.plugin import DriverPlugin


def _line(device: str, table: KinesisOptions) -> SerialLine:
    # "Set flow control to RTS/CTS" (APT protocol, section "USB interface"): else long answers may lose bytes.
    return SerialLine(device, table.port, table.baud, rts_cts=True)


KINESIS: Final = DriverPlugin(KinesisOptions, _line, KinesisStage, twin="gs2ci_sims.wires.kinesis:simulated")
