"""The shutter of a simulated camera: triggers and exposures on the world's clock, whatever interface is above it.

Timing of an edge-triggered sensor without overlap: edge, latency, exposure, readout, transfer; an edge before the end
of the readout is lost, which the frame numbers do not show. Not here: the cameras (`v4l2_camera`, `genicam`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from gs2ci.core.arrays import U16, Rng
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.world import Edge, Event, World


class Shutting(Enum):
    """The event that begins an exposure."""

    FREE = "free"
    EDGE = "edge"
    LEVEL = "level"


@dataclass(frozen=True)
class ShutterModel:
    """The times of a camera's exposures.

    Args:
        trigger_line: Line on the world's trigger bus; "" is not wired.
        latency_s: Mean time from an edge, and a delay that is set, to the start of exposure.
        jitter_s: Standard deviation of it.
        exposure_offset_s: Constant added to every triggered exposure.
        readout_s: From the end of exposure until the next edge is taken.
        transfer_s: From the end of readout until the buffer is full.
        own_period_s: Frame period by its own clock, at least.
    """

    trigger_line: str = ""
    latency_s: float = 0.0
    jitter_s: float = 0.0
    exposure_offset_s: float = 0.0
    readout_s: float = 1e-3
    transfer_s: float = 0.5e-3
    own_period_s: float = 1 / 60


@dataclass(frozen=True)
class Exposed:
    """An exposure that has ended, on the world's clock."""

    start_s: float
    end_s: float


def by_rows(exposed: Exposed, skew_s: float, height: int, integrate: Callable[[float, float], U16]) -> U16:
    """Integrate light as a rolling shutter does, [height, W]: in four steps, the last quarter `skew_s` after the first.

    Args:
        exposed: The exposure of the first rows.
        skew_s: By how much later the last rows begin and end; 0 exposes all at once.
        height: Number of rows.
        integrate: Returns all rows between two times.
    """
    pixels, quarter = integrate(exposed.start_s, exposed.end_s), -(-height // 4)
    for k in (1, 2, 3) if skew_s else ():
        rows, later_s = slice(k * quarter, (k + 1) * quarter), skew_s * k / 3
        pixels[rows] = integrate(exposed.start_s + later_s, exposed.end_s + later_s)[rows]
    return pixels


class CameraShutter:
    """The shutter, which exposes by its own clock or by a trigger line while it runs.

    Args:
        world: The simulated world, with clock and trigger bus.
        model: Its times.
        faults: The faults to inject.
        rng: Draws the jitter.
        exposure_s: Returns the exposure that is set.
        deliver: Called when a frame has been read out.
        active_low: Returns whether it exposes while its line is low.
        delay_s: Returns the delay that is set between a trigger and its exposure.
        longer_ppm: By how much its second is longer than the world's.
    """

    def __init__(
        self,
        world: World,
        model: ShutterModel,
        faults: FaultSet,
        *,
        rng: Rng,
        exposure_s: Callable[[], float],
        deliver: Callable[[Exposed], None],
        active_low: Callable[[], bool],
        delay_s: Callable[[], float] = lambda: 0.0,
        longer_ppm: float = 0.0,
    ) -> None:
        self._clock = world.clock
        self._model = model
        self._faults = faults
        self._rng = rng
        self._exposure_s = exposure_s
        self._deliver = deliver
        self._active_low = active_low
        self._delay_s = delay_s
        self._longer_ppm = longer_ppm
        self._how: Shutting | None = None
        self._pending: list[Event] = []
        self._busy_until_s = 0.0
        self._opened_s: float | None = None
        self._stalled = False
        if model.trigger_line:
            world.bus.listen(model.trigger_line, self._on_edge)

    def start(self, how: Shutting) -> None:
        """Begin to expose, triggered by `how`."""
        self._how, self._stalled = how, False
        self._opened_s, self._busy_until_s = None, self._clock.now_s()
        if how is Shutting.FREE:
            self._plan(self._clock.now_s(), self._free_run)

    def stop(self) -> None:
        """End the current exposure or readout; no frame is delivered any more."""
        self._how = None
        for event in self._pending:
            event.cancel()
        self._pending.clear()

    def _plan(self, when_s: float, action: Callable[[], None]) -> None:
        self._pending = [event for event in self._pending if event.when_s >= self._clock.now_s()]
        self._pending.append(self._clock.at(when_s, action))

    def _free_run(self) -> None:
        start_s, seconds = self._clock.now_s(), self._stretched(self._exposure_s())
        self._expose(start_s, start_s + seconds)
        period_s = max(self._stretched(self._model.own_period_s), seconds + self._model.readout_s)
        self._plan(start_s + period_s, self._free_run)

    def _stretched(self, seconds: float) -> float:
        return seconds * (1 + self._longer_ppm * 1e-6)

    def _on_edge(self, edge: Edge) -> None:
        if edge.level is not self._active_low():
            self._on_rise(edge.when_s)
        elif self._how is Shutting.LEVEL and self._opened_s is not None:
            opened_s, self._opened_s = self._opened_s, None
            end_s = edge.when_s + self._delay_s() + self._model.latency_s + self._model.exposure_offset_s
            self._expose(opened_s, max(end_s, opened_s + 1e-9))

    def _on_rise(self, when_s: float) -> None:
        if self._how not in (Shutting.EDGE, Shutting.LEVEL) or when_s < self._busy_until_s:
            return
        if self._faults.take("v4l2.trigger_missed"):
            return
        jitter_s = self._model.jitter_s * self._rng.standard_normal()
        start_s = when_s + self._delay_s() + max(0.0, self._model.latency_s + jitter_s)
        if self._how is Shutting.LEVEL:
            self._opened_s = start_s
            return
        end_s = start_s + self._stretched(self._exposure_s()) + self._model.exposure_offset_s
        self._expose(start_s, end_s)
        if self._faults.take("v4l2.trigger_doubled"):
            self._expose(self._busy_until_s, self._busy_until_s + end_s - start_s)

    def _expose(self, start_s: float, end_s: float) -> None:
        read_s = end_s + self._model.readout_s
        self._busy_until_s = read_s
        if self._stalled or self._faults.take("v4l2.stalled"):
            self._stalled = True
            return
        done_s = read_s + self._model.transfer_s
        self._plan(done_s, lambda: self._deliver(Exposed(start_s, end_s)))
