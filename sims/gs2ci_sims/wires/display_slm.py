"""The twin of a Santec SLM-200 class panel and its controller: frames, memory slots, a slow liquid crystal.

It follows Santec's own source for macOS (SlmCtrl.m, 2022) and its manual of the library SLMFunc: commands end with a
line feed; the number of a row stands in the bytes 9 to 11, low byte first; while busy it answers BS and takes no
command; the slot that DS shows cannot be overwritten (SLM_Ctrl_WriteMI); a change to memory mode takes 40 s, in which
there is no response (SLM_Ctrl_WriteVI; at power-up it shows its video input); an image is not read while it is asked
for its status at once (slm_Ctrl_WriteMI: "without waiting here it fails however often one tries"). Its phase table
(slm_Ctrl_ReadWL: nm, and the phase of the top level in pi), its trigger input (SLM_Ctrl_WriteTI), by whose pulses it
shows the next slot, and a continuous display (SLM_Ctrl_WriteDR: "until stopped by SLM_Ctrl_WriteDB", during which "some
communication commands are invalid", here those that show something) stay as programs leave them.

Here: frames, commands, slots. Not here: bytes on the line (`serial_twin`, at USB speed), pixels (`panel`). It shares no
code with the driver.
"""

from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import U16
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.panel import Panel, transmissions
from gs2ci_sims.wires.serial_twin import SerialTwin
from gs2ci_sims.world import World

HEIGHT: Final = 1200
WIDTH: Final = 1920
TOP: Final = 1023
_COMMAND_S: Final = 2e-3
_IMAGE_S: Final = 0.145
_MODE_S: Final = 40.0
_READS_S: Final = 0.1
_USB_BAUD: Final = 2_000_000_000
_ROW_FRAME: Final = 16 + 4096
_TEXT_FRAME: Final = 16 + 1024


