"""The record of modulators on a video output (`gs2ci_drivers.plugin`)."""

from typing import Final

from gs2ci_drivers.links.sdl_screen import SdlScreen
from gs2ci_drivers.plugin import DriverPlugin
from gs2ci_drivers.video_out.driver import VideoOut
from gs2ci_drivers.video_out.options import VideoOutOptions

VIDEO: Final = DriverPlugin(
    VideoOutOptions,
    lambda device, _: SdlScreen(device),
    VideoOut,
    "screen",
    twin="gs2ci_sims.wires.screen:simulated",
    size=(1080, 1920),
    access="none",
)
