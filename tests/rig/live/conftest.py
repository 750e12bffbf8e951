"""A small simulated bench, live, and a browser to press its buttons."""

import pytest

from gs2ci.rig.live.bench import LiveBench
from gs2ci.rig.live.server import LiveServer
from gs2ci.rig.opening import load_rig
from tests.evaluate.pages.conftest import tab  # noqa: F401 - a fixture

RIG = """
name = "small"
[modulator]
{modulator}
[sensor]
kind = "{kind}"
port = "simulated"
height = 96
width = 128
format = "{format}"
black_level_dn = 64.0
full_well_e = 10700.0
electrons_per_dn = 2.7
[stage]
kind = "zaber"
port = "simulated"
axes = {{ x = 1 }}
microstep_mm = {{ x = 0.000047625 }}
[stage.mount]
x = [1.0, 0.0, 0.0]
[registration]
superpixel = 2
[capture]
masks = 4
density = 0.5
{capture}
axis = "x"
from_mm = 74.0
to_mm = 75.0
[optics]
full_scale_e_per_s = {light_e_per_s}
[world]
scene = "planes"
scene_units_per_mm = 0.02
height = 96
width = 128
{world}
"""
MODULATOR = 'kind = "dlpc900"\ntrigger_out_2_bit = "disables"'


def begun(folder, kind="v4l2", world="", tables="", modulator=MODULATOR, capture="mask_s = 0.02", light_e_per_s=1e5):
    """Begin a live bench."""
    path = folder / "rig.toml"
    form = "Y12" if kind == "v4l2" else "Mono12"
    left = {"world": world, "modulator": modulator, "capture": capture, "light_e_per_s": light_e_per_s}
    path.write_text(RIG.format(kind=kind, format=form, **left) + tables)
    bench = LiveBench(load_rig(path))
    bench.begin()
    return bench


@pytest.fixture
def make_live(tmp_path):
    """Begin a live bench; it is closed at the end."""
    benches = []

    def make(*given, **named):
        benches.append(begun(tmp_path, *given, **named))
        return benches[-1]

    yield make
    for bench in benches:
        bench.close()


@pytest.fixture
def served(make_live):
    """Serve a live bench."""
    bench = make_live()
    server = LiveServer(bench)
    yield bench, server
    server.stop()


@pytest.fixture(scope="module")
def standing(tmp_path_factory):
    """Serve one live bench to all tests of a file that change nothing about it."""
    bench = begun(tmp_path_factory.mktemp("standing"))
    server = LiveServer(bench)
    yield bench, server
    server.stop()
    bench.close()
