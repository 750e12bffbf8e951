"""The script for a machine with a GPU runs whole without one, part by part, and ends in time."""

import pytest

pytest.importorskip("warp", reason="Warp is not installed")

from gs2ci.reconstruct.settings import Settings
from gs2ci.render import places
from gs2ci.render.warp.backend import WarpBackend
from tests.benchmarks import gpu
from tests.benchmarks.gpu_parts import Asked
from tests.nightly import NIGHTLY

WHOLE = ("draft", "standard", "large_draft", "exponent")
SHORT = {
    "errors": ("error of means", "three replayed renderings have the bits of the one that was called: yes"),
    "iterations": ("| 200 | 24 × 32 | 3 | – |",),
    "worst_kernel": ("no events on this device",),
    "races": ("compute-sanitizer is not there",),
    "beside_gsplat": ("gsplat is not installed",),
}


@pytest.fixture
def asked():
    places.count_host_as_device(yes=True)
    yield Asked(WarpBackend(Settings().raster, "cpu"), small=True)
    places.count_host_as_device(yes=False)


def part(name):
    (found,) = gpu.chosen(name)
    return found


def test_every_part_is_run_here():
    assert {one.name for one in gpu.PLAN} == {*SHORT, *WHOLE}


@pytest.mark.parametrize("name", SHORT)
def test_a_part_runs_on_the_cpu(name, asked, capsys, monkeypatch):
    monkeypatch.setenv("PATH", "")
    part(name).run(asked)
    printed = capsys.readouterr().out
    assert all(words in printed for words in SHORT[name]), printed


@NIGHTLY
@pytest.mark.parametrize("name", WHOLE)
def test_whole_reconstructions_run_on_the_cpu(name, capsys):
    part(name).run(Asked(WarpBackend(Settings().raster, "cpu"), small=True))
    assert "draft, " in capsys.readouterr().out


def test_what_there_is_no_time_for_is_left_out_and_a_failure_keeps_nothing_from_running(capsys):
    def fails(_):
        """Fail."""
        raise RuntimeError("out of memory")

    def works(_):
        """Work."""
        print("worked")

    parts = [gpu.Part("fails", fails, 1), gpu.Part("long", works, 1000), gpu.Part("works", works, 1)]
    assert [one.name for one in gpu.within(parts, None, 60)] == ["long"]
    printed = capsys.readouterr().out
    assert "fails FAILS" in printed
    assert "out of memory" in printed
    assert "worked" in printed


def test_parts_are_chosen_by_name_and_run_in_the_order_of_the_plan():
    assert [one.name for one in gpu.chosen("races,errors")] == ["errors", "races"]
    assert gpu.chosen("") == gpu.PLAN
    with pytest.raises(SystemExit, match="no part laces: errors, "):
        gpu.chosen("laces")
