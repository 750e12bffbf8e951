"""The driver keeps the contract of every modulator, on its twin."""

import pytest
from gs2ci_lamp_array.driver import LampArray
from gs2ci_lamp_array.twin import LampArrayTwin

from gs2ci_drivers.testing.modulator import *  # noqa: F403  the tests
from gs2ci_drivers.testing.modulator import TwinBench
from gs2ci_sims.world import World


def _bench():
    world = World()
    line = "modulator.out"
    return TwinBench(LampArray, "modulator0", LampArrayTwin(world), world, pulse_line=line, gate_line=line, cell=1)


@pytest.fixture
def bench():
    bench = _bench()
    bench.modulator.connect()
    yield bench
    bench.modulator.close()


@pytest.fixture
def unconnected():
    return _bench()


def test_the_shutter_is_open_while_armed_and_running_and_closed_else(bench):
    assert not bench.twin.shutter_open
    bench.modulator.upload(bench.sequence())
    bench.modulator.arm()
    assert bench.twin.shutter_open
    bench.modulator.disarm()
    assert not bench.twin.shutter_open
