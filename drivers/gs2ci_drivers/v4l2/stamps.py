"""What a V4L2 time stamp is the time of. The flag says "start of exposure" or "end of frame", and is not to be trusted.

    unicam, rp1-cfe   stamp the frame start of the bus and leave the flag away: drivers/media/platform/broadcom/
                      bcm2835-unicam.c (unicam_isr, "Timestamp is to be when the first data byte was captured"),
                      drivers/media/platform/raspberrypi/rp1-cfe/cfe.c (cfe_sof_isr_handler)
    uvcvideo          raises the flag for start of exposure and stamps the first packet: drivers/media/usb/uvc/
                      uvc_queue.c (V4L2_BUF_FLAG_TSTAMP_SRC_SOE), uvc_video.c (uvc_video_decode_start)
    others            as the flag says; without it the end of the frame, as videobuf2 has it

A frame's first packet leaves the sensor when its exposure has ended: with a global shutter the two are one line apart.

Here: the table and its use. Not here: finding out by measuring (`gs2ci.rig.trigger_check`).
"""

from typing import Final

from gs2ci_drivers.sensor import StampMeaning

BY_DRIVER: Final[dict[str, StampMeaning]] = {
    "unicam": StampMeaning.START_OF_FRAME,
    "rp1-cfe": StampMeaning.START_OF_FRAME,
    "uvcvideo": StampMeaning.START_OF_FRAME,
}


def meaning_of(driver: str, stated: StampMeaning | None, *, flagged: bool) -> StampMeaning:
    """Return what a time stamp is the time of.

    Args:
        driver: Name of the kernel driver.
        stated: What the rig file says, if anything.
        flagged: Whether the kernel flags it as the start of exposure.
    """
    if stated is not None:
        return stated
    return BY_DRIVER.get(driver, StampMeaning.START_OF_EXPOSURE if flagged else StampMeaning.END_OF_FRAME)
