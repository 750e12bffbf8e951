"""The modulator as an ophyd-async flyer: given a sequence of masks, started, waited for.

Here: `MaskFlyer`. Not here: the modulator (`gs2ci_drivers.modulator`), sequences of masks
(`gs2ci_drivers.pattern_sequence`).
"""

from collections.abc import Awaitable
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from ophyd_async.core import (
    FlyableLogic,
    StandardFlyable,
    StandardReadable,
    StandardReadableFormat,
    soft_signal_r_and_setter,
)

from gs2ci.api.ophyd.worker import SLICE_S, Worker
from gs2ci_drivers.modulator import Modulator
from gs2ci_drivers.pattern_sequence import PatternSequence

PATIENCE_S: Final = 2.0
"""How long after its computed end a sequence may still run."""


@dataclass
class _MaskLogic(FlyableLogic[PatternSequence, PatternSequence]):
    shows: Modulator
    call: Worker

    async def stop(self) -> None:
        await self.call(self.shows.disarm)

    async def on_prepare(self, value: PatternSequence) -> PatternSequence:
        report = await self.call(self.shows.upload, value)
        await self.call(self.shows.arm)
        return report.sequence

    async def on_kickoff(self, ctx: PatternSequence) -> PatternSequence:
        await self.call(self.shows.start)
        return ctx

    async def on_complete(self, ctx: PatternSequence) -> None:
        clock = self.shows.clock
        until_s = clock.now_s() + ctx.duration_s
        while clock.now_s() < until_s:  # in short calls, which also advance a modulator that the host steps
            await self.call(self.shows.keep_time, min(clock.now_s() + SLICE_S, until_s))
        await self.call(self.shows.wait_done, PATIENCE_S)


class MaskFlyer(StandardFlyable[PatternSequence, PatternSequence], StandardReadable):
    """A modulator: `prepare` with a `PatternSequence` uploads and arms, `kickoff` starts, `complete` waits for the end.

    Staging and unstaging leave it dark. Sequences without an end (`repeats = 0`) have no `complete`.

    Args:
        shows: The modulator, connected.
        call: The devices' thread.
        name: Name in Bluesky's documents.
    """

    def __init__(self, shows: Modulator, call: Worker, name: str = "") -> None:
        def state() -> Awaitable[str]:
            return call(lambda: shows.status().state.value)

        with self.add_children_as_readables(StandardReadableFormat.UNCACHED_SIGNAL):
            self.state, _ = soft_signal_r_and_setter(str, getter=state)
        with self.add_children_as_readables(StandardReadableFormat.CONFIG_SIGNAL):
            self.model, _ = soft_signal_r_and_setter(str, shows.info.model)
            self.firmware, _ = soft_signal_r_and_setter(str, shows.info.firmware)
        self._logic_of = shows, call
        super().__init__(name=name)

    @cached_property
    def flyable_logic(self) -> _MaskLogic:
        """Get how it flies; see ophyd-async's `StandardFlyable`."""
        return _MaskLogic(*self._logic_of)