class DisplaySlmTwin(SerialTwin):
    """The panel.

    Args:
        world: Clock, trigger line `<name>.out`, and where masks are shown.
        faults: The faults to inject.
        name: Prefix of its trigger line.
        response_s: Time constant of the liquid crystal.
        greys: The panel's levels at which the optics pass no light and all of it.
    """

    def __init__(
        self,
        world: World,
        faults: FaultSet | None = None,
        *,
        name: str = "slm0",
        response_s: float = 0.0,
        greys: tuple[int, int] = (0, TOP),
    ) -> None:
        super().__init__(world.clock, faults, _USB_BAUD)
        self._full = abs(greys[1] - greys[0])
        self._passes = transmissions(greys, TOP, self._full)
        self.panel = Panel(world, f"{name}.out", self.faults, response_s)
        self._input = bytearray()
        self.table = "633 2.0"
        self._restart()

    @property
    def terminators(self) -> bytes:
        """Get the line feed, which ends commands within their frames."""
        return b"\n"

    def power_cycle(self) -> None:
        """Cut the power for a moment: the connection and all slots are lost."""
        self.unplug()
        self._restart()

    def _restart(self) -> None:
        self.panel.stop()
        self._input.clear()
        self.slots: dict[int, U16] = {}
        self._target = 0
        self._pulses = False
        self.trigger_input = self.playing = False
        self._from_memory = False
        self._shown: int | None = None
        self._image_end_s = 0.0
        self._rows: dict[int, bytes] = {}
        self._word = ""
        self._word_from_s = 0.0
        self._busy_until_s = 0.0

    def _stale(self) -> bytes:
        return self._status_frame("NG")

    def _receive(self, data: bytes) -> None:
        self._input += data
        while True:
            begin = self._input.find(b"SEND")
            if begin < 0:
                del self._input[: max(len(self._input) - 3, 0)]
                return
            del self._input[:begin]
            if len(self._input) < 16:
                return
            size = {1: _TEXT_FRAME, 2: 16, 4: _ROW_FRAME}.get(self._input[7], 4)
            if len(self._input) < size:
                return
            frame = bytes(self._input[:size])
            del self._input[:size]
            self._frame(frame)

    def _frame(self, frame: bytes) -> None:
        kind = frame[7] if len(frame) >= 16 else 0
        if kind == 1:
            self._line(frame[16:].split(b"\0", 1)[0])
        elif kind == 2:
            self._tell()
        elif kind == 4:
            self._take_row(frame[9] + (frame[10] << 8) + (frame[11] << 16), frame[16:])

    def _tell(self) -> None:
        now_s = self.clock.now_s()
        if now_s < self._image_end_s + _READS_S:
            self._word = ""
        word = self._word if now_s >= self._word_from_s else "NO RESPONSE"
        self._word = "" if word == self._word else self._word
        self._reply(self._status_frame(word), "status", delay_s=200e-6)

    def _status_frame(self, word: str) -> bytes:
        kind = 9 if self.faults.take("slm.wrong_kind") else 3
        return b"SEND\x00\xff\x00" + bytes([kind]) + bytes(8) + word.encode("ascii").ljust(1024, b"\0")

    def _finish(self, word: str, about: str, takes_s: float = _COMMAND_S) -> None:
        if self.faults.take("slm.refuses", about):
            word = "NG"
        if self.faults.take("slm.no_response", about):
            word = ""
        self._word, self._word_from_s = word, self.clock.now_s() + takes_s

    def _line(self, line: bytes) -> None:
        text, now_s = line.decode("ascii", "replace"), self.clock.now_s()
        if not text.endswith("\n"):
            return
        head, _, rest = text.strip().partition(" ")
        busy = self.faults.take("slm.busy", text.strip())
        if busy:
            self._busy_until_s = now_s + busy.value
        if now_s < self._busy_until_s:
            self._finish("BS", text.strip())
            return
        changes = head == "VI" and rest == "0" and not self._from_memory
        numbers = [int(field) for field in rest.split() if field.isdigit()]
        self._finish(self._obey(head, numbers), text.strip(), _MODE_S if changes else _COMMAND_S)

    def _obey(self, head: str, numbers: list[int]) -> str:
        told = {"SN": "2018021101", "VI": int(not self._from_memory), "WL": self.table, "TI": int(self.trigger_input)}
        if head in told and not numbers:
            return str(told[head])
        if head == "DB":
            self.playing = False
            return "OK"
        if len(numbers) != 1:
            return "NG"
        value = numbers[0]
        if head == "VI" and value <= 1:
            self._from_memory = value == 0
        elif head == "MI" and 1 <= value <= 128 and value != self._shown:
            self._target = value
            self._rows.clear()
        elif head == "TI" and value <= 1:
            self.trigger_input = value == 1
        elif self.playing:
            return "NG"
        elif head == "DS" and value in self.slots and self._from_memory:
            self._shown = value
            self.panel.set(self._passes[self.slots[value]], self._full)
            if self._pulses:
                self.panel.pulse()
        elif head == "GS" and value <= TOP:
            self._shown = None
            passed = self._passes[value]
            self.panel.set(np.full((HEIGHT, WIDTH), passed) if passed else None, self._full)
        elif head == "TM" and value <= 1:
            self._pulses = value == 1
        else:
            return "NG"
        return "OK"

    def trigger(self) -> None:
        """Give a pulse to the trigger input."""
        if self.trigger_input and self._shown is not None:
            self._obey("DS", [self._shown + 1 if self._shown + 1 in self.slots else 1])

    def _take_row(self, row: int, data: bytes) -> None:
        if not self.faults.take("slm.row_lost"):
            self._rows[row] = data
        if row != HEIGHT - 1:
            return
        self._image_end_s = self.clock.now_s()
        rows, self._rows = self._rows, {}
        if sorted(rows) != list(range(HEIGHT)) or not self._target:
            self._finish("NG", "image", _IMAGE_S)
            return
        buffer = np.frombuffer(b"".join(rows[i] for i in range(HEIGHT)), np.uint8).reshape(HEIGHT, 4096).copy()
        if self.faults.take("slm.pixel_spoilt"):
            buffer[HEIGHT // 2, WIDTH] ^= 1
        low, high = buffer[:, 0 : 2 * WIDTH : 2], buffer[:, 1 : 2 * WIDTH : 2]
        pixels = low + high * np.uint16(256)
        expected = int.from_bytes(buffer[-1, -4:].tobytes(), "little")
        if int(pixels.sum(dtype=np.uint64)) % 2**32 != expected or int(pixels.max()) > TOP:
            self._finish("NG", "image", _IMAGE_S)
            return
        self.slots[self._target] = pixels
        self._finish("OK", "image", _IMAGE_S)


def simulated(world: World, settings: Any) -> DisplaySlmTwin:
    """Build the twin that a rig file's [modulator] and [world] describe."""
    return DisplaySlmTwin(
        world,
        world.stated.faults["modulator"],
        name="modulator",
        response_s=world.stated.table.panel_response_s,
        greys=(settings.dark_level, settings.bright_level),
    )
