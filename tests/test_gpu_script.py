"""The script for a machine with a GPU runs whole without one, part by part, and ends in time."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("warp", reason="Warp is not installed")

from gs2ci.reconstruct.settings import Settings
from gs2ci.render import places
from gs2ci.render.warp.backend import WarpBackend
from tests.benchmarks import gpu, gpu_parts
from tests.benchmarks.gpu_parts import Asked
from tests.nightly import NIGHTLY

ROOT = Path(__file__).parents[1]
WHOLE = ("standard", "large_draft", "exponent")
SHORT = {
    "here": ("device: ", "torch "),
    "compiled": ("small scene as by the CPU, to ",),
    "errors": ("error of means", "three replayed renderings have the bits of the one that was called: yes"),
    "beside_the_host": (
        "parameters after 6 iterations: ",
        "groups of patches: ",
        "GAP-TV: ",
        "a sweep: ",
        "the same bits twice",
    ),
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
    assert "OTHER BITS" not in printed


@NIGHTLY
@pytest.mark.parametrize("name", WHOLE)
def test_whole_reconstructions_run_on_the_cpu(name, capsys):
    part(name).run(Asked(WarpBackend(Settings().raster, "cpu"), small=True))
    printed = capsys.readouterr().out
    assert "draft, " in printed
    assert "asked of " in printed
    assert "s: fit" in printed


LACKS = """
import sys
class Lacks:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("tyro", "serial", "usb", "h5py", "psutil", "matplotlib", "onnxruntime", "jinja2"):
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Lacks())
from tests.benchmarks import gpu, gpu_parts
gpu.run()
"""


@NIGHTLY
def test_the_script_needs_no_more_than_its_page_says():
    small = {"GS2CI_DEVICE": "cpu", "GS2CI_SMALL": "1", "GS2CI_PARTS": "here,exponent", "GS2CI_WATCHED": "1"}
    done = subprocess.run(
        [sys.executable, "-c", LACKS], env={**os.environ, **small}, cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert "asked of the exponent" in done.stdout, done.stdout


def test_all_that_is_missing_is_said_before_anything_begins():
    lacks = LACKS.replace('"tyro", "serial"', '"warp", "pycolmap"')
    done = subprocess.run([sys.executable, "-c", lacks], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "not installed: warp, pycolmap (docs/gpu.md says how to bring them along)\n"


def test_minutes_on_a_card_are_not_spent_on_the_host(monkeypatch):
    monkeypatch.delenv("GS2CI_DEVICE", raising=False)
    silent = ("cuda", "the driver is silent")
    monkeypatch.setattr(gpu_parts.devices, "compute_devices", lambda _: (("cpu", "the default"), silent))
    with pytest.raises(SystemExit, match=r"no CUDA device; GS2CI_DEVICE=cpu .*\ncpu: the default\ncuda: the driver is"):
        gpu_parts.asked()


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


PROGRAM = """
import os, sys, time
for name in os.environ["GS2CI_PARTS"].split(","):
    print(f"\\n== {name}: what it does", flush=True)
    if name == "crashes":
        os._exit(7)
    if name == "hangs":
        time.sleep(60)
    print(f"({name} took 0 s of 1)", flush=True)
"""


def test_a_part_that_ends_the_process_or_never_ends_leaves_the_others_to_another_process(capsys):
    names = ("first", "crashes", "second", "hangs", "third")
    parts, kept = [gpu.Part(name, print, 0.5) for name in names], io.StringIO()
    assert gpu.watched([sys.executable, "-c", PROGRAM], parts, 60, kept) == []
    printed = capsys.readouterr().out
    assert printed == kept.getvalue()
    assert [line for line in printed.splitlines() if "FAILS" in line or "took" in line] == [
        "(first took 0 s of 1)",
        "crashes FAILS: its process ended with 7",
        "(second took 0 s of 1)",
        "(it took too long)",
        "hangs FAILS: its process ended with -9",
        "(third took 0 s of 1)",
    ]


def test_where_nothing_begins_nothing_is_tried_again(capsys):
    parts = [gpu.Part("first", print, 1)]
    program = "print('== gpu', flush=True); import nothing_like_it"  # as `tests.benchmarks` begins
    assert gpu.watched([sys.executable, "-c", program], parts, 60, io.StringIO()) == parts
    assert "what comes before the parts FAILS: its process ended with 1" in capsys.readouterr().out


def test_what_is_printed_becomes_a_page(tmp_path, monkeypatch, capsys):
    program = [sys.executable, "-c", PROGRAM]
    watched = gpu.watched
    monkeypatch.setattr(gpu, "watched", lambda _, *given: watched(program, *given))
    monkeypatch.setenv("GS2CI_PARTS", "errors")
    monkeypatch.setenv("GS2CI_PAGE", str(tmp_path / "page.md"))
    gpu.run()
    assert (tmp_path / "page.md").read_text() == capsys.readouterr().out


def test_parts_are_chosen_by_name_and_run_in_the_order_of_the_plan():
    assert [one.name for one in gpu.chosen("races,errors")] == ["errors", "races"]
    assert gpu.chosen("") == gpu.PLAN
    with pytest.raises(SystemExit, match="no part laces: here, compiled, errors, "):
        gpu.chosen("laces")
