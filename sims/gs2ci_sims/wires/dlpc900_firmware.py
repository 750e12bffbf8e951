"""What the DLPC900's commands do: modes, sequence table, image memory, status and error registers.

Here: the state machine off → standby or normal; video, flash, video-pattern or on-the-fly; empty → table → configured →
loading → ready → running ⇄ paused. Not here: reports (`dlpc900`), image codings (`dlpc900_images`), time
(`dlpc900_sequencer`). The numbers are those of the programmer's guide, entered independently of the driver; those of
the least exposures (0x1A42) and the least LED pulse (0x1A43, in 0.01 us) are TI's host library's (RhojAnn/DLPC900_CLI
e19b3c7, lib/API.c: LCR_GetMinPatExposure, LCR_SetMinLEDPulseWidth). By how much a pulse lengthens them is assumed: each
bit plane is on for one at least.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import U8, U16, U32
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.dlpc900_images import BadImageError, read_image
from gs2ci_sims.wires.dlpc900_lamp import FULL, Lamp, light_of
from gs2ci_sims.wires.dlpc900_sequencer import Output, Sequencer, Step
from gs2ci_sims.wires.dlpc900_tables import ERROR_TEXT, MIRRORS
from gs2ci_sims.world import World

_ON_THE_FLY: Final = 3
_SETTLE_S: Final = 3.0


class Refusal(Exception):  # noqa: N818 - a refusal is the firmware's ordinary answer, not an error of ours
    """The firmware refuses a command with an error code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


@dataclass(frozen=True)
class Entry:
    """One entry of the sequence table, read from its 12 bytes."""

    exposure_us: int
    dark_us: int
    depth: int
    image: int
    bit: int
    waits: bool
    suppresses_out_2: bool


@dataclass
class Loading:
    """An image that is being loaded into memory."""

    image: int
    total: int
    received: bytearray


