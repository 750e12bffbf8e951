"""Setting a GenICam camera up, feature by feature, by the Standard Features Naming Convention (SFNC 2.7).

Chapters of the convention that this follows: Image Format Control (Width, Height, OffsetX, OffsetY, PixelFormat),
Acquisition Control (AcquisitionMode, TriggerSelector to TriggerDelay, ExposureMode, ExposureTime), Analog Control
(Gain), Chunk Data Control.

Here: what a camera offers, and one configuration of it. Not here: its trigger (`trigger`), frames (`driver`), features
one by one (`nodes`), what other programs left set (`leftovers`).
"""

from math import ceil
from typing import Final

from gs2ci_drivers.failures import OutOfRangeError, UnsupportedError
from gs2ci_drivers.genicam.formats import PFNC_FORMATS, PfncFormat
from gs2ci_drivers.genicam.leftovers import SHUTTERS, TOGETHER, Leftovers
from gs2ci_drivers.genicam.nodes import EXPOSURES, GAINS, US, Features, in_decibels, seconds_per_unit
from gs2ci_drivers.genicam.options import GenicamOptions
from gs2ci_drivers.genicam.trigger import Trigger, selected
from gs2ci_drivers.ports import CameraIdentity, Feature, FeatureValue
from gs2ci_drivers.sensor import FrameFormat, SensorConfig, SensorInfo, SensorSettings, TriggerMode

CHUNKS: Final = {"Timestamp": "ChunkTimestamp", "FrameID": "ChunkFrameID", "ExposureTime": "ChunkExposureTime"}
"""The data appended to a frame: the entry of ChunkSelector, and the feature it is read from."""
BASE: Final = "ExposureTimeBaseAbs"
MOST_BASES: Final = 4095
"""Older Baslers expose for 1 to 4095 times this base, in microseconds, and take the nearest to ExposureTimeAbs (Basler
scout GigE manual, 9.7: to 82 ms with the base of 20 us, to 10 s with longer ones)."""
EFFECTIVE: Final = "BslEffectiveExposureTime"
"""The exposure with the sensor's own offset, in microseconds (docs.baslerweb.com/exposure-time: "factors like internal
offsets ... that may cause the exposure time to differ from the exposure time set": ace 2, boost R, dart R and M)."""
READOUTS: Final = ("SensorReadoutTime", "ReadoutTimeAbs")
"""Readout time in microseconds by makers' own features: SFNC has none."""
RATES: Final = (
    "ResultingFrameRate",
    "ResultingFrameRateAbs",
    "BslResultingAcquisitionFrameRate",
    "AcquisitionResultingFrameRate",
    "AcquisitionFrameRateLimit",
    "mvResultingFrameRate",
)
"""The highest frame rate with the present settings, in Hz, by makers' own features: Basler's (manual: "Resulting
Acquisition Frame Rate"; its reciprocal is the shortest period of triggers), FLIR's, Allied Vision's (GigE Camera and
Drivers Features 3.0.0: "the maximum frame rate possible for the current exposure duration and image format") and
Balluff's (mvBlueFOX3, firmware 2.25: AcquisitionFrameRate is not available while its switch is off)."""
RATE: Final = "AcquisitionFrameRate"
REQUESTED_RATES: Final = (RATE, f"{RATE}Abs", f"{RATE}Target")
"""The frame rate that holds triggers back where it is switched on (`leftovers.TOGETHER`), by its names."""
LIMITS: Final[dict[str, tuple[str, FeatureValue]]] = {
    "DeviceLinkThroughputLimit": ("DeviceLinkThroughputLimitMode", "Off"),
    "StreamBytesPerSecond": ("StreamFrameRateConstrain", False),
}
"""Limits of the link in bytes a second, each with the switch that says that it does not lower the frame rate: SFNC's,
and that of Allied Vision's GigE cameras (GigE Camera and Drivers Features 2.0.0)."""
SHAPES: Final = ("Binning", "Decimation", "Reverse")
"""How features begin on which sizes and mosaics depend: they are set before these ("the settings for the image ROI
refer to the binned lines and columns", docs.baslerweb.com/image-roi; WidthMax "takes into account horizontal binning,
decimation", FLIR, Image Format Control; mirrored colours: docs.baslerweb.com/reverse-x-and-reverse-y)."""
PACKET_HEADERS: Final = 36
"""Bytes of a GigE Vision packet that are no data: 20 of IP, 8 of UDP, 8 of GVSP (GigE Vision 1.2; aravis 98c2d790,
arvgvspprivate.h, ARV_GVSP_PACKET_PROTOCOL_OVERHEAD)."""


