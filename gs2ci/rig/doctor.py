"""Examining a bench for problems: each finding with its remedy.

Here: the examination of ports and permissions, identities, faults, clocks, the trigger loop from modulator to sensor,
the modulator's interpretation of its settings, and the meaning of time stamps. The stage is queried and not moved. Not
here: printing (`gs2ci.commands.doctor`), the devices' own checks.
"""

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from serial.tools import list_ports

from gs2ci.core.config import SIMULATED
from gs2ci.core.errors import Gs2ciError, reason_of
from gs2ci.rig.config import DEVICE_GROUPS
from gs2ci.rig.intent import sensor_config
from gs2ci.rig.opening import Rig
from gs2ci.rig.trigger_check import PASSES, StampsFound, check_gate, check_pulses, check_stamps, check_waiting
from gs2ci_drivers.acquisition import Devices, Taken, capture, plan_capture
from gs2ci_drivers.failures import HOME_COMMAND
from gs2ci_drivers.links.gentl import find_producers
from gs2ci_drivers.links.usb_device import udev_rules
from gs2ci_drivers.manners import manners_for
from gs2ci_drivers.pattern_sequence import ModulatorInfo, TriggerOut
from gs2ci_drivers.plan import CaptureSettings, Mode
from gs2ci_drivers.plugin import known_driver
from gs2ci_drivers.sensor import HOW_TRIGGERED, FrameFlag, TriggerMode

Verdict = Literal["ok", "note", "bad", "know"]

LOOP_MASKS = 8
LOOP_MASK_S = 0.05
LARGEST_DRIFT_PPM = 500.0
"""Two crystals differ by about 100 ppm; a larger difference means a wrong clock or a wrong unit."""
UNIT_TOLERANCE = 0.05
"""Share by which exposures may grow otherwise than set, beyond the error of the measurement."""
KNOWN_UNITS_S = (1e-6, 1e-5, 1e-4, 1e-3)
VIDEO_RULE = 'SUBSYSTEM=="video4linux", MODE="0660", GROUP="video", TAG+="uaccess"'


@dataclass(frozen=True)
class BenchFinding:
    """The result of one check.

    Args:
        what: What was checked.
        verdict: The verdict.
        detail: What was found.
        remedy: What to do about it.
    """

    what: str
    verdict: Verdict
    detail: str
    remedy: str = ""


def examine(rig: Rig, *, trigger_loop: bool = True) -> Iterator[BenchFinding]:
    """Examine a bench, finding by finding.

    Args:
        rig: The rig.
        trigger_loop: Whether to show a few masks and count the frames that they trigger.
    """
    yield from _permissions(rig)
    try:
        devices = rig.open()
    except Gs2ciError as error:
        yield _finding_of_error("opening the ports", error)
        return
    found: dict[str, Any] = {}
    answering, connected = True, dict[str, str]()
    try:
        for what, look in (
            ("modulator", _modulator),
            ("sensor", _sensor),
            ("stage", _stage),
        ):
            try:
                yield from look(devices)
                connected[what] = _words(getattr(devices, what))
            except Gs2ciError as error:
                answering = answering and what == "stage"
                yield _finding_of_error(what, error)
        if trigger_loop and answering:
            yield from _waiting(rig, devices)
            yield from (_gate if _gated(rig, devices) else _pulses)(rig, devices, found)
    finally:
        devices.close()
    if trigger_loop and answering:
        # The settings found hold for the rest of the examination, whatever the rig file says.
        yield from _with_settings(rig, found)
    yield from _manners(rig, connected)


def _with_settings(rig: Rig, settings: dict[str, Any]) -> Iterator[BenchFinding]:
    """Run the remaining checks with the settings of the modulator that were found."""
    if settings:
        modulator = rig.table.modulator.model_copy(update=settings)
        rig = replace(rig, table=rig.table.model_copy(update={"modulator": modulator}))
    try:
        devices = rig.open()
    except Gs2ciError as error:
        yield _finding_of_error("opening the ports again", error)
        return
    try:
        devices.modulator.connect()
        devices.sensor.connect()
        yield from _trigger_loop(rig, devices)
        yield from _stamps(rig, devices)
    except Gs2ciError as error:
        yield _finding_of_error("trigger loop", error)
    finally:
        devices.close()


