"""What other programs have left set on a GenICam camera: reset, or recorded and named.

A camera keeps its features until it loses power, and the standard states no default to compare them with. So:

    requested by [sensor], or set by the driver itself    kept
    automatic ("...Auto", with an entry Off)              switched off
    in `NEUTRAL`, and gains                               reset, for every entry of their selectors
    a switch that is on and that nobody here knows        named in the events of the shot file
    every feature of a category outside `ELSEWHERE`       recorded in the shot file, for every entry of its selectors

Here: the rule. Not here: reading and writing features (`nodes`), a capture's own settings (`setup`).
"""

from collections.abc import Collection, Iterator, Mapping
from typing import Final

from gs2ci_drivers.failures import DeviceFaultError, RefusedError
from gs2ci_drivers.genicam.nodes import GAINS, Features, in_decibels
from gs2ci_drivers.ports import Feature, FeatureValue

DEBOUNCERS: Final = (
    "LineDebouncerTime",
    "LineDebouncerTimeAbs",
    "LineDebouncerTimeRaw",
    "LineDebouncerHighTimeAbs",
    "LineDebouncerLowTimeAbs",
    "LineDebounceDuration",
    "lineDebouncingPeriod",
    "LineFilterWidth",
    "BslInputFilterTime",
    "TriggerFilterRaisingEdge",
    "TriggerFilterFallingEdge",
    "mvLineDebounceTimeRisingEdge",
    "mvLineDebounceTimeFallingEdge",
)
"""Times for which a line's level has to last before it counts, chosen by LineSelector: a trigger acts later by as much,
and one that is shorter is lost (docs.baslerweb.com/line-debouncer and /input-filter; Baumer VLXT manual, Debouncer;
Point Grey Chameleon3 by klecknerlab/simple_pyspin 651845ad, pages of cameras: LineDebouncerTimeRaw "in microseconds";
Allied Vision; Teledyne DALSA by names of its own; FLIR: "filter width in microseconds"; Daheng MER-G manual, Input
Debouncer; Balluff BVS CA-GT, Working with debouncing filters: "this mechanism delays the image acquisition")."""
SHUTTERS: Final = ("SensorShutterMode", "ShutterMode")
ALL_ROWS_AT_ONCE: Final = ("Global", "GlobalReset", "GlobalResetRelease")
"""Shutters under which all rows see all masks, the best first (SFNC 2.7, SensorShutterMode; docs.baslerweb.com,
Sensor Shutter Mode): after a global reset rows end one after the other, in the dark behind the last mask."""
AUTOMATICS: Final = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "BlackLevelAuto")
NEUTRAL: Final[Mapping[str, FeatureValue | tuple[str, ...]]] = {
    "SequencerMode": "Off",
    "SequenceEnable": False,
    "TriggerControlImplementation": "Standard",
    "ExposureTimeMode": ("Common", "Standard"),
    "BslExposureTimeMode": "Standard",
    "TransferControlMode": ("Automatic", "Basic"),
    "TriggerDivider": 1,
    "TriggerMultiplier": 1,
    "TriggerCacheEnable": False,
    "AcquisitionBurstFrameCount": 1,
    "ExposureDelay": 0.0,
    "LineDebounceMode": "Off",
    "SyncInGlitchFilter": 0,
    "TriggerFilterTime": 0,
    "StreamHoldEnable": "Off",
    **dict.fromkeys(DEBOUNCERS, 0.0),
    "ImageCompressionMode": "Off",
    "BinningHorizontal": 1,
    "BinningVertical": 1,
    "DecimationHorizontal": 1,
    "DecimationVertical": 1,
    "ReverseX": False,
    "ReverseY": False,
    "TestPattern": "Off",
    "TestImageSelector": "Off",
    "LUTEnable": False,
    "GammaEnable": False,
    "GammaEnabled": False,
    "Gamma": 1.0,
    "DigitalShift": 0,
    "AcquisitionFrameRateEnable": False,
    "AcquisitionFrameRateEnabled": False,
    "AcquisitionFrameRateMode": "Off",
    "AcquisitionFrameRateTargetEnable": False,
    "ColorTransformationEnable": False,
    "BslBrightness": 0.0,
    "BslContrast": 0.0,
    "BslContrastMode": "Linear",
    "BslHue": 0.0,
    "BslSaturation": 1.0,
    "BslNoiseReduction": 0.0,
    "BslSharpnessEnhancement": 1.0,
    "NoiseReduction": 0.0,
    "SharpeningEnable": False,
    "SharpnessEnabled": False,
    "SaturationEnable": False,
    "SaturationEnabled": False,
    "HueEnabled": False,
}
"""Features that would alter the picture or hold triggers back, each with its neutral value or entries: SFNC 2 and SFNC
1, Basler's (docs.baslerweb.com: Digital Shift, Brightness and Contrast, Noise Reduction, Sharpness Enhancement) and
FLIR's. Those of triggers: TriggerCacheEnable keeps a trigger that comes too early for later (Hikrobot GigE manual,
9.7.4), more than one frame of a burst follow one trigger (9.7.1); ExposureDelay lies between trigger and exposure
(Daheng MERCURY2 manual, 8.2.11); SyncInGlitchFilter "increases latency of FrameTrigger by same amount" (AVT GigE
Attributes 1.3.1); TriggerFilterTime ignores shorter pulses (Imperx Cheetah manual); StreamHoldEnable keeps frames in
the camera (Allied Vision, GigE Camera and Drivers Features 3.0.0); AcquisitionFrameRateMode is Daheng's switch of the
frame rate, AcquisitionFrameRateTargetEnable that of IDS. Exposures: an ultra-short mode ends them after microseconds
(docs.baslerweb.com/exposure-time: "Common or Standard ... is the default setting"). Frames stay in a camera whose
TransferControlMode is UserControlled (FLIR, Transfer Control; Lucid; Daheng). TriggerControlImplementation: by Legacy
older Baslers call a frame's trigger AcquisitionStart (pylon, PLCamera). Sequencers change other features from frame to
frame, and lock them; SequenceEnable is that of Basler's GigE cameras, which can be switched while automatic settings
are off (docs.baslerweb.com, "Node SequenceEnable is not writable")."""
TOGETHER: Final = {
    "AcquisitionFrameRateEnable": "AcquisitionFrameRate",
    "AcquisitionFrameRateEnabled": "AcquisitionFrameRate",
    "AcquisitionFrameRateMode": "AcquisitionFrameRate",
    "AcquisitionFrameRateTargetEnable": "AcquisitionFrameRateTarget",
    "LineDebounceMode": "LineDebounceDuration",
}
"""A switch that stays as it is if the rig file requests what it switches on, by any name that begins so."""
ELSEWHERE: Final = frozenset(
    {"ChunkDataControl", "EventControl", "UserSetControl", "FileAccessControl", "TransportLayerControl", "TestControl"}
)
"""Categories whose features change neither readings nor their times."""
HARMLESS: Final = ELSEWHERE | {
    "Root", "DeviceControl", "AcquisitionControl", "DigitalIOControl", "CounterAndTimerControl", "ActionControl",
}  # fmt: skip
"""Categories whose switches are recorded without a note."""
GRAIN: Final = 2e-3
"""Share of its range to which a camera may round a number."""
VALUES: Final = ("integer", "float", "boolean", "enumeration", "string")
PICTURE: Final = ("PixelFormat", "Width", "Height", "OffsetX", "OffsetY")
"""Recorded although a camera may offer no choice of them."""
SETTINGS_OF_TRIGGERS: Final = ("TriggerMode", "TriggerSource", "TriggerActivation", "TriggerDelay", "TriggerOverlap")
"""Recorded although they may be locked while a trigger is on."""


