"""Setting an open camera up: its identity, its abilities, and the format and controls that a capture needs.

Here: `OpenCamera`. Not here: streaming (`streaming`), the interface (`driver`). Imported by `driver` only.
"""

import contextlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Final

from gs2ci.core.clock import Clock
from gs2ci.core.errors import InputError
from gs2ci_drivers.failures import DeviceFaultError, DriverError, OutOfRangeError, UnsupportedError
from gs2ci_drivers.ports import SysPort
from gs2ci_drivers.sensor import FrameFormat, SensorConfig, SensorInfo, SensorSettings, TriggerMode
from gs2ci_drivers.v4l2 import abi, leftovers
from gs2ci_drivers.v4l2.controls import Applied, Control, ControlTable
from gs2ci_drivers.v4l2.exposure import OVERRIDE, ExposureControl, counts_microseconds, line_time_s
from gs2ci_drivers.v4l2.formats import PIXEL_FORMATS, Alignment, FrameGeometry, Packing, PixelFormat, bus_bits
from gs2ci_drivers.v4l2.node import LARGEST_PX, Identity, NodeFormat, Region, VideoNode
from gs2ci_drivers.v4l2.options import V4l2Options
from gs2ci_drivers.v4l2.rows import ROLLS, rolls
from gs2ci_drivers.v4l2.trigger import trigger_adapter

REGION_STEP_PX: Final = 4
"""Centred regions begin at multiples of this: all supported sensors accept these, and a mosaic keeps its order."""
RAISES: Final = frozenset({"rp1-cfe"})
"""Kernel drivers that put what a sensor sends into the upper bits of 16 (Raspberry Pi 5: "zero padding at the least
significant end", documentation of rpicam-apps, Unpacked format details); on a Pi 4 it is in the lower ones."""
PACKS: Final = "rkcif"
"""Rockchip's kernel driver, whose rows of 10 and 12 bits are compact unless a program has set another memory mode: rows
are then shorter than 16-bit values (rkcif_set_fmt in cif/capture.c; wiki of VEYE's cameras on the RK3588, Raw data
format: "By default, the output is in Compact RAW format")."""


@dataclass(frozen=True)
class CameraSetup:
    """The result of a configuration: the settings, the layout for unpacking, the value of each control, and notes."""

    settings: SensorSettings
    geometry: FrameGeometry
    applied: tuple[Applied, ...]
    notes: tuple[str, ...] = ()