def describe_camera(features: Features, identity: CameraIdentity, options: GenicamOptions) -> SensorInfo:
    """Return a camera's identity and abilities as it is set now; nothing is written.

    Raises:
        UnsupportedError: It has no raw pixel format.
        DriverError: It does not answer.
    """
    pixel = features.find("PixelFormat")
    names = [name for name in (pixel.symbols if pixel else ()) if name in PFNC_FORMATS]
    if not names:
        raise UnsupportedError(
            features.device,
            "the camera offers no raw mono or Bayer format",
            asked="connect",
            allowed=", ".join(PFNC_FORMATS),
        )
    height, width = _largest(features, "Height"), _largest(features, "Width")
    low_s, high_s, step_s = _exposure_limits(features, options)
    controls = {
        name: f"{found.low:g}..{found.high:g}"
        for name in (*GAINS, "BlackLevel", "Gamma")
        if (found := features.find(name)) is not None
    }
    return SensorInfo(
        model=f"{identity.vendor} {identity.model}",
        serial=identity.serial,
        driver=f"GenTL {identity.transport}",
        formats=tuple(
            FrameFormat(name, height, width, PFNC_FORMATS[name].bits, PFNC_FORMATS[name].cfa) for name in names
        ),
        min_exposure_s=low_s,
        max_exposure_s=high_s,
        exposure_step_s=step_s,
        triggers=_triggers(features, options),
        controls=controls,
    )


def _largest(features: Features, name: str) -> int:
    """Return the largest size: the sensor's, or the one that the feature allows now."""
    found = features.number(f"{name}Max")
    limits = features.find(name)
    return int(found if found is not None else limits.high if limits is not None else 0)


def _exposure_limits(features: Features, options: GenicamOptions) -> tuple[float, float, float]:
    found = features.first(EXPOSURES)
    if found is not None:
        unit_s, base = seconds_per_unit(features.device, *found), features.find(BASE)
        high_s = max(found[1].high * unit_s, 0.0 if base is None else base.high * US)
        return found[1].low * unit_s, high_s, min(unit_s, US)
    fixed_s = options.fixed_exposure_s or 0.01
    return fixed_s, fixed_s, fixed_s


def _triggers(features: Features, options: GenicamOptions) -> frozenset[TriggerMode]:
    modes = {TriggerMode.FREE_RUN}
    selector = features.find("TriggerSelector")  # a camera with one trigger need not have it (Aravis, pull request 671)
    if features.has("TriggerMode", "On") and (selector is None or selected(features, options)):
        modes.add(TriggerMode.EDGE)
        if features.has("ExposureMode", "TriggerWidth"):
            modes.add(TriggerMode.LEVEL)
    return frozenset(modes)


