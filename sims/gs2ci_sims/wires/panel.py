"""A light modulator panel in the world: shows masks with a response time, plays timed sequences, drives one line.

Here: the common part of the LCoS-like twins. Not here: the protocols (`scpi_modulator`, `display_slm`), the mirrors of
the DLPC900, which switch at once.
"""

import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gs2ci.core.arrays import F32, U8, U16
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.world import Event, World

Levels = U8 | U16

PULSE_S = 50e-6
_TOP_16 = 0xFFFF
# The transition is drawn in steps of half a time constant, until one per mille of it remains.
_STEPS_PER_TIME_CONSTANT = 2
_TIME_CONSTANTS = 7
_MEAN_OF_STEP = -math.expm1(-1 / _STEPS_PER_TIME_CONSTANT) * _STEPS_PER_TIME_CONSTANT


def transmissions(greys: Sequence[int], top: int, full: int) -> U16:
    """Return the light that optics pass at each of a panel's levels 0 to `top`, [top + 1], of `full` at most.

    Args:
        greys: The levels at transmissions 0 to 1 in equal steps, rising or falling; linear in between, constant beyond.
        top: The panel's highest level.
        full: The number that stands for a transmission of 1.
    """
    known, shares = np.asarray(greys), np.linspace(0, full, len(greys))
    order = slice(None, None, 1 if known[0] < known[-1] else -1)
    return np.rint(np.interp(np.arange(top + 1), known[order], shares[order])).astype(np.uint16)


class Out(enum.Enum):
    """The signal of the trigger line during a sequence."""

    NONE = "NONE"
    EXPOSURE = "EXPOSURE"
    GATE = "GATE"
    MASK = "MASK"


@dataclass(frozen=True)
class Show:
    """A timed sequence.

    Args:
        masks: Levels of each mask, [H, W].
        top: Level of a fully open pixel.
        exposure_s: Time for which each mask is shown.
        dark_s: Dark time between masks.
        pause_s: Dark time after a pass.
        repeats: Passes; 0 for ever.
        out: Signal of the trigger line.
    """

    masks: list[Levels]
    top: int
    exposure_s: float
    dark_s: float
    pause_s: float
    repeats: int
    out: Out


class Panel:
    """Pixels that follow the set levels with a first-order response.

    Args:
        world: Where masks are shown.
        line: The trigger line ("lcos0.out").
        faults: The faults to inject.
        response_s: Time constant of rise and fall; 0 switches at once.
    """

    def __init__(self, world: World, line: str, faults: FaultSet, response_s: float = 0.0) -> None:
        self.world = world
        self.line = line
        self.faults = faults
        self.response_s = response_s
        self.running = False
        self.shown = 0
        self._target: tuple[Levels, int] | None = None
        self._left: F32 | float = 0.0
        self._left_s = world.clock.now_s()
        self._settling: list[Event] = []
        self._next: Event | None = None

    def set(self, levels: Levels | None, top: int = 1) -> None:
        """Drive the pixels to these levels; None to dark."""
        for event in self._settling:
            event.cancel()
        self._settling.clear()
        # A mask that is shown for a few time constants leaves pixels on their way.
        self._left, self._left_s = self._share_now(), self.world.clock.now_s()
        self._target = None if levels is None else (levels, top)
        if self.response_s > 0 and (levels is not None or np.any(self._left)):
            self._blend(self._left, self._target)
        else:
            self.world.show_mask(levels, top)

    def _share_now(self) -> F32 | float:
        """Return the transmission of the pixels, [H, W], or of all."""
        target = _share(self._target)
        passed_s = self.world.clock.now_s() - self._left_s
        if passed_s >= _TIME_CONSTANTS * self.response_s:
            return target
        return target + (self._left - target) * math.exp(-passed_s / self.response_s)

    def _blend(self, old: F32 | float, after: tuple[Levels, int] | None) -> None:
        new = _share(after)
        step_s = self.response_s / _STEPS_PER_TIME_CONSTANT

        def draw(step: int) -> None:
            # The mean level of the step is used for the whole step.
            left = math.exp(-step / _STEPS_PER_TIME_CONSTANT) * _MEAN_OF_STEP
            mixed = np.asarray(new + (old - new) * left)
            self.world.show_mask(np.rint(mixed * _TOP_16).astype(np.uint16), _TOP_16)

        def rest() -> None:
            self.world.show_mask(*(after or (None, 1)))

        draw(0)
        steps = _TIME_CONSTANTS * _STEPS_PER_TIME_CONSTANT
        clock = self.world.clock
        self._settling = [clock.after(step * step_s, _bound(draw, step)) for step in range(1, steps)]
        self._settling.append(clock.after(steps * step_s, rest))

    def play(self, show: Show, latency_s: float) -> None:
        """Begin a sequence after `latency_s`."""
        self.stop()
        self.running = True
        self._after(latency_s, lambda: self._begin(show, 0))

    def stop(self) -> None:
        """End the sequence and go dark."""
        if self._next:
            self._next.cancel()
        self.running = False
        self.shown = 0
        self.set(None)
        self.world.bus.drive(self.line, False)

    def pulse(self) -> None:
        """Pulse the trigger line once; with a fault not at all, or twice."""
        if self.faults.take("panel.pulse_lost"):
            return
        self.world.bus.pulse(self.line, PULSE_S)
        twice = self.faults.take("panel.pulse_twice")
        if twice:
            gap_s = max(twice.value, 1.2 * PULSE_S)
            self.world.clock.after(gap_s, lambda: self.world.bus.pulse(self.line, PULSE_S))

    def _begin(self, show: Show, index: int) -> None:
        if self.faults.take("panel.stops_early"):
            shown = self.shown
            self.stop()
            self.shown = shown
            return
        slot = index % len(show.masks)
        if self.faults.take("panel.mask_skipped"):
            self.set(None)
        else:
            self.set(show.masks[slot], show.top)
            self.shown += 1
        if show.out is Out.MASK or (show.out is Out.EXPOSURE and slot == 0):
            self.pulse()
        elif show.out is Out.GATE and slot == 0:
            self.world.bus.drive(self.line, True)
        self._after(show.exposure_s, lambda: self._end(show, index))

    def _end(self, show: Show, index: int) -> None:
        ends_pass = (index + 1) % len(show.masks) == 0
        last = show.repeats > 0 and index + 1 >= show.repeats * len(show.masks)
        wait_s = show.pause_s if ends_pass else show.dark_s
        if wait_s > 0 or last:
            self.set(None)
        if ends_pass and show.out is Out.GATE:
            self.world.bus.drive(self.line, False)
        self._after(wait_s, self._finish if last else lambda: self._begin(show, index + 1))

    def _finish(self) -> None:
        self.running = False

    def _after(self, delay_s: float, action: Callable[[], None]) -> None:
        self._next = self.world.clock.after(delay_s, action)


def _share(shown: tuple[Levels, int] | None) -> F32 | float:
    return shown[0].astype(np.float32) / np.float32(shown[1]) if shown else 0.0


def _bound(draw: Callable[[int], None], step: int) -> Callable[[], None]:
    return lambda: draw(step)
