"""What must be known of a camera that its kernel driver does not tell; filled from the rig file's [sensor] table.

Here: `V4l2Options` and its checks. Not here: what is set for one capture (`gs2ci_drivers.sensor.SensorConfig`).
Imported by the rest of this package and by `gs2ci.rig`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from gs2ci.core.errors import InputError
from gs2ci_drivers.sensor import TriggerMode
from gs2ci_drivers.v4l2.formats import Alignment

Adapter = Literal["none", "module", "control"]


@dataclass(frozen=True)
class V4l2Options:
    """How a V4L2 camera is reached and what only its data sheet says.

    Args:
        path: The capture node.
        subdevice: The sensor's own node (`/dev/v4l-subdev0`) where a media controller keeps the controls there.
        trigger_adapter: How an external trigger is switched on: `module` parameter, private `control`, or `none`.
        trigger_module: Kernel module with the parameter `trigger_mode`.
        trigger_control: Name of the private control.
        trigger_values: Its value for each mode; the default is that of the VC-MIPI drivers.
        power_down_s: How long an idle sensor takes to power down; a module parameter is taken in only then.
        alignment: Where values sit in 16-bit pixels.
        significant_bits: Bits that carry the value; 0 takes the pixel format's.
        exposure_unit_s: Seconds per unit of the control EXPOSURE, where the driver does not tell its line time.
        fixed_exposure_s: Exposure of a camera that has no control for it.
        readout_s: Time from the end of an exposure to the earliest next one; None computes it from the line time.
        exposure_offset_s: Constant added to the exposure; None takes what is known of `trigger_module`.
        gain_db_per_unit: Gain in dB per unit of the gain control, where it is linear in dB.
        full_well_e: Electrons at the top of the scale.
        first_sequence: Number of the first frame after a start; None for drivers that go on counting.
    """

    path: str = "/dev/video0"
    subdevice: str = ""
    trigger_adapter: Adapter = "none"
    trigger_module: str = "imx296"
    trigger_control: str = "trigger_mode"
    trigger_values: Mapping[TriggerMode, int] = field(
        default_factory=lambda: {TriggerMode.FREE_RUN: 0, TriggerMode.EDGE: 1, TriggerMode.LEVEL: 2}
    )
    power_down_s: float = 1.1
    alignment: Alignment = "low"
    significant_bits: int = 0
    exposure_unit_s: float | None = None
    fixed_exposure_s: float | None = None
    readout_s: float | None = None
    exposure_offset_s: float | None = None
    gain_db_per_unit: float | None = None
    full_well_e: float | None = None
    first_sequence: int | None = 0

    def check(self) -> "V4l2Options":
        """Return self if every value can be used.

        Raises:
            InputError: A word that is none of those allowed, or a number out of its range.
        """
        for key, value, words in (
            ("trigger_adapter", self.trigger_adapter, ("none", "module", "control")),
            ("alignment", self.alignment, ("low", "high")),
        ):
            if value not in words:
                raise InputError(f"{key} = {value!r} in [sensor]", allowed=", ".join(words))
        if not 0 <= self.significant_bits <= 16:
            raise InputError(f"significant_bits = {self.significant_bits} in [sensor]", allowed="0 to 16")
        for key, seconds in (
            ("exposure_unit_s", self.exposure_unit_s),
            ("fixed_exposure_s", self.fixed_exposure_s),
            ("gain_db_per_unit", self.gain_db_per_unit),
            ("full_well_e", self.full_well_e),
        ):
            if seconds is not None and not seconds > 0:
                raise InputError(f"{key} = {seconds} in [sensor]", allowed="a number above 0")
        for key, seconds in (("readout_s", self.readout_s), ("power_down_s", self.power_down_s)):
            if seconds is not None and not seconds >= 0:
                raise InputError(f"{key} = {seconds} in [sensor]", allowed="a number of at least 0")
        if "/" in self.trigger_module or not self.trigger_module:
            raise InputError(f"trigger_module = {self.trigger_module!r} in [sensor]", allowed="a kernel module's name")
        return self
