"""The twin of a Thorlabs motion controller: the APT protocol over a `SerialTwin`, its axes as `AxisMotion`.

It reads and writes messages with its own code. Its behaviour follows Thorlabs' "Motion Controllers Host-Controller
Communications Protocol":

- MGMSG_MOT_SET_POSCOUNTER: after power-up the position is unknown and counts from 0 where the stage stands; homing
  gives it its reference;
- MGMSG_MOT_MOVE_ABSOLUTE is not answered; at its end MGMSG_MOT_MOVE_COMPLETED is sent, unless
  MGMSG_MOT_SUSPEND_ENDOFMOVEMSGS has switched that off; a move without a reference is carried out;
- MGMSG_HW_START_UPDATEMSGS: a status update every 100 ms, at most 50 of them without MGMSG_MOT_ACK_DCSTATUSUPDATE;
- MGMSG_MOT_SET_VELPARAMS: held in memory that power clears;
- MGMSG_MOT_SET_GENMOVEPARAMS: a move in reverse goes past its target by this "backlash distance" and returns to it
  (BMS001 manual, D.3.1: "a negative move ... first causes the stage to overshoot the target position and then move
  positively through a small amount", "enabled as its default mode of operation");
- MGMSG_MOT_REQ_PMDSTAGEAXISPARAMS: brushless controllers tell what the memory in the stage's plug holds, in 74 bytes
  (Thorlabs' BrushlessMotor.h, MOT_StageAxisParameters); others do not know the message;
- MGMSG_MOT_MOVE_STOP: parameter 1 at once, 2 with deceleration; then MGMSG_MOT_MOVE_STOPPED;
- a motor that is switched off ignores moves.

That the status word lags by one update of 10 ms, and how far the distance is at power-up, are assumptions: the
documents give no figures. Not here: the byte
level (`serial_twin`), the driver.
"""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from gs2ci.core.mechanics import Mechanics
from gs2ci_sims.axis_motion import AxisMotion
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.disturbed import Disturbances
from gs2ci_sims.wires.serial_twin import SerialTwin
from gs2ci_sims.world import VirtualClock, World

STATUS_S: Final = 10e-3
UPDATE_S: Final = 0.1
MOST_UPDATES: Final = 50
_FLAG_FORWARD, _FLAG_REVERSE, _FLAG_HOMING, _FLAG_HOMED = 0x10, 0x20, 0x200, 0x400
_FLAG_CONNECTED, _FLAG_SETTLED, _FLAG_ERROR, _FLAG_ON = 0x100, 0x2000, 0x4000, 0x80000000


@dataclass(frozen=True)
class AptAxis:
    """A stage as built, and its controller's loop.

    Args:
        counts_per_mm: Encoder counts, or microsteps, per mm.
        travel_mm: Travel, from 0.
        speed_mm_s: Speed of moves after power-up.
        acceleration_mm_s2: Their acceleration.
        sample_s: Interval of the servo loop, in which speeds are counted; 0 for a stepper motor.
        start_mm: Where it stands at power-up.
        mechanics: The errors between counted and true position.
        overshoot_mm: Backlash distance at power-up; direct drives have none.
        part: Part number in its plug.
        home_mm_s: Speed of homing; None takes half that of moves. At 0 it does not move.
    """

    counts_per_mm: float = 20000.0
    travel_mm: float = 110.0
    speed_mm_s: float = 50.0
    acceleration_mm_s2: float = 500.0
    sample_s: float = 102.4e-6
    start_mm: float = 55.0
    mechanics: Mechanics = field(default_factory=Mechanics)
    overshoot_mm: float = 0.0
    part: str = "MLS203"
    home_mm_s: float | None = None

    @property
    def speed_unit(self) -> float:
        """Get the protocol's speed units per mm/s: 16 bits of fraction of counts per sample, or 53.68 per step/s."""
        return self.counts_per_mm * (self.sample_s * 2.0**16 if self.sample_s else 53.68)

    @property
    def acceleration_unit(self) -> float:
        """Get the protocol's acceleration units per mm/s², likewise per sample², or one per 90.9 steps/s²."""
        return self.counts_per_mm * (self.sample_s**2 * 2.0**16 if self.sample_s else 1 / 90.9)


