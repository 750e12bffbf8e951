"""The camera behind the V4L2 twin: its data sheet, and the bytes that it sends.

Here: `CameraModel` (a data sheet) and `pack_frame`. Not here: cameras that differ from a usual one
(`tests/twins/v4l2.py`), the times of its exposures (`shutter`), ioctls and
buffers (`v4l2`, `v4l2_queue`), controls (`v4l2_controls`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from gs2ci.core.arrays import U8, U16
from gs2ci.core.errors import InputError
from gs2ci_sims.wires.shutter import ShutterModel, Shutting

BITS = {"GREY": 8, "Y10 ": 10, "Y12 ": 12, "Y16 ": 16, "Y10P": 10, "Y12P": 12, "RGGB": 8, "RG10": 10, "RG12": 12}
BITS |= {"RG16": 16, "pRAA": 10, "pRCC": 12, "Y14 ": 14, "RG14": 14, "Y14P": 14, "pREE": 14}
FIVE_FOURTHS = ("Y10P", "pRAA")
THREE_HALVES = ("Y12P", "pRCC")
SEVEN_FOURTHS = ("Y14P", "pREE")
"""linux, pixfmt-srggb14p.rst: four high bytes, then 24 bits with six low bits of each pixel, the first pixel lowest."""
ONE = ("GREY", "RGGB")
_LEAST_SIDE: Final = 4
PADDING_BYTE = 0xA5
"""The padding after the pixels of a row, visible in the picture of a program that ignores the stride."""


MODULE_MODES: Final[Mapping[str, Mapping[int, Shutting]]] = {
    "imx296": {1: Shutting.LEVEL},
    "imx477": {2: Shutting.EDGE},
}
"""What a module's parameter `trigger_mode` switches on besides the sensor's own clock; other modules: 1 an edge.

imx296.c, "0=default, 1=XTRIG"; imx477.c, MODULE_PARM_DESC "Set vsync trigger mode: 1=source, 2=sink" and
imx477_start_streaming: as a source the sensor runs by its own clock and drives its XVS pin."""
REALTIME_S: Final = 1.79e9
"""CLOCK_REALTIME less CLOCK_MONOTONIC on a computer that was started at the beginning of the simulated world."""


Stamps = Literal["start-of-exposure", "start-of-frame", "end-of-frame"]
STAMPING: dict[str, tuple[Stamps, bool]] = {
    "twin": ("start-of-exposure", True),
    "unicam": ("start-of-frame", False),
    "rp1-cfe": ("start-of-frame", False),
    "uvcvideo": ("start-of-frame", True),
    "other": ("end-of-frame", False),
}
"""The event that kernel drivers stamp, and whether they flag it as the start of exposure, by their sources: unicam_isr
in bcm2835-unicam.c and cfe_sof_isr_handler in rp1-cfe/cfe.c stamp the frame start on the bus, and set only MONOTONIC
in the queue's flags; uvc_queue.c flags SOE and uvc_video_decode_start stamps the first packet; videobuf2 drivers in
general stamp a buffer when its frame is complete."""


@dataclass(frozen=True)
class CameraModel(ShutterModel):
    """A camera's data sheet; further arguments as for `ShutterModel`.

    Args:
        height: Rows of the pixel array, a multiple of 2.
        width: Columns, a multiple of 4.
        formats: Four-character codes of its formats; the first is the default.
        line_s: Time of one line.
        trigger: Adapter for external triggers; "outside": the sensor was switched by other means (I2C, hidraw).
        outside: What it was switched to by them.
        module: Kernel module with the parameter, for `trigger` = "module".
        clock_ppm: Difference of its second from the world's; positive is longer.
        driver: Name of the kernel driver; see `STAMPING`.
        stamps: The event of a time stamp: the start of exposure, the start of the frame's transfer (at the end of the
            exposure) or the end of the transfer.
        flags_start: Whether stamps are flagged as the start of exposure (V4L2_BUF_FLAG_TSTAMP_SRC_SOE).
        on_subdevice: Whether the controls are on the sub-device.
        crops: Whether a region of the pixel array can be read out, and no other size: as in imx296_set_selection and
            imx296_set_format of drivers/media/i2c/imx296.c, offsets and sizes are rounded up to multiples of 4.
        rolls: Whether rows begin one after the other, a line time apart, instead of all at once.
    """

    height: int = 64
    width: int = 96
    formats: tuple[str, ...] = ("Y10 ", "GREY", "Y12 ", "Y16 ", "Y10P", "Y12P", "RG10", "RG12", "pRAA", "pRCC")
    line_s: float = 10e-6
    trigger: Literal["module", "control", "none", "outside"] = "control"
    outside: Shutting = Shutting.EDGE
    module: str = "imx296"
    clock_ppm: float = 0.0
    driver: str = "twin"
    stamps: Stamps = "end-of-frame"
    flags_start: bool = False
    on_subdevice: bool = False
    crops: bool = False
    rolls: bool = False

    @property
    def active_low(self) -> bool:
        """Get whether it exposes while its line is low.

        The IMX296 does: "exposure time = XTRIG low level pulse width + 14.26 us" (its data sheet, as quoted in
        raspberrypi/linux pull request 5560).
        """
        return self.trigger == "module" and self.module == "imx296"

    @property
    def files(self) -> dict[str, bytes]:
        """Get what the kernel shows of the sensor's device tree below /sys/bus/i2c, as on a Raspberry Pi, by file."""
        if self.trigger == "module":
            return {f"/sys/bus/i2c/drivers/{self.module}/10-001a/of_node/compatible": b"twin"}
        node = "/sys/bus/i2c/drivers/vc-mipi-cam/10-001a/of_node"
        # With the property `libcamera` exposures are in lines (vc_mipi_camera.c, vc_sd_s_ctrl).
        return {f"{node}/compatible": b"twin", f"{node}/libcamera": b""} if self.trigger == "control" else {}

    def module_mode(self, value: int) -> Shutting:
        """Return what a number of the module's parameter switches on."""
        return MODULE_MODES.get(self.module, {1: Shutting.EDGE}).get(value, Shutting.FREE)

    def __post_init__(self) -> None:
        unknown = [code for code in self.formats if code not in BITS]
        if unknown or not self.formats:
            raise InputError(
                f"a simulated V4L2 camera of format {', '.join(map(repr, unknown)) or 'none'}",
                allowed=f"four characters: {', '.join(BITS)}",
                remedy="change `format` in [sensor] of the rig file",
            )
        if self.height % 2 or self.width % 4 or min(self.height, self.width) < _LEAST_SIDE:
            raise InputError(
                f"a simulated V4L2 camera of {self.height} rows and {self.width} columns",
                allowed=f"an even number of rows and a multiple of 4 columns, {_LEAST_SIDE} or more of each",
                remedy="change `height` and `width` in [sensor] and [world] of the rig file",
            )

    def bits(self, code: str) -> int:
        """Return the bits of a pixel that carry the value."""
        return BITS[code]

    def stride(self, code: str, width: int) -> int:
        """Return the bytes from one row to the next."""
        return row_bytes(code, width)


