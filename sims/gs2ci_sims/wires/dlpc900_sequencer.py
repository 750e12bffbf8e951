"""The DLPC900's sequencer in the world: shows bit-planes for their times and drives the two trigger outputs.

Here: one run from start to stop. Not here: commands and image memory (`dlpc900_firmware`).
"""

from collections.abc import Callable
from dataclasses import dataclass

from gs2ci.core.arrays import U8, U16
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.world import Event, World

# Default time from a start to the first step.
START_LATENCY_S = 500e-6
_DOUBLE_PULSE_S = 60e-6
_NEVER = 1 << 62


@dataclass(frozen=True)
class Step:
    """One sequence entry, ready to show.

    Args:
        levels: Light of the mirrors, [H, W] uint8 or uint16.
        top: Light of a fully open mirror.
        exposure_s: Time for which it is shown.
        dark_s: Dark time afterwards.
        pulse: Whether trigger output 2 fires at its beginning.
        waits: Whether trigger input 1 must rise first.
    """

    levels: U8 | U16
    top: int
    exposure_s: float
    dark_s: float
    pulse: bool
    waits: bool


@dataclass(frozen=True)
class Output:
    """Setting of one trigger output: seconds relative to the mask, and polarity."""

    inverted: bool = False
    rise_s: float = 0.0
    fall_s: float = 0.0


class Sequencer:
    """Runs steps on the world's clock.

    Args:
        world: Where masks are shown.
        name: Prefix of the lines: `<name>.out1`, `<name>.out2`, `<name>.in1`.
        faults: The faults to inject.
    """

    def __init__(self, world: World, name: str, faults: FaultSet) -> None:
        self.start_latency_s = START_LATENCY_S
        self.world = world
        self.faults = faults
        self.running = False
        self.paused = False
        self.aborted = False
        self.shown = 0
        self.outputs = [Output(), Output()]
        self.trigger_in_delay_s = 105e-6
        self._lines = (f"{name}.out1", f"{name}.out2")
        self._steps: list[Step] = []
        self._total = 0
        self._pending: list[Event] = []
        self._waiting = False
        world.bus.listen(f"{name}.in1", lambda edge: self._advance() if edge.level else None)

    def configure(self, output: int, setting: Output) -> None:
        """Set a trigger output, 0 or 1; its idle level takes effect at once."""
        self.outputs[output] = setting
        self._drive(output, active=False)

    def start(self, steps: list[Step], total: int) -> None:
        """Begin with the first step, or continue after a pause; show `total` masks in all, 0 for ever."""
        if self.paused:
            self.paused, self.running = False, True
            self._plan(self.shown, self.world.clock.now_s() + self.start_latency_s)
            return
        self.stop()
        off = self.faults.take("dlpc900.count_off")
        self._steps = steps
        self._total = (total or _NEVER) + (int(off.value or 1) if off else 0)
        self.running = True
        self._plan(0, self.world.clock.now_s() + self.start_latency_s)

    def pause(self) -> None:
        """Stop; the next start continues with the current step."""
        if self.running:
            shown = self.shown
            self.stop()
            self.paused, self.shown = True, shown

    def stop(self) -> None:
        """Go dark; the next start begins with the first step."""
        for event in self._pending:
            event.cancel()
        self._pending.clear()
        self.running = self.paused = self._waiting = False
        self.shown = 0
        self.world.show_mask(None)
        for output in (0, 1):
            self._drive(output, active=False)

    def _plan(self, index: int, when_s: float) -> None:
        """Schedule step `index` to begin at `when_s`, trigger edges included (they may come before it)."""
        now_s = self.world.clock.now_s()
        self._pending = [event for event in self._pending if event.when_s >= now_s and not event.cancelled]
        step = self._steps[index % len(self._steps)]
        self._at(when_s, lambda: self._begin(index))
        self._at(when_s + self.outputs[0].rise_s, lambda: self._drive(0, active=True))
        pulse = step.pulse != (self.faults.take("dlpc900.suppress_inverted") is not None)
        if pulse and not self.faults.take("dlpc900.pulse_lost"):
            self._pulse(when_s)
            if self.faults.take("dlpc900.pulse_twice"):
                self._pulse(when_s + _DOUBLE_PULSE_S)

    def _pulse(self, when_s: float) -> None:
        setting = self.outputs[1]
        # The hardware makes no pulse shorter than 20 µs.
        fall_s = max(setting.fall_s, setting.rise_s + 20e-6)
        self._at(when_s + setting.rise_s, lambda: self._drive(1, active=True))
        self._at(when_s + fall_s, lambda: self._drive(1, active=False))

    def _begin(self, index: int) -> None:
        if self.faults.take("dlpc900.stops_early"):
            self.stop()
            return
        if self.faults.take("dlpc900.sequencer_abort"):
            self.aborted = True
            self.stop()
            return
        step = self._steps[index % len(self._steps)]
        self.shown = index
        self.world.show_mask(step.levels, step.top)
        self._at(self.world.clock.now_s() + step.exposure_s, lambda: self._end(index))

    def _end(self, index: int) -> None:
        step = self._steps[index % len(self._steps)]
        now_s = self.world.clock.now_s()
        last = index + 1 >= self._total
        following = self._steps[(index + 1) % len(self._steps)]
        if last or step.dark_s > 0 or following.waits:
            self.world.show_mask(None)
            fall = self._at(now_s + self.outputs[0].fall_s, lambda: self._drive(0, active=False))
            if last:
                self._pending.remove(fall)  # the line still falls after the end
        if last:
            self._at(now_s + step.dark_s, self._finish)
        elif following.waits:
            self._waiting, self.shown = True, index + 1
        else:
            self._plan(index + 1, now_s + step.dark_s)

    def _advance(self) -> None:
        if self.running and self._waiting:
            self._waiting = False
            self._plan(self.shown, self.world.clock.now_s() + self.trigger_in_delay_s)

    def _finish(self) -> None:
        self.running = False
        self.shown = 0

    def _at(self, when_s: float, action: Callable[[], None]) -> Event:
        event = self.world.clock.at(when_s, action)
        now_s = self.world.clock.now_s()
        self._pending = [one for one in self._pending if one.when_s >= now_s and not one.cancelled]
        self._pending.append(event)
        return event

    def _drive(self, output: int, *, active: bool) -> None:
        self.world.bus.drive(self._lines[output], active != self.outputs[output].inverted)
