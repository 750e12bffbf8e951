"""The twin of a ViALUX DMD: the functions of the ALP library, over a device in the simulated world.

It interprets its arguments with its own code. Its behaviour follows alp4lib 1.1 (ALP4.py: constants, their comments and
the passages of the maker's description that its docstrings have), olfa-lab/DmdLib (memory of 43690 binary XGA
pictures; freeing a sequence that is shown is refused) and published code (44 us per picture without dark phase, XGA):

- allocating a device sets it to its defaults; another program's allocation is ALP_NOT_READY until it is freed;
- picture data are one byte per mirror, of which binary pictures take the highest bit (ALP_DATA_MSB_ALIGN, the default);
- ALP_BIN_NORMAL has a dark phase after each picture, ALP_BIN_UNINTERRUPTED none, and the illumination time is then that
  of the picture; the mode becomes active with the next AlpSeqTiming (ViALUX's sample: "set up timing, also activating
  the ALP_BITNUM and ALP_BIN_MODE setting"), until then limits are those of before;
- a start while a sequence is shown is queued and follows without a gap, one at most;
- a gated synch output pulses for the pictures whose entry is 1, and repeats after its period; the count begins at
  each start.

Assumptions, since the sources have no figure: the dark phase takes at least 44 us; a start takes 2 ms; in uninterrupted
mode the last picture stays on the mirrors until another is shown or the device is freed (so a driver must not rely on
either). Not here: the library's binary interface (tests build a stand-in in C for that), the driver.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import U8
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.plugged import Plugged, Session
from gs2ci_sims.world import Event, World

SHORTEST_US: Final = 44
DARK_US: Final = 44
LONGEST_US: Final = 10_000_000
START_S: Final = 2e-3
UPLOAD_BYTES_S: Final = 25e6
_CALL_S: Final = 50e-6
_OK, _NOT_ONLINE, _NOT_IDLE, _NOT_AVAILABLE, _NOT_READY = 0, 1001, 1002, 1003, 1004
_INVALID, _FULL, _IN_USE, _REMOVED = 1005, 1007, 1008, 1012


@dataclass
class _Pictures:
    """A sequence in the device's memory."""

    levels: U8
    uninterrupted: bool = False
    asked: bool = False
    """Whether it was asked to be uninterrupted from the next times on."""
    illuminate_us: int = 0
    picture_us: int = 33_334
    pulse_us: int = 0
    repeats: int = 1
    settings: dict[int, int] = field(default_factory=dict)

    @property
    def shown_us(self) -> int:
        """Get how long a picture is shown."""
        if self.uninterrupted:
            return self.picture_us
        return self.illuminate_us or self.picture_us - DARK_US


