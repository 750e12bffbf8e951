"""A ViALUX DMD as a `Modulator`, by the functions of the ALP library.

Here: the order of calls, limits, states. Not here: pictures and pulses (`layout`), numbers (`codes`), the library
(`gs2ci_drivers.links.alp_library`).

A device belongs to the program that has allocated it: allocating sets it to its defaults, and when the program ends or
frees it, it goes dark and forgets its sequences. So a device is dark after `close`, unlike other modulators.
"""

from collections.abc import Sequence
from contextlib import suppress
from typing import Final

import numpy as np

from gs2ci.core.arrays import U8, U16
from gs2ci.core.clock import Clock
from gs2ci_drivers.alp.codes import GONE, MEANINGS, MSB_ALIGN, NO_MIRRORS, POWER_FLOAT, SIZES, Alp, gate
from gs2ci_drivers.alp.layout import AlpPictures, lay_out
from gs2ci_drivers.alp.options import AlpOptions
from gs2ci_drivers.failures import (
    AccessError,
    DeviceFaultError,
    DisconnectedError,
    DriverError,
    RefusedError,
    SequenceError,
)
from gs2ci_drivers.modulator import Modulator, ModulatorStatus, PulseVerdict, UploadProgress
from gs2ci_drivers.pattern_sequence import ModulatorInfo, PatternSequence, TriggerOut
from gs2ci_drivers.ports import LibraryPort, port_errors

_US: Final = 1e-6
_RATE_BYTES_S: Final = 25e6
"""Of an upload over USB 2, in bytes of 8 mirrors."""
_CALL_S: Final = 1e-3
START_LATENCY_S: Final = 0.05
"""The maker states no figure: a capture waits for the first trigger and does not depend on it."""
_TYPICAL_START_S: Final = 2e-3
_EARLY_S: Final = 5e-3
_TEMPERATURES: Final = {
    "DDC FPGA": Alp.DDC_FPGA_TEMPERATURE,
    "application FPGA": Alp.APPS_FPGA_TEMPERATURE,
    "board": Alp.PCB_TEMPERATURE,
}


