"""A Santec SLM-200 class panel as a `Modulator`: grey-level masks, stepped by the host. EXPERIMENTAL.

Here: slots, grey levels, the host's timetable. Not here: the exchange (`link`), the bytes (`packets`).

Masks lie in the panel's memory slots; the host shows them one by one (`keep_time`, `wait_done`), and the panel
pulses its trigger output at each change. Between masks and after disarming it shows its dark level.
"""

from contextlib import suppress
from typing import Final

import numpy as np

from gs2ci.core.arrays import U8, U16
from gs2ci.core.clock import Clock
from gs2ci_drivers.display_slm.link import BUSY_TIMEOUT_S, IMAGE_S, SlmLink
from gs2ci_drivers.display_slm.options import DisplaySlmOptions
from gs2ci_drivers.display_slm.packets import HEIGHT, SLOTS, WIDTH, image
from gs2ci_drivers.failures import NoAnswerError, RefusedError, SequenceError
from gs2ci_drivers.modulator import Modulator, ModulatorStatus, UploadProgress
from gs2ci_drivers.pattern_sequence import ModulatorInfo, PatternSequence, TriggerOut
from gs2ci_drivers.ports import BytePort

_MEMORY_MODE: Final = "0"
_MODE_S: Final = 40.0
"""How long the change to it takes (manual of SLMFunc, SLM_Ctrl_WriteVI)."""
_COMMAND_S: Final = 0.02
_STEP_S: Final = 1e-3
# Sums of the same times in another order differ by rounding; the host's timing is coarser than a microsecond.
_SAME_TIME_S: Final = 1e-6
_MAX_EXPOSURE_S: Final = 60.0
_DEPTHS: Final = (1, 8, 10)
_PITCH_M: Final = 8e-6


