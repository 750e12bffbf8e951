"""Options of a GenICam camera: the [sensor] table of a rig file, which is also the driver's options.

Here: `GenicamOptions`. Not here: what is set for one capture (`gs2ci_drivers.sensor.SensorConfig`).
"""

from typing import Annotated, Final, Literal

from pydantic import Field, field_validator

from gs2ci.core.config import SIMULATED, Count, Delay, Duration, Offset
from gs2ci.core.records import CfaPattern
from gs2ci_drivers.camera_options import CameraOptions
from gs2ci_drivers.genicam.formats import PFNC_FORMATS
from gs2ci_drivers.sensor import StampMeaning

ONLY = "only"
"""The `port` of the only camera that a producer lists."""

_EXPOSURE = "the times in [capture]"
SET_BY: Final = {
    **dict.fromkeys(("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw", "ExposureTimeBaseAbs"), _EXPOSURE),
    **dict.fromkeys(("ExposureMode", "TriggerMode", "AcquisitionMode"), "mode in [capture]"),
    "PixelFormat": "format",
    "Height": "height",
    "Width": "width",
    "OffsetY": "top",
    "OffsetX": "left",
    "TriggerSelector": "trigger_selector",
    "TriggerSource": "trigger_line",
    "TriggerActivation": "trigger_activation",
    "TriggerOverlap": "trigger_overlap",
    **dict.fromkeys(("TriggerDelay", "TriggerDelayAbs"), "trigger_delay_s"),
}
"""Features that a capture sets itself, each with what sets it: another value behind its back would be neither what
frames are unpacked by nor what the plan has counted."""


class GenicamOptions(CameraOptions):
    """[sensor] with kind = "genicam": a GigE Vision, USB3 Vision or CoaXPress camera. Needs the extra `genicam`."""

    kind: Literal["genicam"]
    port: str = SIMULATED
    """Serial number of the camera, "only" if there is only one, or "simulated"."""
    producer: str = ""
    """The maker's GenTL producer, a .cti file; without it, those in the folders of GENICAM_GENTL64_PATH."""
    top: Annotated[int, Field(ge=0)] | None = None
    """First row of the region of interest; without it, the middle of the sensor. Cameras take multiples of a step."""
    format: str = ""
    """Pixel format by its PFNC name ("Mono12", "Mono12p", "BayerRG12Packed", ...); "" takes the present one."""
    gain_db: float | None = None
    """Gain. Without it, gains are set to 0 dB, a factor of 1, or the least that the camera has."""
    gain_unit: Literal["", "dB", "factor"] = ""
    """Whether the camera's gain is in decibels or a factor, if its own unit does not tell."""
    buffers: Count = 8
    """Frame buffers to announce."""
    trigger_selector: str = "FrameStart"
    """Which of the camera's triggers begins an exposure (SFNC: TriggerSelector); ExposureStart or FrameBurstStart where
    there is none of that name."""
    trigger_line: str = "Line1"
    """Input that the trigger comes in by (SFNC: TriggerSource)."""
    trigger_activation: Literal["RisingEdge", "FallingEdge"] = "RisingEdge"
    """Edge that begins an exposure; a gated one lasts until the other edge."""
    trigger_overlap: Literal["", "Off", "ReadOut", "PreviousFrame"] = ""
    """Whether a trigger may come while the previous frame is read out, if the camera offers the choice."""
    trigger_delay_s: Delay = 0.0
    """Delay after a trigger that the camera is set to (SFNC: TriggerDelay); 0 takes the least that it has, which the
    plan counts."""
    trigger_latency_s: Delay = 0.0
    """Further time from a trigger to the exposure, from the data sheet: opto-couplers take microseconds. What the
    camera tells itself (Basler: BslExposureStartDelay) is counted without it."""
    features: dict[str, bool | int | float | str] = Field(default_factory=dict)
    """[sensor.features]: further features by name, written in this order; what sizes depend on (Binning, Decimation,
    Reverse) before the region."""
    exposure_offset_s: Offset | None = None
    """By how much an exposure is longer than configured, or than the line is held, from the data sheet; without it, by
    what the camera tells of it (Basler: BslEffectiveExposureTime), or 0."""
    fixed_exposure_s: Duration | None = None
    """Exposure of a camera that has no feature for it."""
    readout_s: Delay | None = None
    """Time from the end of an exposure to the earliest next one; without it, the camera's own figure, or the period of
    its highest frame rate at its shortest exposure."""
    first_frame_id: Annotated[int, Field(ge=0)] | Literal["any"] | None = None
    """Number of the first frame after a start; "any" for cameras that go on counting after a stop. Without it, 1 for
    GigE Vision, 0 for USB3 Vision, any for others."""
    stamps: StampMeaning = StampMeaning.START_OF_EXPOSURE
    """The event that a frame's time stamp marks: "start-of-exposure" by SFNC and by Basler's manuals;
    "start-of-frame" or "end-of-frame" on cameras that stamp later. `gs2ci doctor` measures it."""

    @field_validator("features")
    @classmethod
    def _set_by_no_other(cls, features: dict[str, bool | int | float | str]) -> dict[str, bool | int | float | str]:
        if taken := [f"{name} ({SET_BY[name]})" for name in features if name in SET_BY]:
            raise ValueError(f"a capture sets these itself, by what stands behind each: {', '.join(taken)}")
        return features

    @property
    def controls(self) -> dict[str, int]:
        """Get the controls set by name through the sensor's interface: none, a GenICam camera has [sensor.features]."""
        return {}

    @property
    def cfa(self) -> CfaPattern | None:
        """Get the colour mosaic of the format that is requested."""
        return PFNC_FORMATS[self.format].cfa if self.format in PFNC_FORMATS else None

    @property
    def bits(self) -> int | None:
        """Get the bits of the format that is requested; None if the camera's present one is kept."""
        return PFNC_FORMATS[self.format].bits if self.format in PFNC_FORMATS else None