class OpenCamera:
    """The capture node, the sensor's sub-device if it has one, its controls and its trigger.

    Args:
        name: Name of the device for messages.
        port: The system calls.
        clock: The clock of all waits.
        options: What the kernel driver does not report.

    Raises:
        UnsupportedError: Not a streaming capture node, or the trigger adapter's module or control is not there.
        DriverError: The node cannot be opened or does not answer; whatever was opened is closed.
    """

    def __init__(self, name: str, port: SysPort, clock: Clock, options: V4l2Options) -> None:
        self.name = name
        self._options = options
        with contextlib.ExitStack() as undo:
            self.node = undo.enter_context(contextlib.closing(VideoNode(port, options.node, name)))
            self.identity = self.node.identity()
            self._require_capture(self.identity)
            self._subdevice: VideoNode | None = None
            self._moved: tuple[Applied, ...] = ()
            self._sent_bits = 0
            if options.subdevice:
                subdevice = VideoNode(port, options.subdevice, name, of_subdevice=True)
                self._subdevice = undo.enter_context(contextlib.closing(subdevice))
            self.controls = ControlTable(self._subdevice or self.node)
            self._others = ControlTable(self.node) if self._subdevice is not None else None
            self._micro = counts_microseconds(port, self.controls)
            self._rolls = rolls(port, options)
            self.adapter = trigger_adapter(port, clock, name, self.controls, options)
            undo.pop_all()

    def close(self) -> None:
        """Restore the trigger mode that was found and close the nodes; never raises."""
        with contextlib.suppress(DriverError):
            self.adapter.restore()
        self.node.close()
        if self._subdevice is not None:
            self._subdevice.close()

    def _require_capture(self, identity: Identity) -> None:
        if identity.buffer_type is None or abi.Cap.STREAMING not in identity.caps:
            raise UnsupportedError(
                self.name,
                f"{self._options.node} ({identity.card}) is no streaming capture node",
                asked="VIDIOC_QUERYCAP",
                allowed="a node with VIDEO_CAPTURE or VIDEO_CAPTURE_MPLANE, and STREAMING",
                remedy="a camera may have several nodes; `gs2ci devices` shows which of them captures",
            )

    def describe(self) -> SensorInfo:
        """Read the camera's identity and abilities; nothing is changed.

        Raises:
            UnsupportedError: It offers no raw format.
            DriverError: It does not answer.
        """
        offered = self.node.formats()
        # A capture node beside a sensor's own may accept any size: rp1-cfe (cfe_enum_framesizes).
        largest = (LARGEST_PX, LARGEST_PX) if self._subdevice is None else self._subdevice.largest_px()
        formats = tuple(
            self._frame_format(PIXEL_FORMATS[code], self.node.try_format(code, *largest))
            for code in offered
            if code in PIXEL_FORMATS
        )
        if not formats:
            raise UnsupportedError(
                self.name,
                f"no raw format on {self._options.node} (it offers {', '.join(offered) or 'nothing'})",
                asked="VIDIOC_ENUM_FMT",
                allowed=", ".join(sorted(code.strip() for code in PIXEL_FORMATS)),
                remedy="choose another node, or write the frames of this camera through a driver of its maker",
            )
        exposure = self._exposure_control(self.node.get_format().width, self._options.controls)
        low_s, high_s, step_s = self._exposure_limits(exposure)
        return SensorInfo(
            model=self.identity.card,
            serial=self.identity.bus,
            driver=f"{self.identity.driver} {self.identity.version}",
            formats=formats,
            min_exposure_s=low_s,
            max_exposure_s=high_s,
            exposure_step_s=step_s,
            triggers=self.adapter.triggers,
            controls={c.name: c.range_text for c in self.controls if c.settable},
            exposure_unsettled="" if exposure is None else exposure.unsettled,
        )

    def _exposure_limits(self, exposure: ExposureControl | None) -> tuple[float, float, float]:
        if exposure is not None:
            return exposure.min_s, exposure.max_s, exposure.step_s
        if self._options.fixed_exposure_s is not None:
            return self._options.fixed_exposure_s, self._options.fixed_exposure_s, 0.0
        return 0.0, float("inf"), 0.0

    def _exposure_control(self, width: int, planned: Mapping[str, int] | None = None) -> ExposureControl | None:
        unit_s = self._options.exposure_unit_s
        return ExposureControl.find(self.controls, width, unit_s, micro=self._micro, planned=planned)

    def _frame_format(self, pixel: PixelFormat, fmt: NodeFormat) -> FrameFormat:
        bits = min(self._options.significant_bits or self._sent_bits or pixel.bits, pixel.bits)
        return FrameFormat(pixel.code.strip(), fmt.height, fmt.width, bits, pixel.cfa)

    def apply(self, config: SensorConfig) -> CameraSetup:
        """Set format, controls, trigger and exposure, in this order; return the settings in force.

        Raises:
            UnsupportedError: A format, control or trigger does not exist, or the device does not report a figure that
                is needed.
            DeviceFaultError: The kernel reports an impossible frame.
            DriverError: On the way.
        """
        notes = self._set_layout(config)
        fmt = self._set_format(config)
        geometry = self._geometry(fmt)
        self.controls.refresh()
        notes += self._reset(config, fmt.width)
        applied = self._set_controls(config)
        self.adapter.set_mode(config.trigger)
        offset_s = self._options.exposure_offset_s
        exposure_s = self._set_exposure(config, fmt.width)
        readout_s = self._readout_s(fmt, config.trigger)
        if self._rolls:
            notes.append(f"{self.name}: {ROLLS.format(readout_s * 1e3)}")
        settings = SensorSettings(
            format=self._frame_format(geometry.pixel, fmt),
            exposure_s=exposure_s,
            trigger=config.trigger,
            readout_s=readout_s,
            rows_s=readout_s if self._rolls else 0.0,
            exposure_offset_s=self.adapter.exposure_offset_s if offset_s is None else offset_s,
            full_well_e=self._options.full_well_e,
            stride=geometry.stride,
            buffers=config.buffers,
            recorded=self._record(),
        )
        return CameraSetup(settings, geometry, (*self._moved, *applied), tuple(notes))

    def _requested(self, config: SensorConfig) -> dict[int, int]:
        return {self.controls.require(key).cid: value for key, value in config.controls.items()}

    def _set_layout(self, config: SensorConfig) -> list[str]:
        """Set or reset what may change the pixel format, before the format is chosen."""
        requested = self._requested(config)
        notes = self._leftovers(requested, leftovers.changes_layout)
        for control in self.controls:
            if leftovers.changes_layout(control) and control.cid in requested:
                self.controls.set(control.cid, requested[control.cid])
        return notes

    def _reset(self, config: SensorConfig, width: int) -> list[str]:
        """Switch automatic controls off, then reset the others that no request and no figure of the capture sets."""
        kept = set(self._requested(config)) | self.adapter.controls
        exposure = None if config.trigger is TriggerMode.LEVEL else self._exposure_control(width)
        if config.trigger is TriggerMode.LEVEL:  # ignored
            kept |= {abi.Cid.EXPOSURE, abi.Cid.EXPOSURE_ABSOLUTE}
        if exposure is not None:
            kept |= exposure.controls
        notes = self._leftovers(kept, leftovers.is_automatic)
        for table in (self.controls, self._others):
            notes += [] if table is None else leftovers.name_tables(table, self.name)
        gain = None if config.gain_db is None else self._gain_control()
        return notes + self._leftovers(kept | ({gain.cid} if gain is not None else set()), lambda control: True)

    def _leftovers(self, kept: Collection[int], which: Callable[[Control], bool]) -> list[str]:
        notes: list[str] = []
        for table in (self.controls, self._others):
            if table is not None:
                chosen = [one for one in table if which(one)]
                notes += leftovers.reset(table, self.name, kept, chosen, self.identity.driver)
        return notes

    def _record(self) -> dict[str, bool | int | float | str]:
        """Read every setting that the kernel tells of the camera."""
        present = self.node.get_format()
        recorded: dict[str, bool | int | float | str] = {
            "driver": f"{self.identity.driver} {self.identity.version}",
            "format": f"{present.code.strip()} {present.height} x {present.width}",
        }
        node = self._subdevice or self.node
        for name, target in (("region", abi.SelectionTarget.CROP), ("composed", abi.SelectionTarget.COMPOSE)):
            region = node.get_region(target)
            if region is not None:
                recorded[name] = f"{region.height} x {region.width} at {region.top}, {region.left}"
        others = {} if self._others is None else {f"node.{name}": v for name, v in self._others.values().items()}
        return recorded | self.adapter.recorded() | self.controls.values() | others

    def _geometry(self, fmt: NodeFormat) -> FrameGeometry:
        pixel = PIXEL_FORMATS[fmt.code]
        stride = fmt.stride or pixel.row_bytes(fmt.width)  # some drivers leave it 0 for packed formats
        bits = self._frame_format(pixel, fmt).bits
        if self.identity.driver == PACKS and pixel.packing is Packing.WORDS and stride < pixel.row_bytes(fmt.width):
            pixel = replace(pixel, packing=Packing.STREAM)
        try:
            geometry = FrameGeometry(pixel, fmt.width, fmt.height, stride, bits, self._alignment())
        except InputError as error:
            raise DeviceFaultError(self.name, "VIDIOC_S_FMT", [str(error)]) from error
        if fmt.size_bytes < geometry.payload_bytes:
            raise DeviceFaultError(
                self.name,
                "VIDIOC_S_FMT",
                [f"buffers of {fmt.size_bytes} bytes for frames of {geometry.payload_bytes}"],
            )
        return geometry

    def _alignment(self) -> Alignment:
        """Return where values lie in 16 bits: as the rig file says, or as is known of the kernel driver."""
        raised = (
            self._sent_bits and self.identity.driver in RAISES and "alignment" not in self._options.model_fields_set
        )
        return "high" if raised else self._options.alignment

    def _offered(self) -> str:
        return ", ".join(code.strip() for code in self.node.formats() if code in PIXEL_FORMATS)

    def _set_format(self, config: SensorConfig) -> NodeFormat:
        """Set the format on the sub-device and the capture node; return the one that the kernel set."""
        node = self.node
        if self._subdevice is None:
            self._whole_picture(node)
        present = node.get_format()
        code = config.fourcc.ljust(4) if config.fourcc else present.code
        if code not in PIXEL_FORMATS:
            raise UnsupportedError(
                self.name,
                f"the present format {code!r} cannot be unpacked",
                asked="configure",
                allowed=self._offered(),
                remedy="set `format` in [sensor]",
            )
        width, height = config.width or present.width, config.height or present.height
        bits = bus_bits(PIXEL_FORMATS[code])
        if self._subdevice is not None:
            self._set_region(self._subdevice, config)
            if bits:
                sent, width, height = self._subdevice.set_bus_format(tuple(bits), width, height)
                self._sent_bits = 0 if bits[sent] == PIXEL_FORMATS[code].bits else bits[sent]
        fmt = node.set_format(code, width, height)
        # A capture node with a scaler accepts every size; one without reads out the region that was set.
        other = config.top is not None or config.left is not None or (fmt.height, fmt.width) != (height, width)
        if self._subdevice is None and other and self._set_region(node, config):
            fmt = node.set_format(code, width, height)
        if fmt.code != code or fmt.planes != 1:
            raise UnsupportedError(
                self.name,
                f"the driver answered {fmt.code.strip()} in {fmt.planes} plane(s) to {code.strip()}",
                asked="VIDIOC_S_FMT",
                allowed=self._offered(),
                remedy="choose another `format` in [sensor]",
            )
        return fmt

    def _whole_picture(self, node: VideoNode) -> None:
        """Undo another program's region: behind a scaler it would be enlarged, or fill a part of the frame only."""
        targets = abi.SelectionTarget
        for target, default in ((targets.CROP, targets.CROP_DEFAULT), (targets.COMPOSE, targets.COMPOSE_DEFAULT)):
            present = node.get_region(target)
            whole = node.get_region(default)
            if present is not None and whole is not None and present != whole:
                node.set_region(whole, target)

    def _set_region(self, node: VideoNode, config: SensorConfig) -> bool:
        """Set the requested region of interest; return whether the driver supports regions.

        Raises:
            UnsupportedError: A position is requested and regions are not supported, or not this size.
            OutOfRangeError: It leaves the pixel array.
        """
        bounds = node.get_region(abi.SelectionTarget.CROP_BOUNDS)
        placed = config.top is not None or config.left is not None
        if bounds is None:
            if placed:
                raise UnsupportedError(
                    self.name,
                    "this kernel driver knows no regions",
                    asked=f"region at top = {config.top}, left = {config.left}",
                    remedy="leave `top` and `left` out of [sensor], or name the sensor's own node as `subdevice`",
                )
            return False
        height, width = config.height or bounds.height, config.width or bounds.width
        top, left = (
            _centred(there, side) if given is None else given
            for given, there, side in (
                (config.top, bounds.height, height),
                (config.left, bounds.width, width),
            )
        )
        asked = f"region of {height} x {width} at row {top}, column {left}"
        if top < 0 or left < 0 or top + height > bounds.height or left + width > bounds.width:
            raise OutOfRangeError(
                self.name,
                "it leaves the pixel array",
                asked=asked,
                allowed=f"inside {bounds.height} x {bounds.width}",
                remedy="change height, width, top and left in [sensor]",
            )
        wanted = Region(bounds.top + top, bounds.left + left, height, width)
        got = node.set_region(wanted)
        if (got.height, got.width) != (height, width):
            raise UnsupportedError(
                self.name,
                f"the sensor reads out {got.height} x {got.width} instead",
                asked=asked,
                allowed=f"{got.height} x {got.width}",
                remedy="set height and width in [sensor] to these",
            )
        self._moved = tuple(
            Applied(name, asked_px, got_px)
            for name, asked_px, got_px in (("top", wanted.top, got.top), ("left", wanted.left, got.left))
        )
        return True

    def _set_controls(self, config: SensorConfig) -> list[Applied]:
        """Set the gain and the requested controls, in their order."""
        table, applied = self.controls, []
        if config.gain_db is not None:
            applied.append(self._set_gain(table, config.gain_db))
        return applied + [table.set(key, value) for key, value in config.controls.items()]

    def _set_gain(self, table: ControlTable, gain_db: float) -> Applied:
        control = self._gain_control()
        if control is None or self._options.gain_db_per_unit is None:
            raise UnsupportedError(
                self.name,
                f"gain of {gain_db} dB: " + ("no gain control" if control is None else "its unit is not known"),
                asked="configure",
                allowed="the control's own units" if control else "",
                remedy="set `gain_db_per_unit` in [sensor], or set the control itself in [sensor.controls]",
            )
        return table.set(control.cid, round(gain_db / self._options.gain_db_per_unit))

    def _gain_control(self) -> Control | None:
        found = self.controls.find(abi.Cid.ANALOGUE_GAIN) or self.controls.find(abi.Cid.GAIN)
        return found or (self.controls.find("gain") if self.controls.find(OVERRIDE) else None)

    def _set_exposure(self, config: SensorConfig, width: int) -> float:
        """Set the exposure; return the one in force, in seconds."""
        if config.trigger is TriggerMode.LEVEL:  # the line determines the exposure, the control is ignored
            return config.exposure_s
        exposure = self._exposure_control(width)
        if exposure is not None:
            return exposure.set_s(config.exposure_s)
        if self._options.fixed_exposure_s is None:
            raise UnsupportedError(
                self.name,
                "there is no exposure control whose unit is known",
                asked=f"exposure of {config.exposure_s:.6g} s",
                remedy="set `exposure_unit_s` (seconds per unit of the control `exposure`), `fixed_exposure_s` or "
                "`subdevice` in [sensor]",
            )
        return self._options.fixed_exposure_s

    def _readout_s(self, fmt: NodeFormat, trigger: TriggerMode) -> float:
        """Compute the shortest time from the end of an exposure to the start of the next: one frame's lines."""
        if self._options.readout_s is not None:
            return self._options.readout_s
        line_s = line_time_s(self.controls, fmt.width)
        if line_s is not None:
            return fmt.height * line_s
        if trigger is TriggerMode.FREE_RUN:  # the sensor's own frame period holds
            return 0.0
        raise UnsupportedError(
            self.name,
            "the driver does not tell how long reading out a frame takes",
            asked=f"trigger mode {trigger.value}",
            remedy="set `readout_s` in [sensor] from the camera's data sheet",
        )


def _centred(there: int, wanted: int) -> int:
    """Return the first row or column of a centred region."""
    return (there - wanted) // 2 // REGION_STEP_PX * REGION_STEP_PX