class Firmware:
    """Commands and memory of one controller.

    Args:
        world: Where masks are shown.
        faults: The faults to inject.
        name: Prefix of its trigger lines.
        dmd: Type of the mirrors.
        counts_repeats: Whether the count of 0x1A31 counts repeats.
        bit_enables: Whether bit 0 of an entry's byte 9 enables the pulse of trigger output 2.
    """

    def __init__(
        self, world: World, faults: FaultSet, *, name: str, dmd: int, counts_repeats: bool, bit_enables: bool
    ) -> None:
        self.world = world
        self.faults = faults
        self.dmd = dmd
        self.mirrors = MIRRORS[dmd]
        self.counts_repeats = counts_repeats
        self.bit_enables = bit_enables
        self.sequencer = Sequencer(world, name, faults)
        self._reads: dict[int, Callable[[], bytes]] = {
            0x0100: self._read_error,
            0x0101: lambda: ERROR_TEXT.get(self._told, "Internal Error").encode().ljust(128, b"\0"),
            0x0205: lambda: bytes.fromhex("01000206 00000002 05000300 00000104"),
            0x0206: lambda: bytes([self.dmd]) + b"GS2CI-TWIN".ljust(32, b"\0"),
            0x1A0A: self._read_hardware_status,
            0x1A0B: lambda: b"\x01",
            0x1A0C: self._read_main_status,
            0x1A42: self._read_least_exposures,
        }
        self._writes: dict[int, Callable[[bytes], None]] = {
            0x0200: self._write_power,
            0x0201: self._write_idle,
            0x1008: lambda data: _require(len(data) == 1 and data[0] <= 1, 6),
            0x1009: lambda data: _require(len(data) == 1 and data[0] <= 1, 6),
            0x1A07: lambda data: _require(len(data) == 1, 6),
            0x1A1B: self._write_mode,
            0x1A1D: lambda data: self._write_output(0, data),
            0x1A1E: lambda data: self._write_output(1, data),
            0x1A24: self._write_control,
            0x1A2A: lambda data: self._begin_image(0, data),
            0x1A2B: lambda data: self._take_image_data(0, data),
            0x1A2C: lambda data: self._begin_image(1, data),
            0x1A2D: lambda data: self._take_image_data(1, data),
            0x1A30: self._write_invert,
            0x1A31: self._write_config,
            0x1A34: self._write_entry,
            0x1A35: self._write_trigger_in_1,
            0x1A36: lambda data: _require(len(data) == 1, 6),
            0x1A40: self._write_blocks,
            0x1A43: lambda data: _require(len(data) == 4, 6),
        }
        self.lamp: Lamp = "switched"
        self.reset()

    def reset(self) -> None:
        """Return to the state after power-on: video mode, empty memory."""
        self.sequencer.stop()
        self.sequencer.aborted = False
        self.sequencer.outputs = [Output(), Output()]
        self.parked = False
        self.table: dict[int, Entry] = {}
        self.images: tuple[dict[int, U32], ...] = ({}, {})
        self.secondary = True
        """Whether the second of two controllers answers."""
        self._planes: dict[tuple[int, int, int], U8] = {}
        self._loading: list[Loading | None] = [None, None]
        self._entries = 0
        self._count = 0
        self._error = self._told = 0
        self._idle_since_s = 0.0
        self._awake_from_s = 0.0
        self._settings: dict[int, bytes] = {
            0x0200: b"\0",
            0x0201: b"\0",
            0x1008: b"\0",
            0x1009: b"\0",
            0x1A07: b"\x08",
            0x1A1B: b"\0",
            0x1A1D: bytes(5),
            0x1A1E: bytes(5),
            0x1A30: b"\0",
            0x1A31: bytes(6),
            0x1A35: b"\x69\0\0",
            0x1A36: b"\0",
            # Start block and number of blocks (DLPU018, table 2-101); after a reset all of them.
            0x1A40: bytes([0, self.mirrors.blocks]),
            0x1A43: bytes(4),
        }

    def note_error(self, code: int) -> None:
        """Set the error register; the first code stays until it is read."""
        self._error = self._error or code

    def read(self, number: int) -> bytes:
        """Return a register.

        Raises:
            Refusal: The register does not exist.
        """
        if self.faults.take("dlpc900.standby"):
            self._settings[0x0200] = b"\x01"
        if number in self._reads:
            return self._reads[number]()
        if number in self._settings:
            return self._settings[number]
        raise Refusal(3)

    def write(self, number: int, data: bytes) -> bytes:
        """Execute a command; return the empty payload of its acknowledgement.

        Raises:
            Refusal: Unknown, malformed, out of range, or not in this state.
        """
        if number not in self._writes:
            raise Refusal(3)
        asleep = self._settings[0x0200] == b"\x01" or self.world.clock.now_s() < self._awake_from_s
        if asleep and number != 0x0200:
            raise Refusal(5)
        if number not in (0x1A2B, 0x1A2D):
            self._require_images_whole()
        self._writes[number](data)
        if number in self._settings:
            self._settings[number] = data
        return b""

    def _require_images_whole(self) -> None:
        """Refuse a command while an image still lacks bytes; this ends the load."""
        if any(self._loading):
            self._loading = [None, None]
            raise Refusal(9)

    def _read_error(self) -> bytes:
        self._told, self._error = self._error, 0
        return bytes([self._told])

    def _read_hardware_status(self) -> bytes:
        if self.mirrors.dual and self.faults.take("dlpc900.secondary_silent"):
            self.secondary = False
            self._planes.clear()
        dual = self.mirrors.dual and self.secondary
        return bytes([1 | (0x10 if dual else 0) | (0x40 if self.sequencer.aborted else 0)])

    def _read_main_status(self) -> bytes:
        if self.faults.take("dlpc900.parked"):
            self.parked = True
            self.world.show_mask(None)
        return bytes([int(self.parked) | int(self.sequencer.running) << 1])

    def _write_power(self, data: bytes) -> None:
        _require(len(data) == 1 and data[0] in (0, 1), 6)
        if data[0] == 1:
            self.sequencer.stop()
        elif self._settings[0x0200] == b"\x01":
            self._awake_from_s = self.world.clock.now_s() + _SETTLE_S
        self.parked = data[0] == 1

    def _write_idle(self, data: bytes) -> None:
        _require(len(data) == 1 and data[0] in (0, 1), 6)
        now_s = self.world.clock.now_s()
        if data[0]:
            # Only while the sequence is stopped, and not in video mode (DLPU018, DMD idle mode).
            _require(not self.sequencer.running and self._settings[0x1A1B] != b"\0", 5)
            self._idle_since_s = now_s
        else:
            _require(self._settings[0x0201] == b"\0" or now_s - self._idle_since_s >= _SETTLE_S, 5)

    def _write_mode(self, data: bytes) -> None:
        _require(len(data) == 1 and data[0] <= _ON_THE_FLY, 6)
        _require(not self.sequencer.running and self._settings[0x0201] == b"\0", 5)
        self.sequencer.aborted = False

    def _write_output(self, output: int, data: bytes) -> None:
        _require(len(data) == 5 and data[0] <= 1, 6)
        rise, fall = (int.from_bytes(data[at : at + 2], "little", signed=True) for at in (1, 3))
        _require(-20 <= rise <= 20000 and -20 <= fall <= 20000 and (data[0] == 1 or rise <= fall), 13)
        self.sequencer.configure(output, Output(bool(data[0]), rise * 1e-6, fall * 1e-6))

    def _write_trigger_in_1(self, data: bytes) -> None:
        delay_us = int.from_bytes(data[:2], "little")
        _require(len(data) == 3 and delay_us >= 104, 6)
        self.sequencer.trigger_in_delay_s = delay_us * 1e-6

    def _write_invert(self, data: bytes) -> None:
        _require(len(data) == 1, 6)
        self.table.clear()

    def _write_blocks(self, data: bytes) -> None:
        _require(len(data) == 2 and data[1] >= 1 and data[0] + data[1] <= self.mirrors.blocks, 6)

    def _shortest_us(self, depth: int) -> int:
        _, blocks = self._settings[0x1A40]
        pulses_us = ((1 << depth) - 1) * int.from_bytes(self._settings[0x1A43], "little") // 100
        if depth == 1 and blocks < self.mirrors.blocks:
            return max(self.mirrors.block_us[blocks - 1], pulses_us)
        return max(self.mirrors.shortest_us[depth - 1], pulses_us)

    def _read_least_exposures(self) -> bytes:
        times_us = [min(self._shortest_us(depth), 0xFFFF) for depth in range(1, 9)]
        return b"".join(time_us.to_bytes(2, "little") for time_us in times_us) + bytes(16)

    def _write_entry(self, data: bytes) -> None:
        _require(len(data) == 12, 6)
        _require(self._settings[0x1A1B] != b"\0" and not self.sequencer.running, 5)
        index = data[0] | data[1] << 8
        entry = Entry(
            exposure_us=data[2] | data[3] << 8 | data[4] << 16,
            dark_us=data[6] | data[7] << 8 | data[8] << 16,
            depth=((data[5] & 0x0E) >> 1) + 1,
            image=data[10] | (data[11] & 0x07) << 8,
            bit=data[11] >> 3,
            waits=bool(data[5] & 0x80),
            suppresses_out_2=bool(data[9] & 0x01) != self.bit_enables,
        )
        _require(index < self.mirrors.entries, 15)
        _require(entry.bit + entry.depth <= 24, 10)
        _require(entry.exposure_us >= self._shortest_us(entry.depth), 14)
        _require(entry.image < 18, 17)
        before = self.table.get(index)
        if before and (before.image, before.bit) != (entry.image, entry.bit):
            self._lose_images()
        self.table[index] = entry

    def _write_config(self, data: bytes) -> None:
        _require(len(data) == 6, 6)
        _require(self._settings[0x1A1B] != b"\0" and not self.sequencer.running, 5)
        entries = data[0] | data[1] << 8
        _require(1 <= entries <= self.mirrors.entries, 15)
        _require(all(index in self.table for index in range(entries)), 16)
        if entries != self._entries:
            self._lose_images()
        self._entries = entries
        self._count = int.from_bytes(data[2:6], "little")

    def _lose_images(self) -> None:
        for memory in self.images:
            memory.clear()
        self._planes.clear()

    def _begin_image(self, controller: int, data: bytes) -> None:
        _require(len(data) == 6 and (controller == 0 or self.mirrors.dual), 6)
        _require(controller == 0 or self.secondary, 2)
        _require(self._settings[0x1A1B] == bytes([_ON_THE_FLY]) and not self.sequencer.running, 5)
        _require(self._entries > 0, 16)
        image, total = int.from_bytes(data[0:2], "little"), int.from_bytes(data[2:6], "little")
        _require(image < 18 and total > 48, 6)
        # Images must come from the last to the first.
        memory = self.images[controller]
        wanted = {self.table[index].image for index in range(self._entries)}
        _require(all(later in memory for later in wanted if later > image), 17)
        self._planes.clear()
        memory.pop(image, None)
        self._loading[controller] = Loading(image, total, bytearray())

    def _take_image_data(self, controller: int, data: bytes) -> None:
        loading = self._loading[controller]
        size = int.from_bytes(data[:2], "little")
        if loading is None or size != len(data) - 2 or len(loading.received) + size > loading.total:
            self._loading[controller] = None
            raise Refusal(9)
        loading.received += data[2:]
        if len(loading.received) == loading.total:
            self._loading[controller] = None
            width = self.mirrors.width // 2 if self.mirrors.dual else self.mirrors.width
            try:
                words = read_image(bytes(loading.received), width, self.mirrors.height)
            except BadImageError as error:
                raise Refusal(9) from error
            self.images[controller][loading.image] = self._flipped(words)

    def _flipped(self, words: U32) -> U32:
        """Return an image, [H, W], as it is loaded: flips take effect with the next load (API.c of TI's GUI)."""
        rows, columns = (-1 if self._settings.get(axis) == b"\1" else 1 for axis in (0x1008, 0x1009))
        return words[::rows, ::columns]

    def _write_control(self, data: bytes) -> None:
        _require(len(data) == 1 and data[0] <= 2, 6)
        _require(self._settings[0x1A1B] != b"\0", 5)
        if data[0] == 0 and not self.faults.take("dlpc900.ignores_stop"):
            self.sequencer.stop()
        elif data[0] == 1:
            self.sequencer.pause()
        elif data[0] == 2:
            self._start()

    def _start(self) -> None:
        _require(not self.sequencer.running and self._settings[0x0201] == b"\0", 5)
        if self.faults.take("dlpc900.forgets_images"):
            self._lose_images()
        entries = [self.table.get(index) for index in range(self._entries)]
        _require(bool(entries), 16)
        steps = [self._step(entry) for entry in entries if entry]
        _require(len(steps) == len(entries), 16)
        self.sequencer.start(steps, self._count * (self._entries if self.counts_repeats else 1))

    def _step(self, entry: Entry) -> Step:
        levels: U8 | U16 = self._plane(entry)
        top = (1 << entry.depth) - 1
        # Bit 3 of the LED enables off: the lamp stays as it is put, whatever the sequencer does.
        if self._settings[0x1A07][0] & 0xF == 0 and self.lamp == "switched":
            levels = np.zeros_like(levels)
        elif (self.lamp == "continuous" or not self._settings[0x1A07][0] & 8) and entry.depth > 1:
            levels, top = light_of(self._plane(entry), entry.depth, entry.exposure_us * 1e-6), FULL
        return Step(
            levels=levels,
            top=top,
            exposure_s=entry.exposure_us * 1e-6,
            dark_s=entry.dark_us * 1e-6,
            pulse=not entry.suppresses_out_2,
            waits=entry.waits,
        )

    def _plane(self, entry: Entry) -> U8:
        """Return the mirrors' levels of an entry, from the decoded image."""
        key = (entry.image, entry.bit, entry.depth)
        if key not in self._planes:
            memories = self.images if self.mirrors.dual and self.secondary else self.images[:1]
            _require(all(entry.image in memory for memory in memories), 16)
            top = np.uint32((1 << entry.depth) - 1)
            # Joined as bytes: both halves of four megabytes of words would take three times as long.
            halves = [((memory[entry.image] >> entry.bit) & top).astype(np.uint8) for memory in memories]
            halves += [np.zeros_like(halves[0])] * (len(self.images) - len(halves) if self.mirrors.dual else 0)
            self._planes[key] = np.hstack(halves)
        levels = self._planes[key]
        if self._settings[0x1A30] == b"\x01":
            levels = np.uint8((1 << entry.depth) - 1) - levels
        if self.parked:
            levels = np.zeros_like(levels)
        return self._only_blocks(levels)

    def _only_blocks(self, levels: U8) -> U8:
        first, blocks = self._settings[0x1A40]
        if not self.mirrors.blocks or blocks == self.mirrors.blocks:
            return levels
        rows = self.mirrors.height // self.mirrors.blocks
        lit = np.zeros_like(levels)
        lit[first * rows : (first + blocks) * rows] = levels[first * rows : (first + blocks) * rows]
        return lit


def _require(condition: bool, code: int) -> None:
    if not condition:
        raise Refusal(code)