class GenicamSetup:
    """One configuration of a camera, and the settings in force.

    Args:
        device: Name of the sensor.
        features: The camera's features.
        options: The rig file's table.
        incidents: Receives a note for each setting in force that was not requested.

    Attributes:
        form: The pixel format in force.
        chunks: The chunks that are appended to a frame, by the names of the features they are read from.
        settings: The settings in force.
    """

    def __init__(self, device: str, features: Features, options: GenicamOptions, incidents: list[str]) -> None:
        self._device = device
        self._features = features
        self._options = options
        self._incidents = incidents
        self.form: PfncFormat = PFNC_FORMATS["Mono8"]
        self.chunks: tuple[str, ...] = ()
        self.settings: SensorSettings | None = None
        self._trigger = Trigger(device, features, options, incidents)
        self._leftovers: Leftovers | None = None

    def clear(self) -> Leftovers:
        """Switch triggers off and reset what other programs left, which limits exposures and sizes, too.

        Raises:
            DriverError: The camera refuses, or does not answer.
        """
        self._trigger.stop_all()
        unit = self._options.gain_unit
        decibels = unit == "dB" if unit else None
        leftovers = Leftovers(self._device, self._features, self._options.features, self._incidents, decibels=decibels)
        leftovers.reset()
        self._leftovers = leftovers
        return leftovers

    def apply(self, config: SensorConfig) -> SensorSettings:
        """Apply the configuration, once `clear` has been called; a setting that limits others is set before them.

        Raises:
            DriverError: The camera refuses, has no such feature, or does not answer.
        """
        leftovers = self._leftovers or self.clear()
        self._write_features(shaping=True)
        self.form = self._set_format(config.fourcc)
        height, width = self._set_region(config)
        self._write_features(shaping=False)
        exposure_s = self._set_exposure(config)
        self._set_gain(config.gain_db)
        self._note_others()
        self.chunks = self._set_chunks()
        readout_s = self._readout_s(config.trigger)
        recorded = leftovers.record()
        self._trigger.set(config.trigger)
        recorded |= leftovers.record_trigger()
        self.settings = SensorSettings(
            format=FrameFormat(self.form.name, height, width, self.form.bits, self.form.cfa),
            exposure_s=exposure_s,
            trigger=config.trigger,
            readout_s=readout_s,
            exposure_offset_s=self._exposure_offset_s(exposure_s),
            full_well_e=self._options.full_well_e,
            stride=0,
            buffers=config.buffers,
            trigger_delay_s=self._trigger.delay_s,
            link_s=self._link_s(exposure_s + readout_s),
            rows_s=readout_s if self._rolls() else 0.0,
            recorded=recorded,
        )
        return self.settings

    def set_trigger(self, mode: TriggerMode) -> None:
        """Set what starts an exposure: the camera's clock, an edge or a level.

        Raises:
            DriverError: As `apply`.
        """
        self._trigger.set(mode)

    def _write_features(self, *, shaping: bool) -> None:
        """Write the requested features on which sizes and mosaics depend, or the others, in the rig file's order."""
        for name, value in self._options.features.items():
            if name.startswith(SHAPES) == shaping:
                in_force = self._features.write(name, value)
                found = self._features.find(name)
                if in_force != value and found is not None and found.selectors:
                    self._incidents.append(f"{self._device}: {name} = {value} was requested, {in_force} is set")

    def _note_others(self) -> None:
        """Note the requested features that have another value, whether the camera or the capture has changed it."""
        for name, value in self._options.features.items():
            found = self._features.find(name)
            if found is None or not found.readable or found.selectors:  # which entry was meant is not known any more
                continue
            if (in_force := self._features.read(name)) != value:
                self._incidents.append(f"{self._device}: {name} = {value} was requested, {in_force} is set")

    def _set_format(self, name: str) -> PfncFormat:
        if name:
            self._features.write("PixelFormat", name)
        present = str(self._features.read("PixelFormat"))
        if present in PFNC_FORMATS:
            return PFNC_FORMATS[present]
        pixel = self._features.find("PixelFormat")
        raw = [one for one in (pixel.symbols if pixel else ()) if one in PFNC_FORMATS]
        raise UnsupportedError(
            self._device,
            f"the camera's format {present!r} is no raw one",
            asked="configure",
            allowed=", ".join(raw),
            remedy="set `format` in [sensor]",
        )

    def _set_region(self, config: SensorConfig) -> tuple[int, int]:
        """Set size and offset; offsets to 0 first, because SFNC limits a size to the sensor's less the offset."""
        for name in ("OffsetX", "OffsetY"):
            self._features.write_if_there(name, 0)
        height = self._set_size("Height", config.height)
        width = self._set_size("Width", config.width)
        self._set_offset("OffsetY", config.top, _largest(self._features, "Height") - height)
        self._set_offset("OffsetX", config.left, _largest(self._features, "Width") - width)
        return height, width

    def _set_size(self, name: str, wanted: int) -> int:
        limits = self._limits(name)
        step = limits.step or 1.0
        # A sensor's own size need not be one of the camera's steps.
        most = (limits.high - limits.low) // step
        wanted = wanted or int(limits.low + most * step)
        if (wanted - limits.low) % step or not limits.low <= wanted <= limits.high:
            nearest = limits.low + min(max(round((wanted - limits.low) / step), 0), most) * step
            raise OutOfRangeError(
                self._device,
                f"{name} = {wanted}",
                asked="configure",
                allowed=f"{limits.low:g} to {limits.high:g} by {step:g}",
                remedy=f"the nearest is {nearest:g}: set `{name.lower()}` in [sensor]",
            )
        return int(self._features.write(name, wanted))

    def _set_offset(self, name: str, wanted: int | None, spare: int) -> None:
        """Place the region as requested, or in the middle, on the camera's grid."""
        found = self._features.find(name)
        if found is None or not found.writable:
            if wanted:
                raise UnsupportedError(
                    self._device,
                    f"the camera has no feature {name}",
                    asked="configure",
                    remedy="leave `top`, `left` out",
                )
            return
        place = spare // 2 if wanted is None else wanted
        step = int(found.step) or 1
        on_grid = int(found.low) + (place - int(found.low)) // step * step
        in_force = int(self._features.write(name, on_grid))
        if wanted is not None and in_force != wanted:
            self._incidents.append(f"{self._device}: {name} = {wanted} was requested, {in_force} is set")

    def _limits(self, name: str) -> Feature:
        found = self._features.find(name)
        if found is None:
            raise UnsupportedError(self._device, f"the camera has no feature {name}", asked="configure")
        return found

    def _set_exposure(self, config: SensorConfig) -> float:
        found = self._features.first(EXPOSURES)
        if found is None:
            return self._options.fixed_exposure_s or 0.01
        self._features.write_if_there("ExposureMode", "Timed")
        if config.trigger is TriggerMode.LEVEL:
            return config.exposure_s
        return self._write_exposure(config.exposure_s)

    def _write_exposure(self, exposure_s: float) -> float:
        """Set the nearest exposure that the camera takes now, by its finest base; return it."""
        base = self._features.find(BASE)
        if base is not None:
            self._features.write(BASE, float(min(max(ceil(exposure_s / US / MOST_BASES), base.low), base.high)))
        found = self._features.first(EXPOSURES)
        assert found is not None  # the caller has seen it
        name, limits = found
        unit_s = seconds_per_unit(self._device, name, limits)
        return float(self._features.write(name, min(max(exposure_s / unit_s, limits.low), limits.high))) * unit_s

    def _exposure_offset_s(self, exposure_s: float) -> float:
        """Return by how much an exposure is longer than set: as stated, or by what the camera tells of it."""
        stated_s = self._options.exposure_offset_s
        told = self._features.number(EFFECTIVE) if stated_s is None else None
        timed = self._features.has("ExposureMode") and self._features.read("ExposureMode") == "Timed"
        return told * US - exposure_s if told and timed else stated_s or 0.0

    def _set_gain(self, gain_db: float | None) -> None:
        if gain_db is None:
            return
        found = self._features.first(GAINS)
        if found is None:
            raise UnsupportedError(
                self._device, "the camera has no gain", asked="configure", remedy="leave gain_db in [sensor] out"
            )
        name, gain = found
        unit = self._options.gain_unit
        decibels = unit == "dB" if unit else in_decibels(gain)
        if decibels is None:
            raise UnsupportedError(
                self._device,
                f"{name} has the unit {gain.unit!r}, which tells neither decibels nor a factor",
                asked=f"gain of {gain_db:g} dB",
                remedy="set gain_unit in [sensor] from the camera's manual, or leave gain_db out",
            )
        for entry in ("All", "AnalogAll"):
            self._features.write_if_there("GainSelector", entry)
        self._features.write(name, gain_db if decibels else 10 ** (gain_db / 20))

    def _set_chunks(self) -> tuple[str, ...]:
        """Enable the frame's number, time and exposure as chunks; return those that the camera has."""
        selector = self._features.find("ChunkSelector")
        wanted = [entry for entry in CHUNKS if selector is not None and entry in selector.symbols]
        if not wanted:
            return ()
        self._features.write_if_there("ChunkModeActive", True)
        for entry in wanted:
            self._features.write("ChunkSelector", entry)
            self._features.write_if_there("ChunkEnable", True)
        return tuple(CHUNKS[entry] for entry in wanted)

    def _readout_s(self, trigger: TriggerMode) -> float:
        """Return the readout time: from the options, from the camera, or from its highest frame rate.

        Raises:
            UnsupportedError: It is triggered, and none of them is known.
        """
        if self._options.readout_s is not None:
            return self._options.readout_s
        for name in READOUTS:
            told = self._features.number(name)
            if told is not None:
                return told * US
        rate_hz = self._highest_rate_hz()
        if rate_hz is not None:
            return 1 / rate_hz
        if trigger is TriggerMode.FREE_RUN:  # the camera's own frame period holds
            return 0.0
        raise UnsupportedError(
            self._device,
            "the camera does not tell how long reading out a frame takes",
            asked=f"trigger mode {trigger.value}",
            remedy="set `readout_s` in [sensor] from the camera's data sheet",
        )

    def _link_s(self, taken_s: float) -> float:
        """Return how long a frame takes over a link that is limited; 0 if no limit is told. Note one that slows down.

        Args:
            taken_s: How long exposure and readout of a frame take.
        """
        size = self._features.number("PayloadSize") or 0.0
        limits = [(size / limit, f"{name} is {limit / 1e6:g} MB/s", name) for name, limit in self._limits_in_force()]
        delayed_s = self._delays_s(size)
        limits.append((delayed_s, f"GevSCPD adds {delayed_s * 1e3:.3g} ms between a frame's packets", "GevSCPD"))
        limits += self._requested_rates()
        link_s, words, name = max(limits)
        if link_s > taken_s:
            self._incidents.append(
                f"{self._device}: {words}: frames are {link_s * 1e3:.3g} ms apart at least, longer than the "
                f"{taken_s * 1e3:.3g} ms of exposure and readout, and earlier triggers would be lost; plans keep "
                f"to it, {name} in [sensor.features] can change it"
            )
        return link_s

    def _requested_rates(self) -> list[tuple[float, str, str]]:
        """Return period, words and name of a frame rate that the rig file requests: triggers are held to it, too."""
        requested, found = self._options.features, []
        switches = [one for one in TOGETHER if one.startswith(RATE) and self._features.has(one)]
        off = any(self._features.read(one) in (False, "Off") for one in switches)
        for name in () if off or not any(one.startswith(RATE) for one in requested) else REQUESTED_RATES:
            if rate_hz := self._features.number(name):
                found.append((1 / rate_hz, f"{name} is {rate_hz:g} Hz", name))
        return found

    def _limits_in_force(self) -> list[tuple[str, float]]:
        features, found = self._features, []
        for name, (switch, off) in LIMITS.items():
            limit = features.number(name)
            if limit and not (features.has(switch) and features.read(switch) == off):
                found.append((name, limit))
        return found

    def _delays_s(self, size: float) -> float:
        """Return how long the pauses between the packets of a frame are (aravis, arv_camera_gv_set_packet_delay)."""
        number = self._features.number
        ticks, packet = number("GevSCPD"), number("GevSCPSPacketSize")
        if not ticks or not packet or packet <= PACKET_HEADERS:
            return 0.0
        return size / (packet - PACKET_HEADERS) * ticks / (number("GevTimestampTickFrequency") or 1e9)

    def _rolls(self) -> bool:
        found = self._features.first(SHUTTERS)
        return found is not None and found[1].readable and str(self._features.read(found[0])).startswith("Rolling")

    def _highest_rate_hz(self) -> float | None:
        """Return the frame rate that the camera computes for its shortest exposure; None if it computes none.

        At a longer exposure the rate tells of the exposure. A limit that a long exposure does not lower is only a
        number of the data sheet (mvBlueFOX3 manual: AcquisitionFrameRate from 0.8 to 1111 Hz for every sensor).
        """
        found = self._features.first(EXPOSURES)
        if found is None:
            return None
        present_s = float(self._features.read(found[0])) * seconds_per_unit(self._device, *found)
        try:
            self._write_exposure(0.0)
            shortest_hz = self._rate_hz()
            if shortest_hz is None:
                return None
            self._write_exposure(2 / shortest_hz)
            longer_hz = self._rate_hz()
        finally:
            self._write_exposure(present_s)
        return shortest_hz if longer_hz is not None and longer_hz < shortest_hz else None

    def _rate_hz(self) -> float | None:
        """Return the highest frame rate at the present exposure, as far as the camera tells one."""
        told = next((rate for name in RATES if (rate := self._features.number(name)) is not None), None)
        limits = self._features.find("AcquisitionFrameRate")
        rate = told if told is not None else limits.high if limits is not None else 0.0
        return rate if rate > 0 else None