def _waiting(rig: Rig, devices: Devices) -> Iterator[BenchFinding]:
    """Find out whether the sensor waits for triggers, which a mode that was set does not prove."""
    trigger = TriggerMode.LEVEL if _gated(rig, devices) else TriggerMode.EDGE
    if trigger not in devices.sensor.info.triggers:
        return
    what = "sensor waits"
    try:
        came = check_waiting(devices, sensor_config(rig, devices), trigger)
    except Gs2ciError as error:
        yield _finding_of_error(what, error)
        return
    if came == 0:
        yield BenchFinding(what, "ok", f"no frame came without a trigger (mode {trigger.value})")
        return
    outside = getattr(rig.table.sensor, "trigger_adapter", "") == "outside"
    yield BenchFinding(
        what,
        "bad",
        f"{came} frames came without a trigger: it runs by its own clock, or something else triggers it",
        "switch its external trigger on by the means that you use for it"
        if outside
        else "compare trigger_adapter and trigger_values with the sensor's documentation: what was set is no external "
        "trigger; then look for reflections and other sources on the trigger line",
    )


def _pulses(rig: Rig, devices: Devices, found: dict[str, Any]) -> Iterator[BenchFinding]:
    """Find out with which masks the modulator pulses; put the matching settings into `found`."""
    info, triggers = devices.modulator.info, devices.sensor.info.triggers
    if TriggerOut.PER_EXPOSURE not in info.trigger_outs or TriggerMode.EDGE not in triggers:
        return
    try:
        pulses = check_pulses(devices, sensor_config(rig, devices))
    except Gs2ciError as error:
        yield _finding_of_error("trigger pulses", error)
        return
    verdict = pulses.verdict
    found.update(verdict.settings)
    light = {
        True: "; the light in the frames confirms it",
        False: "; but the light in the frames is that of other masks",
        None: "; the frames have too little light to confirm it",
    }[pulses.by_light]
    agrees = verdict.agrees and pulses.by_light is not False
    remedy = verdict.remedy or "check that nothing but the modulator's trigger output triggers the sensor"
    yield BenchFinding("trigger pulses", "ok" if agrees else "bad", verdict.said + light, "" if agrees else remedy)


def _gated(rig: Rig, devices: Devices) -> bool:
    """Return whether the sensor exposes while its line is held, on this rig."""
    return devices.sensor.connect().only_gated or Mode(rig.table.capture.mode) is Mode.GATE


def _gate(rig: Rig, devices: Devices, found: dict[str, Any]) -> Iterator[BenchFinding]:
    """Find out whether a gated sensor exposes while masks are shown; put the correct polarity into `found`."""
    try:
        gate = check_gate(devices, sensor_config(rig, devices))
    except Gs2ciError as error:
        yield _finding_of_error("trigger gate", error)
        return
    seen = f"{gate.count} exposures in {PASSES} passes, " + (
        "while the masks are shown" if gate.right else "not while the masks are shown"
    )
    light = (
        "; the light in the frames confirms it" if gate.by_light else "; the frames have too little light to confirm it"
    )
    remedy = "check the trigger cable, the level of the line (often 1.8 V) and the sensor's trigger"
    other = devices.modulator.other_polarity() if gate.inverted else None
    if other is not None:
        found.update(other.settings)
        remedy = other.remedy
    yield BenchFinding("trigger gate", "ok" if gate.right else "bad", seen + light, "" if gate.right else remedy)


