"""An Arduino that lights 12 x 16 lamps, opens a shutter and triggers the camera, as a `Modulator`.

The protocol is the firmware's (`firmware/lamp_array.ino`): lines of text, one reply to each.

    ?                               lamp-array 1 SERIAL
    L COUNT EXPOSURE DARK PAUSE REPEATS OUT   ok      times in us; OUT is NONE, EXPOSURE, GATE or MASK
    M INDEX HEX                     ok                a mask, rows of 16 bits, the leftmost lamp the highest bit
    A                               ok                armed: the shutter opens
    G                               ok                runs, within 1 ms of this line
    S                               ok                stopped and dark, the shutter closed; any time
    Q                               STATE SHOWN       idle, loaded, armed or running; masks shown since G

Whatever it refuses it answers with `no REASON`. Here: the order of lines. Not here: bytes on the line (pyserial), masks
and their timing (gs2ci).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import U8, U16
from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import BadReplyError, RefusedError, SequenceError, UnsupportedError
from gs2ci_drivers.lines import LineChannel
from gs2ci_drivers.modulator import Modulator, ModulatorState, ModulatorStatus, UploadProgress
from gs2ci_drivers.pattern_sequence import ModulatorInfo, PatternSequence, TriggerOut
from gs2ci_drivers.ports import BytePort
from gs2ci_lamp_array.settings import LampArrayOptions

ROWS: Final = 12
COLUMNS: Final = 16
CAPACITY: Final = 32
_US: Final = 1e-6
_START_S: Final = 1e-3
_OUTS: Final = {
    TriggerOut.NONE: "NONE",
    TriggerOut.PER_EXPOSURE: "EXPOSURE",
    TriggerOut.GATE: "GATE",
    TriggerOut.PER_MASK: "MASK",
}
_LINE_BYTES: Final = 110
_EXCHANGE_S: Final = 2e-3


class LampArray(Modulator):
    """The lamps behind an Arduino."""

    def __init__(self, name: str, port: BytePort, clock: Clock, settings: LampArrayOptions | None = None) -> None:
        super().__init__(name, clock)
        self.settings = settings or LampArrayOptions()
        self._lines = LineChannel(name, port, clock)
        self._running: PatternSequence | None = None
        self._started_s = 0.0

    def _do_connect(self) -> ModulatorInfo:
        said = self._ask("?").split()
        if said[:2] != ["lamp-array", "1"] or len(said) != 3:
            raise UnsupportedError(self.name, f"firmware {' '.join(said)!r}", asked="?", allowed="lamp-array 1 SERIAL")
        return ModulatorInfo(
            model="lamp array",
            serial=said[2],
            firmware=said[1],
            height=ROWS,
            width=COLUMNS,
            pitch_m=10e-3,
            min_exposure_s={1: 500e-6},
            max_exposure_s=10.0,
            exposure_step_s=_US,
            min_dark_s=_US,
            capacity={1: CAPACITY},
            trigger_outs=frozenset(_OUTS),
            start_latency_s=_START_S + 2 * self._exchange_s(),
            typical_start_s=_START_S,
        )

    def _do_status(self) -> ModulatorStatus:
        return ModulatorStatus(self._state()[0])

    def _do_close(self) -> None:
        self._lines.close()

    def _do_upload_eta_s(self, sequence: PatternSequence) -> float:
        return sequence.count * _LINE_BYTES * 10 / self.settings.baud + (sequence.count + 2) * self._exchange_s()

    def _do_upload(self, sequence: PatternSequence, progress: UploadProgress) -> int:
        self._running, sent = None, 0
        self._ask("S")
        times_us = [round(time_s / _US) for time_s in (sequence.exposure_s, sequence.dark_s, sequence.pause_s)]
        told = [sequence.count, *times_us, sequence.repeats, _OUTS[sequence.trigger]]
        self._ask(" ".join(["L", *map(str, told)]))
        for index, mask in enumerate(sequence.masks):
            data = packed(mask)
            self._ask(f"M {index} {data.hex()}")
            sent += len(data)
            progress((index + 1) / sequence.count)
        return sent

    def _do_arm(self, sequence: PatternSequence) -> None:
        self._running = None
        self._ask("S")
        self._ask("A")

    def _do_start(self, sequence: PatternSequence) -> None:
        self._started_s = self.clock.now_s()
        self._ask("G")
        self._running = sequence

    def _do_wait_done(self, timeout_s: float) -> None:
        sequence, asked = self._running, "wait for the end of the sequence"
        if sequence is None:
            return
        end_s = self._started_s + sequence.duration_s
        self._wait_while(lambda: self._state()[0] is ModulatorState.RUNNING, timeout_s, asked, end_s)
        self._running = None
        shown, planned = self._state()[1], sequence.count * sequence.repeats
        if shown != planned:
            raise SequenceError(self.name, asked, (f"{shown} masks were shown and {planned} planned",))

    def _do_disarm(self) -> None:
        self._running = None
        self._ask("S")

    def _state(self) -> tuple[ModulatorState, int]:
        said = self._ask("Q")
        word, _, shown = said.partition(" ")
        try:
            return ModulatorState(word), int(shown)
        except ValueError as error:
            raise BadReplyError(self.name, "Q", said.encode(), "no state", allowed="STATE SHOWN") from error

    def _ask(self, line: str) -> str:
        """Send a line and return its reply.

        Raises:
            NoAnswerError: None came in time.
            RefusedError: The firmware says no.
            DisconnectedError: The port is gone.
        """
        self._lines.drain(line)  # an answer of an earlier session is nobody's
        self._lines.send(line.encode("ascii") + b"\n", line)
        reply = self._lines.line(self.clock.now_s() + self.settings.timeout_s, line).decode("ascii", "replace")
        if reply.startswith("no "):
            raise RefusedError(self.name, line, "no", reply[3:])
        return reply

    def _exchange_s(self) -> float:
        return 20 * 10 / self.settings.baud + _EXCHANGE_S


def packed(mask: U8 | U16) -> bytes:
    """Pack a mask, [12, 16] of 0 and 1, into two bytes a row, the leftmost lamp first."""
    return np.packbits(mask.astype(np.uint8), axis=1).tobytes()
