"""The sensor's interface: a triggered camera that returns raw frames with their numbers and times.

The public methods check and keep the order of calls; a driver writes only the private `_do_*` hooks. The order:

    connect → configure → start → read … read → stop → close

Promises that every implementation keeps and `tests/contracts/test_sensor.py` tests: connecting changes nothing
on the device; `stop` may be called in any state and more than once; `close` may be called twice; `read` never
waits beyond its deadline; a lost, corrupt or stale frame raises an error type of its own and the stream continues.

Here: the records and the abstract class. Not here: ioctls (`gs2ci_drivers.v4l2`).
"""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, IntFlag
from typing import Final

from gs2ci.core.arrays import U16
from gs2ci.core.clock import Clock
from gs2ci_drivers.device import Device
from gs2ci_drivers.failures import OutOfRangeError, UnsupportedError, WrongStateError

HOW_TRIGGERED: Final = "state in [sensor] how it is triggered: `trigger_adapter` (v4l2), `trigger_selector` (genicam)"


class TriggerMode(Enum):
    """What begins and ends an exposure."""

    FREE_RUN = "free-run"
    """The sensor's own clock."""
    EDGE = "edge"
    """An edge begins an exposure of the set length."""
    LEVEL = "level"
    """The exposure lasts as long as the line is active; the set exposure is ignored."""


class FrameFlag(IntFlag):
    """Properties of one frame besides its pixels; stored as u4 in shot files."""

    NONE = 0
    CORRUPT = 1
    """The driver marked the payload bad (kept for the record; such a frame is never returned)."""
    STAMPED_AT_START = 2
    """`t_kernel_ns` is the start of exposure."""
    STAMPED_MONOTONIC = 4
    """`t_kernel_ns` counts on CLOCK_MONOTONIC; otherwise its origin is unknown."""
    RETRIED = 8
    """The frame is a repetition after a failed attempt."""
    AFTER_LOSS = 16
    """Frames before this one were lost."""
    STAMPED_AT_FRAME_START = 32
    """`t_kernel_ns` is the start of readout, when the exposure has ended; with neither this flag nor
    `STAMPED_AT_START`, it is the end of readout."""


class StampMeaning(Enum):
    """The event that a frame's time stamp marks."""

    START_OF_EXPOSURE = "start-of-exposure"
    START_OF_FRAME = "start-of-frame"
    """The first pixels arrive: the exposure has ended, readout begins."""
    END_OF_FRAME = "end-of-frame"
    """The last pixels have arrived: readout has ended."""

    @property
    def flag(self) -> FrameFlag:
        """Get the flag that frames with such stamps carry."""
        return {
            StampMeaning.START_OF_EXPOSURE: FrameFlag.STAMPED_AT_START,
            StampMeaning.START_OF_FRAME: FrameFlag.STAMPED_AT_FRAME_START,
            StampMeaning.END_OF_FRAME: FrameFlag.NONE,
        }[self]


@dataclass(frozen=True)
class FrameFormat:
    """A picture format that a sensor offers.

    Args:
        fourcc: The V4L2 four-character code, or a name of the driver's own.
        height: Rows.
        width: Columns.
        bits: Significant bits of a pixel.
        cfa: Colour filter array ("RGGB", ...) or None for mono.
    """

    fourcc: str
    height: int
    width: int
    bits: int
    cfa: str | None = None

    @property
    def top(self) -> int:
        """Get the largest pixel value."""
        return int(2**self.bits - 1)


@dataclass(frozen=True)
class SensorInfo:
    """What a sensor is and can do.

    Args:
        model: Maker and model.
        serial: Serial number or bus address.
        driver: Kernel driver and version.
        formats: Formats on offer; for a device with ranges of sizes, the largest size.
        min_exposure_s: Shortest exposure.
        max_exposure_s: Longest exposure.
        exposure_step_s: Exposures are multiples of this.
        triggers: Trigger modes that it supports.
        controls: Names of the controls that can be set, with "min..max step".
        exposure_unsettled: What is still unknown about the unit of exposure, so that no capture may rely on it; "" if
            nothing is.
    """

    model: str
    serial: str
    driver: str
    formats: tuple[FrameFormat, ...]
    min_exposure_s: float
    max_exposure_s: float
    exposure_step_s: float
    triggers: frozenset[TriggerMode]
    controls: Mapping[str, str] = field(default_factory=dict)
    exposure_unsettled: str = ""

    @property
    def only_gated(self) -> bool:
        """Get whether level-gated exposure is the only mode of the external trigger, as with the IMX296."""
        return TriggerMode.LEVEL in self.triggers and TriggerMode.EDGE not in self.triggers