def _stamps(rig: Rig, devices: Devices) -> Iterator[BenchFinding]:
    """Find out which event the sensor's time stamps mark."""
    gated = _gated(rig, devices)
    out = TriggerOut.GATE_PER_MASK if gated else TriggerOut.PER_MASK
    mode = TriggerMode.LEVEL if gated else TriggerMode.EDGE
    if out not in devices.modulator.info.trigger_outs or mode not in devices.sensor.info.triggers:
        return
    found = check_stamps(devices, sensor_config(rig, devices), gated=gated)
    if not gated:
        yield from _unit(rig, devices, found)
    if found.meaning is None:
        yield BenchFinding("time stamps", "note", f"taken for {found.assumed.value}: {found.why}")
        return
    agrees = found.meaning is found.assumed
    yield BenchFinding(
        "time stamps",
        "ok" if agrees else "bad",
        f"{found.meaning.value}: {found.why}" + ("" if agrees else f"; they were taken for {found.assumed.value}"),
        "" if agrees else f'set stamps = "{found.meaning.value}" in [sensor]',
    )


def _unit(rig: Rig, devices: Devices, found: StampsFound) -> Iterator[BenchFinding]:
    """Compare the growth of the frames' arrival with the exposures that were set: is their unit the right one?"""
    what, sensor = "unit of exposure", rig.table.sensor
    if found.growth is None:
        yield BenchFinding(what, "note", found.why)
        return
    seen = f"exposures grow by {found.growth:.2f} of what is set"
    step_s = devices.sensor.info.exposure_step_s
    unsettled = devices.sensor.info.exposure_unsettled
    if abs(found.growth - 1) <= UNIT_TOLERANCE + found.growth_error:
        remedy = f"set exposure_unit_s = {step_s:.4g} in [sensor]" if unsettled else ""
        yield BenchFinding(what, "bad" if unsettled else "ok", seen + (f"; {unsettled}" if unsettled else ""), remedy)
        return
    if found.growth <= 2 * found.growth_error:
        yield BenchFinding(
            what,
            "bad",
            f"{seen}: the sensor ignores its exposure control",
            "check that no automatic exposure is on; or state fixed_exposure_s in [sensor]",
        )
        return
    nearest_s = _known_unit(step_s * found.growth, step_s * found.growth_error)
    yield BenchFinding(
        what,
        "bad",
        f"{seen}: its unit is {step_s * found.growth:.3g} s, not {step_s:.3g} s",
        f"set exposure_unit_s = {nearest_s:.4g} in [sensor]"
        if sensor.kind == "v4l2"
        else "look for a feature that scales its exposures in the maker's viewer, and set it in [sensor.features]",
    )


def _known_unit(unit_s: float, error_s: float) -> float:
    """Return the unit that drivers use and that a measured one is, within its error; otherwise the measured one."""
    near = [one for one in KNOWN_UNITS_S if abs(one - unit_s) <= max(3 * error_s, UNIT_TOLERANCE * one)]
    return min(near, key=lambda one: abs(one - unit_s), default=unit_s)


def _finding_of_error(what: str, error: Gs2ciError) -> BenchFinding:
    remedy = "; ".join(part for part in (error.allowed and f"allowed: {error.allowed}", error.remedy) if part)
    return BenchFinding(what, "bad", error.problem, remedy)


def _permissions(rig: Rig) -> Iterator[BenchFinding]:
    tables = {"modulator": rig.table.modulator, "sensor": rig.table.sensor, "stage": rig.table.stage}
    for device, table in tables.items():
        if table is not None and table.port != SIMULATED:
            yield from _permission(device, table)


def _permission(device: str, table: Any) -> Iterator[BenchFinding]:
    """Examine what a device's port needs, by its driver's record."""
    record = known_driver(DEVICE_GROUPS[device], table.kind)
    if record.access == "usb" and record.usb_ids is not None:
        yield BenchFinding(
            f"permissions for the {device}",
            "note",
            "USB needs a udev rule unless you are root",
            f"put into /etc/udev/rules.d/70-gs2ci.rules:\n{udev_rules(*record.usb_ids)}",
        )
    elif record.access == "gentl":
        yield from _producer(table)
    elif record.access == "library":
        yield _library(table)
    elif record.access == "video":
        yield from _node(device, table.port, VIDEO_RULE)
    elif record.access == "tty":
        yield from _node(device, table.port, tty_rule(table.port))


