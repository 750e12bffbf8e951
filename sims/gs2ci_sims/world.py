"""The world that all twins of a rig share: its clock, its trigger lines, the camera's pose, the mask that is shown.

Time is virtual and passes only while a caller waits on the clock; actions scheduled by twins run meanwhile, in order of
time. The stage twin returns the positions of the axes at any past time, the modulator twin sets the mask that it shows,
and the sensor twin calls `World.integrate` for the light that a pixel array collects between two times.

Here: the clock, the bus, the histories, the record of one exposure. Not here: light (`gs2ci_sims.light_path` behind the
`LightPath` interface), protocols (`gs2ci_sims.wires`). Drivers never use this module.
"""

import heapq
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import count
from typing import Protocol

import numpy as np

from gs2ci.core.arrays import F64, U8, U16
from gs2ci.core.errors import InputError
from gs2ci_sims.stated import Stated

BOOT_S = 1000.0
"""Time of the clock when a world begins: not 0, so that earlier times are positive, too."""


@dataclass(order=True)
class Event:
    """A scheduled action; ordered by time, then by the order of scheduling."""

    when_s: float
    order: int
    action: Callable[[], None] = field(compare=False)
    cancelled: bool = field(default=False, compare=False)

    def cancel(self) -> None:
        """Cancel it; allowed any number of times, also afterwards."""
        self.cancelled = True


