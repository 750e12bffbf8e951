"""What a V4L2 time stamp marks. Its flag says "start of exposure" or "end of frame", and is wrong for some drivers.

    unicam, rp1-cfe   stamp the bus's frame start and do not set the flag: drivers/media/platform/broadcom/
                      bcm2835-unicam.c (unicam_isr, "Timestamp is to be when the first data byte was captured"),
                      drivers/media/platform/raspberrypi/rp1-cfe/cfe.c (cfe_sof_isr_handler)
    uvcvideo          sets the flag for start of exposure and stamps the first packet: drivers/media/usb/uvc/
                      uvc_queue.c (V4L2_BUF_FLAG_TSTAMP_SRC_SOE), uvc_video.c (uvc_video_decode_start)
    tegra-video       stamps the frame start on the camera processor's own clock and flags CLOCK_MONOTONIC: NVIDIA's
                      vi5_fops.c (vi5_capture_dequeue, sof_timestamp), 29 s ahead on a Xavier (forums.developer.
                      nvidia.com/t/265011); vi2_fops.c on older ones, by getrawmonotonic
    others            as the flag says; without it the end of the frame, as videobuf2 defines

A frame's first packet leaves the sensor when its exposure has ended: with a global shutter the two are one line apart.

Here: the table and its use. Not here: the measurement of it (`gs2ci.rig.trigger_check`).
"""

from typing import Final

from gs2ci_drivers.sensor import StampMeaning

BY_DRIVER: Final[dict[str, StampMeaning]] = {
    "unicam": StampMeaning.START_OF_FRAME,
    "rp1-cfe": StampMeaning.START_OF_FRAME,
    "uvcvideo": StampMeaning.START_OF_FRAME,
    "tegra-video": StampMeaning.START_OF_FRAME,
}
CLOCKS_OF_THEIR_OWN: Final = frozenset({"tegra-video"})
"""Kernel drivers whose stamps drift beside CLOCK_MONOTONIC, whatever their flag says."""


def meaning_of(driver: str, stated: StampMeaning | None, *, flagged: bool) -> StampMeaning:
    """Return the event that a time stamp marks.

    Args:
        driver: Name of the kernel driver.
        stated: What the rig file says, if anything.
        flagged: Whether the kernel flags it as the start of exposure.
    """
    if stated is not None:
        return stated
    return BY_DRIVER.get(driver, StampMeaning.START_OF_EXPOSURE if flagged else StampMeaning.END_OF_FRAME)
