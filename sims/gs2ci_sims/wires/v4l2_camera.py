"""The camera behind the V4L2 twin: its data sheet, and the bytes that it sends.

Here: `CameraModel` (a data sheet) and `pack_frame`. Not here: the times of its exposures (`shutter`), ioctls and
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
BITS |= {"RG16": 16, "pRAA": 10, "pRCC": 12}
FIVE_FOURTHS = ("Y10P", "pRAA")
THREE_HALVES = ("Y12P", "pRCC")
ONE = ("GREY", "RGGB")
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
        significant_bits: Bits of the converter if they are fewer than the format's; 0 for the format's.
        left_aligned: Whether 16-bit containers carry the value in their upper bits.
        repeats_top: Whether its top bits are repeated below it then, as by VI5 of NVIDIA's Jetson Xavier and Orin
            (T_R16; https://forums.developer.nvidia.com/t/223616).
        stride_multiple: Rows are padded to a multiple of this number of bytes.
        multi_plane: Whether it captures through the multi-plane interface, with a header before each plane.
        header_bytes: Header before the pixels of a plane (multi-plane only).
        max_buffers: Most buffers that the kernel gives.
        exposure: Its exposure control: in lines, in microseconds although line times are reported (vc_mipi_camera.c,
            vc_sd_s_ctrl, unless the device tree has the property `libcamera`), in units of 100 µs, or none.
        line_s: Time of one line.
        trigger: Adapter for external triggers; "outside": the sensor was switched by other means (I2C, hidraw).
        outside: What it was switched to by them.
        module: Kernel module with the parameter, for `trigger` = "module".
        tree_trigger: The device tree's `trigger-mode`, which overrides the parameter (imx477_probe: trigger_mode_of).
        tree_known: Whether the device tree of the sensor is below /sys/bus/i2c, as on a Raspberry Pi.
        ignored_triggers: Edges lost after each start.
        clock_ppm: Difference of its second from the world's; positive is longer.
        power_down_s: Time after a stop for which it stays powered; the module parameter is read at power-up.
        driver: Name of the kernel driver; see `STAMPING`.
        stamps: The event of a time stamp: the start of exposure, the start of the frame's transfer (at the end of the
            exposure) or the end of the transfer.
        flags_start: Whether stamps are flagged as the start of exposure (V4L2_BUF_FLAG_TSTAMP_SRC_SOE).
        monotonic: Whether stamps count on CLOCK_MONOTONIC.
        realtime: Whether they count on CLOCK_REALTIME and are flagged as CLOCK_MONOTONIC nevertheless: uvcvideo with
            clock=realtime (uvc_video_get_time in uvc_video.c; uvc_queue_init sets the flag in any case).
        restarts_numbers: Whether frame numbers restart with each start.
        first_number: The first of them: unicam's is 1 (kbingham/libcamera issue 50).
        has_events: Whether source changes can be subscribed to.
        on_subdevice: Whether the controls are on the sub-device.
        crops: Whether a region of the pixel array can be read out, and no other size: as in imx296_set_selection and
            imx296_set_format of drivers/media/i2c/imx296.c, offsets and sizes are rounded up to multiples of 4.
        processing: Whether it has further controls that change readings (`v4l2_processing`).
        rolls: Whether rows begin one after the other, a line time apart, instead of all at once.
        sensor: Kernel driver of the sensor, which the kernel lists below /sys/bus/i2c; "": it lists none.
        auto_gain: Where automatic gain stands while it is on; it stays there when it is switched off.
    """

    height: int = 64
    width: int = 96
    formats: tuple[str, ...] = ("Y10 ", "GREY", "Y12 ", "Y16 ", "Y10P", "Y12P", "RG10", "RG12", "pRAA", "pRCC")
    significant_bits: int = 0
    left_aligned: bool = False
    repeats_top: bool = False
    stride_multiple: int = 1
    multi_plane: bool = False
    header_bytes: int = 0
    max_buffers: int = 32
    exposure: Literal["lines", "microseconds", "absolute", "none"] = "lines"
    line_s: float = 10e-6
    trigger: Literal["module", "control", "none", "outside"] = "control"
    outside: Shutting = Shutting.EDGE
    module: str = "imx296"
    tree_trigger: int | None = None
    tree_known: bool = True
    ignored_triggers: int = 0
    clock_ppm: float = 0.0
    power_down_s: float = 1.0
    driver: str = "twin"
    stamps: Stamps = "end-of-frame"
    flags_start: bool = False
    monotonic: bool = True
    realtime: bool = False
    restarts_numbers: bool = True
    first_number: int = 0
    has_events: bool = True
    on_subdevice: bool = False
    crops: bool = False
    processing: bool = False
    rolls: bool = False
    sensor: str = ""
    auto_gain: int = 0

    @property
    def active_low(self) -> bool:
        """Get whether it exposes while its line is low.

        The IMX296 does: "exposure time = XTRIG low level pulse width + 14.26 us" (its data sheet, as quoted in
        raspberrypi/linux pull request 5560).
        """
        return self.trigger == "module" and self.module == "imx296"

    @property
    def files(self) -> dict[str, bytes]:
        """Get what the kernel shows of the sensor, file by file; of its device tree, a number is big-endian."""
        if self.sensor:
            return {f"/sys/bus/i2c/drivers/{self.sensor}/10-0010": b""}
        if not self.tree_known:
            return {}
        if self.trigger == "module":
            node = f"/sys/bus/i2c/drivers/{self.module}/10-001a/of_node"
            tree = {} if self.tree_trigger is None else {"trigger-mode": self.tree_trigger.to_bytes(4, "big")}
        elif self.trigger == "control":
            node, tree = "/sys/bus/i2c/drivers/vc-mipi-cam/10-001a/of_node", {}
            if self.exposure == "lines":
                tree = {"libcamera": b""}
        else:
            return {}
        return {f"{node}/{name}": data for name, data in ({"compatible": b"twin"} | tree).items()}

    def module_mode(self, value: int) -> Shutting:
        """Return what a number of the module's parameter switches on; the device tree's takes precedence."""
        value = value if self.tree_trigger is None else self.tree_trigger
        return MODULE_MODES.get(self.module, {1: Shutting.EDGE}).get(value, Shutting.FREE)

    def __post_init__(self) -> None:
        unknown = [code for code in self.formats if code not in BITS]
        if unknown or not self.formats or self.height % 2 or self.width % 4 or min(self.height, self.width) < 4:
            raise InputError(
                f"camera of {self.width}x{self.height} with formats {list(self.formats)}",
                allowed=f"height a multiple of 2, width of 4, formats out of {', '.join(BITS)}",
            )

    def bits(self, code: str) -> int:
        """Return the bits of a pixel that carry the value."""
        return min(self.significant_bits or BITS[code], BITS[code])

    def stride(self, code: str, width: int) -> int:
        """Return the bytes from one row to the next."""
        row = row_bytes(code, width)
        return -(-row // self.stride_multiple) * self.stride_multiple


def row_bytes(code: str, width: int) -> int:
    """Return the bytes of a row without padding."""
    if code in ONE:
        return width
    if code in FIVE_FOURTHS:
        return width // 4 * 5
    return width // 2 * 3 if code in THREE_HALVES else 2 * width


def pack_frame(pixels: U16, code: str, stride: int, shift: int = 0, *, repeats_top: bool = False) -> U8:
    """Pack pixels as a sensor sends them.

    Args:
        pixels: [H, W] uint16, W a multiple of 4.
        code: Four-character code.
        stride: Bytes per row; those after the pixels are `PADDING_BYTE`.
        shift: By how many bits 16-bit containers are left-aligned.
        repeats_top: Whether the bits below repeat the value's top bits.

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
    elif code in THREE_HALVES:
        first, second = pixels[:, 0::2], pixels[:, 1::2]
        line[:, 0::3], line[:, 1::3] = first // 16, second // 16
        line[:, 2::3] = first % 16 + second % 16 * 16
    else:
        words = pixels.astype(np.uint32) << shift
        if repeats_top:
            words |= words >> (16 - shift)
        line[:, 0::2], line[:, 1::2] = words % 256, words // 256
    return rows