class Leftovers:
    """The settings of an open camera that a capture does not make itself.

    Args:
        device: Name of the sensor.
        features: The camera's features.
        requested: Names of the features that the rig file requests.
        notes: Receives a note for each setting that was reset or is not known.
        decibels: Whether gains are in decibels, by the rig file; None if it does not say.
    """

    def __init__(
        self,
        device: str,
        features: Features,
        requested: Collection[str],
        notes: list[str],
        *,
        decibels: bool | None = None,
    ) -> None:
        self._device = device
        self._features = features
        self._requested = requested
        self._notes = notes
        self._decibels = decibels

    def reset(self) -> None:
        """Switch automatic settings off, then reset what is off its neutral value.

        Raises:
            DeviceFaultError: A feature does not take its neutral value.
            DriverError: The camera refuses, or does not answer.
        """
        listed = self._features.list()
        if "SequencerMode" not in self._requested:
            self._set("SequencerMode", "Off")  # automatic settings are locked while it is on
        autos = dict.fromkeys((*AUTOMATICS, *(name for _, name in listed if name.endswith("Auto"))))
        for name in autos:
            if name not in self._requested and self._features.has(name, "Off"):
                self._features.write_if_there(name, "Off")
        for name, neutral in NEUTRAL.items():
            together = name in TOGETHER and any(one.startswith(TOGETHER[name]) for one in self._requested)
            if name not in self._requested and not together:
                self._set(name, neutral)
        self._reset_gains()
        self._open_all_rows()
        self._name_switches(listed)

    def _set(self, name: str, neutrals: FeatureValue | tuple[str, ...]) -> None:
        chosen = self._features.find(name)
        for entry in () if chosen is None else self._entries(chosen):
            found = self._features.find(name)  # an output has no debouncer (mvBlueFOX3)
            if found is None or not (found.readable and found.writable):
                continue
            left = self._features.read(name)
            several: tuple[FeatureValue, ...] = neutrals if isinstance(neutrals, tuple) else (neutrals,)
            there = [one for one in several if found.kind != "enumeration" or one in found.symbols]
            if not there or left in there:
                continue
            neutral = there[0]
            if found.kind in ("integer", "float"):
                neutral = min(max(float(neutral), found.low), found.high)
            # Of a range of 20 ms, ten microseconds are nothing, and of a trigger pulse all.
            if left == neutral or (name not in DEBOUNCERS and _same(left, neutral, found)):
                continue
            label = f"{name}[{entry}]" if entry else name
            in_force = self._features.write(name, int(neutral) if found.kind == "integer" else neutral)
            if not _same(in_force, neutral, found):
                raise DeviceFaultError(
                    self._device,
                    f"reset {label}",
                    [f"it stays at {in_force} instead of {neutral}"],
                    remedy=f"set {name} in [sensor.features] to what is wanted, or load the camera's default user set",
                )
            self._notes.append(
                f"{self._device}: {label} was {_text(left)} and has been reset to {_text(neutral)}; "
                "[sensor.features] can set it"
            )

    def _reset_gains(self) -> None:
        """Set each gain to its neutral value: 0 dB, a factor of 1, or the least that the camera has."""
        found = self._features.first((*GAINS, "GainRaw"))
        if found is None or found[0] in self._requested:
            return
        name, gain = found
        decibels = self._decibels if self._decibels is not None else in_decibels(gain)
        if decibels is None:  # no camera has a factor of 0
            decibels = gain.low <= 0
        self._set(name, 0.0 if decibels else 1.0)

    def _open_all_rows(self) -> None:
        """Choose a shutter under which all rows see all masks; note a rolling one."""
        found = self._features.first(SHUTTERS)
        if found is None or found[0] in self._requested or not found[1].readable:
            return
        name, shutter = found
        best = next((one for one in ALL_ROWS_AT_ONCE if one in shutter.symbols), None)
        if best is not None:
            self._set(name, best)
        if str(self._features.read(name)).startswith("Rolling"):
            self._notes.append(
                f"{self._device}: {name} is Rolling: rows are exposed one after the other, so that masks at both ends "
                "of an exposure reach only some of them; a plan refuses masks that are short beside the readout time"
            )

    def _name_switches(self, listed: list[tuple[str, str]]) -> None:
        """Note the switches that are on, and of which nothing is known here."""
        for category, name in listed:
            if category in HARMLESS or name in NEUTRAL or name in self._requested or name.endswith("Selector"):
                continue
            found = self._features.find(name)
            if found is None or not (found.readable and found.writable) or found.selectors:
                continue
            if found.kind == "boolean" or (found.kind == "enumeration" and "Off" in found.symbols):
                value = self._features.read(name)
                if value not in (False, "Off"):
                    self._notes.append(
                        f"{self._device}: {name} is {value}; what it does to readings is not known here, "
                        "[sensor.features] can set it"
                    )

    def record(self) -> dict[str, FeatureValue]:
        """Read every setting, by name; one that a selector chooses, once for each of its entries.

        Raises:
            DriverError: The camera does not answer.
        """
        recorded: dict[str, FeatureValue] = {}
        for category, name in self._features.list():
            found = None if category in ELSEWHERE or name.endswith("Selector") else self._features.find(name)
            if found is None or found.kind not in VALUES or not found.readable:
                continue
            if name in SETTINGS_OF_TRIGGERS or not (found.writable or name in PICTURE):
                continue
            for entry in self._entries(found):
                try:
                    recorded[f"{name}[{entry}]" if entry else name] = self._features.read(name)
                except RefusedError:  # this entry of the selector has no such feature
                    continue
        return recorded

    def record_trigger(self) -> dict[str, FeatureValue]:
        """Read the settings of the trigger that is chosen.

        Raises:
            DriverError: The camera does not answer.
        """
        there = ((name, self._features.find(name)) for name in SETTINGS_OF_TRIGGERS)
        return {name: self._features.read(name) for name, found in there if found is not None and found.readable}

    def _entries(self, found: Feature) -> Iterator[str]:
        """Choose each entry of the feature's selectors in turn; "" once if there is none. The choices are put back."""
        yield from (", ".join(chosen) for chosen in self._chosen(found.selectors))

    def _chosen(self, selectors: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
        if not selectors:
            yield ()
            return
        selector, choice = selectors[0], self._features.find(selectors[0])
        if choice is None or choice.kind != "enumeration" or not choice.writable:
            yield from self._chosen(selectors[1:])
            return
        before = self._features.read(selector)
        try:
            for entry in choice.symbols:
                self._features.write(selector, entry)
                for others in self._chosen(selectors[1:]):
                    yield (entry, *others)
        finally:
            self._features.write(selector, before)


def _text(value: FeatureValue) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _same(value: FeatureValue, wanted: FeatureValue, found: Feature) -> bool:
    """Return whether a feature has a value, as far as its own rounding allows."""
    if found.kind != "float":
        return value == wanted
    return abs(float(value) - float(wanted)) <= GRAIN * (found.high - found.low)