@dataclass(frozen=True)
class SensorConfig:
    """The requested configuration of a sensor.

    Args:
        height: Rows; 0 keeps the device's present setting.
        width: Columns; 0 keeps the device's present setting.
        fourcc: Format; "" keeps the device's present setting.
        top: First row of a region of interest; None centres the region if the sensor is larger.
        left: First column.
        exposure_s: Exposure (ignored with `TriggerMode.LEVEL`).
        trigger: What begins an exposure.
        gain_db: Analogue gain, if the device has one; None sets its neutral value.
        buffers: Frame buffers to request from the kernel.
        warm_up_frames: Frames to discard after the start (some sensors' first frames are old or black).
        controls: Further controls by name, set in this order.
    """

    height: int = 0
    width: int = 0
    fourcc: str = ""
    exposure_s: float = 0.01
    trigger: TriggerMode = TriggerMode.EDGE
    gain_db: float | None = None
    buffers: int = 4
    warm_up_frames: int = 0
    controls: Mapping[str, int] = field(default_factory=dict)
    top: int | None = None
    left: int | None = None


@dataclass(frozen=True)
class SensorSettings:
    """The settings in force after a `SensorConfig` was applied.

    Args:
        format: The format in force.
        exposure_s: The exposure in force, quantised.
        trigger: The trigger mode in force.
        readout_s: Time from the end of an exposure until the next may begin.
        exposure_offset_s: Constant added to the line's width in `LEVEL` mode, or to the exposure in `EDGE` mode.
        full_well_e: Electrons at the top of the scale, or None when not known.
        stride: Bytes from one row to the next in the kernel's buffer.
        buffers: Buffers the kernel allocated.
        trigger_delay_s: From a trigger to the start of the exposure, as configured or as known.
        link_s: Least time from the start of one exposure to that of the next by what its link carries; 0 if no limit of
            the link is known.
        rows_s: From the start of the first row's exposure to that of the last one; 0 if all rows begin at once.
        recorded: Every setting of the device that could be read after it was configured, by the device's own names,
            for the shot file: two sessions can be compared by them.
    """

    format: FrameFormat
    exposure_s: float
    trigger: TriggerMode
    readout_s: float
    exposure_offset_s: float = 0.0
    full_well_e: float | None = None
    stride: int = 0
    buffers: int = 0
    trigger_delay_s: float = 0.0
    link_s: float = 0.0
    rows_s: float = 0.0
    recorded: Mapping[str, bool | int | float | str] = field(default_factory=dict)


@dataclass(frozen=True)
class Frame:
    """One frame as received.

    Args:
        pixels: [H, W] uint16, values in the low bits (0 to 2**bits − 1), mosaic not demosaiced.
        sequence: The kernel's number of it since the start of streaming.
        t_kernel_ns: The kernel's time stamp.
        t_host_ns: When the driver received it, on the same clock if that clock is known.
        flags: See `FrameFlag`.
    """

    pixels: U16
    sequence: int
    t_kernel_ns: int
    t_host_ns: int
    flags: FrameFlag

    def began_s(self, exposure_s: float, readout_s: float) -> float:
        """Return when its exposure began, seconds on the stamp's clock, from the stamp and its meaning.

        Args:
            exposure_s: How long it was exposed.
            readout_s: From the end of exposure to the end of the frame.
        """
        stamp_s = self.t_kernel_ns * 1e-9
        if self.flags & FrameFlag.STAMPED_AT_START:
            return stamp_s
        return stamp_s - exposure_s - (0.0 if self.flags & FrameFlag.STAMPED_AT_FRAME_START else readout_s)


@dataclass(frozen=True)
class SensorStatus:
    """What a sensor reports of itself.

    Args:
        streaming: Whether it streams.
        delivered: Frames returned since the start.
        lost: Frames missing since the start, counted by sequence numbers.
        corrupt: Frames marked bad since the start.
        faults: Faults in the device's own terms.
    """

    streaming: bool
    delivered: int = 0
    lost: int = 0
    corrupt: int = 0
    faults: tuple[str, ...] = ()


