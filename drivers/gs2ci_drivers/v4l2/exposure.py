"""Exposure of a V4L2 camera in seconds, on top of its controls.

V4L2_CID_EXPOSURE has no unit by the manual. Sensor drivers of the kernel count lines, whose time follows from HBLANK
and PIXEL_RATE. Vision Components' driver reports both and counts microseconds, unless the device tree has the property
`libcamera` for it (vc_mipi_camera.c: vc_sd_s_ctrl, and device_property_read_bool for `libcamera_enabled`).

NVIDIA's drivers for Jetson have controls of their own, whose numbers differ between releases and whose names do not
(tegracam_ctrls.c: "Do not change the name field"): Exposure, mostly in microseconds (device trees, exposure_factor:
"For convenience use 1 sec = 1000000us"), Frame Rate, which ends exposures at a frame's lines without a word
(nv_imx219.c: "exposure limited by frame_length"), and Override Enable, without which a start sends neither
(tegracam_v4l2.c, v4l2sd_stream).

Here: `ExposureControl` (seconds ↔ units of the control) and the unit. Not here: the measurement of the unit
(`gs2ci.rig.trigger_check`), controls themselves (`controls`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from gs2ci_drivers.ports import SysPort
from gs2ci_drivers.v4l2 import abi
from gs2ci_drivers.v4l2.controls import Control, ControlTable

ABSOLUTE_UNIT_S: Final = 100e-6
"""Unit of V4L2_CID_EXPOSURE_ABSOLUTE (V4L2 manual, camera class)."""
MICROSECOND_S: Final = 1e-6
VBLANK_MARGIN_LINES: Final = 16
"""Lines left between exposure and frame length when VBLANK is raised; sensors need 4 to 13."""
OVERRIDE: Final = "override_enable"
"""The switch by which NVIDIA's sensor drivers are recognised."""
PRIVATE_CAMERA: Final = 0x009A2000
"""The first number of NVIDIA's controls (tegra-v4l2-camera.h: V4L2_CTRL_CLASS_CAMERA | 0x2000)."""
FRAME_MARGIN_S: Final = 1e-3
"""By how much a frame has to be longer than its exposure: 4 to 32 lines, which take up to 30 us each."""
MICROHERTZ: Final = 1_000_000
"""From this on a default frame rate is in units of 1e-6 Hz, as NVIDIA's; below it, in 1e-3 Hz, as VC MIPI's (device
trees: framerate_factor)."""
VC_CONTROLS: Final = frozenset({"trigger_mode", "single_trigger", "io_mode"})
"""The controls by which Vision Components' driver is recognised: capture nodes do not name the sensor's driver."""
VC_TREES: Final = "/sys/bus/i2c/drivers/vc*mipi*/*/of_node/"
"""Where the kernel shows its device tree; its I2C name is "vc-mipi-cam" (vc_id in vc_mipi_camera.c)."""


@dataclass(frozen=True)
class ExposureUnit:
    """The unit of V4L2_CID_EXPOSURE.

    Args:
        seconds: Its length.
        unsettled: Why it is not sure; "" if it is.
    """

    seconds: float
    unsettled: str = ""


def counts_microseconds(port: SysPort, table: ControlTable) -> bool | None:
    """Return whether the driver counts exposure in microseconds; None if that depends on what cannot be read.

    Args:
        port: The system calls.
        table: The sensor's controls.
    """
    if not {control.name for control in table} >= VC_CONTROLS:
        return False
    trees = {path.rpartition("/")[0] for path in port.list_nodes(VC_TREES + "compatible")}
    flagged = {path.rpartition("/")[0] for path in port.list_nodes(VC_TREES + "libcamera")}
    if trees and (not flagged or flagged == trees):
        return not flagged
    return None


def exposure_unit(
    table: ControlTable,
    width: int,
    stated_s: float | None,
    *,
    micro: bool | None,
    planned: Mapping[str, int] | None = None,
) -> ExposureUnit | None:
    """Return the unit of V4L2_CID_EXPOSURE, or None if the driver tells nothing of it.

    Args:
        table: The sensor's controls.
        width: Columns, for the line time.
        stated_s: Seconds per unit by the rig file, if it states them.
        micro: From `counts_microseconds`.
        planned: As for `line_time_s`.
    """
    if stated_s:
        return ExposureUnit(stated_s)
    line_s = line_time_s(table, width, planned)
    if line_s is None:
        return None
    if micro is None:
        said = f"lines of {line_s * 1e6:.3g} us or microseconds: the driver's device tree decides, and cannot be read"
        return ExposureUnit(line_s, said)
    return ExposureUnit(MICROSECOND_S if micro else line_s)