class DisplaySlm(Modulator):
    """A panel with 1920 × 1200 pixels of 10 bits.

    Args:
        name: Name of the device in the rig file.
        port: The USB FIFO; closed with this.
        clock: Where deadlines and the timetable are kept.
        settings: From the rig file.
    """

    def __init__(self, name: str, port: BytePort, clock: Clock, settings: DisplaySlmOptions | None = None) -> None:
        super().__init__(name, clock)
        self.settings = settings or DisplaySlmOptions()
        self._link = SlmLink(name, port, clock)
        self._running: PatternSequence | None = None
        self._began_s = 0.0
        self._shows_memory = False
        self._next_change = 0

    def _do_connect(self) -> ModulatorInfo:
        serial = self._link.ask("SN")
        self._shows_memory = self._link.ask("VI") == _MEMORY_MODE
        return ModulatorInfo(
            # Its phase table decides what a level passes, and outlives programs (SLM_Ctrl_WriteWL, SLM_Ctrl_WriteAW): a
            # bundle of another table is one of another panel.
            model=f"Santec SLM-200 class, phase table {self._link.ask('WL')}",
            serial=serial,
            firmware="",
            height=HEIGHT,
            width=WIDTH,
            pitch_m=_PITCH_M,
            min_exposure_s=dict.fromkeys(_DEPTHS, self.settings.min_exposure_s),
            max_exposure_s=_MAX_EXPOSURE_S,
            exposure_step_s=_STEP_S,
            min_dark_s=self.settings.min_exposure_s,
            capacity=dict.fromkeys(_DEPTHS, SLOTS),
            trigger_outs=frozenset({TriggerOut.NONE, TriggerOut.PER_MASK}),
            start_latency_s=None,
            hardware_timed=False,
            experimental=True,
        )

    def levels(self, mask: U8 | U16, bit_depth: int) -> U16:
        """Return the panel's grey levels of a mask, [1200, 1920] uint16."""
        dark, bright = self.settings.dark_level, self.settings.bright_level
        table = np.rint(np.linspace(dark, bright, 1 << bit_depth)).astype(np.uint16)
        return np.asarray(table[mask])

    def _do_upload_eta_s(self, sequence: PatternSequence) -> float:
        first_s = 0.0 if self._shows_memory else _MODE_S
        return first_s + sequence.count * (IMAGE_S + 2 * _COMMAND_S) + 3 * _COMMAND_S

    def _do_upload(self, sequence: PatternSequence, progress: UploadProgress) -> int:
        self._show_memory()
        self._go_dark()  # the slot on show cannot be overwritten (SLM_Ctrl_WriteMI)
        sent = 0
        for i, mask in enumerate(sequence.masks):
            self._link.ask(f"MI {i + 1}")
            frames = image(self.levels(mask, sequence.bit_depth))
            self._link.send_image(frames, f"image for slot {i + 1}")
            sent += len(frames)
            progress((i + 1) / sequence.count)
        return sent

    def _do_turn(self, sequence: PatternSequence) -> None:
        """Do nothing: the host shows the slots in the order that a sequence has."""

    def _do_turn_eta_s(self, sequence: PatternSequence) -> float:
        return 0.0

    def _show_memory(self) -> None:
        """Have the panel show its memory instead of its video input, unless it does: that takes 40 s."""
        with suppress(RefusedError):  # another program's continuous display ends with it alone (SLM_Ctrl_WriteDR)
            self._link.ask("DB")
        if self._link.ask("VI") != _MEMORY_MODE:
            self._link.ask(f"VI {_MEMORY_MODE}", BUSY_TIMEOUT_S)
        self._shows_memory = True

    def _do_arm(self, sequence: PatternSequence) -> None:
        self._go_dark()
        if self._link.ask("TI") != "0":  # left on by another program
            self._link.ask("TI 0")
            self.incidents.append(f"{self.name}: the trigger input was on, which shows slots out of turn: switched off")
        self._link.ask(f"TM {int(sequence.trigger is TriggerOut.PER_MASK)}")

    def _do_start(self, sequence: PatternSequence) -> None:
        self._running, self._next_change = sequence, 0
        self._began_s = self.clock.now_s()
        self._step(sequence)

    def _change_s(self, sequence: PatternSequence, change: int) -> float:
        """Return when a change is due; even ones show a mask, odd ones end it."""
        passes, within = divmod(change // 2, sequence.count)
        begin_s = self._began_s + passes * sequence.period_s + within * (sequence.exposure_s + sequence.dark_s)
        return begin_s + (change % 2) * sequence.exposure_s

    def _step(self, sequence: PatternSequence) -> None:
        """Make the change that is due."""
        change, self._next_change = self._next_change, self._next_change + 1
        place = change // 2 % sequence.count
        slot, last_of_pass = sequence.order[place], place == sequence.count - 1
        if change % 2 == 0:
            late_s = self.clock.now_s() - self._change_s(sequence, change)
            if late_s > self.settings.late_s:
                self._running = None
                raise SequenceError(
                    self.name,
                    f"show mask {slot}",
                    (f"the host is {late_s * 1e3:.0f} ms late",),
                    remedy="raise `mask_s` in [capture], or `late_s` in [modulator]",
                )
            self._link.ask(f"DS {slot + 1}")
        elif (sequence.pause_s if last_of_pass else sequence.dark_s) > 0 or self._is_last(sequence, change):
            self._link.ask(f"GS {self.settings.dark_level}")

    def _is_last(self, sequence: PatternSequence, change: int) -> bool:
        return sequence.repeats > 0 and change + 1 >= 2 * sequence.count * sequence.repeats

    def _do_keep_time(self, until_s: float) -> None:
        sequence = self._running
        while sequence is not None and self._is_unfinished(sequence):
            due_s = self._change_s(sequence, self._next_change)
            if due_s > until_s + _SAME_TIME_S:
                break
            self.clock.sleep_s(due_s - self.clock.now_s())
            self._step(sequence)
        self.clock.sleep_s(until_s - self.clock.now_s())

    def _is_unfinished(self, sequence: PatternSequence) -> bool:
        return sequence.repeats == 0 or self._next_change < 2 * sequence.count * sequence.repeats

    def _do_wait_done(self, timeout_s: float) -> None:
        sequence = self._running
        if sequence is None:
            return
        deadline_s = self.clock.now_s() + timeout_s
        self._do_keep_time(min(self._began_s + sequence.duration_s, deadline_s))
        if self._is_unfinished(sequence):
            raise NoAnswerError(
                self.name, "wait for the end of the sequence", timeout_s, remedy="wait longer or disarm"
            )
        self._running = None

    def _do_disarm(self) -> None:
        self._go_dark()

    def _go_dark(self) -> None:
        self._running = None
        self._link.ask(f"GS {self.settings.dark_level}")

    def _do_status(self) -> ModulatorStatus:
        self._link.ask("SN")
        return ModulatorStatus(self._state_if(self._running is not None))

    def _do_close(self) -> None:
        self._link.close()