# Encoder of 512 counts, gear of 67.49:1, lead of 1 mm: 34555 counts per mm; the document's figure is 34554.96.
_SCREW_MM: Final = 0.05
_Z8: Final = AptAxis(34554.96, 25.0, 2.4, 4.5, 2048 / 6e6, 12.5, overshoot_mm=_SCREW_MM)
BUILT: Final[dict[str, AptAxis]] = {
    "MTS25-Z8": _Z8,
    "MTS50-Z8": replace(_Z8, travel_mm=50.0, start_mm=25.0),
    "Z812": replace(_Z8, travel_mm=12.0, speed_mm_s=2.6, acceleration_mm_s2=4.0, start_mm=6.0),
    "Z825": replace(_Z8, speed_mm_s=2.6, acceleration_mm_s2=4.0),
    "MLS203-X": AptAxis(),
    "MLS203-Y": AptAxis(travel_mm=75.0, start_mm=37.5),
    "DDSM50": AptAxis(2000.0, 50.0, 100.0, 1000.0, start_mm=25.0, part="DDSM50"),
    "DDSM100": AptAxis(2000.0, 100.0, 100.0, 1000.0, start_mm=50.0, part="DDSM100"),
    "DDS220": AptAxis(20000.0, 220.0, 100.0, 1000.0, start_mm=110.0, part="DDS220"),
    "LTS150": AptAxis(409600.0, 150.0, 20.0, 20.0, 0.0, 75.0, overshoot_mm=_SCREW_MM),
    "LTS300": AptAxis(409600.0, 300.0, 20.0, 20.0, 0.0, 150.0, overshoot_mm=_SCREW_MM),
}
"""Stages by their models, with typical settings."""


class _Axis:
    """An axis with its live settings."""

    def __init__(self, built: AptAxis, *, homed: bool, enabled: bool) -> None:
        self.built = built
        self.motion = AxisMotion(built.start_mm, built.acceleration_mm_s2, built.mechanics)
        self.offset = 0 if homed else -round(built.start_mm * built.counts_per_mm)
        self.enabled = enabled
        self.homed = homed
        self.reset_settings()
        self.begun_s = float("-inf")
        self.direction = 0
        self.homing = False
        self.error = 0

    def reset_settings(self) -> None:
        self.speed = round(self.built.speed_mm_s * self.built.speed_unit)
        self.acceleration = round(self.built.acceleration_mm_s2 * self.built.acceleration_unit)
        home_mm_s = self.built.speed_mm_s / 2 if self.built.home_mm_s is None else self.built.home_mm_s
        self.home_speed = round(home_mm_s * self.built.speed_unit)
        self.overshoot = round(self.built.overshoot_mm * self.built.counts_per_mm)

    def counts(self, now_s: float) -> int:
        """Return what the controller counts."""
        return round(self.motion.position_at(now_s) * self.built.counts_per_mm) + self.offset

    def bits(self, now_s: float) -> int:
        seen_s = now_s - STATUS_S
        word = _FLAG_CONNECTED | (_FLAG_ON if self.enabled else 0) | (_FLAG_HOMED if self.homed else 0)
        if self.begun_s <= seen_s < self.motion.ends_s:
            word |= _FLAG_FORWARD if self.direction > 0 else _FLAG_REVERSE
            return word | (_FLAG_HOMING if self.homing else 0)
        position_mm = self.motion.position_at(now_s)
        word |= 0x1 if position_mm >= self.built.travel_mm else 0
        word |= 0x2 if position_mm <= 0 and not self.homed else 0
        return word | _FLAG_SETTLED | self.error


