"""`gs2ci devices`: what is connected and what it can do.

Here: the arguments and the printing. Not here: opening devices and looking for them (`gs2ci.api.rigs`).
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import print_table, say
from gs2ci.core.errors import InputError

if TYPE_CHECKING:
    from gs2ci_drivers.acquisition import Devices
    from gs2ci_drivers.modulator import Modulator
    from gs2ci_drivers.sensor import Sensor
    from gs2ci_drivers.stage import Stage


def run(*, rig: Path | None = None, home: bool = False, json: AsJson = False) -> None:
    """List what is connected and what it can do; nothing is changed and, without --home, nothing moves.

    Without a rig, also what may render reconstructions.

    Args:
        rig: Query the devices of this rig file; by default, look for devices on this computer.
        home: Move the stage of the rig to its reference; the way must be free.

    Raises:
        InputError: Nothing can be homed, because no rig is given, or it has no stage.
        DeviceError: A device does not answer.
    """
    if home and rig is None:
        from gs2ci_drivers.failures import HOME_COMMAND

        raise InputError("--home without a rig", remedy=HOME_COMMAND)
    with answered(json) as answer:
        if rig is None:
            answer(_print_found())
            return
        from gs2ci.api.rigs import open_rig

        with open_rig(rig) as opened:
            told = _print_devices(opened.devices)
            if home:
                if opened.devices.stage is None:
                    raise InputError(f"--home: {rig} names no stage", remedy="add [stage] to it, or leave --home out")
                positions = opened.home()
                homed = ", ".join(f"{axis} {mm:.4f} mm" for axis, mm in positions.items())
                say(f"homed: {homed}")
                told["homed_mm"] = positions
            answer(told)


def _print_found() -> list[dict[str, str]]:
    from gs2ci.api.rigs import find_devices

    found = find_devices()
    if all(kind == "compute" for kind, _, _ in found):
        say("no camera, serial port or modulator was found; `gs2ci doctor` says what may be missing")
    for kind, port, name in found:
        place = f"--device {port}" if kind == "compute" else f"port = {port!r}"
        say(f"{kind:<10} {place}  {name}")
    return [{"kind": kind, "port": port, "name": name} for kind, port, name in found]


def _print_devices(devices: "Devices") -> dict[str, Any]:
    told: dict[str, Any] = {}
    for rows in (_modulator(devices.modulator), _sensor(devices.sensor), _stage(devices.stage)):
        (kind, model), *others = rows
        told[kind] = {"model": model, **dict(others)}
        print_table((), rows)
        say()
    return told


def _modulator(modulator: "Modulator") -> list[tuple[str, str]]:
    info = modulator.connect()
    status = modulator.status()
    depths = ", ".join(
        f"{bits} bit: from {shortest * 1e6:.0f} us, at most {info.capacity[bits]} masks"
        for bits, shortest in sorted(info.min_exposure_s.items())
    )
    return [
        ("modulator", info.model + (" (experimental)" if info.experimental else "")),
        ("firmware", info.firmware),
        ("pixels", f"{info.height} x {info.width}, pitch {info.pitch_m * 1e6:.2f} um"),
        ("depths", depths),
        ("trigger out", ", ".join(sorted(out.value for out in info.trigger_outs))),
        ("state", ", ".join([status.state.value, *status.faults])),
    ]


def _sensor(sensor: "Sensor") -> list[tuple[str, str]]:
    info = sensor.connect()
    formats = ", ".join(f"{fmt.fourcc} {fmt.height} x {fmt.width} ({fmt.bits} bit)" for fmt in info.formats)
    return [
        ("sensor", f"{info.model} {info.serial}".strip()),
        ("driver", info.driver),
        ("formats", formats),
        ("exposure", f"{info.min_exposure_s:.3g} to {info.max_exposure_s:.3g} s"),
        ("trigger in", ", ".join(sorted(mode.value for mode in info.triggers))),
        ("controls", ", ".join(f"{name} {limits}" for name, limits in info.controls.items())),
    ]


def _stage(stage: "Stage | None") -> list[tuple[str, str]]:
    if stage is None:
        return [("stage", "none in the rig file")]
    info = stage.connect()
    status = stage.status()
    rows = [("stage", f"{info.model} {info.serial}".strip()), ("firmware", info.firmware)]
    for name, axis in info.axes.items():
        here = status.positions_mm.get(name, float("nan"))
        rows.append(
            (
                f"axis {name}",
                f"at {here:.4f} mm of {axis.min_mm:g} to {axis.max_mm:g}, steps of {axis.step_mm * 1e3:.4g} um, "
                f"up to {axis.max_speed_mm_s:.4g} mm/s",
            )
        )
    state = "moving" if status.moving else "at rest" if status.referenced else "not referenced: home it first"
    rows.append(("state", ", ".join([state, *status.faults, *status.warnings])))
    return rows
