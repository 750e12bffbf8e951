"""The DLPC900's firmware behind a HID port: answers reports, keeps patterns, runs sequences in the world.

Here: the USB side (64-byte reports, one shared buffer, numbering) and its faults. Not here: the effect of commands
(`dlpc900_firmware`), the reading of images (`dlpc900_images`), their display (`dlpc900_sequencer`). It shares no code
with the driver.
"""

from functools import partial
from typing import Any, Final

from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.dlpc900_firmware import Firmware, Refusal
from gs2ci_sims.wires.dlpc900_lamp import Lamp
from gs2ci_sims.wires.dlpc900_sequencer import START_LATENCY_S
from gs2ci_sims.wires.dlpc900_tables import COMMAND_NAMES
from gs2ci_sims.wires.plugged import Plugged, Session
from gs2ci_sims.world import Event, World

REPORT_BYTES: Final = 64
REPORT_S: Final = 1e-3
REPLY_LATENCY_S: Final = 2e-3
_BUFFER_BYTES: Final = 512


class Dlpc900Twin(Plugged["_Session"]):
    """A controller with its mirrors, below the HID port.

    Args:
        world: Clock, trigger lines, and where masks are shown.
        faults: The faults to inject.
        name: Prefix of its trigger lines on the bus.
        dmd: Type of the mirrors: 1 DLP6500, 2 DLP9000, 3 DLP670S, 4 DLP500YX, 5 DLP5500.
        counts_repeats: Whether the count of 0x1A31 counts repeats (DLPU018F) or masks (DLPU018J).
        bit_enables: Whether bit 0 of an entry's byte 9 enables the pulse of trigger output 2 (as API.c of TI's GUI
            writes it) or disables it (DLPU018, table 2-137): public sources contradict each other.
        start_latency_s: From the command that starts a sequence to its first mask.
        lamp: Whether its lamp follows the LED enables or stays on: see `dlpc900_lamp`.
    """

    def __init__(
        self,
        world: World,
        faults: FaultSet | None = None,
        *,
        name: str = "dmd0",
        dmd: int = 1,
        counts_repeats: bool = False,
        bit_enables: bool = False,
        start_latency_s: float = START_LATENCY_S,
        lamp: Lamp = "switched",
    ) -> None:
        super().__init__(faults)
        self.world = world
        self.clock = world.clock
        self.firmware = Firmware(
            world, self.faults, name=name, dmd=dmd, counts_repeats=counts_repeats, bit_enables=bit_enables
        )
        self.firmware.sequencer.start_latency_s = start_latency_s
        self.firmware.lamp = lamp
        self._message = bytearray()
        self._expected = 0
        self._outgoing: list[bytes] = []
        self._answering: list[Event] = []

    def _begin_session(self) -> "_Session":
        self._outgoing = (
            [b"\xc0\x01\x01\x00\x7f".ljust(REPORT_BYTES, b"\0")] if self.faults.take("dlpc900.stale") else []
        )
        return _Session(self)

    def _lose(self) -> None:
        """Lose what is under way; patterns stay in memory."""
        self._message.clear()
        self._drop_replies()

    def power_cycle(self) -> None:
        """Cut the power: like `unplug`, and all memory is lost."""
        self.unplug()
        self.firmware.reset()

    def host_sends(self, report: bytes) -> None:
        """Receive one report from the host and process it at once."""
        if not self._message:
            self._drop_replies()  # one buffer serves both directions
            if not self._begin_message(report):
                return
        self._message += report
        if len(self._message) >= self._expected:
            message = bytes(self._message[: self._expected])
            self._message.clear()
            self._handle(message)

    def device_sends(self) -> bytes | None:
        """Return the next report for the host, or None."""
        return self._outgoing.pop(0) if self._outgoing else None

    def current_command(self, report: bytes) -> str:
        """Name the command that a report belongs to, for faults and tests."""
        head = self._message or report
        number = int.from_bytes(head[4:6], "little")
        return COMMAND_NAMES.get(number, f"{number:#06x}")

    def _begin_message(self, report: bytes) -> bool:
        length = int.from_bytes(report[2:4], "little")
        # Reserved, refusal and destination bits are 0 in every request.
        if report[0] & 0x3F or not 2 <= length <= _BUFFER_BYTES - 4:
            self.firmware.note_error(3)
            return False
        self._expected = 4 + length
        return True

    def _handle(self, message: bytes) -> None:
        flags, sequence = message[0], message[1]
        number = int.from_bytes(message[4:6], "little")
        name = COMMAND_NAMES.get(number, f"{number:#06x}")
        is_read = bool(flags & 0x80)
        data, refused = b"", False
        try:
            forced = self.faults.take("dlpc900.nack", name)
            if forced:
                raise Refusal(int(forced.value) or 255)
            data = self.firmware.read(number) if is_read else self.firmware.write(number, message[6:])
        except Refusal as refusal:
            self.firmware.note_error(refusal.code)
            refused = True
        if flags & 0x40:
            flags = flags & 0xC0 | (0x20 if refused else 0)
            self._answer(name, bytes([flags, sequence]) + len(data).to_bytes(2, "little") + data)

    def _answer(self, name: str, reply: bytes) -> None:
        take = self.faults.take
        if take("dlpc900.reply_lost", name):
            return
        if take("dlpc900.reply_other_sequence", name):
            reply = reply[:1] + bytes([(reply[1] + 101) & 0xFF]) + reply[2:]
        if take("dlpc900.reply_garbled", name):
            reply = b"\xff" * 4 + reply[4:]
        padded = reply.ljust(-(-len(reply) // REPORT_BYTES) * REPORT_BYTES, b"\0")
        reports = [padded[at : at + REPORT_BYTES] for at in range(0, len(padded), REPORT_BYTES)]
        short = take("dlpc900.reply_short", name)
        if short:
            reports = [reply[: int(short.value) or 2]]
        if take("dlpc900.reply_twice", name):
            reports = reports * 2
        if take("dlpc900.babble", name):
            reports = [bytes([i]) * REPORT_BYTES for i in range(100)] + reports
        late = take("dlpc900.reply_late", name)
        delay_s = REPLY_LATENCY_S + (late.value if late else 0.0)
        for i, report in enumerate(reports):
            event = self.clock.after(delay_s + i * REPORT_S, partial(self._deliver, report))
            if not late:  # a late reply is in the host's queue already, and the next request does not drop it
                self._answering.append(event)

    def _deliver(self, report: bytes) -> None:
        if self.plugged:
            self._outgoing.append(report)

    def _drop_replies(self) -> None:
        if self._answering or self._outgoing:
            for event in self._answering:
                event.cancel()
            self._answering.clear()
            self._outgoing.clear()


class _Session(Session[Dlpc900Twin]):
    """One opening of the twin's interface: a `HidPort`."""

    def write(self, report: bytes, timeout_s: float) -> None:
        """Send one report; takes one USB frame of 1 ms."""
        twin = self._twin
        self._require_alive()
        if len(report) != REPORT_BYTES:
            raise ValueError(f"a report of {len(report)} bytes")
        if twin.faults.waiting and self._loses_report(report, timeout_s):
            return
        twin.clock.sleep_s(REPORT_S)
        twin.host_sends(report)

    def _loses_report(self, report: bytes, timeout_s: float) -> bool:
        """Apply the faults of the transfer; return whether the report is lost."""
        twin, name = self._twin, self._twin.current_command(report)
        if twin.faults.take("dlpc900.unplugged", name):
            twin.unplug()
        if twin.faults.take("dlpc900.power_cycle", name):
            twin.power_cycle()
        self._require_alive()
        if twin.faults.take("dlpc900.write_stuck", name):
            twin.clock.sleep_s(timeout_s)
            raise TimeoutError("Operation timed out", timeout_s)
        if twin.faults.take("dlpc900.report_lost", name):
            twin.clock.sleep_s(REPORT_S)
            return True
        return False

    def read(self, timeout_s: float) -> bytes:
        """Wait for a report from the device."""
        twin = self._twin
        self._require_alive()
        twin.clock.wait_until(lambda: bool(twin._outgoing) or not twin.plugged, timeout_s)
        self._require_alive()
        return twin.device_sends() or b""


def simulated(world: World, settings: Any) -> Dlpc900Twin:
    """Build the twin that a rig file's [world] describes."""
    table = world.stated.table
    return Dlpc900Twin(
        world,
        world.stated.faults["modulator"],
        name="modulator",
        bit_enables=table.trigger_out_2_bit == "enables",
        start_latency_s=table.dlpc900_start_s,
        lamp=table.lamp,
    )