class VirtualClock:
    """A clock (`gs2ci.core.clock.Clock`) whose time passes only by waiting."""

    def __init__(self, start_s: float = BOOT_S) -> None:
        self._now_s = start_s
        self._events: list[Event] = []
        self._order = count()
        self._inside = False

    def now_s(self) -> float:
        """Get the time in seconds."""
        return self._now_s

    def now_ns(self) -> int:
        """Get the time in nanoseconds, as the kernel's monotonic clock would show it."""
        return round(self._now_s * 1e9)

    def at(self, when_s: float, action: Callable[[], None]) -> Event:
        """Schedule `action`; a past time counts as now. Actions must not wait."""
        event = Event(max(when_s, self._now_s), next(self._order), action)
        heapq.heappush(self._events, event)
        return event

    def after(self, delay_s: float, action: Callable[[], None]) -> Event:
        """Schedule `action` for `delay_s` from now."""
        return self.at(self._now_s + delay_s, action)

    def sleep_s(self, duration_s: float) -> None:
        """Let time pass; all actions scheduled in it run."""
        self.wait_until(lambda: False, duration_s)

    def wait_until(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Let time pass until `done()` holds or `timeout_s` is over; return whether it holds.

        Time stops at the event that made it hold, so a wait takes no more virtual time than needed.

        Raises:
            RuntimeError: Called from inside a scheduled action, which must not wait.
        """
        if self._inside:
            raise RuntimeError("a scheduled action waited on the clock; schedule a later action instead")
        deadline_s = self._now_s + max(timeout_s, 0.0)
        if done():
            return True
        while self._events and self._events[0].when_s <= deadline_s:
            event = heapq.heappop(self._events)
            if event.cancelled:
                continue
            self._now_s = max(self._now_s, event.when_s)
            self._inside = True
            try:
                event.action()
            finally:
                self._inside = False
            if done():
                return True
        self._now_s = max(self._now_s, deadline_s)
        return done()


@dataclass(frozen=True)
class Edge:
    """A change of a trigger line."""

    when_s: float
    line: str
    level: bool


EdgeListener = Callable[[Edge], None]


class TriggerBus:
    """Named trigger lines ("dmd0.out2"), low until driven, with a log of every change."""

    def __init__(self, clock: VirtualClock) -> None:
        self.edges: list[Edge] = []
        self._clock = clock
        self._levels: dict[str, bool] = defaultdict(bool)
        self._listeners: dict[str, list[EdgeListener]] = defaultdict(list)

    def level(self, line: str) -> bool:
        """Get the level of a line."""
        return self._levels[line]

    def drive(self, line: str, level: bool) -> None:
        """Set a line now; listeners are called if that changes it."""
        if self._levels[line] == level:
            return
        self._levels[line] = level
        edge = Edge(self._clock.now_s(), line, level)
        self.edges.append(edge)
        for listener in tuple(self._listeners[line]):
            listener(edge)

    def pulse(self, line: str, width_s: float, *, level: bool = True) -> None:
        """Set a line to a level now and to the other one `width_s` later."""
        self.drive(line, level)
        self._clock.after(width_s, lambda: self.drive(line, not level))

    def listen(self, line: str, listener: EdgeListener) -> None:
        """Call `listener` at every change of a line, at its time."""
        self._listeners[line].append(listener)

    def forget_before(self, when_s: float) -> None:
        """Delete changes before a time."""
        kept = bisect_right(self.edges, when_s, key=lambda edge: edge.when_s)
        del self.edges[:kept]

    def rising(self, line: str) -> list[float]:
        """Return the times at which a line rose so far."""
        return [edge.when_s for edge in self.edges if edge.line == line and edge.level]


@dataclass(frozen=True)
class MaskInterval:
    """A mask that was shown during a part of an exposure.

    Args:
        levels: Levels of the modulator's pixels, [Hm, Wm] uint8 or uint16.
        top: The level of a fully open pixel.
        start_s: Begin on the world's clock, cut to the exposure.
        end_s: End on the world's clock, cut to the exposure.
    """

    levels: U8 | U16
    top: int
    start_s: float
    end_s: float


@dataclass(frozen=True)
class Exposure:
    """All that determines the light that a sensor collects in one exposure.

    Args:
        index: How many exposures this world has integrated before, used to seed noise.
        start_s: Begin on the world's clock.
        end_s: End on the world's clock.
        masks: The masks shown, in order of time; between them the modulator is dark.
        world_to_camera_at: The camera's pose, [4, 4], at a time on the world's clock.
        height: Rows of the sensor.
        width: Columns of the sensor.
        bits: Bits of a pixel.
    """

    index: int
    start_s: float
    end_s: float
    masks: tuple[MaskInterval, ...]
    world_to_camera_at: Callable[[float], F64]
    height: int
    width: int
    bits: int


class LightPath(Protocol):
    """From light to numbers: the interface of a simulator of optics and sensor for the twins."""

    def collect(self, exposure: Exposure) -> U16:
        """Return the sensor's pixels after an exposure, [H, W] uint16 in 0 to 2**bits − 1."""


class Darkness:
    """A light path without light, for twins whose pictures are not used."""

    def collect(self, exposure: Exposure) -> U16:
        """Return zeros; see `LightPath`."""
        return np.zeros((exposure.height, exposure.width), np.uint16)


class Motion(Protocol):
    """An object with the history of its axes' positions: a stage twin."""

    def positions_mm_at(self, when_s: float) -> Mapping[str, float]:
        """Return the true positions of the axes at a time up to now."""


@dataclass(frozen=True)
class Mount:
    """How the stage moves the camera.

    Args:
        rest_world_to_camera: The camera's pose when all axes are at `rest_mm`, [4, 4], OpenCV axes.
        directions: For each axis, the camera's motion per mm in its own rest frame, [3], in the scene's unit.
        rest_mm: Positions of the axes in the rest pose; an axis that is not named rests at 0.
    """

    rest_world_to_camera: F64 = field(default_factory=lambda: np.eye(4))
    directions: Mapping[str, tuple[float, float, float]] = field(
        default_factory=lambda: {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    )
    rest_mm: Mapping[str, float] = field(default_factory=dict)

    def world_to_camera(self, positions_mm: Mapping[str, float]) -> F64:
        """Return the camera's pose, [4, 4], for these positions: moving the camera by d moves the scene by −d."""
        shift = np.zeros(3)
        for axis, position in positions_mm.items():
            if axis in self.directions:
                shift += np.asarray(self.directions[axis]) * (position - self.rest_mm.get(axis, 0.0))
        camera_from_rest = np.eye(4)
        camera_from_rest[:3, 3] = -shift
        return np.asarray(camera_from_rest @ self.rest_world_to_camera, dtype=np.float64)


@dataclass(frozen=True)
class _Shown:
    start_s: float
    levels: U8 | U16 | None
    top: int


class World:
    """The surroundings of one rig; twins have access to it, drivers never do.

    Args:
        light: Turns an exposure into pixels; None: darkness.
        mount: How the stage moves the camera.
        stated: What a rig file states of the surroundings, for those who build twins.
    """

    def __init__(
        self, light: LightPath | None = None, mount: Mount | None = None, stated: Stated | None = None
    ) -> None:
        self.clock = VirtualClock()
        self.bus = TriggerBus(self.clock)
        self.light = light or Darkness()
        self.mount = mount or Mount()
        self.stated = stated or Stated()
        self.exposures: list[Exposure] = []
        self._forgotten = 0
        self._motion: Motion | None = None
        self._shown: list[_Shown] = [_Shown(float("-inf"), None, 1)]

    def carry_camera(self, motion: Motion) -> None:
        """Attach the camera to a stage twin."""
        self._motion = motion

    def world_to_camera_at(self, when_s: float) -> F64:
        """Return the camera's true pose at a time up to now, [4, 4]."""
        return self.mount.world_to_camera(self._motion.positions_mm_at(when_s) if self._motion else {})

    def forget_before(self, when_s: float) -> list[int]:
        """Delete exposures, masks and changes of lines before a time; return the exposures' indices.

        The mask shown at that time is kept, and the count of exposures goes on.
        """
        done = bisect_right(self.exposures, when_s, key=lambda exposure: exposure.end_s)
        forgotten = [exposure.index for exposure in self.exposures[:done]]
        del self.exposures[:done]
        self._forgotten += done
        shown = bisect_right(self._shown, when_s, key=lambda one: one.start_s) - 1
        del self._shown[: max(shown, 0)]
        self.bus.forget_before(when_s)
        return forgotten

    def show_mask(self, levels: U8 | U16 | None, top: int = 1) -> None:
        """Show a mask, [H, W], from now on; None is dark. The array must not be changed afterwards.

        Raises:
            InputError: Not two-dimensional, or `top` below 1.
        """
        if levels is not None and (levels.ndim != 2 or top < 1):
            raise InputError(f"mask of shape {list(levels.shape)}, top {top}", allowed="[H, W] with top >= 1")
        now_s = self.clock.now_s()
        if self._shown[-1].start_s == now_s:
            self._shown.pop()
        self._shown.append(_Shown(now_s, levels, top))

    def masks_between(self, start_s: float, end_s: float) -> tuple[MaskInterval, ...]:
        """Return the masks shown between two times, cut to these; dark times are left out."""
        first = bisect_right(self._shown, start_s, key=lambda shown: shown.start_s) - 1
        intervals = []
        for i in range(max(first, 0), len(self._shown)):
            shown = self._shown[i]
            until_s = self._shown[i + 1].start_s if i + 1 < len(self._shown) else float("inf")
            begin, end = max(shown.start_s, start_s), min(until_s, end_s)
            if begin >= end_s:
                break
            if shown.levels is not None and end > begin:
                intervals.append(MaskInterval(shown.levels, shown.top, begin, end))
        return tuple(intervals)

    def integrate(self, start_s: float, end_s: float, *, height: int, width: int, bits: int) -> U16:
        """Return the sensor's pixels for the light between two times up to now, [H, W] uint16.

        Raises:
            InputError: The exposure ends in the future or has no length.
        """
        if not start_s < end_s <= self.clock.now_s() + 1e-9:  # a nanosecond: the clock's own rounding
            raise InputError(
                f"exposure from {start_s:.9f} to {end_s:.9f} s at {self.clock.now_s():.9f} s",
                allowed="a positive length that ends by now",
            )
        exposure = Exposure(
            index=self._forgotten + len(self.exposures),
            start_s=start_s,
            end_s=end_s,
            masks=self.masks_between(start_s, end_s),
            world_to_camera_at=self.world_to_camera_at,
            height=height,
            width=width,
            bits=bits,
        )
        self.exposures.append(exposure)
        return self.light.collect(exposure)