class ExposureControl:
    """Exposure in seconds, through the control that the sensor has for it.

    Args:
        table: Where the controls are.
        control: EXPOSURE, EXPOSURE_ABSOLUTE or NVIDIA's.
        unit: Unit of the control.
        in_lines: Whether it counts lines, so that a frame of more lines allows longer exposures.
        switch: What has to be on for the exposure to have an effect (NVIDIA's Override Enable).
    """

    def __init__(
        self,
        table: ControlTable,
        control: Control,
        unit: ExposureUnit,
        *,
        in_lines: bool = False,
        switch: Control | None = None,
    ) -> None:
        self._table = table
        self._control = control
        self._in_lines = in_lines
        self._switch = switch
        self._rate = table.find("frame_rate") if switch is not None else None
        self.unit_s = unit.seconds
        self.unsettled = unit.unsettled

    @classmethod
    def find(
        cls,
        table: ControlTable,
        width: int,
        unit_s: float | None = None,
        *,
        micro: bool | None = False,
        planned: Mapping[str, int] | None = None,
    ) -> "ExposureControl | None":
        """Return the finest exposure control whose unit is known, or None.

        Args:
            table: Where the controls are.
            width: Columns, for the line time (width + HBLANK) / PIXEL_RATE.
            unit_s: Seconds per unit of EXPOSURE from the user; None to take the driver's figures.
            micro: From `counts_microseconds`.
            planned: As for `line_time_s`.
        """
        control, absolute = table.find(abi.Cid.EXPOSURE), table.find(abi.Cid.EXPOSURE_ABSOLUTE)
        if control is not None and control.settable:
            unit = exposure_unit(table, width, unit_s, micro=micro, planned=planned)
            if unit is not None:
                return cls(table, control, unit, in_lines=unit.seconds != MICROSECOND_S)
        if absolute is not None and absolute.settable:
            return cls(table, absolute, ExposureUnit(ABSOLUTE_UNIT_S))
        own, switch = table.find("exposure"), table.find(OVERRIDE)
        if own is not None and switch is not None and own.settable and own.cid > PRIVATE_CAMERA:
            return cls(table, own, ExposureUnit(unit_s or MICROSECOND_S), switch=switch)
        return None

    @property
    def controls(self) -> frozenset[int]:
        """Get the numbers of the controls that setting an exposure may change."""
        others = {one.cid for one in (self._switch, self._rate) if one is not None}
        return frozenset({self._control.cid} | others | ({abi.Cid.VBLANK} if self._in_lines else set()))

    @property
    def min_s(self) -> float:
        """Get the shortest exposure in seconds."""
        return self._control.minimum * self.unit_s

    @property
    def step_s(self) -> float:
        """Get the granularity in seconds."""
        return max(1, self._control.step) * self.unit_s

    @property
    def max_s(self) -> float:
        """Get the longest exposure in seconds, with longer frames if these can be set."""
        longest_s = (self._control.maximum + self._spare_lines()) * self.unit_s
        if self._rate is None:
            return longest_s
        return min(longest_s, self._rates_per_hz / max(1, self._rate.minimum) - FRAME_MARGIN_S)

    @property
    def _rates_per_hz(self) -> int:
        return MICROHERTZ if self._rate is None or self._rate.default >= MICROHERTZ else 1000

    def _spare_lines(self) -> int:
        vblank = self._vblank()
        if vblank is None:
            return 0
        return max(0, vblank.maximum - self._table.get(vblank.cid))

    def _vblank(self) -> Control | None:
        """Return VBLANK if raising it allows longer exposures, that is, if exposure is counted in lines."""
        vblank = self._table.find(abi.Cid.VBLANK)
        return vblank if self._in_lines and vblank is not None and vblank.settable else None

    def set_s(self, exposure_s: float) -> float:
        """Set the exposure; return the one in force, quantised and clamped by the device.

        Raises:
            DriverError: The controls cannot be set.
        """
        units = round(exposure_s / self.unit_s)
        if self._switch is not None:
            self._table.set(self._switch.cid, 1)
        if self._rate is not None:
            longest = int(self._rates_per_hz / (exposure_s + FRAME_MARGIN_S))
            self._table.set(self._rate.cid, min(self._rate.default, longest))
        vblank = self._vblank()
        if vblank is not None:  # whatever it was before, the same exposure is taken in the same frame
            self._table.set(vblank.cid, vblank.default)
            self._control = self._table.renewed(self._control)
        missing = units - self._control.maximum
        if missing > 0 and vblank is not None:
            self._table.set(vblank.cid, self._table.get(vblank.cid) + missing + VBLANK_MARGIN_LINES)
        applied = self._table.set(self._control.cid, units).applied
        self._control = self._table.require(self._control.cid)
        return applied * self.unit_s


def line_time_s(table: ControlTable, width: int, planned: Mapping[str, int] | None = None) -> float | None:
    """Compute a line's duration, (width + HBLANK) / PIXEL_RATE, in seconds; None if the driver reports neither.

    Args:
        table: Where the controls are.
        width: Columns.
        planned: Controls that a capture will set, by name: for the line that it will have, whatever another program
            (libcamera stretches lines for long exposures) left; None for the present one.
    """
    hblank, rate = table.find(abi.Cid.HBLANK), table.find(abi.Cid.PIXEL_RATE)
    if hblank is None or rate is None:
        return None
    pixels_per_s = table.get(rate.cid)
    if planned is None or not hblank.settable:
        blank = table.get(hblank.cid)
    else:
        blank = planned.get(hblank.name, hblank.default)
    return (width + blank) / pixels_per_s if pixels_per_s > 0 else None
