"""A modulator on a video output: grey pictures, one per refresh, with a check of each picture's time.

A mask is shown for a whole number of refreshes. The time at which each picture appears is compared with that of the one
before: if a picture stays when another was due (doubled) or never appears (dropped), the run ends with an error, since
the exposure of its mask differs from the planned one. A picture that stays because the next one is the same is correct:
a display keeps its last picture.

Here: `VideoOut`. Not here: windows (`gs2ci_drivers.links.sdl_screen`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import U8, U16
from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import DisconnectedError, NoAnswerError, SequenceError
from gs2ci_drivers.modulator import Modulator, ModulatorStatus, UploadProgress
from gs2ci_drivers.pattern_sequence import ModulatorInfo, PatternSequence, TriggerOut
from gs2ci_drivers.ports import ScreenOutput, ScreenPort, port_errors
from gs2ci_drivers.video_out.options import VideoOutOptions

LAST: Final = "last"
MAX_EXPOSURE_S: Final = 60.0
CAPACITY: Final = 4096
"""Limit on the number of masks, which are kept in memory as pictures."""
DEPTHS: Final = (1, 8)
UNEVEN: Final = 0.5
"""Share of a refresh after which a picture counts as shown at the next refresh."""


class VideoOut(Modulator):
    """A second display.

    Args:
        name: Name of the device in the rig file.
        port: The video output; closed with this.
        clock: The clock of the deadlines.
        settings: From the rig file.
    """

    def __init__(self, name: str, port: ScreenPort, clock: Clock, settings: VideoOutOptions | None = None) -> None:
        super().__init__(name, clock)
        self.settings = settings or VideoOutOptions(kind="video")
        self._port = port
        self._output: ScreenOutput | None = None
        self._pictures: list[U8] = []
        self._running: PatternSequence | None = None
        self._refresh = 0
        self._shown_ns = 0

    @property
    def refresh_s(self) -> float:
        """Get the time from one picture to the next."""
        return self.info.exposure_step_s

    def _do_connect(self) -> ModulatorInfo:
        wanted = "" if self.settings.port == LAST else self.settings.port
        with port_errors(self.name, "open"):
            output = self._output = self._port.open(wanted)
        self._straighten()
        period_s = 1 / output.refresh_hz
        outs = frozenset(TriggerOut) if self.settings.trigger_patch else frozenset({TriggerOut.NONE})
        return ModulatorInfo(
            model=f"video output {output.name}",
            serial="",
            firmware=f"{output.refresh_hz:.3f} Hz",
            height=output.height,
            width=output.width,
            pitch_m=self.settings.pitch_um * 1e-6,
            min_exposure_s=dict.fromkeys(DEPTHS, period_s),
            max_exposure_s=MAX_EXPOSURE_S,
            exposure_step_s=period_s,
            min_dark_s=period_s,
            capacity=dict.fromkeys(DEPTHS, CAPACITY),
            trigger_outs=outs,
            start_latency_s=None,
            hardware_timed=False,
            experimental=True,
        )

    def levels(self, mask: U8 | U16, bit_depth: int) -> U8:
        """Return a mask's grey levels, [H, W] uint8: by the table if given, otherwise linear from dark to bright."""
        shares = np.linspace(0, 1, 1 << bit_depth)
        greys = self.settings.greys
        table = np.interp(shares, np.linspace(0, 1, len(greys)), greys)
        return np.asarray(np.rint(table).astype(np.uint8)[mask])

    def _do_upload_eta_s(self, sequence: PatternSequence) -> float:
        return 2e-3 * sequence.count

    def _do_upload(self, sequence: PatternSequence, progress: UploadProgress) -> int:
        self._go_dark()
        self._pictures = []
        for i, mask in enumerate(sequence.masks):
            self._pictures.append(self.levels(mask, sequence.bit_depth))
            progress((i + 1) / sequence.count)
        return sum(picture.nbytes for picture in self._pictures)

    def _require_output(self, asked: str) -> None:
        """Raise an error if the output is gone: the window of a missing output still accepts pictures."""
        with port_errors(self.name, asked):
            if self._output not in self._port.list_outputs():
                raise DisconnectedError(self.name, asked, "the video output has been disconnected")

    def _straighten(self) -> None:
        """Undo what another program does to levels on their way to the panel, by now: a night light comes at dusk."""
        with port_errors(self.name, "gamma ramp"):
            notes = [f"{self.name}: {note}" for note in self._port.straighten()]
        self.incidents += [note for note in notes if note not in self.incidents]

    def _do_arm(self, sequence: PatternSequence) -> None:
        self._require_output("arm")
        self._straighten()
        self._go_dark()

    def _do_start(self, sequence: PatternSequence) -> None:
        self._running, self._refresh, self._shown_ns = sequence, 0, 0
        self._step(sequence)

    def _step(self, sequence: PatternSequence) -> None:
        """Show the picture that is due at the next refresh, and compare its time with that of the one before.

        Raises:
            SequenceError: A picture was on show for longer or shorter than it should have been.
        """
        drawn = self._refresh + self._idle_refreshes()
        slot, since = self._due(sequence, drawn)
        with port_errors(self.name, "flip"):
            shown_ns = self._port.flip(self._drawn(sequence, slot, since))
        before_ns, self._shown_ns = self._shown_ns, shown_ns
        if not before_ns:
            self._refresh = 1
            return
        passed = (shown_ns - before_ns) * 1e-9 / self.refresh_s
        first, shown = self._refresh, self._refresh + round(passed) - 1
        # A picture that stays because the next one is the same is shown for the planned time.
        stayed = all(self._looks(sequence, first - 1) == self._looks(sequence, one) for one in range(first, shown))
        fits = self._looks(sequence, drawn) == self._looks(sequence, shown)
        if passed < UNEVEN or not stayed or not fits:
            self._running = None
            what = "dropped" if passed < UNEVEN else "doubled"
            self._show_dark()
            raise SequenceError(
                self.name,
                f"refresh {first}",
                (f"a picture was {what}: the next one came {passed:.2f} refreshes after it",),
                remedy="close other programs, turn the compositor off, and let nothing else draw on this output",
            )
        self._refresh = shown + 1

    def _idle_refreshes(self) -> int:
        """Return how many refreshes passed without a call since the last picture."""
        if not self._shown_ns:
            return 0
        passed = (self._port.clock_ns() - self._shown_ns) * 1e-9 / self.refresh_s
        return max(0, int(passed + 1e-6))

    def _looks(self, sequence: PatternSequence, refresh: int) -> tuple[int | None, bool]:
        """Return which mask is due at a refresh, and whether the trigger patch is lit with it."""
        slot, since = self._due(sequence, refresh)
        return slot, self._is_lit(sequence, slot, since)

    def _due(self, sequence: PatternSequence, refresh: int) -> tuple[int | None, int]:
        """Return which mask is due at a refresh, None for dark, and for how many refreshes it has been."""
        step = self.refresh_s
        shown, dark, pause = (
            round(time_s / step) for time_s in (sequence.exposure_s, sequence.dark_s, sequence.pause_s)
        )
        period = sequence.count * shown + (sequence.count - 1) * dark + pause
        slot, since = divmod(refresh % period, shown + dark)
        if slot >= sequence.count:  # the pause is longer than a mask
            return None, since
        return (slot, since) if since < shown else (None, since)

    def _drawn(self, sequence: PatternSequence, slot: int | None, since: int) -> U8:
        """Return a mask's picture with the trigger patch in it."""
        picture = self._dark() if slot is None else self._pictures[slot]
        if self.settings.trigger_patch is None:
            return picture
        lit = self._is_lit(sequence, slot, since)
        return self._with_patch(picture, lit=lit)

    def _is_lit(self, sequence: PatternSequence, slot: int | None, since: int) -> bool:
        lit = {
            TriggerOut.NONE: False,
            TriggerOut.PER_EXPOSURE: slot == 0 and since == 0,
            TriggerOut.GATE: True,
            TriggerOut.PER_MASK: since == 0,
            TriggerOut.GATE_PER_MASK: True,
        }
        return slot is not None and lit[sequence.trigger]

    def _with_patch(self, picture: U8, *, lit: bool) -> U8:
        assert self.settings.trigger_patch is not None
        top, left, height, width = self.settings.trigger_patch
        drawn = picture.copy()
        drawn[top : top + height, left : left + width] = self.settings.greys[-1 if lit else 0]
        return drawn

    def _dark(self) -> U8:
        return np.full((self.info.height, self.info.width), self.settings.greys[0], np.uint8)

    def _refreshes(self, sequence: PatternSequence) -> int:
        return round(sequence.duration_s / self.refresh_s)

    def _do_keep_time(self, until_s: float) -> None:
        sequence = self._running
        while sequence is not None and self._is_unfinished(sequence) and self.clock.now_s() < until_s:
            self._step(sequence)
        if sequence is not None and not self._is_unfinished(sequence):
            self._end()
        self.clock.sleep_s(until_s - self.clock.now_s())

    def _is_unfinished(self, sequence: PatternSequence) -> bool:
        return sequence.repeats == 0 or self._refresh < self._refreshes(sequence)

    def _do_wait_done(self, timeout_s: float) -> None:
        sequence = self._running
        if sequence is None:
            return
        deadline_s = self.clock.now_s() + timeout_s
        while self._is_unfinished(sequence):
            if self.clock.now_s() > deadline_s:
                raise NoAnswerError(
                    self.name, "wait for the end of the sequence", timeout_s, remedy="wait longer or disarm"
                )
            self._step(sequence)
        self._end()

    def _end(self) -> None:
        self._running = None
        self._show_dark()
        self.clock.sleep_s(self.settings.frames_late * self.refresh_s)  # until the panel itself is dark

    def _do_disarm(self) -> None:
        self._go_dark()

    def _go_dark(self) -> None:
        self._running = None
        self._show_dark()

    def _show_dark(self) -> None:
        with port_errors(self.name, "flip"):
            self._port.flip(self._dark())

    def _do_status(self) -> ModulatorStatus:
        self._require_output("status")
        return ModulatorStatus(self._state_if(self._running is not None))

    def _do_close(self) -> None:
        self._port.close()