def tty_rule(port: str) -> str:
    """Return the udev rule for one serial device: by its USB identity if it has one, otherwise by its name.

    The rule is never for all of them: that would give access to consoles, modems and other people's devices.
    """
    node = os.path.realpath(port)
    access = 'MODE="0660", GROUP="dialout", TAG+="uaccess"'
    usb = next((one for one in list_ports.comports() if one.device == node and one.vid is not None), None)
    if usb is None:
        return f'SUBSYSTEM=="tty", KERNEL=="{Path(node).name}", {access}'
    serial = f', ATTRS{{serial}}=="{usb.serial_number}"' if usb.serial_number else ""
    identity = f'ATTRS{{idVendor}}=="{usb.vid:04x}", ATTRS{{idProduct}}=="{usb.pid:04x}"{serial}'
    return f'SUBSYSTEM=="tty", {identity}, {access}'


def _node(device: str, port: str, rule: str) -> Iterator[BenchFinding]:
    what = f"permissions for the {device}"
    if not Path(port).exists():
        yield BenchFinding(what, "bad", f"{port} does not exist", "connect it; `gs2ci devices` lists what is connected")
    elif not os.access(port, os.R_OK | os.W_OK):
        yield BenchFinding(
            what,
            "bad",
            f"{port} may not be read and written by this user",
            f"put into /etc/udev/rules.d/70-gs2ci.rules:\n{rule}\nor join the group that owns {port}",
        )
    else:
        yield BenchFinding(what, "ok", f"{port} may be read and written")


def _producer(sensor: Any) -> Iterator[BenchFinding]:
    """Return the finding about the camera's GenTL producer; makers' producers install their own udev rules."""
    what = "GenTL producer"
    try:
        found = find_producers(sensor.producer)
    except OSError as error:
        yield BenchFinding(
            what,
            "bad",
            reason_of(error),
            "install the camera maker's software, which sets GENICAM_GENTL64_PATH, or set `producer` in [sensor]",
        )
        return
    yield BenchFinding(what, "ok", ", ".join(str(path) for path in found))


def _words(device: Any) -> str:
    """Return what a device says of itself; "" if there is none."""
    info = None if device is None else device.info
    return " ".join(str(getattr(info, name, "")) for name in ("model", "firmware", "driver"))


def _manners(rig: Rig, connected: Mapping[str, str]) -> Iterator[BenchFinding]:
    """Return what is known of the devices that answer and that one would not guess (docs/devices.md)."""
    tables = {"modulator": rig.table.modulator, "sensor": rig.table.sensor, "stage": rig.table.stage}
    for device in connected:
        table = tables[device]
        for one in manners_for(table.kind, connected[device]) if table is not None else ():
            yield BenchFinding(f"about the {device}", "know", f"{one.applies}: not “{one.guess}”, but: {one.fact}")


def _library(table: Any) -> BenchFinding:
    """Return the finding about the maker's library of a device that is reached through one."""
    file: Path = table.library_file
    return BenchFinding(
        "maker's library",
        "ok" if file.is_file() else "bad",
        str(file) if file.is_file() else f"{file} does not exist",
        "" if file.is_file() else "install the maker's software, or set `library` and `version` in [modulator]",
    )


def _modulator(devices: Devices) -> Iterator[BenchFinding]:
    info = devices.modulator.connect()
    yield BenchFinding("modulator", "ok", f"{info.model} answers")
    yield BenchFinding(
        "modulator firmware", "ok" if info.firmware else "note", info.firmware or "the device does not report it"
    )
    if info.experimental:
        yield BenchFinding(
            "modulator protocol",
            "note",
            "experimental: not confirmed on real hardware",
            "compare a few masks by eye before trusting it",
        )
    faults = devices.modulator.status().faults
    yield BenchFinding(
        "modulator state",
        "bad" if faults else "ok",
        ", ".join(faults) or "no faults",
        "see its manual for these; a power cycle clears most" if faults else "",
    )


