"""The record of ViALUX DMDs (`gs2ci_drivers.plugin`)."""

from typing import Final

from gs2ci_drivers.alp.driver import AlpModulator
from gs2ci_drivers.alp.options import AlpOptions
from gs2ci_drivers.links.alp_library import AlpLibrary
from gs2ci_drivers.plugin import DriverPlugin


def _library(device: str, table: AlpOptions) -> AlpLibrary:
    return AlpLibrary(device, table.version, table.library_file.parent)


ALP: Final = DriverPlugin(
    AlpOptions,
    _library,
    AlpModulator,
    "library",
    twin="gs2ci_sims.wires.alp:simulated",
    size=(768, 1024),  # a 0.7" XGA
    access="library",
)