def row_bytes(code: str, width: int) -> int:
    """Return the bytes of a row without padding."""
    if code in ONE:
        return width
    if code in FIVE_FOURTHS:
        return width // 4 * 5
    if code in SEVEN_FOURTHS:
        return width // 4 * 7
    return width // 2 * 3 if code in THREE_HALVES else 2 * width


def pack_frame(pixels: U16, code: str, stride: int) -> U8:
    """Pack pixels as a sensor sends them.

    Args:
        pixels: [H, W] uint16, W a multiple of 4.
        code: Four-character code.
        stride: Bytes per row; those after the pixels are `PADDING_BYTE`.

    Returns:
        [H, stride] uint8.
    """
    height, width = pixels.shape
    rows = np.full((height, stride), PADDING_BYTE, np.uint8)
    line = rows[:, : row_bytes(code, width)]
    if code in ONE:
        line[:] = pixels
    elif code in FIVE_FOURTHS:
        fours = pixels.reshape(height, -1, 4)
        for i in range(4):
            line[:, i::5] = fours[:, :, i] // 4
        line[:, 4::5] = (fours % 4 * np.array([1, 4, 16, 64], np.uint16)).sum(axis=2)
    elif code in SEVEN_FOURTHS:
        fours = pixels.reshape(height, -1, 4).astype(np.uint32)
        low = (fours % 64 * np.array([1, 64, 64**2, 64**3], np.uint32)).sum(axis=2)
        for i in range(4):
            line[:, i::7] = fours[:, :, i] // 64
        for k in range(3):
            line[:, 4 + k :: 7] = low // 256**k % 256
    elif code in THREE_HALVES:
        first, second = pixels[:, 0::2], pixels[:, 1::2]
        line[:, 0::3], line[:, 1::3] = first // 16, second // 16
        line[:, 2::3] = first % 16 + second % 16 * 16
    else:
        line[:, 0::2], line[:, 1::2] = pixels % 256, pixels // 256
    return rows