class KinesisTwin(SerialTwin):
    """A controller with its axes, named as in the rig.

    Args:
        clock: The world's clock.
        axes: Its axes by name; several are the bays of a benchtop controller, in this order.
        faults: The faults to inject.
        homed: Whether it has been homed since it was switched on.
        enabled: Whether its motors are on.
        model: What it says it is.
        benchtop: Whether it has bays behind a motherboard, whatever their number; None: if there are several.
    """

    def __init__(
        self,
        clock: VirtualClock,
        axes: Mapping[str, AptAxis] | None = None,
        faults: FaultSet | None = None,
        *,
        homed: bool = True,
        enabled: bool = True,
        model: str = "KDC101",
        benchtop: bool | None = None,
    ) -> None:
        super().__init__(clock, faults)
        built = dict(axes or {"x": AptAxis()})
        self._axes = {name: _Axis(axis, homed=homed, enabled=enabled) for name, axis in built.items()}
        bays = len(built) > 1 if benchtop is None else benchtop
        self._model = model
        self._main = 0x11 if bays else 0x50
        self._at = {(0x21 + i if bays else 0x50): axis for i, axis in enumerate(self._axes.values())}
        self._ends_told = True
        self._updates_left = 0
        self._input = bytearray()
        self._generation = 0
        self._moved = False
        self.disturbances = Disturbances(clock, self.faults)

    @property
    def terminators(self) -> bytes:
        """Get nothing: messages have a length."""
        return b""

    def positions_mm_at(self, when_s: float) -> dict[str, float]:
        """Return the true positions of the carriages."""
        return {name: axis.motion.true_position_at(when_s) for name, axis in self._axes.items()}

    def power_cycle(self) -> None:
        """Cut the power for a moment: motion ends, the reference and all settings are lost."""
        now_s = self.clock.now_s()
        self._generation += 1
        self._input.clear()
        self._ends_told, self._updates_left = True, 0
        for axis in self._axes.values():
            axis.motion.halt(now_s)
            axis.homed, axis.homing, axis.error = False, False, 0
            axis.offset = 0
            axis.offset = -axis.counts(now_s)
            axis.reset_settings()

    def begin_updates(self) -> None:
        """Do what another program does that asks for status updates and leaves."""
        self._updates_left = MOST_UPDATES
        self._update(self._generation)

    def suspend_end_of_move_messages(self) -> None:
        """Do what another program does that does not want to be told the ends of moves."""
        self._ends_told = False

    def _stale(self) -> bytes:
        address, axis = next(iter(self._at.items()))
        return self._long(0x0412, address, struct.pack("<Hi", 1, axis.counts(self.clock.now_s()) + 12345))

    def _line(self, line: bytes) -> None:
        raise AssertionError("messages are no lines")

    def _receive(self, data: bytes) -> None:
        self._input += data
        while len(self._input) >= 6:
            ident, first, second, dest, _ = struct.unpack_from("<HBBBB", self._input)
            size = 6 + (first | second << 8 if dest & 0x80 else 0)
            if len(self._input) < size:
                return
            body = bytes(self._input[6:size])
            del self._input[:size]
            if not self.faults.take("serial.request_lost", f"{ident:#06x}"):
                self._message(ident, first, second, dest & 0x7F, body)

    def _message(self, ident: int, first: int, second: int, dest: int, body: bytes) -> None:
        if dest == self._main and ident in (0x0005, 0x0011, 0x0012):
            self._main_message(ident)
        axis = self._at.get(dest)
        if axis is None:
            return
        handlers: dict[int, Callable[[], None]] = {
            0x0210: lambda: setattr(axis, "enabled", second == 1),
            0x0411: lambda: self._answer(0x0412, dest, struct.pack("<Hi", 1, axis.counts(self.clock.now_s()))),
            0x0413: lambda: self._set_speed(axis, body),
            0x0414: lambda: self._answer(0x0415, dest, struct.pack("<Hiii", 1, 0, axis.acceleration, axis.speed)),
            0x0429: lambda: self._answer(0x042A, dest, struct.pack("<HI", 1, axis.bits(self.clock.now_s()))),
            0x043A: lambda: setattr(axis, "overshoot", struct.unpack_from("<Hi", body)[1]),
            0x043B: lambda: self._answer(0x043C, dest, struct.pack("<Hi", 1, axis.overshoot)),
            0x0440: lambda: setattr(axis, "home_speed", struct.unpack_from("<HHHii", body)[3]),
            0x0441: lambda: self._answer(0x0442, dest, struct.pack("<HHHii", 1, 2, 1, axis.home_speed, 0)),
            0x0443: lambda: self._home(dest, axis),
            0x0453: lambda: self._move(dest, axis, struct.unpack_from("<Hi", body)[1]),
            0x0465: lambda: self._stop(dest, axis, at_once=second == 1),
            0x046B: self.suspend_end_of_move_messages,
            0x046C: lambda: setattr(self, "_ends_told", True),
            0x04F1: lambda: self._tell_plug(dest, axis.built),
            0x0492: lambda: setattr(self, "_updates_left", MOST_UPDATES if self._updates_left else 0),
        }
        handlers.get(ident, lambda: None)()

    def _main_message(self, ident: int) -> None:
        if ident == 0x0005:
            model = self._model.encode("ascii").ljust(8, b"\0")
            data = struct.pack("<i8sHBBBB60sHHH", 27250001, model, 16, 3, 2, 1, 0, b"", 1, 0, len(self._at))
            self._answer(0x0006, self._main, data)
        elif ident == 0x0011:
            self.begin_updates()
        else:
            self._updates_left = 0

    def _set_speed(self, axis: _Axis, body: bytes) -> None:
        _, _, axis.acceleration, axis.speed = struct.unpack_from("<Hiii", body)
        axis.motion.acceleration_mm_s2 = axis.acceleration / axis.built.acceleration_unit

    def _tell_plug(self, address: int, built: AptAxis) -> None:
        if built.sample_s != AptAxis.sample_s:
            return
        counts = round(built.counts_per_mm)
        data = struct.pack("<HHH", 1, 5, 1) + built.part.encode("ascii").ljust(16, b"\0")
        data += struct.pack("<IIii", 27250002, counts, 0, round(built.travel_mm * counts))
        self._answer(0x04F2, address, data + bytes(74 - len(data)))

    def _home(self, address: int, axis: _Axis) -> None:
        if not axis.enabled or not axis.home_speed:
            return
        now_s = self.clock.now_s()
        axis.homed, axis.homing, axis.error = False, True, 0
        ends_s = self._begin(axis, 0.0, axis.home_speed / axis.built.speed_unit, now_s)

        def arrive() -> None:
            if axis.homing and axis.motion.ends_s == ends_s:
                axis.homed, axis.homing, axis.offset = True, False, 0
                self._arrive(struct.pack("<HBBBB", 0x0444, 1, 0, 0x01, address), self.clock.now_s())

        self.clock.at(ends_s, arrive)

    def _move(self, address: int, axis: _Axis, counts: int) -> None:
        if not axis.enabled:
            return
        now_s, built = self.clock.now_s(), axis.built
        self._moved = True
        axis.error, axis.homing = 0, False
        here_mm = axis.motion.position_at(now_s)
        target_mm = min(max((counts - axis.offset) / built.counts_per_mm, 0.0), built.travel_mm)
        beside = self.faults.take("kinesis.beside")
        if beside:
            target_mm -= (beside.value or 0.1) * (1 if target_mm > here_mm else -1)
        past_mm = axis.overshoot / built.counts_per_mm if target_mm < here_mm else 0.0
        speed_mm_s = axis.speed / built.speed_unit
        ends_s = self._begin(axis, max(target_mm - past_mm, 0.0), speed_mm_s, now_s)
        self._schedule_faults(axis, now_s, ends_s)
        returns = past_mm > 0

        def ends(when_s: float) -> None:
            def arrive() -> None:
                nonlocal returns
                if axis.motion.ends_s != when_s:
                    return
                if returns and not axis.error:
                    returns = False
                    ends(self._begin(axis, target_mm, speed_mm_s, when_s))
                elif self._ends_told:
                    self._arrive(self._status(0x0464, address, axis), self.clock.now_s() + STATUS_S)

            self.clock.at(when_s, arrive)

        ends(ends_s)
        self.disturbances.schedule([axis.motion], ends_s, "0x0453", ends)

    def _begin(self, axis: _Axis, target_mm: float, speed_mm_s: float, now_s: float) -> float:
        axis.begun_s = now_s
        axis.direction = 1 if target_mm > axis.motion.position_at(now_s) else -1
        return axis.motion.move_to(target_mm, speed_mm_s, now_s)

    def _schedule_faults(self, axis: _Axis, now_s: float, ends_s: float) -> None:
        stall, wheel = self.faults.take("kinesis.stall"), self.faults.take("kinesis.wheel")
        cut, fault = self.faults.take("kinesis.power_cycle"), self.faults.take("kinesis.status_bit")
        at_s = now_s + (ends_s - now_s) * ((stall.value if stall else 0.0) or 0.5)

        def strike() -> None:
            if cut:
                self.power_cycle()
                return
            axis.motion.halt(self.clock.now_s())
            axis.error = int(fault.value) if fault else _FLAG_ERROR if stall else 0

        if stall or wheel or cut or fault:
            self.clock.at(at_s, strike)

    def _stop(self, address: int, axis: _Axis, *, at_once: bool) -> None:
        now_s = self.clock.now_s()
        if not axis.motion.moving_at(now_s):
            return
        axis.homing = False
        if at_once:
            axis.motion.halt(now_s)
        else:
            axis.motion.stop(now_s)
        if self._ends_told:
            self._arrive(self._status(0x0466, address, axis), axis.motion.ends_s + STATUS_S)

    def _update(self, generation: int) -> None:
        if self._updates_left <= 0 or generation != self._generation:
            return
        self._updates_left -= 1
        for address, axis in self._at.items():
            self._arrive(self._status(0x0491, address, axis), self.clock.now_s())
        self.clock.after(UPDATE_S, lambda: self._update(generation))

    def _status(self, ident: int, address: int, axis: _Axis) -> bytes:
        now_s = self.clock.now_s()
        speed = round(abs(axis.motion.speed_at(now_s)) * axis.built.speed_unit / 2.0**16) & 0xFFFF
        return self._long(ident, address, struct.pack("<HiHHI", 1, axis.counts(now_s), speed, 0, axis.bits(now_s)))

    def _answer(self, ident: int, source: int, data: bytes) -> None:
        reply = self._long(ident, source, data)
        if self.faults.take("kinesis.complains", f"{ident:#06x}"):
            words = b"a text that says what is wrong".ljust(64, b"\0")
            reply = self._long(0x0081, source, struct.pack("<HH64s", ident, 7, words)) + reply
        moved, self._moved = self._moved, False
        self._reply(reply, f"{ident:#06x}" + (" behind S\x04" if moved else ""))

    @staticmethod
    def _long(ident: int, source: int, data: bytes) -> bytes:
        return struct.pack("<HHBB", ident, len(data), 0x81, source) + data


def simulated(world: World, settings: Any) -> KinesisTwin:
    """Build the twin that a rig file's [stage] and [world] describe: stages as their models are built."""
    stated = world.stated
    axes = {}
    for name, _ in sorted(settings.axes.items(), key=lambda one: one[1]):
        built = BUILT[settings.stages[name]]
        axes[name] = replace(built, start_mm=stated.start_mm(built.start_mm), mechanics=stated.mechanics(name))
    benchtop = any(settings.axes.values())
    model = "BBD202" if benchtop else "KDC101"
    return KinesisTwin(world.clock, axes, stated.faults["stage"], model=model, benchtop=benchtop)