class Sensor(Device[SensorInfo, SensorStatus]):
    """A triggered camera.

    `close` ends its stream.
    """

    def __init__(self, name: str, clock: Clock) -> None:
        super().__init__(name, clock)
        self._settings: SensorSettings | None = None
        self._streaming = False

    @property
    def settings(self) -> SensorSettings:
        """Get the settings in force.

        Raises:
            WrongStateError: Not configured.
        """
        self._require_open("settings")
        if self._settings is None:
            raise WrongStateError(self.name, "not configured", asked="settings", remedy="call configure() first")
        return self._settings

    def prepare(self) -> SensorInfo:
        """Connect, reset what other programs left that limits the device, and return its abilities without that.

        Raises:
            DriverError: As `connect` and `configure`.
        """
        self.connect()
        self._info = self._do_prepare()
        return self._info

    def configure(self, config: SensorConfig) -> SensorSettings:
        """Set format, exposure and trigger; return the settings that the device accepted.

        Raises:
            WrongStateError: Streaming.
            OutOfRangeError: Exposure or size beyond the device.
            UnsupportedError: Format, trigger mode or control not there.
            LinkError, RefusedError: On the way.
        """
        if self._streaming:
            raise WrongStateError(self.name, "streaming", asked="configure", remedy="call stop() first")
        _ = self.info
        check_config(self.name, self.prepare(), config)
        self._settings = self._do_configure(config)
        return self._settings

    def start(self) -> None:
        """Begin to wait for triggers; earlier frames are discarded, the next frame has index 0.

        Raises:
            WrongStateError: Not configured, or streaming already.
            LinkError, RefusedError: The device did not start.
        """
        _ = self.settings
        if self._streaming:
            raise WrongStateError(self.name, "streaming", asked="start", remedy="call stop() first")
        self._do_start()
        self._streaming = True

    def read(self, timeout_s: float, *, not_before_ns: int = 0, trigger_index: int | None = None) -> Frame:
        """Wait for the next frame.

        Args:
            timeout_s: Deadline from now on the driver's clock.
            not_before_ns: Kernel time before which a frame cannot belong to this trigger.
            trigger_index: Which trigger it answers, for messages.

        Raises:
            WrongStateError: Not streaming.
            TriggerTimeoutError: No frame in time.
            FrameLostError: Frames before this one are missing; the frame itself comes with the next call.
            FrameCorruptError: The frame is bad; its buffer goes back to the kernel and it is not returned.
            FrameStaleError: The frame is older than `not_before_ns`; it is discarded.
            DisconnectedError: The device is gone.
        """
        self._require_open("read")
        if not self._streaming:
            raise WrongStateError(self.name, "not streaming", asked="read", remedy="call start() first")
        return self._do_read(timeout_s, not_before_ns, trigger_index)

    def discard(self) -> int:
        """Discard the frames that wait to be read; return how many. Never waits.

        Raises:
            DisconnectedError: The device is gone.
        """
        self._require_open("discard")
        return self._do_discard() if self._streaming else 0

    def stop(self) -> None:
        """Stop streaming and give all buffers back; allowed in any state, any number of times.

        Raises:
            LinkError, RefusedError: The command did not reach the device, or was refused. It counts as stopped
                nevertheless.
        """
        self._require_open("stop")
        if self._streaming:
            self._streaming = False
            self._do_stop()

    def _do_prepare(self) -> SensorInfo:
        """Reset what limits the device, and describe it anew; here: nothing does."""
        return self.info

    @abstractmethod
    def _do_configure(self, config: SensorConfig) -> SensorSettings:
        """Set a checked configuration and read back what came of it."""

    @abstractmethod
    def _do_start(self) -> None:
        """Get buffers, start streaming, flush, drop warm-up frames; undo all of it on failure."""

    @abstractmethod
    def _do_read(self, timeout_s: float, not_before_ns: int, trigger_index: int | None) -> Frame:
        """Wait for one frame."""

    @abstractmethod
    def _do_discard(self) -> int:
        """Drop what is ready."""

    @abstractmethod
    def _do_stop(self) -> None:
        """Stop streaming and release the buffers, going on past errors; raise the first at the end."""


def check_config(device: str, info: SensorInfo, config: SensorConfig) -> None:
    """Accept a configuration that a sensor with these limits can take.

    Raises:
        OutOfRangeError: Exposure or number of buffers beyond the device.
        UnsupportedError: Format or trigger mode not there.
    """
    if config.trigger not in info.triggers:
        raise UnsupportedError(
            device,
            f"trigger mode {config.trigger.value!r} is not available",
            asked="configure",
            allowed=", ".join(sorted(mode.value for mode in info.triggers)),
            remedy='set mode = "gate" in [capture]: this sensor exposes as long as its line is held'
            if info.only_gated
            else f"{HOW_TRIGGERED}, or choose another `mode` in [capture]",
        )
    names = sorted({fmt.fourcc for fmt in info.formats})
    if config.fourcc and config.fourcc not in names:
        raise UnsupportedError(
            device, f"format {config.fourcc!r} is not available", asked="configure", allowed=", ".join(names)
        )
    slack_s = info.exposure_step_s / 2
    if config.trigger is not TriggerMode.LEVEL and not (
        info.min_exposure_s - slack_s <= config.exposure_s <= info.max_exposure_s + slack_s
    ):
        raise OutOfRangeError(
            device,
            f"exposure {config.exposure_s:.6g} s",
            asked="configure",
            allowed=f"{info.min_exposure_s:.6g} to {info.max_exposure_s:.6g} s",
        )
    if config.buffers < 1 or config.warm_up_frames < 0:
        raise OutOfRangeError(
            device,
            f"buffers = {config.buffers}, warm_up_frames = {config.warm_up_frames}",
            asked="configure",
            allowed="buffers >= 1, warm_up_frames >= 0",
        )
