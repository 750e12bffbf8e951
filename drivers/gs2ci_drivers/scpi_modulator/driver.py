"""A modulator that speaks the open SCPI-style protocol, as a `Modulator`.

Here: the order of commands, capabilities, times in µs. Not here: the exchange (`link`), the bytes (`packets`), the
protocol's text (docs/scpi-modulator.md).
"""

from typing import Final

from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import BadReplyError, DeviceFaultError, SequenceError, UnsupportedError
from gs2ci_drivers.modulator import Modulator, ModulatorState, ModulatorStatus, UploadProgress
from gs2ci_drivers.pattern_sequence import ModulatorInfo, PatternSequence, TriggerOut
from gs2ci_drivers.ports import BytePort
from gs2ci_drivers.scpi_modulator.link import ScpiLink
from gs2ci_drivers.scpi_modulator.options import ScpiOptions
from gs2ci_drivers.scpi_modulator.packets import (
    PROTOCOL,
    VERSION,
    MalformedScpiReplyError,
    mask_bytes,
    pack_mask,
    parse_integers,
)

_US: Final = 1e-6
_OUTS: Final = {
    "NONE": TriggerOut.NONE,
    "EXPOSURE": TriggerOut.PER_EXPOSURE,
    "GATE": TriggerOut.GATE,
    "MASK": TriggerOut.PER_MASK,
}
_STATES: Final = {
    "IDLE": ModulatorState.IDLE,
    "LOADED": ModulatorState.LOADED,
    "ARMED": ModulatorState.ARMED,
    "RUNNING": ModulatorState.RUNNING,
    "FAULT": ModulatorState.FAULT,
}
# A command and its reply on the line, and the device's own time for it.
_EXCHANGE_BYTES: Final = 40
_EXCHANGE_S: Final = 2e-3