def _sensor(devices: Devices) -> Iterator[BenchFinding]:
    info = devices.sensor.prepare()
    yield BenchFinding("sensor", "ok", f"{info.model} answers ({info.driver})")
    external = {TriggerMode.EDGE, TriggerMode.LEVEL} & info.triggers
    yield BenchFinding(
        "sensor trigger",
        "ok" if external else "bad",
        ", ".join(sorted(mode.value for mode in info.triggers)),
        "" if external else HOW_TRIGGERED,
    )


def _stage(devices: Devices) -> Iterator[BenchFinding]:
    if devices.stage is None:
        yield BenchFinding("stage", "note", "none in the rig file")
        return
    info = devices.stage.connect()
    yield BenchFinding("stage", "ok", f"{info.model} answers, firmware {info.firmware}")
    status = devices.stage.status()
    yield BenchFinding(
        "stage reference",
        "ok" if status.referenced else "bad",
        "its position is known" if status.referenced else "its position is unknown",
        "" if status.referenced else f"home it with `{HOME_COMMAND}` when nothing is in its way",
    )
    if status.faults or status.warnings:
        yield BenchFinding(
            "stage state",
            "bad" if status.faults else "note",
            ", ".join((*status.faults, *status.warnings)),
            "remove obstacles, release the emergency stop, check its supply" if status.faults else "",
        )


def _loop_masks(info: ModulatorInfo) -> np.ndarray[tuple[int, int, int], np.dtype[np.uint8]]:
    """Return masks that upload quickly: open and closed in turn."""
    masks = np.zeros((LOOP_MASKS, info.height, info.width), np.uint8)
    masks[::2] = 1
    return masks


def _trigger_loop(rig: Rig, devices: Devices) -> Iterator[BenchFinding]:
    """Show masks with one trigger each and count the frames."""
    info = devices.modulator.info
    mask_s = info.at_least_s(max(LOOP_MASK_S, 2 * info.min_exposure_s[min(info.min_exposure_s)]))
    settings = CaptureSettings(
        masks=_loop_masks(info), bit_depth=min(info.min_exposure_s), mask_s=mask_s, mode=Mode.PER_MASK,
        margin_s=mask_s / 2, gated=_gated(rig, devices),
    )  # fmt: skip
    taken: list[Taken] = []
    try:
        plan = plan_capture(devices, settings, sensor_config(rig, devices)).require_sound()
        capture(devices, plan, taken.append)
    except Gs2ciError as error:
        yield _finding_of_error("trigger loop", error)
        return
    frames = taken[0].frames
    yield BenchFinding(
        "trigger loop", "ok", f"{LOOP_MASKS} triggers gave {len(frames)} frames, in order, none left over"
    )
    stamped = all(frame.flags & FrameFlag.STAMPED_MONOTONIC for frame in frames)
    yield _clock(stamped, lambda: [frame.t_kernel_ns for frame in frames], plan.frame_period_s)


def _clock(stamped: bool, stamps_ns: Callable[[], list[int]], period_s: float) -> BenchFinding:
    if not stamped:
        return BenchFinding(
            "clocks",
            "note",
            "the camera's time stamps have an unknown origin",
            "telemetry then rests on the computer's time: expect errors of milliseconds",
        )
    stamps = stamps_ns()
    drift_ppm = ((stamps[-1] - stamps[0]) * 1e-9 / ((len(stamps) - 1) * period_s) - 1) * 1e6
    good = abs(drift_ppm) < LARGEST_DRIFT_PPM
    return BenchFinding(
        "clocks",
        "ok" if good else "bad",
        f"the modulator's second is {drift_ppm:+.0f} ppm longer than the computer's",
        "" if good else "check the modulator's firmware profile and its time unit",
    )
