"""The stage contract (`gs2ci_drivers.testing.stage`), run on every implementation through its twin.

Real stages: `test_on_rig.py`.
"""

from collections.abc import Iterator

import pytest

from gs2ci_drivers.grbl.driver import GrblStage
from gs2ci_drivers.grbl.options import GrblOptions
from gs2ci_drivers.kinesis.driver import KinesisStage
from gs2ci_drivers.kinesis.options import KinesisOptions
from gs2ci_drivers.stage import Stage
from gs2ci_drivers.testing.stage import *  # noqa: F403  the tests
from gs2ci_drivers.testing.stage import StageBench
from gs2ci_drivers.zaber.driver import ZaberStage
from gs2ci_drivers.zaber.options import ZaberOptions
from gs2ci_sims.wires.grbl_build import GrblMachine
from gs2ci_sims.wires.kinesis import BUILT, KinesisTwin
from gs2ci_sims.wires.zaber import ZaberAxis, ZaberTwin
from gs2ci_sims.world import VirtualClock
from tests.twins.grbl import GrblTwin


def _zaber(referenced: bool) -> StageBench:
    clock = VirtualClock()
    twin = ZaberTwin(clock, {"x": ZaberAxis(), "y": ZaberAxis(start_mm=20.0)}, referenced=referenced)

    def reopen() -> Stage:
        return ZaberStage(
            "stage0",
            twin.open(),
            clock,
            ZaberOptions(axes={"x": 1, "y": 2}, microstep_mm={"x": 0.000047625, "y": 0.000047625}),
        )

    return StageBench(reopen(), twin, clock, reopen, twin.power_cycle)


def _grbl(referenced: bool) -> StageBench:
    clock = VirtualClock()
    twin = GrblTwin(clock, GrblMachine(homed=referenced))

    def reopen() -> Stage:
        return GrblStage("stage0", twin.open(), clock, GrblOptions(axes=("x", "y")))

    return StageBench(reopen(), twin, clock, reopen, twin.reboot, "$J=")


# The first bytes of MGMSG_MOT_MOVE_ABSOLUTE.
MOVE_TEXT = "S\x04"


def _kinesis(referenced: bool) -> StageBench:
    clock = VirtualClock()
    twin = KinesisTwin(clock, {"x": BUILT["MLS203-X"], "y": BUILT["MLS203-Y"]}, homed=referenced)
    settings = KinesisOptions(axes={"x": 1, "y": 2}, stages={"x": "MLS203-X", "y": "MLS203-Y"})

    def reopen() -> Stage:
        return KinesisStage("stage0", twin.open(), clock, settings)

    return StageBench(reopen(), twin, clock, reopen, twin.power_cycle, MOVE_TEXT)


MAKERS = {"zaber": _zaber, "grbl": _grbl, "kinesis": _kinesis}


@pytest.fixture(params=sorted(MAKERS))
def bench(request: pytest.FixtureRequest) -> Iterator[StageBench]:
    bench = MAKERS[request.param](True)
    bench.stage.connect()
    yield bench
    bench.stage.close()


@pytest.fixture(params=sorted(MAKERS))
def unreferenced(request: pytest.FixtureRequest) -> StageBench:
    return MAKERS[request.param](False)
