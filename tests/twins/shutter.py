"""A shutter that loses edges as odd cameras do: behind a debouncer, after a start, within a limit of the frame rate.

Or it keeps those that come too early, or exposes several times for one.
"""

from collections.abc import Callable
from dataclasses import replace

from gs2ci_sims.wires.shutter import CameraShutter, Shutting
from gs2ci_sims.world import Edge


class OddShutter(CameraShutter):
    """A shutter with what its camera sets after it is made."""

    ignored_triggers = 0
    """Edges lost after each start."""
    least_period_s: Callable[[], float] = staticmethod(lambda: 0.0)
    """Returns the shortest time between exposures that a frame rate allows; an edge before that is lost."""
    debounce_s: Callable[[], float] = staticmethod(lambda: 0.0)
    """Returns for how long a level has to last before it counts; edges act that much later."""
    keeps_edges: Callable[[], bool] = staticmethod(lambda: False)
    """Returns whether an edge that comes too early begins an exposure as soon as one can."""
    burst: Callable[[], int] = staticmethod(lambda: 1)
    """Returns how many exposures follow an edge."""
    _latest: Edge | None = None
    _edges = 0

    def start(self, how: Shutting) -> None:
        self._edges = 0
        super().start(how)

    def _on_edge(self, edge: Edge) -> None:
        self._latest, wait_s = edge, self.debounce_s()
        if wait_s <= 0:
            super()._on_edge(edge)
            return
        later, act = replace(edge, when_s=edge.when_s + wait_s), super()._on_edge
        self._plan(later.when_s, lambda: act(later) if self._latest is edge else None)

    def _on_rise(self, when_s: float) -> None:
        if self._how is Shutting.EDGE and when_s < self._busy_until_s and self.keeps_edges():
            later_s = self._busy_until_s
            self._plan(later_s, lambda: self._on_rise(later_s))
            return
        if self._how in (Shutting.EDGE, Shutting.LEVEL) and when_s >= self._busy_until_s:
            self._edges += 1
            if self._edges <= self.ignored_triggers:
                return
        busy_s = self._busy_until_s
        super()._on_rise(when_s)
        for _ in range(self.burst() - 1 if self._busy_until_s > busy_s else 0):
            self._expose(self._busy_until_s, self._busy_until_s + self._exposure_s())

    def _expose(self, start_s: float, end_s: float) -> None:
        super()._expose(start_s, end_s)
        self._busy_until_s = max(self._busy_until_s, start_s + self.least_period_s())
