"""The DLPC900 as a modulator: pattern-on-the-fly over USB HID, in the order that the firmware wants.

Here: the order of the commands. Not here: bytes (`packets`, `payloads`, `lut`, `images`), the single exchange
(`channel`), the translation of a sequence (`plan`).

Order of an upload (DLPU018, chapter 4): stop, mode on-the-fly, stop, triggers, entries, entry count, images from
the last to the first, entry count again. TRIG_OUT_2 carries the pulses (one per exposure, or one per mask),
TRIG_OUT_1 the gate. Connecting only reads.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Final

from gs2ci.core.clock import Clock
from gs2ci_drivers.dlpc900 import firmware, timing
from gs2ci_drivers.dlpc900.channel import Channel
from gs2ci_drivers.dlpc900.lut import MAX_TIME_US
from gs2ci_drivers.dlpc900.options import Dlpc900Options
from gs2ci_drivers.dlpc900.packets import Command, MalformedHidReplyError
from gs2ci_drivers.dlpc900.payloads import (
    DisplayMode,
    HardwareStatus,
    MainStatus,
    PatternControl,
    PowerMode,
    decode_hardware_type,
    decode_least_exposures,
    decode_version,
    encode_block_load,
    encode_image_chunks,
    encode_image_start,
    encode_lut_config,
)
from gs2ci_drivers.dlpc900.plan import ImageSet, digest_masks, encode_images, lut_entries
from gs2ci_drivers.dlpc900.pulses import interpret_pulses
from gs2ci_drivers.failures import (
    DeviceFaultError,
    DriverError,
    NoAnswerError,
    OutOfRangeError,
    RefusedError,
    SequenceError,
    UnsupportedError,
)
from gs2ci_drivers.modulator import POLL_S, Modulator, ModulatorStatus, PulseVerdict, UploadProgress
from gs2ci_drivers.pattern_sequence import ModulatorInfo, PatternSequence, TriggerOut
from gs2ci_drivers.ports import HidPort

_US: Final = 1e-6
_NOT_ALLOWED: Final = 5
_STOP_TIMEOUT_S: Final = 2.0
# A sequence of 105 µs masks ends before the first poll; one that lasts longer than this must be found running.
_SEEN_RUNNING_FROM_S: Final = 0.1
# Two crystals of 100 ppm, with margin, and the jitter of one USB exchange.
_CLOCK_TOLERANCE: Final = 1e-3
_EXCHANGE_JITTER_S: Final = 5e-3
# A setting with its answer takes two 1 ms frames: one for each entry and about twenty others, beside the image data.
_EXCHANGE_S: Final = 2e-3
_FIXED_EXCHANGES: Final = 22
# The start command and its answer over USB; a capture corrects this figure by its first frame.
_TYPICAL_START_S: Final = 5e-3
_BY_SEQUENCER: Final = 8  # of the LED enables: "ignore the other LED enable settings" (API.c, DLPC900_SetLedEnables)
_TELLS_LEAST_SINCE: Final = 6  # major version of the firmware
_TELLS_NOTHING: Final = (0,) * 8
_UNSETTLED: Final = "trigger_out_2_bit is not stated"
_GREY: Final = "under a lamp that stays on, bit planes of short weight are lit for as long as the mirrors take to load"


class Dlpc900(Modulator):
    """A mirror device behind a DLPC900 controller (DLP6500, DLP9000, DLP670S, DLP500YX, DLP5500).

    Args:
        name: Name of the device in the rig file.
        port: The HID interface; closed with this.
        clock: The clock of the deadlines.
        settings: From the rig file.
    """

    def __init__(self, name: str, port: HidPort, clock: Clock, settings: Dlpc900Options | None = None) -> None:
        super().__init__(name, clock)
        self.settings = settings or Dlpc900Options()
        self._profile = firmware.PROFILES[self.settings.firmware]
        self._port = port
        self._channel = Channel(
            name, port, clock, incidents=self.incidents, reply_timeout_s=self.settings.reply_timeout_s
        )
        self._dual = False
        self._model = timing.MODELS[timing.DmdType.DLP6500]  # until `connect` has read the type
        self._images: ImageSet | None = None
        self._on_device = b""
        self._used = False
        self._started_s = 0.0
        self._running: PatternSequence | None = None

    def check(self, sequence: PatternSequence) -> PatternSequence:
        """Return the sequence in whole microseconds; see `Modulator.check`.

        Raises:
            OutOfRangeError, UnsupportedError: As the base class; also a gate with dark gaps, a gate that never
                falls, and masks that are not dark outside the loaded blocks.
        """
        quantised = super().check(sequence)
        if quantised.trigger in (TriggerOut.GATE, TriggerOut.GATE_PER_MASK):
            self._check_gate(quantised)
        if self.settings.blocks is not None:
            self._check_blocks(quantised, *self.settings.blocks)
        return quantised

    def _do_interpret_pulses(self, sequence: PatternSequence, counted: int) -> PulseVerdict:
        fires = [entry.trigger_out_2 for entry in lut_entries(sequence)]
        return interpret_pulses(self.settings, fires, sequence.repeats, counted)

    def _check_gate(self, sequence: PatternSequence) -> None:
        each = sequence.trigger is TriggerOut.GATE_PER_MASK
        falls_within = sequence.dark_s > 0
        falls_between = sequence.repeats == 1 or sequence.pause_s > 0
        if (each and not (falls_within or sequence.count == 1)) or (not each and falls_within) or not falls_between:
            raise OutOfRangeError(
                self.name,
                "TRIG_OUT_1 is the gate: it falls in every dark time and at no other time",
                asked=f"{sequence.trigger.value} with dark_s = {sequence.dark_s:g}, pause_s = {sequence.pause_s:g}",
                allowed=("dark_s > 0" if each else "dark_s = 0") + ", and a pause when there is more than one pass",
                remedy="change dark_s or set a pause, or use one trigger per exposure",
            )

    def _check_blocks(self, sequence: PatternSequence, first: int, count: int) -> None:
        rows, end = self._model.height // self._model.blocks, first + count
        outside = sequence.masks[:, : first * rows].any() or sequence.masks[:, end * rows :].any()
        if outside:
            raise OutOfRangeError(
                self.name,
                f"masks are lit outside the loaded mirror blocks {first} to {end - 1}",
                asked="upload",
                allowed=f"light in rows {first * rows} to {end * rows - 1}",
                remedy="darken the other rows or load more blocks",
            )

    def _do_connect(self) -> ModulatorInfo:
        channel = self._channel
        channel.drain("connect")
        channel.take_error()  # clears the error of an earlier session
        type_number, tag = decode_hardware_type(channel.read(Command.HARDWARE_TYPE, "read the mirror type"))
        if type_number not in set(timing.DmdType):
            raise UnsupportedError(
                self.name,
                f"mirror device type {type_number}",
                asked="connect",
                allowed=", ".join(f"{kind.value} {kind.name}" for kind in timing.DmdType),
                remedy="check that the firmware on the board is the one for its mirrors",
            )
        version = decode_version(channel.read(Command.VERSIONS, "read the firmware version", length=16))
        self._model = timing.MODELS[timing.DmdType(type_number)]
        status = self._hardware_status("read status")
        self._dual = status.dual_controller
        if self._model.dual and not self._dual:
            raise DeviceFaultError(
                self.name,
                "connect",
                status.faults,
                remedy="power-cycle the board; if it stays so, reflash its firmware, both files of it, -primary and "
                "-secondary",
            )
        told = self._least_exposures_us() if version[0] >= _TELLS_LEAST_SINCE else _TELLS_NOTHING
        return self._describe(f"{'.'.join(map(str, version))} {tag}".strip(), told)

    def _least_exposures_us(self) -> tuple[int, ...]:
        """Return what the controller itself tells of the shortest times of 1 to 8 bits; 0 if it does not.

        It knows what the tables do not: the DLP5500, and a least LED pulse that another program has set (0x1A43), which
        makes them longer. With a range of blocks that another session has set it tells shorter ones.
        """
        asked = "read the least exposures"
        try:
            return decode_least_exposures(self._channel.read(Command.LEAST_EXPOSURES, asked, length=16))
        except RefusedError:  # it does not know the command
            return _TELLS_NOTHING

    def _describe(self, version: str, told_us: Sequence[int]) -> ModulatorInfo:
        model, gate = self._model, self.settings.trigger_out_1
        if self.settings.blocks is None:
            shortest = {bits: max(timing.min_exposure_us(model, bits), told_us[bits - 1]) for bits in range(1, 9)}
        else:
            first, count = self.settings.blocks
            if first + count > model.blocks:
                raise OutOfRangeError(
                    self.name,
                    f"{count} mirror blocks from block {first} on",
                    asked="connect",
                    allowed=f"blocks 0 to {model.blocks - 1}" if model.blocks else "no partial loading",
                    remedy="change `blocks` in [modulator]",
                )
            shortest = {1: timing.min_exposure_us(model, 1, blocks=count)}
        return ModulatorInfo(
            model=f"TI DLPC900 + {model.name}",
            serial="",
            firmware=version,
            height=model.height,
            width=model.width,
            pitch_m=model.pitch_um * _US,
            min_exposure_s={bits: us * _US for bits, us in shortest.items()},
            max_exposure_s=MAX_TIME_US * _US,
            exposure_step_s=_US,
            min_dark_s=_US,
            capacity={bits: timing.max_patterns(model, bits) for bits in shortest},
            trigger_outs=frozenset(TriggerOut),
            trigger_delay_s=self.settings.trigger_out_2.rise_us * _US,
            gate_delay_s=gate.rise_us * _US,
            gate_longer_s=(gate.fall_us - gate.rise_us) * _US,
            pulses_unsettled="" if self.settings.trigger_out_2_bit else _UNSETTLED,
            grey_unsettled="" if self.settings.lamp == "switched" else _GREY,
            typical_start_s=_TYPICAL_START_S,
        )

    def _do_other_polarity(self) -> PulseVerdict:
        edges = self.settings.trigger_out_1.model_copy(update={"inverted": not self.settings.trigger_out_1.inverted})
        remedy = f"set trigger_out_1 = {{ inverted = {str(edges.inverted).lower()} }} in [modulator]"
        return PulseVerdict(False, "the gate is inverted", remedy, {"trigger_out_1": edges})

    def _do_upload_eta_s(self, sequence: PatternSequence) -> float:
        settings_s = self._do_turn_eta_s(sequence)
        digest = digest_masks(sequence)
        if digest == self._on_device:
            return settings_s
        return settings_s + self._encoded(sequence, digest).upload_s

    def _do_turn_eta_s(self, sequence: PatternSequence) -> float:
        return (_FIXED_EXCHANGES + sequence.count) * _EXCHANGE_S

    def _encoded(self, sequence: PatternSequence, digest: bytes) -> ImageSet:
        if self._images is None or self._images.digest != digest:
            self._images = encode_images(sequence, self.settings, dual=self._dual, digest=digest)
        return self._images

    def _do_upload(self, sequence: PatternSequence, progress: UploadProgress) -> int:
        images = self._encoded(sequence, digest_masks(sequence))
        keep = images.digest == self._on_device
        self._on_device = b""  # from here on the images count as lost until the upload is complete
        self._running = None
        self._channel.take_error()
        self._wake()
        keep = not self._unflip() and keep
        self._free_lamp()
        self._configure(sequence)
        if not keep:
            self._send_images(images, progress)
        # Sent again, as is common practice: with the same entry count it keeps the images.
        self._send_count(sequence)
        self._channel.check_error("finish the upload")
        self._on_device, self._used = images.digest, True
        progress(1.0)
        return 0 if keep else images.total_bytes

    def _do_turn(self, sequence: PatternSequence) -> None:
        """Send the entries in another order; the images stay where they are."""
        self._do_upload(sequence, lambda share: None)

    def _wake(self) -> None:
        """Leave standby, parking and mirror idling: whoever uploads wants to use the device."""
        channel = self._channel
        standby = channel.read(Command.POWER_MODE, "read the power mode")[0] == PowerMode.STANDBY
        if standby or MainStatus.decode(channel.read(Command.MAIN_STATUS, "read the status")).parked:
            channel.write(Command.POWER_MODE, bytes([PowerMode.NORMAL]), "leave standby")
            self.clock.sleep_s(self.settings.wake_s)
        if channel.read(Command.IDLE_MODE, "read the idle mode")[0]:
            # Idling must have lasted for a while before it may end (DLPU018, section 2.3.1.2).
            self.clock.sleep_s(self.settings.wake_s)
            channel.write(Command.IDLE_MODE, b"\0", "leave mirror idling")

    def _unflip(self) -> bool:
        """Undo flips that another program has left; return whether there were any: images have to be loaded again.

        "In Structured Light mode, the image flip will take effect on the next bit-plane, image, or video frame load"
        (API.c of TI's DLPC900 GUI, DLPC900_GetLongAxisImageFlip and DLPC900_GetShortAxisImageFlip).
        """
        found = False
        for flip, axis in ((Command.FLIP_LONG, "long"), (Command.FLIP_SHORT, "short")):
            try:
                flipped = self._channel.read(flip, f"read the flip across the {axis} axis")[0] & 1
            except RefusedError:  # it cannot flip
                continue
            if flipped:
                self._channel.write(flip, b"\0", f"undo the flip across the {axis} axis")
                self.incidents.append(
                    f"{self.name}: pictures were flipped across the {axis} axis by another program, and no longer are"
                )
                found = True
        return found

    def _free_lamp(self) -> None:
        """Have a switched lamp follow the masks: another program may have left it on or off."""
        if self.settings.lamp != "switched":
            return
        if not self._channel.read(Command.LED_ENABLES, "read the LED enables")[0] & _BY_SEQUENCER:
            self._channel.write(Command.LED_ENABLES, bytes([_BY_SEQUENCER]), "have the LED enables follow the masks")
            self.incidents.append(f"{self.name}: another program held the LED enables, which follow the masks again")

    def _configure(self, sequence: PatternSequence) -> None:
        channel, settings = self._channel, self.settings
        self._stop()
        channel.write(Command.DISPLAY_MODE, bytes([DisplayMode.ON_THE_FLY]), "select pattern-on-the-fly mode")
        self._stop()  # again, as is common practice
        channel.write(Command.INVERT_DATA, bytes([settings.invert]), "set data inversion")
        channel.write(Command.TRIGGER_OUT_1, settings.trigger_out_1.encode(), "set trigger output 1")
        channel.write(Command.TRIGGER_OUT_2, settings.trigger_out_2.encode(), "set trigger output 2")
        if self._model.blocks:
            # Always sent: a block range of an earlier session holds until the controller is switched off, and keeps the
            # other blocks dark.
            blocks = settings.blocks or (0, self._model.blocks)
            channel.write(Command.BLOCK_LOAD, encode_block_load(*blocks), "set mirror blocks")
        bit_enables = settings.trigger_out_2_bit == "enables"
        for entry in lut_entries(sequence, settings.leds):
            channel.write(Command.LUT_ENTRY, entry.encode(bit_enables=bit_enables), f"define mask {entry.index}")
        self._send_count(sequence)

    def _send_count(self, sequence: PatternSequence) -> None:
        count = self._profile.count(sequence.count, sequence.repeats)
        self._channel.write(Command.LUT_CONFIG, encode_lut_config(sequence.count, count), "set the number of masks")

    def _send_images(self, images: ImageSet, progress: UploadProgress) -> None:
        shares = _Shares(progress, images.total_bytes)
        for index, secondary, block in images.in_order():
            asked = f"load image {index}" + (", right half" if secondary else "")
            start = Command.IMAGE_START_SECONDARY if secondary else Command.IMAGE_START
            data = Command.IMAGE_DATA_SECONDARY if secondary else Command.IMAGE_DATA
            self._channel.write(start, encode_image_start(index, len(block)), asked)
            self._channel.stream(data, encode_image_chunks(block), asked, shares.sent)
            # Image data is never acknowledged; only the error register says whether it was understood.
            self._channel.check_error(asked)
            shares.finish(len(block))

    def _do_arm(self, sequence: PatternSequence) -> None:
        self._stop()
        self._require_healthy("arm")

    def _require_healthy(self, asked: str) -> None:
        hardware = self._hardware_status(asked)
        if hardware.faults:
            self._on_device = b""
            raise DeviceFaultError(
                self.name,
                asked,
                hardware.faults,
                remedy="upload again; if the fault returns, power-cycle the controller",
            )
        if MainStatus.decode(self._channel.read(Command.MAIN_STATUS, asked)).parked:
            raise DeviceFaultError(
                self.name,
                asked,
                ["mirrors are parked"],
                remedy="check the controller's supply, then upload again: that wakes it",
            )

    def _hardware_status(self, asked: str) -> HardwareStatus:
        """Read the hardware status; that one of two controllers does not answer is a fault: its half stays dark."""
        status = HardwareStatus.decode(self._channel.read(Command.HARDWARE_STATUS, asked))
        if status.dual_controller or not self._model.dual:
            return status
        silent = f"the secondary controller of the {self._model.name} does not answer: the right half stays dark"
        return replace(status, faults=(silent, *status.faults))

    def _do_start(self, sequence: PatternSequence) -> None:
        self._started_s = self.clock.now_s()
        # A device that does not start may have lost its images: do not rely on them until it has started.
        images, self._on_device = self._on_device, b""
        self._channel.write(Command.PATTERN_CONTROL, bytes([PatternControl.START]), "start the sequence")
        self._on_device, self._running = images, sequence
        if sequence.duration_s > _SEEN_RUNNING_FROM_S and not self._is_running("start the sequence"):
            self._raise_stopped("start the sequence")

    def _do_wait_done(self, timeout_s: float) -> None:
        asked = "wait for the end of the sequence"
        sequence = self._running
        if sequence is None:
            return
        end_s = self._started_s + sequence.duration_s
        self._wait_while(lambda: self._is_running(asked), timeout_s, asked, end_s)
        ran_s = self.clock.now_s() - self._started_s
        if ran_s < sequence.duration_s * (1 - _CLOCK_TOLERANCE) - _EXCHANGE_JITTER_S:
            self._raise_stopped(asked)
        self._running = None
        faults = self._hardware_status(asked).faults
        if faults:
            self._on_device = b""
            raise SequenceError(self.name, asked, faults, remedy="upload the sequence again and repeat")

    def _raise_stopped(self, asked: str) -> None:
        sequence, ran_s = self._running, self.clock.now_s() - self._started_s
        assert sequence is not None
        self._running = None
        self._on_device = b""
        faults = self._hardware_status(asked).faults
        raise SequenceError(
            self.name,
            asked,
            (f"the sequence stopped by itself after at most {ran_s:.3g} of {sequence.duration_s:.3g} s", *faults),
            remedy="upload the sequence again; check `firmware` in [modulator] if it always stops early",
        )

    def _do_disarm(self) -> None:
        self._running = None
        self._stop()

    def _stop(self) -> None:
        """Stop the sequence and check that it stopped; a device that is in no pattern mode has nothing to stop."""
        asked = "stop the sequence"
        for last in (False, True):
            try:
                self._channel.write(Command.PATTERN_CONTROL, bytes([PatternControl.STOP]), asked)
                break
            except RefusedError as error:
                if error.code == _NOT_ALLOWED:
                    break
                if last:
                    raise
                # The refusal may be about an image load that broke off before; it does not come a second time.
                self.incidents.append(f"{error}; asked again")
        deadline_s = self.clock.now_s() + _STOP_TIMEOUT_S
        while self._is_running(asked):
            if self.clock.now_s() >= deadline_s:
                raise NoAnswerError(
                    self.name, asked, _STOP_TIMEOUT_S, remedy="power-cycle the controller: it ignores its commands"
                )
            self.clock.sleep_s(POLL_S)

    def _is_running(self, asked: str) -> bool:
        return MainStatus.decode(self._channel.read(Command.MAIN_STATUS, asked)).running

    def _do_status(self) -> ModulatorStatus:
        hardware = self._hardware_status("read status")
        main = MainStatus.decode(self._channel.read(Command.MAIN_STATUS, "read status"))
        power = self._channel.read(Command.POWER_MODE, "read status")[0]
        parked = ("mirrors are parked",) if main.parked else ()
        faults = hardware.faults + parked
        notes = {"power": "standby" if power == PowerMode.STANDBY else "normal"}
        return ModulatorStatus(self._state_if(main.running, faults), faults, notes)

    def _do_close(self) -> None:
        if self.settings.idle_after and self._used:
            # DLPU018, DMD idle mode: mirrors flip on and off evenly while nothing is shown for long. A device that is
            # gone, or runs an endless sequence, is released as it is.
            with suppress(DriverError, MalformedHidReplyError):
                self._channel.write(Command.IDLE_MODE, b"\1", "let the mirrors idle")
        self._port.close()


class _Shares:
    """Turns bytes sent into shares of an upload, reported once per whole percent: drawing progress takes time, too."""

    def __init__(self, progress: UploadProgress, total_bytes: int) -> None:
        self._progress = progress
        self._total_bytes = total_bytes
        self._finished_bytes = 0
        self._percent = 0

    def sent(self, of_block: int) -> None:
        """Note how many bytes of the present block were sent."""
        # The bytes sent include each chunk's own two-byte count, hence the cap.
        share = min((self._finished_bytes + of_block) / self._total_bytes, 1.0)
        if int(100 * share) > self._percent:
            self._percent = int(100 * share)
            self._progress(share)

    def finish(self, block_bytes: int) -> None:
        """Note that a block was sent completely."""
        self._finished_bytes += block_bytes