class _Refused(Exception):  # noqa: N818  a code of the library's, not an error of the twin's
    """The library returns this code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class AlpTwin(Plugged["_Session"]):
    """A device with the library above it, as a `LibraryPort`.

    Args:
        world: Clock, trigger line `<name>.out`, and where masks are shown.
        faults: The faults to inject.
        name: Prefix of its trigger line.
        height: Rows.
        width: Columns.
        memory: Binary pictures that fit.
        kind: Type of its mirrors; 255 without any, where a board behaves as with 1920 x 1080 ("behaves like 1080p").
        tells_size: Whether the library knows its size ("old API versions did not support ALP_DEV_DISPLAY_WIDTH and
            _HEIGHT": ViALUX's samples).
        temperature_c: Of its board; None for a board without sensors.
    """

    def __init__(
        self,
        world: World,
        faults: FaultSet | None = None,
        *,
        name: str = "alp0",
        height: int = 768,
        width: int = 1024,
        memory: int = 43_690,
        kind: int = 4,
        tells_size: bool = True,
        temperature_c: float | None = 36.5,
    ) -> None:
        super().__init__(faults)
        self.world = world
        self.size = (1080, 1920) if kind == 255 else (height, width)
        self.kind = kind
        self.tells_size = tells_size
        self.memory = memory
        self.temperature_c = temperature_c
        self._line = f"{name}.out"
        self._event: Event | None = None
        self._reset()

    def _begin_session(self) -> "_Session":
        """Load the library, as a process does; one at a time here."""
        if self.faults.take("alp.stale"):
            self._sequences[99] = _Pictures(np.full((1, *self.size), 255, np.uint8), uninterrupted=True)
            self._begin(self._sequences[99], endless=True)
        return _Session(self)

    def _lose(self) -> None:
        """Lose pictures and settings, and go dark."""
        self._reset()

    def _closed(self) -> None:
        """React as the driver does, which frees a device that its process leaves allocated."""
        if self.allocated:
            self._end()
            self._reset()

    def _reset(self) -> None:
        self.allocated = False
        self.floating = False
        self._sequences: dict[int, _Pictures] = {}
        self._next_id = 1
        self._gate: tuple[bool, list[bool]] = (True, [])
        self._inverted = False
        self._shown: _Pictures | None = None
        self._queued: tuple[_Pictures, bool] | None = None
        if self._event:
            self._event.cancel()
        self._dark()

    def _dark(self) -> None:
        self.world.show_mask(None)
        self.world.bus.drive(self._line, not self._gate[0] if self._gate[1] else False)

    def answer(self, function: str, numbers: Sequence[int], data: bytes) -> tuple[int, int]:
        """Run a function of the library; return its code, and the number that it writes."""
        self.world.clock.sleep_s(_CALL_S)
        try:
            return _OK, self._answered(function, list(numbers), data)
        except _Refused as refused:
            return refused.code, 0

    def _answered(self, function: str, numbers: list[int], data: bytes) -> int:
        if not self.plugged:
            raise _Refused(_NOT_ONLINE if function == "AlpDevAlloc" else _REMOVED)
        refused = self.faults.take("alp.refuses", function)
        if refused:
            raise _Refused(int(refused.value or _INVALID))
        if function == "AlpDevAlloc":
            return self._allocate()
        if not self.allocated:
            raise _Refused(_NOT_AVAILABLE)
        handler = {
            "AlpDevInquire": self._inquire,
            "AlpDevControlEx": self._control_gate,
            "AlpDevHalt": self._halt,
            "AlpDevFree": self._free,
            "AlpSeqAlloc": self._seq_alloc,
            "AlpSeqFree": self._seq_free,
            "AlpSeqControl": self._seq_control,
            "AlpSeqInquire": self._seq_inquire,
            "AlpSeqTiming": self._seq_timing,
            "AlpSeqPut": self._seq_put,
            "AlpProjControl": self._proj_control,
            "AlpProjStart": self._start_once,
            "AlpProjStartCont": self._start_endless,
        }[function]
        return handler(numbers[1:], data)

    def _sequence(self, ident: int) -> _Pictures:
        if ident not in self._sequences:
            raise _Refused(_NOT_AVAILABLE)
        return self._sequences[ident]

    def _allocate(self) -> int:
        if self.allocated or self.faults.take("alp.held"):
            raise _Refused(_NOT_READY)
        self._reset()
        self.allocated = True
        return 7

    def _inquire(self, numbers: list[int], data: bytes) -> int:
        if self.faults.take("alp.floats"):
            self.floating = True
            self._end()
        used = sum(len(one.levels) for one in self._sequences.values())
        known = {
            2000: 13_579,
            2001: 0x0403,
            2002: 1102 if self._shown is None else 1100,
            2003: self.memory - used,
            2021: self.kind,
            2064: int(self.floating),
        }
        if self.tells_size:
            known |= {2057: self.size[0], 2058: self.size[1]}
        if self.temperature_c is not None:
            known |= dict.fromkeys((2050, 2051, 2052), round(self.temperature_c * 256))
        return _known(known, numbers[0])

    def _control_gate(self, numbers: list[int], data: bytes) -> int:
        if numbers[0] != 2023 or len(data) != 18:
            raise _Refused(_INVALID)
        period, polarity, entries = struct.unpack("<BB16s", data)
        if period > 16:
            raise _Refused(_INVALID)
        self._gate = (polarity == 1, [entry == 1 for entry in entries[:period]])
        if self._shown is None:
            self.world.bus.drive(self._line, not self._gate[0])
        return 0

    def _halt(self, numbers: list[int], data: bytes) -> int:
        self._end()
        return 0

    def _free(self, numbers: list[int], data: bytes) -> int:
        if self._shown is not None:
            raise _Refused(_NOT_IDLE)
        self._reset()
        return 0

    def _seq_alloc(self, numbers: list[int], data: bytes) -> int:
        bits, count = numbers
        used = sum(len(one.levels) for one in self._sequences.values())
        if bits != 1 or count < 1:
            raise _Refused(_INVALID)
        if used + count > self.memory:
            raise _Refused(_FULL)
        self._sequences[self._next_id] = _Pictures(np.zeros((count, *self.size), np.uint8))
        self._next_id += 1
        return self._next_id - 1

    def _seq_free(self, numbers: list[int], data: bytes) -> int:
        one = self._sequence(numbers[0])
        if one is self._shown:
            raise _Refused(_IN_USE)
        del self._sequences[numbers[0]]
        return 0

    def _seq_control(self, numbers: list[int], data: bytes) -> int:
        ident, kind, value = numbers
        one = self._sequence(ident)
        if kind == 2104 and value in (2105, 2106):
            one.asked = value == 2106
        elif kind == 2100 and value >= 1:
            one.repeats = value
        elif kind == 2110 and value in (0, 1):
            one.settings[kind] = value
        else:
            raise _Refused(_INVALID)
        return 0

    def _seq_inquire(self, numbers: list[int], data: bytes) -> int:
        one = self._sequence(numbers[0])
        known = {
            2200: 1,
            2201: len(one.levels),
            2203: one.picture_us,
            2204: one.shown_us,
            2211: SHORTEST_US if one.uninterrupted else SHORTEST_US + DARK_US,
            2212: SHORTEST_US,
            2213: LONGEST_US,
        }
        return _known(known, numbers[1])

    def _seq_timing(self, numbers: list[int], data: bytes) -> int:
        ident, illuminate_us, picture_us, delay_us, pulse_us, _ = numbers
        one = self._sequence(ident)
        one.uninterrupted = one.asked
        if picture_us == 0:
            picture_us = illuminate_us + (0 if one.uninterrupted else DARK_US) if illuminate_us else 33_334
        longest_us = picture_us - (0 if one.uninterrupted else DARK_US)
        shortest_us = SHORTEST_US if one.uninterrupted else SHORTEST_US + DARK_US
        if not shortest_us <= picture_us <= LONGEST_US or illuminate_us > longest_us or delay_us:
            raise _Refused(_INVALID)
        one.illuminate_us, one.picture_us, one.pulse_us = illuminate_us, picture_us, pulse_us or longest_us
        return 0

    def _seq_put(self, numbers: list[int], data: bytes) -> int:
        ident, offset, load = numbers
        one = self._sequence(ident)
        if one is self._shown:
            raise _Refused(_IN_USE)
        pictures = np.frombuffer(data, np.uint8).reshape(-1, *self.size)
        if len(pictures) != load or offset + load > len(one.levels):
            raise _Refused(_INVALID)
        bit = 1 if one.settings.get(2110) == 1 else 0x80
        one.levels[offset : offset + load] = (pictures & bit) != 0
        self.world.clock.sleep_s(pictures.size / 8 / UPLOAD_BYTES_S + 1e-3)
        return 0

    def _proj_control(self, numbers: list[int], data: bytes) -> int:
        if numbers[0] != 2306:
            raise _Refused(_INVALID)
        self._inverted = numbers[1] != 0
        return 0

    def _start_once(self, numbers: list[int], data: bytes) -> int:
        return self._start(numbers[0], endless=False)

    def _start_endless(self, numbers: list[int], data: bytes) -> int:
        return self._start(numbers[0], endless=True)

    def _start(self, ident: int, *, endless: bool) -> int:
        one = self._sequence(ident)
        if self._shown is not None:
            self._queued = (one, endless)
        else:
            self._begin(one, endless=endless)
        return 0

    def _begin(self, one: _Pictures, *, endless: bool) -> None:
        self._shown = one
        self._event = self.world.clock.after(START_S, lambda: self._show(one, 0, endless))

    def _show(self, one: _Pictures, index: int, endless: bool) -> None:
        total = len(one.levels) * one.repeats
        if (index >= total and not endless) or self.faults.take("alp.stops_early"):
            self._follow()
            return
        levels = one.levels[index % len(one.levels)]
        levels = levels ^ 1 if self._inverted else levels
        self.world.show_mask(levels if levels.any() else None, 1)
        high, entries = self._gate
        if entries and entries[index % len(entries)] and not self.faults.take("alp.pulse_lost"):
            self.world.bus.pulse(self._line, one.pulse_us * 1e-6, level=high)
        if not one.uninterrupted:
            self.world.clock.after(one.shown_us * 1e-6, lambda: self._darken(one))
        self._event = self.world.clock.after(one.picture_us * 1e-6, lambda: self._show(one, index + 1, endless))

    def _darken(self, one: _Pictures) -> None:
        if self._shown is one:
            self.world.show_mask(None)

    def _follow(self) -> None:
        """Go on with the sequence that waits, or stay as it is."""
        if self._queued is None:
            self._shown = None
            return
        (one, endless), self._queued = self._queued, None
        self._shown = one
        self._show(one, 0, endless)

    def _end(self) -> None:
        """Halt: in normal mode the mirrors go dark, in uninterrupted mode the picture stays."""
        if self._event:
            self._event.cancel()
        if self._shown is not None and not self._shown.uninterrupted:
            self.world.show_mask(None)
        self._shown = self._queued = None


def _known(told: Mapping[int, int], kind: int) -> int:
    if kind not in told:
        raise _Refused(_INVALID)
    return told[kind]


class _Session(Session[AlpTwin]):
    """The library in one process: a `LibraryPort`."""

    what = "library"

    def call(self, function: str, numbers: Sequence[int], data: bytes = b"") -> int:
        """Call a function."""
        return self._answer(function, numbers, data)[0]

    def ask(self, function: str, numbers: Sequence[int]) -> tuple[int, int]:
        """Call a function that writes a number."""
        return self._answer(function, numbers, b"")

    def _answer(self, function: str, numbers: Sequence[int], data: bytes) -> tuple[int, int]:
        self._require_open()
        return self._twin.answer(function, numbers, data)


def simulated(world: World, settings: Any) -> AlpTwin:
    """Build the twin that a rig file describes: a 0.7" XGA."""
    return AlpTwin(world, world.stated.faults["modulator"], name="modulator")