class ScpiModulator(Modulator):
    """A modulator behind the open protocol, version 1.

    Args:
        name: Name of the device in the rig file.
        port: The serial line; closed with this.
        clock: Where deadlines are kept.
        settings: From the rig file.
    """

    def __init__(self, name: str, port: BytePort, clock: Clock, settings: ScpiOptions | None = None) -> None:
        super().__init__(name, clock)
        self.settings = settings or ScpiOptions()
        self._link = ScpiLink(name, port, clock, incidents=self.incidents, timeout_s=self.settings.timeout_s)
        self._takes_patterns = True
        self._running: PatternSequence | None = None
        self._started_s = 0.0

    def _do_connect(self) -> ModulatorInfo:
        protocol = self._link.ask("SYST:VERS?")
        if protocol != f"{PROTOCOL},{VERSION}":
            raise UnsupportedError(
                self.name,
                f"protocol {protocol!r}",
                asked="SYST:VERS?",
                allowed=f"{PROTOCOL},{VERSION}",
                remedy="update the modulator's firmware or gs2ci; see docs/scpi-modulator.md",
            )
        identity = self._fields("*IDN?", 4)
        kind = self._choice("MOD:KIND?", ("PATTERNS", "FIXED"))
        self._takes_patterns = kind == "PATTERNS"
        height, width = self._integers("MOD:SIZE?", 2)
        depths = self._integers("MOD:DEPTHS?")
        latency_s = self._integers("MOD:LATENCY?", 1)[0] * _US
        return ModulatorInfo(
            model=f"{identity[0]} {identity[1]}",
            serial=identity[2],
            firmware=identity[3],
            height=height,
            width=width,
            pitch_m=self._integers("MOD:PITCH?", 1)[0] * 1e-9,
            min_exposure_s={bits: self._integers(f"MOD:MIN? {bits}", 1)[0] * _US for bits in depths},
            max_exposure_s=self._integers("MOD:MAX?", 1)[0] * _US,
            exposure_step_s=self._integers("MOD:STEP?", 1)[0] * _US,
            min_dark_s=self._integers("MOD:DARK?", 1)[0] * _US,
            capacity={bits: self._integers(f"MOD:CAP? {bits}", 1)[0] for bits in depths},
            trigger_outs=frozenset(_OUTS[out] for out in self._fields("MOD:OUTS?") if out in _OUTS),
            trigger_delay_s=self._integers("MOD:DELAY?", 1)[0] * _US,
            start_latency_s=latency_s + 2 * self._exchange_s(),
            typical_start_s=latency_s + self._exchange_s() / 2,
        )

    def _exchange_s(self) -> float:
        """Return how long a command and its reply take on the line and in the device."""
        return _EXCHANGE_BYTES * 10 / self.settings.baud + _EXCHANGE_S

    def _do_upload_eta_s(self, sequence: PatternSequence) -> float:
        exchanges = 6 + (sequence.count if self._takes_patterns else 0)
        data_bytes = 0
        if self._takes_patterns:
            data_bytes = sequence.count * mask_bytes(self.info.height, self.info.width, sequence.bit_depth)
        return data_bytes * 10 / self.settings.baud + exchanges * self._exchange_s()

    def _do_upload(self, sequence: PatternSequence, progress: UploadProgress) -> int:
        self._running = None
        ask, sent = self._link.ask, 0
        ask("SEQ:STOP")
        ask(f"SEQ:NEW {sequence.count},{sequence.bit_depth}")
        if self._takes_patterns:
            for index, mask in enumerate(sequence.masks):
                data = pack_mask(mask, sequence.bit_depth)
                self._link.load(index, data)
                sent += len(data)
                progress((index + 1) / sequence.count)
        times_us = (round(time_s / _US) for time_s in (sequence.exposure_s, sequence.dark_s, sequence.pause_s))
        ask("SEQ:TIME " + ",".join(map(str, times_us)))
        ask(f"SEQ:REP {sequence.repeats}")
        ask("SEQ:OUT " + next(word for word, out in _OUTS.items() if out is sequence.trigger))
        ask("SEQ:END")
        progress(1.0)
        return sent

    def _do_arm(self, sequence: PatternSequence) -> None:
        self._running = None
        self._link.ask("SEQ:STOP")
        self._require_well("SEQ:ARM")
        self._link.ask("SEQ:ARM")

    def _do_start(self, sequence: PatternSequence) -> None:
        self._started_s = self.clock.now_s()
        self._link.once("SEQ:START")
        self._running = sequence

    def _do_wait_done(self, timeout_s: float) -> None:
        asked = "wait for the end of the sequence"
        sequence = self._running
        if sequence is None:
            return
        end_s = self._started_s + sequence.duration_s
        self._wait_while(lambda: self._state()[0] is ModulatorState.RUNNING, timeout_s, asked, end_s)
        self._running = None
        self._require_well(asked)
        shown, planned = self._integers("SEQ:SHOWN?", 1)[0], sequence.count * sequence.repeats
        if shown != planned:
            raise SequenceError(
                self.name,
                asked,
                (f"{shown} masks were shown and {planned or 'endlessly many'} planned",),
                remedy="upload the sequence again and repeat",
            )

    def _do_disarm(self) -> None:
        self._running = None
        self._link.ask("SEQ:STOP")

    def _do_status(self) -> ModulatorStatus:
        state, fault = self._state()
        return ModulatorStatus(state, (fault,) if state is ModulatorState.FAULT else ())

    def _do_close(self) -> None:
        self._link.close()

    def _require_well(self, asked: str) -> None:
        state, fault = self._state()
        if state is ModulatorState.FAULT:
            raise DeviceFaultError(self.name, asked, (fault,))

    def _state(self) -> tuple[ModulatorState, str]:
        word, _, fault = self._link.ask("MOD:STATE?").partition(",")
        if word not in _STATES:
            raise BadReplyError(self.name, "MOD:STATE?", word.encode(), "no such state", allowed=", ".join(_STATES))
        return _STATES[word], fault.strip('"') or "a fault without a name"

    def _choice(self, asked: str, allowed: tuple[str, ...]) -> str:
        body = self._link.ask(asked)
        if body not in allowed:
            raise BadReplyError(self.name, asked, body.encode(), "no such value", allowed=", ".join(allowed))
        return body

    def _fields(self, asked: str, count: int | None = None) -> list[str]:
        body = self._link.ask(asked)
        fields = [field.strip() for field in body.split(",")]
        if count not in (None, len(fields)):
            raise BadReplyError(self.name, asked, body.encode(), f"{len(fields)} fields", allowed=f"{count} fields")
        return fields

    def _integers(self, asked: str, count: int | None = None) -> tuple[int, ...]:
        body = self._link.ask(asked)
        try:
            return parse_integers(body, count)
        except MalformedScpiReplyError as error:
            raise BadReplyError(self.name, asked, body.encode(), error.problem, allowed=error.allowed) from error
