"""Options of a V4L2 camera: the [sensor] table of a rig file, which is also the driver's options.

Here: `V4l2Options`: the requested settings of the camera, and properties of it that its kernel driver does not report.
Not here: what is set for one capture (`gs2ci_drivers.sensor.SensorConfig`).
"""

from typing import Annotated, Literal

from pydantic import Field

from gs2ci.core.config import SIMULATED, Count, Delay, Duration, Offset, Positive
from gs2ci.core.records import CfaPattern
from gs2ci_drivers.camera_options import CameraOptions
from gs2ci_drivers.sensor import StampMeaning, TriggerMode
from gs2ci_drivers.v4l2.formats import PIXEL_FORMATS, Alignment

SIMULATED_NODE = "/dev/video0"
"""The only camera of a simulated computer."""


class V4l2Options(CameraOptions):
    """[sensor] with kind = "v4l2": a camera of the Linux kernel."""

    kind: Literal["v4l2"] = "v4l2"
    port: str = SIMULATED
    """The capture node ("/dev/video0") or "simulated"."""
    subdevice: str = ""
    """The sensor's own node ("/dev/v4l-subdev0"), if a media controller exposes the controls there."""
    top: Annotated[int, Field(ge=0)] | None = None
    """First row of the region of interest; without it, the region is centred. Kernel drivers move and widen regions to
    those that the sensor supports, the IMX296's to multiples of 4."""
    format: str = ""
    """Four-character code ("Y10", "Y12", "RG12", ...); "" takes the device's present one."""
    gain_db: float | None = None
    """Analogue gain; needs `gain_db_per_unit`. Without it, gains are set to the driver's defaults."""
    gain_db_per_unit: Positive | None = None
    """Gain in dB per unit of the gain control, if it is linear in dB."""
    buffers: Count = 4
    """Frame buffers to request from the kernel."""
    controls: dict[str, int] = Field(default_factory=dict)
    """[sensor.controls]: further controls by name, set in this order."""
    trigger_adapter: Literal["none", "module", "control", "outside"] = "control"
    """How an external trigger is switched on: a kernel module's parameter, a private control, "outside" by means of
    your own (hidraw, I2C, device tree), which `gs2ci doctor` proves, or not at all."""
    outside_trigger: Literal["edge", "level"] = "edge"
    """What those other means have switched it to."""
    trigger_module: Annotated[str, Field(pattern=r"^[^/]+$")] = "imx296"
    """Kernel module with the parameter `trigger_mode`."""
    trigger_control: str = "trigger_mode"
    """Name of the private control."""
    trigger_values: dict[TriggerMode, int] = Field(default_factory=dict)
    """[sensor.trigger_values]: the number for "free-run", "edge" and "level", of the control or of the parameter;
    without it, those of the VC-MIPI drivers, or of a known module."""
    power_down_s: Delay = 1.1
    """How long an idle sensor takes to power down; a change of a module's parameter takes effect only after that."""
    alignment: Alignment = "low"
    """Position of values in 16-bit pixels: in the "low" or the "high" bits, or "repeated": in the high bits, the top
    ones once more below them (Jetson Xavier and Orin)."""
    significant_bits: Annotated[int, Field(ge=0, le=16)] = 0
    """Bits that carry the value; 0 takes the pixel format's."""
    exposure_unit_s: Duration | None = None
    """Seconds per unit of the control EXPOSURE, if the driver does not report its line time or counts in another unit.
    `gs2ci doctor` measures it."""
    fixed_exposure_s: Duration | None = None
    """Exposure of a camera that has no control for it."""
    readout_s: Delay | None = None
    """Time from the end of an exposure to the earliest next one; without it, computed from the line time."""
    shutter: Literal["global", "rolling"] | None = None
    """Whether all rows expose at once ("global") or one after the other ("rolling"); without it, by the name of the
    sensor's kernel driver where that is known, and at once otherwise."""
    exposure_offset_s: Offset | None = None
    """Constant added to the exposure; without it, the known constant of `trigger_module`."""
    first_sequence: Annotated[int, Field(ge=-1)] | None = None
    """Number of the first frame after a start; -1 for kernel drivers that do not restart the count. Without it, 0, or 0
    and 1 for kernel drivers that are known to begin with either."""
    stamps: StampMeaning | None = None
    """The event that a frame's time stamp marks: "start-of-exposure", "start-of-frame" or "end-of-frame"; without it,
    the known one of the kernel driver. `gs2ci doctor` measures it."""

    @property
    def node(self) -> str:
        """Get the capture node."""
        return SIMULATED_NODE if self.port == SIMULATED else self.port

    @property
    def cfa(self) -> CfaPattern | None:
        """Get the colour mosaic of the format that is requested."""
        known = PIXEL_FORMATS.get(self.format.strip().ljust(4))
        return known.cfa if known else None

    @property
    def bits(self) -> int | None:
        """Get the bits of the format that is requested; None if the device's present one is kept."""
        known = PIXEL_FORMATS.get(self.format.strip().ljust(4))
        return known.bits if known else None
