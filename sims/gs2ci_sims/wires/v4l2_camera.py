"""The camera behind the V4L2 twin: its data sheet, the times of its exposures, and the bytes that it sends.

Here: `CameraModel` (a data sheet), `CameraShutter` (triggers and exposures on the world's clock) and `pack_frame`. Not
here: ioctls and buffers (`v4l2`, `v4l2_queue`), controls (`v4l2_controls`). Timing of an edge-triggered sensor without
overlap: edge, latency, exposure, readout, transfer; an edge before the end of the readout is lost, which the frame
numbers do not show.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, unique
from typing import Literal

import numpy as np

from gs2ci.core.arrays import U8, U16
from gs2ci.core.errors import InputError
from gs2ci_sims.faults import FaultSet, declare
from gs2ci_sims.world import Edge, Event, World

TRIGGER_MISSED = declare("v4l2.trigger_missed", "the sensor does not see a trigger edge")
TRIGGER_DOUBLED = declare("v4l2.trigger_doubled", "ringing on the line: the sensor exposes again after the frame")
STALLED = declare("v4l2.stalled", "the sensor sends no more frames until it is stopped and started")

BITS = {"GREY": 8, "Y10 ": 10, "Y12 ": 12, "Y16 ": 16, "Y10P": 10, "Y12P": 12, "RGGB": 8, "RG10": 10, "RG12": 12}
BITS |= {"RG16": 16, "pRAA": 10, "pRCC": 12}
FIVE_FOURTHS = ("Y10P", "pRAA")
THREE_HALVES = ("Y12P", "pRCC")
ONE = ("GREY", "RGGB")
PADDING_BYTE = 0xA5
"""The padding after the pixels of a row, visible in the picture of a program that ignores the stride."""


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


@unique
class Shutting(Enum):
    """The event that begins an exposure."""

    FREE = "free"
    EDGE = "edge"
    LEVEL = "level"


@dataclass(frozen=True)
class CameraModel:
    """A camera's data sheet.

    Args:
        height: Rows of the pixel array, a multiple of 2.
        width: Columns, a multiple of 4.
        formats: Four-character codes of its formats; the first is the default.
        significant_bits: Bits of the converter if they are fewer than the format's; 0 for the format's.
        left_aligned: Whether 16-bit containers carry the value in their upper bits.
        stride_multiple: Rows are padded to a multiple of this number of bytes.
        multi_plane: Whether it captures through the multi-plane interface, with a header before each plane.
        header_bytes: Header before the pixels of a plane (multi-plane only).
        max_buffers: Most buffers that the kernel gives.
        exposure: Its exposure control: in lines, in units of 100 µs, or none.
        line_s: Time of one line.
        own_period_s: Frame period by its own clock, at least.
        trigger: Adapter for external triggers.
        module: Kernel module with the parameter, for `trigger` = "module".
        trigger_line: Line on the world's trigger bus; "" is not wired.
        latency_s: Mean time from an edge to the start of exposure.
        jitter_s: Standard deviation of it.
        exposure_offset_s: Constant added to every triggered exposure.
        readout_s: From the end of exposure until the next edge is taken.
        transfer_s: From the end of readout until the buffer is full.
        ignored_triggers: Edges lost after each start.
        clock_ppm: Difference of its second from the world's; positive is longer.
        power_down_s: Time after a stop for which it stays powered; the module parameter is read at power-up.
        driver: Name of the kernel driver; see `STAMPING`.
        stamps: The event of a time stamp: the start of exposure, the start of the frame's transfer (at the end of the
            exposure) or the end of the transfer.
        flags_start: Whether stamps are flagged as the start of exposure (V4L2_BUF_FLAG_TSTAMP_SRC_SOE).
        monotonic: Whether stamps count on CLOCK_MONOTONIC.
        restarts_numbers: Whether frame numbers restart with each start.
        has_events: Whether source changes can be subscribed to.
        on_subdevice: Whether the controls are on the sub-device.
        crops: Whether a region of the pixel array can be read out, and no other size: as in imx296_set_selection and
            imx296_set_format of drivers/media/i2c/imx296.c, offsets and sizes are rounded up to multiples of 4.
    """

    height: int = 64
    width: int = 96
    formats: tuple[str, ...] = ("Y10 ", "GREY", "Y12 ", "Y16 ", "Y10P", "Y12P", "RG10", "RG12", "pRAA", "pRCC")
    significant_bits: int = 0
    left_aligned: bool = False
    stride_multiple: int = 1
    multi_plane: bool = False
    header_bytes: int = 0
    max_buffers: int = 32
    exposure: Literal["lines", "absolute", "none"] = "lines"
    line_s: float = 10e-6
    own_period_s: float = 1 / 60
    trigger: Literal["module", "control", "none"] = "control"
    module: str = "imx296"
    trigger_line: str = ""
    latency_s: float = 0.0
    jitter_s: float = 0.0
    exposure_offset_s: float = 0.0
    readout_s: float = 1e-3
    transfer_s: float = 0.5e-3
    ignored_triggers: int = 0
    clock_ppm: float = 0.0
    power_down_s: float = 1.0
    driver: str = "twin"
    stamps: Stamps = "end-of-frame"
    flags_start: bool = False
    monotonic: bool = True
    restarts_numbers: bool = True
    has_events: bool = True
    on_subdevice: bool = False
    crops: bool = False

    @property
    def active_low(self) -> bool:
        """Get whether it exposes while its line is low.

        The IMX296 does: "exposure time = XTRIG low level pulse width + 14.26 us" (its data sheet, as quoted in
        raspberrypi/linux pull request 5560).
        """
        return self.trigger == "module" and self.module == "imx296"

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


def pack_frame(pixels: U16, code: str, stride: int, shift: int = 0) -> U8:
    """Pack pixels as a sensor sends them.

    Args:
        pixels: [H, W] uint16, W a multiple of 4.
        code: Four-character code.
        stride: Bytes per row; those after the pixels are `PADDING_BYTE`.
        shift: By how many bits 16-bit containers are left-aligned.

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
        line[:, 0::2], line[:, 1::2] = words % 256, words // 256
    return rows


