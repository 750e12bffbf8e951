"""The twin of a modulator with the open SCPI-style protocol: the protocol's reference device.

Here: lines, blocks, error queue, the sequence's states (docs/scpi-modulator.md). Not here: bytes on the line
(`serial_twin`), pixels (`panel`). It shares no code with the driver.
"""

import binascii
import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import reduce
from operator import xor
from typing import Any, Final

import numpy as np

from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.panel import Levels, Out, Panel, Show
from gs2ci_sims.wires.serial_twin import SerialTwin
from gs2ci_sims.world import World

QUIET_S: Final = 0.5
START_LATENCY_US: Final = 1000
_QUEUE: Final = 16
_TEXTS: Final = {
    0: "No error",
    -102: "Syntax error",
    -113: "Undefined header",
    -160: "Block data error",
    -200: "Execution error",
    -221: "Settings conflict",
    -222: "Data out of range",
    -240: "Hardware error",
    -350: "Queue overflow",
    -363: "Input buffer overrun",
}
_BLOCK: Final = re.compile(rb"\s*(?:@(\d{1,3}) )?SEQ:DATA (\d+),([0-9A-Fa-f]{8}),#(\d)(\d*)", re.IGNORECASE)
_LONGEST_LINE: Final = 128


class CommandError(Exception):
    """The device refuses a command, with an SCPI code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


@dataclass(frozen=True)
class ScpiPanel:
    """The device's data sheet.

    Args:
        height: Rows.
        width: Columns.
        shortest_us: Shortest exposure by bit depth.
        capacity: Most masks.
        response_s: Time constant of the pixels.
        built_in: Masks that are fixed in the device (a moving mask), [N, H, W]; None takes patterns.
    """

    height: int = 300
    width: int = 400
    shortest_us: dict[int, int] = field(default_factory=lambda: {1: 250, 8: 2000})
    capacity: int = 64
    response_s: float = 0.0
    built_in: Levels | None = None


class ScpiModulatorTwin(SerialTwin):
    """The device.

    Args:
        world: Clock, trigger line `<name>.out`, and where masks are shown.
        faults: The faults to inject.
        name: Prefix of its trigger line.
        panel: Its data sheet.
        baud: Bits per second.
    """

    def __init__(
        self,
        world: World,
        faults: FaultSet | None = None,
        *,
        name: str = "lcos0",
        panel: ScpiPanel | None = None,
        baud: int = 115200,
    ) -> None:
        super().__init__(world.clock, faults, baud)
        self.model = panel or ScpiPanel()
        self.panel = Panel(world, f"{name}.out", self.faults, self.model.response_s)
        self._input = bytearray()
        self._last_byte_s = 0.0
        self._skips_until_quiet = False
        self._errors: deque[int] = deque()
        self._commands: dict[str, Callable[[str], str | None]] = {
            "*IDN?": lambda _: "GS2CI,SCPI-TWIN,0001,1.0",
            "*CLS": self._clear_errors,
            "*TRG": self._start,
            "SYST:VERS?": lambda _: "GS2CI-MOD,1",
            "SYST:ERR?": self._next_error,
            "MOD:KIND?": lambda _: "PATTERNS" if self.model.built_in is None else "FIXED",
            "MOD:SIZE?": lambda _: f"{self.model.height},{self.model.width}",
            "MOD:PITCH?": lambda _: "8000",
            "MOD:DEPTHS?": lambda _: ",".join(map(str, self.model.shortest_us)),
            "MOD:MIN?": lambda bits: str(self.model.shortest_us[self._depth(bits)]),
            "MOD:MAX?": lambda _: "10000000",
            "MOD:STEP?": lambda _: "1",
            "MOD:DARK?": lambda _: "1",
            "MOD:CAP?": self._capacity,
            "MOD:OUTS?": lambda _: "NONE,EXPOSURE,GATE,MASK",
            "MOD:DELAY?": lambda _: "0",
            "MOD:LATENCY?": lambda _: str(START_LATENCY_US),
            "MOD:STATE?": self._state,
            "SEQ:NEW": self._new,
            "SEQ:TIME": self._time,
            "SEQ:REP": self._repeats,
            "SEQ:OUT": self._out,
            "SEQ:END": self._end,
            "SEQ:ARM": self._arm,
            "SEQ:START": self._start,
            "SEQ:STOP": self._stop,
            "SEQ:SHOWN?": lambda _: str(self.panel.shown),
        }
        self._restart()

    @property
    def terminators(self) -> bytes:
        """Get the line feed."""
        return b"\n"

    def power_cycle(self) -> None:
        """Cut the power for a moment: the port disappears, patterns are lost."""
        self.unplug()
        self._restart()

    def _restart(self) -> None:
        self.panel.stop()
        self.fault = ""
        self._armed = self._complete = False
        self._count, self._bits = 0, 1
        self._masks: dict[int, Levels] = {}
        self._times_us = (0, 0, 0)
        self._passes = 1
        self._line_mode = Out.NONE
        self._input.clear()
        self._errors.clear()

    def _stale(self) -> bytes:
        return self._framed(999, "RUNNING")

    def _receive(self, data: bytes) -> None:
        """Collect lines and blocks; an unfinished one is dropped after half a second of silence."""
        now_s = self.clock.now_s()
        if now_s - self._last_byte_s > QUIET_S:
            if self._input:
                self._note(-363)
            self._input.clear()
            self._skips_until_quiet = False
        self._last_byte_s = now_s
        if self._skips_until_quiet:
            return
        self._input += data
        while self._take_one():
            pass

    def _take_one(self) -> bool:
        """Handle the first complete line or block; return whether there was one."""
        block = _BLOCK.match(self._input)
        if block and len(block[5]) >= int(block[4]):
            return self._take_block(block)
        end = self._input.find(b"\n")
        if end < 0:
            if not block and len(self._input) > _LONGEST_LINE:
                self._lose_track(None, -363)
            return False
        line = bytes(self._input[:end])
        del self._input[: end + 1]
        if not self.faults.take("serial.request_lost", line.decode("ascii", "replace")):
            self._line(line)
        return True

    def _take_block(self, block: re.Match[bytes]) -> bool:
        tag = int(block[1]) if block[1] else None
        # The groups are read first, because the match refers to the buffer that is cut below.
        index, expected = int(block[2]), int(block[3], 16)
        digits = int(block[4])
        length = int(block[5][:digits]) if digits else -1
        if length != self._mask_bytes() or not self._count:
            self._lose_track(tag, -160 if self._count else -221)
            return False
        begin = block.start(5) + digits
        if len(self._input) <= begin + length:
            return False
        data = bytes(self._input[begin : begin + length])
        end = self._input[begin + length]
        if self.faults.take("scpi.block_short"):
            data, end = data[1:] + bytes([end]), 0
        if self.faults.take("scpi.block_spoilt"):
            data = bytes([data[0] ^ 0x10]) + data[1:]
        if end != ord("\n"):
            self._lose_track(tag, -160)
            return False
        del self._input[: begin + length + 1]
        self._answer(tag, "SEQ:DATA", lambda: self._store(index, expected, data))
        return True

    def _lose_track(self, tag: int | None, code: int) -> None:
        """Ignore everything up to the next silence, because the begin of lines is unknown."""
        self._input.clear()
        self._skips_until_quiet = True

        def refuse() -> None:
            raise CommandError(code)

        self._answer(tag, "SEQ:DATA", refuse)

    def _line(self, line: bytes) -> None:
        text = line.decode("ascii", "replace").strip()
        if not text:
            return
        tag = None
        if text.startswith("@"):
            match = re.fullmatch(r"@((\d{1,3}) (.*))\*([0-9A-F]{2})", text)
            if not match or reduce(xor, match[1].encode("ascii", "replace"), 0) != int(match[4], 16):
                self._note(-102)
                return
            tag, text = int(match[2]), match[3]
        head, _, argument = text.partition(" ")
        self._answer(tag, text, lambda: self._execute(head.upper(), argument.strip()))

    def _execute(self, head: str, argument: str) -> str | None:
        if head not in self._commands:
            raise CommandError(-113)
        return self._commands[head](argument)

    def _answer(self, tag: int | None, about: str, action: Callable[[], str | None]) -> None:
        if self.faults.take("scpi.restarts", about):
            self._restart()
        if self.faults.take("scpi.fault", about):
            self.fault = "over-temperature"
        try:
            refusal = self.faults.take("scpi.refuses", about)
            if refusal:
                raise CommandError(int(refusal.value) or -200)
            body = action()
        except CommandError as error:
            self._note(error.code)
            body = "ERR" if tag is not None else None
        if tag is not None:
            self._reply(self._framed(tag, "OK" if body is None else body), about)
        elif body is not None:
            self._reply(body.encode("ascii") + b"\n", about)

    def _framed(self, tag: int, body: str) -> bytes:
        text = f"{tag} {body}".encode("ascii")
        return b"@" + text + b"*%02X\n" % reduce(xor, text, 0)

    def _note(self, code: int) -> None:
        if len(self._errors) >= _QUEUE:
            self._errors[-1] = -350
        else:
            self._errors.append(code)

    def _next_error(self, _: str) -> str:
        code = self._errors.popleft() if self._errors else 0
        return f'{code},"{_TEXTS.get(code, "Device error")}"'

    def _clear_errors(self, _: str) -> None:
        self._errors.clear()

    def _numbers(self, argument: str, count: int) -> list[int]:
        fields = argument.split(",")
        if len(fields) != count or not all(field.strip().isdigit() for field in fields):
            raise CommandError(-102)
        return [int(field) for field in fields]

    def _depth(self, argument: str) -> int:
        (bits,) = self._numbers(argument, 1)
        if bits not in self.model.shortest_us:
            raise CommandError(-222)
        return bits

    def _capacity(self, argument: str) -> str:
        self._depth(argument)
        return str(self.model.capacity if self.model.built_in is None else len(self.model.built_in))

    def _mask_bytes(self) -> int:
        pixel_bits = 1 if self._bits == 1 else 8 if self._bits <= 8 else 16
        return self.model.height * -(-self.model.width * pixel_bits // 8)

    def _require(self, condition: bool, code: int = -221) -> None:
        if not condition:
            raise CommandError(code)

    def _state(self, _: str) -> str:
        if self.fault:
            return f'FAULT,"{self.fault}"'
        if self.panel.running:
            return "RUNNING"
        return "ARMED" if self._armed else "LOADED" if self._complete else "IDLE"

    def _new(self, argument: str) -> None:
        count, bits = self._numbers(argument, 2)
        self._require(not self.panel.running)
        self._depth(str(bits))
        self._require(1 <= count <= int(self._capacity(str(bits))), -222)
        self._count, self._bits = count, bits
        self._masks.clear()
        self._complete = self._armed = False
        self._times_us = (0, 0, 0)

    def _store(self, index: int, expected: int, data: bytes) -> None:
        self._require(self.model.built_in is None and not self.panel.running)
        self._require(index < self._count, -222)
        self._require(binascii.crc32(b"%d:" % index + data) == expected, -160)
        height, width = self.model.height, self.model.width
        if self._bits == 1:
            rows = np.frombuffer(data, np.uint8).reshape(height, -1)
            columns = np.arange(width)
            self._masks[index] = (rows[:, columns >> 3] >> (7 - (columns & 7)) & 1).astype(np.uint8)
        else:
            pixels = np.frombuffer(data, np.uint8).reshape(height, width, -1)
            levels: Levels = pixels[..., 0]
            if self._bits > 8:
                levels = pixels[..., 0] + pixels[..., 1] * np.uint16(256)
            self._require(int(levels.max()) < 1 << self._bits, -222)
            self._masks[index] = levels
        self._complete = self._armed = False

    def _time(self, argument: str) -> None:
        exposure, dark, pause = self._numbers(argument, 3)
        self._require(bool(self._count))
        self._require(exposure >= self.model.shortest_us[self._bits] and max(exposure, dark, pause) <= 10**7, -222)
        self._times_us = (exposure, dark, pause)

    def _repeats(self, argument: str) -> None:
        (self._passes,) = self._numbers(argument, 1)

    def _out(self, argument: str) -> None:
        self._require(argument in Out.__members__, -222)
        self._line_mode = Out[argument]

    def _end(self, _: str) -> None:
        built_in = self.model.built_in
        if built_in is not None:
            self._masks = {index: built_in[index] for index in range(self._count)}
        self._require(self._count > 0 and len(self._masks) == self._count and self._times_us[0] > 0)
        self._complete = True

    def _arm(self, _: str) -> None:
        self._require(not self.fault, -240)
        self._require(self._complete and not self.panel.running)
        self._armed = True

    def _start(self, _: str) -> None:
        self._require(not self.fault, -240)
        self._require(self._armed)
        self._armed = False
        exposure_s, dark_s, pause_s = (time_us * 1e-6 for time_us in self._times_us)
        masks = [self._masks[index] for index in range(self._count)]
        top = (1 << self._bits) - 1
        show = Show(masks, top, exposure_s, dark_s, pause_s, self._passes, self._line_mode)
        self.panel.play(show, START_LATENCY_US * 1e-6)

    def _stop(self, _: str) -> None:
        self._armed = False
        self.panel.stop()


def simulated(world: World, settings: Any) -> ScpiModulatorTwin:
    """Build the twin that a rig file's [modulator] describes."""
    return ScpiModulatorTwin(world, world.stated.faults["modulator"], name="modulator", baud=settings.baud)
