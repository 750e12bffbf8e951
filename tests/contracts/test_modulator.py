"""The modulator contract (`gs2ci_drivers.testing.modulator`), run on every implementation through its twin."""

from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from gs2ci_drivers.alp.driver import AlpModulator
from gs2ci_drivers.display_slm.driver import DisplaySlm
from gs2ci_drivers.dlpc900.driver import Dlpc900
from gs2ci_drivers.scpi_modulator.driver import ScpiModulator
from gs2ci_drivers.testing.modulator import *  # noqa: F403  the tests
from gs2ci_drivers.testing.modulator import TwinBench
from gs2ci_drivers.video_out.driver import VideoOut
from gs2ci_drivers.video_out.options import VideoOutOptions
from gs2ci_sims.wires.alp import AlpTwin
from gs2ci_sims.wires.display_slm import DisplaySlmTwin
from gs2ci_sims.wires.dlpc900 import Dlpc900Twin
from gs2ci_sims.wires.scpi_modulator import ScpiModulatorTwin, ScpiPanel
from gs2ci_sims.wires.screen import ScreenTwin
from gs2ci_sims.world import World


def _dlpc900() -> TwinBench:
    world = World()
    lines = {"pulse_line": "dmd0.out2", "gate_line": "dmd0.out1"}
    return TwinBench(Dlpc900, "modulator0", Dlpc900Twin(world, dmd=5), world, **lines, stale="dlpc900.stale")


def _scpi() -> TwinBench:
    world = World()
    twin = ScpiModulatorTwin(world, panel=ScpiPanel(height=96, width=128))
    return TwinBench(ScpiModulator, "modulator0", twin, world, pulse_line="lcos0.out", gate_line="lcos0.out")


def _display_slm() -> TwinBench:
    world = World()
    return TwinBench(DisplaySlm, "modulator0", DisplaySlmTwin(world), world, pulse_line="slm0.out")


def _video_out() -> TwinBench:
    world, patch = World(), (0, 500, 20, 12)
    twin = ScreenTwin(world, height=96 + 32, width=512, patch=patch)
    # It is opened by its driver: what the bench opens is the twin itself.
    session = SimpleNamespace(open=lambda: twin, plug_in=twin.plug_in, unplug=twin.unplug, faults=twin.faults)
    settings = VideoOutOptions(kind="video", trigger_patch=patch, frames_late=0)
    lines = {"pulse_line": "screen0.out", "gate_line": "screen0.out"}
    return TwinBench(VideoOut, "modulator0", session, world, settings, **lines, exclusive=False)


def _alp() -> TwinBench:
    world = World()
    twin = AlpTwin(world, height=96, width=128, memory=64)
    return TwinBench(AlpModulator, "modulator0", twin, world, pulse_line="alp0.out", stale="alp.stale")


MAKERS = {"alp": _alp, "video_out": _video_out, "dlpc900": _dlpc900, "scpi": _scpi, "display_slm": _display_slm}


@pytest.fixture(params=sorted(MAKERS))
def bench(request: pytest.FixtureRequest) -> Iterator[TwinBench]:
    bench = MAKERS[request.param]()
    bench.modulator.connect()
    yield bench
    bench.modulator.close()


@pytest.fixture(params=sorted(MAKERS))
def unconnected(request: pytest.FixtureRequest) -> TwinBench:
    return MAKERS[request.param]()
