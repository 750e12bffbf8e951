"""An axis of the stage as an ophyd-async device: moved (`bps.mv`), read, and flown at constant speed.

Here: `StageAxis`. Not here: the stage (`gs2ci_drivers.stage`), which keeps limits, speeds and run-ups.
"""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from ophyd_async.core import (
    CALCULATE_TIMEOUT,
    CalculatableTimeout,
    FlyableLogic,
    FlyMotorInfo,
    MovableLogic,
    StandardFlyable,
    StandardMovable,
    StandardReadable,
    StandardReadableFormat,
    TimeoutCalculator,
    WatchableAsyncStatus,
    soft_signal_r_and_setter,
    soft_signal_rw,
)

from gs2ci.api.ophyd.worker import SLICE_S, Worker
from gs2ci_drivers.axis import Sweep
from gs2ci_drivers.stage import Stage

POLL_S: Final = 0.1
"""How often a position is reported to a watcher."""
PATIENCE_S: Final = 2.0
"""How long after its computed end a sweep may still run."""


@dataclass
class _AxisLogic(MovableLogic[float], FlyableLogic[FlyMotorInfo, Sweep]):
    carrier: Stage
    axis: str
    call: Worker
    stopped: bool = False

    async def stop(self) -> None:
        self.stopped = True
        if (await self.call(self.carrier.status)).moving:
            await self.call(self.carrier.stop)

    async def check_move(self, new_position: float) -> None:
        await self.call(self.carrier.check_targets, {self.axis: new_position})

    async def move(self, new_position: float, timeout: TimeoutCalculator) -> None:
        if self.stopped:  # stopped after the request but before the start: ophyd-async has nothing to cancel yet
            return
        limit_s = timeout()
        if limit_s is None:
            limit_s = await self.call(self.carrier.move_timeout_s, {self.axis: new_position})
        await self.setpoint.set(new_position)
        try:
            await self.call(self.carrier.begin_move, {self.axis: new_position})
            await self._until_idle(limit_s)
        except asyncio.CancelledError:
            await self.stop()  # the stop may have come before the move had begun in the other thread
            raise

    async def on_prepare(self, value: FlyMotorInfo) -> Sweep:
        self.stopped = False
        sweep = await self.call(
            self.carrier.plan_sweep, self.axis, value.start_position, value.end_position, value.speed
        )
        await self.move(sweep.begin_mm, lambda: None)
        return sweep

    async def on_kickoff(self, ctx: Sweep) -> Sweep:
        await self.setpoint.set(ctx.end_mm)
        await self.call(self.carrier.begin_sweep, ctx)
        await self.call(self.carrier.clock.sleep_s, ctx.lead_s)  # until its speed is constant
        return ctx

    async def on_complete(self, ctx: Sweep) -> None:
        await self._until_idle(2 * ctx.lead_s + ctx.cruise_s + PATIENCE_S)

    async def _until_idle(self, limit_s: float) -> None:
        """Wait for the end of motion in short calls, so that `stop` can run between them."""
        clock = self.carrier.clock
        until_s = clock.now_s() + limit_s
        while (await self.call(self.carrier.status)).moving and clock.now_s() < until_s:
            await self.call(clock.sleep_s, SLICE_S)
        await self.call(self.carrier.wait_idle, max(until_s - clock.now_s(), SLICE_S))


class StageAxis(StandardMovable[float], StandardFlyable[FlyMotorInfo, Sweep], StandardReadable):
    """One axis of a stage, positions in mm.

    Moves beyond the limits are refused before anything moves. A flight (`FlyMotorInfo`, mm and seconds) crosses its
    range at constant speed; its run-up follows from the stage's acceleration, and `kickoff` is done where the range
    begins.

    Args:
        carrier: The stage, connected.
        axis: The axis's name in the rig file.
        call: The devices' thread.
        name: Name in Bluesky's documents.
    """

    def __init__(self, carrier: Stage, axis: str, call: Worker, name: str = "") -> None:
        here_mm = call.now(carrier.positions_mm)[axis]

        def read() -> Awaitable[float]:
            return call(_position_of(carrier, axis))

        with self.add_children_as_readables(StandardReadableFormat.HINTED_UNCACHED_SIGNAL):
            self.readback, _ = soft_signal_r_and_setter(
                float, here_mm, units="mm", precision=4, getter=read, poll_period=POLL_S
            )
        self.setpoint = soft_signal_rw(float, here_mm, units="mm", precision=4)
        self._logic_of = carrier, axis, call
        super().__init__(name=name)

    def set(
        self,
        new_position: float,
        timeout: CalculatableTimeout = CALCULATE_TIMEOUT,  # type: ignore[assignment]
    ) -> WatchableAsyncStatus[float]:
        """Move there, mm; see ophyd-async's `StandardMovable`."""
        self._logic.stopped = False
        return super().set(new_position, timeout)

    @cached_property
    def _logic(self) -> _AxisLogic:
        return _AxisLogic(self.setpoint, self.readback, *self._logic_of)

    @cached_property
    def movable_logic(self) -> _AxisLogic:
        """Get how it moves; see ophyd-async's `StandardMovable`."""
        return self._logic

    @cached_property
    def flyable_logic(self) -> _AxisLogic:
        """Get how it flies; see ophyd-async's `StandardFlyable`."""
        return self._logic


def _position_of(carrier: Stage, axis: str) -> Callable[[], float]:
    return lambda: carrier.positions_mm()[axis]