@dataclass(frozen=True)
class Exposed:
    """An exposure that has ended, on the world's clock."""

    start_s: float
    end_s: float


class CameraShutter:
    """The shutter, which exposes by its own clock or by a trigger line while it runs.

    Args:
        world: The simulated world, with clock and trigger bus.
        model: The data sheet.
        faults: The faults to inject.
        rng: Draws the jitter.
        exposure_s: Returns the exposure that is set.
        deliver: Called when a frame has been read out.
        active_low: Returns whether it exposes while its line is low; the default is that of the data sheet.
        delay_s: Returns the delay that is set between a trigger and its exposure.
    """

    def __init__(
        self,
        world: World,
        model: CameraModel,
        faults: FaultSet,
        *,
        rng: np.random.Generator,
        exposure_s: Callable[[], float],
        deliver: Callable[[Exposed], None],
        active_low: Callable[[], bool] | None = None,
        delay_s: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self._clock = world.clock
        self._model = model
        self._faults = faults
        self._rng = rng
        self._exposure_s = exposure_s
        self._deliver = deliver
        self._active_low = active_low or (lambda: model.active_low)
        self._delay_s = delay_s
        self._how: Shutting | None = None
        self._pending: list[Event] = []
        self._busy_until_s = 0.0
        self._opened_s: float | None = None
        self._edges = 0
        self._stalled = False
        if model.trigger_line:
            world.bus.listen(model.trigger_line, self._on_edge)

    def start(self, how: Shutting) -> None:
        """Begin to expose, triggered by `how`."""
        self._how, self._stalled, self._edges = how, False, 0
        self._opened_s, self._busy_until_s = None, self._clock.now_s()
        if how is Shutting.FREE:
            self._plan(self._clock.now_s(), self._free_run)

    def stop(self) -> None:
        """End the current exposure or readout; no frame is delivered any more."""
        self._how = None
        for event in self._pending:
            event.cancel()
        self._pending.clear()

    def _plan(self, when_s: float, action: Callable[[], None]) -> None:
        self._pending = [event for event in self._pending if event.when_s >= self._clock.now_s()]
        self._pending.append(self._clock.at(when_s, action))

    def _free_run(self) -> None:
        start_s, seconds = self._clock.now_s(), self._stretched(self._exposure_s())
        self._expose(start_s, start_s + seconds)
        period_s = max(self._stretched(self._model.own_period_s), seconds + self._model.readout_s)
        self._plan(start_s + period_s, self._free_run)

    def _stretched(self, seconds: float) -> float:
        return seconds * (1 + self._model.clock_ppm * 1e-6)

    def _on_edge(self, edge: Edge) -> None:
        if edge.level is not self._active_low():
            self._on_rise(edge.when_s)
        elif self._how is Shutting.LEVEL and self._opened_s is not None:
            opened_s, self._opened_s = self._opened_s, None
            end_s = edge.when_s + self._delay_s() + self._model.latency_s + self._model.exposure_offset_s
            self._expose(opened_s, max(end_s, opened_s + 1e-9))

    def _on_rise(self, when_s: float) -> None:
        if self._how not in (Shutting.EDGE, Shutting.LEVEL) or when_s < self._busy_until_s:
            return
        self._edges += 1
        if self._edges <= self._model.ignored_triggers or self._faults.take(TRIGGER_MISSED):
            return
        jitter_s = self._model.jitter_s * self._rng.standard_normal()
        start_s = when_s + self._delay_s() + max(0.0, self._model.latency_s + jitter_s)
        if self._how is Shutting.LEVEL:
            self._opened_s = start_s
            return
        end_s = start_s + self._stretched(self._exposure_s()) + self._model.exposure_offset_s
        self._expose(start_s, end_s)
        if self._faults.take(TRIGGER_DOUBLED):
            self._expose(self._busy_until_s, self._busy_until_s + end_s - start_s)

    def _expose(self, start_s: float, end_s: float) -> None:
        self._busy_until_s = end_s + self._model.readout_s
        if self._stalled or self._faults.take(STALLED):
            self._stalled = True
            return
        done_s = self._busy_until_s + self._model.transfer_s
        self._plan(done_s, lambda: self._deliver(Exposed(start_s, end_s)))