class AlpModulator(Modulator):
    """One device of the ALP family, for binary masks.

    Args:
        name: Name of the device in the rig file.
        port: The maker's library; closed with this.
        clock: Where deadlines are kept.
        settings: From the rig file.
    """

    def __init__(self, name: str, port: LibraryPort, clock: Clock, settings: AlpOptions | None = None) -> None:
        super().__init__(name, clock)
        self.settings = settings or AlpOptions(kind="alp")
        self._port = port
        self._device: int | None = None
        self._sequence: int | None = None
        self._dark: int | None = None
        self._running: PatternSequence | None = None
        self._started_s = 0.0
        self._shows = False

    def check(self, sequence: PatternSequence) -> PatternSequence:
        """Return the sequence in whole microseconds; see `Modulator.check`.

        Raises:
            OutOfRangeError, UnsupportedError: As the base class, and as `lay_out`.
        """
        checked = super().check(sequence)
        lay_out(self.name, checked)
        return checked

    def _do_connect(self) -> ModulatorInfo:
        self._device = self._ask("AlpDevAlloc", [self.settings.serial, 0], "take the device")
        height, width = self._size()
        shortest_us, longest_us, dark_us = self._limits_us()
        return ModulatorInfo(
            model=f"ViALUX ALP-{self.settings.version}",
            serial=str(self._inquire(Alp.DEVICE_NUMBER)),
            firmware=f"{self._inquire(Alp.VERSION):#x}",
            height=height,
            width=width,
            pitch_m=self.settings.pitch_um * 1e-6,
            min_exposure_s={1: shortest_us * _US},
            max_exposure_s=longest_us * _US,
            exposure_step_s=_US,
            min_dark_s=dark_us * _US,
            capacity={1: self._inquire(Alp.AVAIL_MEMORY) - 2},  # two dark pictures besides
            trigger_outs=frozenset({TriggerOut.NONE, TriggerOut.PER_EXPOSURE, TriggerOut.PER_MASK}),
            start_latency_s=START_LATENCY_S,
            typical_start_s=_TYPICAL_START_S,
            experimental=True,
            whole_pauses=True,
        )

    def _size(self) -> tuple[int, int]:
        """Return rows and columns of the mirrors, by their type where the library does not tell them."""
        kind = self._inquire(Alp.DEV_DMDTYPE)
        if kind == NO_MIRRORS:
            raise DeviceFaultError(
                self.name,
                "connect",
                ["no mirror device is connected to the board (ALP_DMDTYPE_DISCONNECT)"],
                remedy="check its flat cable, then switch the board off and on",
            )
        try:
            return self._inquire(Alp.DEV_DISPLAY_HEIGHT), self._inquire(Alp.DEV_DISPLAY_WIDTH)
        except RefusedError:
            if kind not in SIZES:
                raise
            return SIZES[kind]

    def _limits_us(self) -> tuple[int, int, int]:
        """Return shortest and longest picture time and the least dark time, which are a sequence's: one is made."""
        sequence = self._ask("AlpSeqAlloc", [self._id, 1, 1], "reserve a sequence to ask for its limits")
        try:
            normal_us = self._of(sequence, Alp.MIN_PICTURE_TIME)
            dark_us = normal_us - self._of(sequence, Alp.MIN_ILLUMINATE_TIME)
            self._control(sequence, Alp.BIN_MODE, Alp.BIN_UNINTERRUPTED)
            # The mode becomes active with the times (ViALUX's sample of AlpSeqTiming: "also activating the ALP_BITNUM
            # and ALP_BIN_MODE setting").
            self._call("AlpSeqTiming", [self._id, sequence, 0, 0, 0, 0, 0], "set default times")
            return self._of(sequence, Alp.MIN_PICTURE_TIME), self._of(sequence, Alp.MAX_PICTURE_TIME), dark_us
        finally:
            with suppress(DriverError):  # an error on the way is the one to be told
                self._call("AlpSeqFree", [self._id, sequence], "free it")

    def _do_upload_eta_s(self, sequence: PatternSequence) -> float:
        pictures = lay_out(self.name, sequence)
        return len(pictures.order) * (self._picture_bytes() / 8 / _RATE_BYTES_S + _CALL_S)

    def _picture_bytes(self) -> int:
        return self.info.height * self.info.width

    def _do_upload(self, sequence: PatternSequence, progress: UploadProgress) -> int:
        self._halt()
        for one in (self._sequence, self._dark):
            if one is not None:
                self._call("AlpSeqFree", [self._id, one], "free a sequence")
        self._sequence = self._dark = None
        self._call("AlpProjControl", [self._id, Alp.PROJ_INVERSION, int(self.settings.invert)], "set the inversion")
        # The picture that is shown while nothing is asked for: 0 on all mirrors, whatever the inversion.
        self._dark = self._put(np.zeros((1, self.info.height, self.info.width), np.uint8), (-1,), lambda share: None)
        pictures = lay_out(self.name, sequence)
        self._sequence = self._put(sequence.masks, pictures.order, progress)
        self._set_times(pictures)
        progress(1.0)
        return len(pictures.order) * self._picture_bytes()

    def _put(self, masks: U8 | U16, order: Sequence[int], progress: UploadProgress) -> int:
        """Reserve a sequence and send its pictures one by one; return its number."""
        made = self._ask("AlpSeqAlloc", [self._id, 1, len(order)], f"reserve {len(order)} pictures")
        self._control(made, Alp.DATA_FORMAT, MSB_ALIGN)
        closed = 255 if self.settings.invert else 0
        for index, mask in enumerate(order):
            # Mirrors take the highest bit: 1 would be as dark as 0.
            levels = np.full(masks.shape[1:], closed, np.uint8) if mask < 0 else masks[mask].astype(np.uint8) * 255
            self._call("AlpSeqPut", [self._id, made, index, 1], f"send picture {index}", levels.tobytes())
            progress((index + 1) / len(order))
        return made

    def _set_times(self, pictures: AlpPictures) -> None:
        assert self._sequence is not None
        sequence = self._sequence
        mode = Alp.BIN_UNINTERRUPTED if pictures.uninterrupted else Alp.BIN_NORMAL
        self._control(sequence, Alp.BIN_MODE, mode)
        pulse_us = max(min(self.settings.pulse_us, pictures.illuminate_us // 2), 1)
        times = [pictures.illuminate_us, pictures.picture_us, 0, pulse_us, 0]
        self._call("AlpSeqTiming", [self._id, sequence, *times], "set the times")
        if pictures.repeats:
            self._control(sequence, Alp.SEQ_REPEAT, pictures.repeats)

    def _gate(self, pulses: list[bool]) -> None:
        setting = gate(pulses, active_high=self.settings.trigger_active == "high")
        self._call("AlpDevControlEx", [self._id, Alp.DEV_DYN_SYNCH_OUT1_GATE], "set synch output 1", setting)

    def _do_arm(self, sequence: PatternSequence) -> None:
        self._halt()
        self._require_well("arm")
        self._gate(list(lay_out(self.name, sequence).pulses))

    def _do_start(self, sequence: PatternSequence) -> None:
        assert self._sequence is not None
        self._started_s = self.clock.now_s()
        name = "AlpProjStart" if sequence.repeats else "AlpProjStartCont"
        self._call(name, [self._id, self._sequence], "start")
        self._running, self._shows = sequence, True

    def _do_wait_done(self, timeout_s: float) -> None:
        sequence = self._running
        if sequence is None:
            return
        asked = "wait for the end of the sequence"
        end_s = self._started_s + sequence.duration_s
        self._wait_while(self._busy, timeout_s, asked, end_s)
        self._running = None
        missing_s = end_s - sequence.pause_s - self.clock.now_s()
        if missing_s > _EARLY_S:
            raise SequenceError(
                self.name,
                asked,
                [f"it ended {missing_s * 1e3:.0f} ms before its last mask could have been shown"],
                remedy="close other programs that use the device, then repeat",
            )

    def _do_disarm(self) -> None:
        self._halt()
        if self._shows and self._dark is not None:
            # A halted sequence leaves its last picture on the mirrors in uninterrupted mode; no pulse for the dark one.
            self._gate([False])
            self._call("AlpProjStart", [self._id, self._dark], "show nothing")
            self._shows = False

    def _halt(self) -> None:
        self._running = None
        if self._device is not None:
            self._call("AlpDevHalt", [self._id], "halt")

    def _do_status(self) -> ModulatorStatus:
        busy, faults = self._busy(), self._faults()
        return ModulatorStatus(self._state_if(busy and self._running is not None, faults), faults)

    def _do_other_polarity(self) -> PulseVerdict:
        other = "low" if self.settings.trigger_active == "high" else "high"
        remedy = f'set trigger_active = "{other}" in [modulator]'
        return PulseVerdict(False, "the gate is inverted", remedy, {"trigger_active": other})

    def _do_temperatures_c(self) -> dict[str, float]:
        found = {}
        for name, kind in _TEMPERATURES.items():
            with suppress(RefusedError):  # boards before revision B have no sensors
                found[name] = self._inquire(kind) / 256
        return found

    def _do_close(self) -> None:
        try:
            if self._device is not None:
                self._call("AlpDevHalt", [self._id], "halt")
                self._call("AlpDevFree", [self._id], "free the device")
        except DriverError:  # it may be unplugged; closing must still let go of the library
            self._device = None
        self._port.close()

    def _faults(self) -> tuple[str, ...]:
        floating = self._inquire(Alp.DEV_DMD_MODE) == POWER_FLOAT
        return ("the mirrors are released (ALP_DMD_POWER_FLOAT): check the supply",) if floating else ()

    def _require_well(self, asked: str) -> None:
        faults = self._faults()
        if faults:
            raise DeviceFaultError(self.name, asked, faults)

    def _busy(self) -> bool:
        return self._inquire(Alp.DEV_STATE) == Alp.DEV_BUSY

    @property
    def _id(self) -> int:
        return self._device or 0

    def _inquire(self, kind: Alp) -> int:
        return self._ask("AlpDevInquire", [self._id, kind], f"read {kind.name}")

    def _of(self, sequence: int, kind: Alp) -> int:
        return self._ask("AlpSeqInquire", [self._id, sequence, kind], f"read {kind.name}")

    def _control(self, sequence: int, kind: Alp, value: int) -> None:
        self._call("AlpSeqControl", [self._id, sequence, kind, value], f"set {kind.name}")

    def _call(self, function: str, numbers: Sequence[int], asked: str, data: bytes = b"") -> None:
        with port_errors(self.name, asked):
            code = self._port.call(function, numbers, data)
        self._require_ok(code, f"{function}: {asked}")

    def _ask(self, function: str, numbers: Sequence[int], asked: str) -> int:
        with port_errors(self.name, asked):
            code, value = self._port.ask(function, numbers)
        self._require_ok(code, f"{function}: {asked}")
        return value

    def _require_ok(self, code: int, asked: str) -> None:
        if code == Alp.OK:
            return
        meaning = MEANINGS.get(code, "a code that the maker's header does not have")
        if code in GONE:
            raise DisconnectedError(self.name, asked, f"{code}: {meaning}")
        if code == Alp.NOT_READY:
            raise AccessError(self.name, meaning, asked=asked, remedy="close that program, then try again")
        raise RefusedError(self.name, asked, code, meaning)
