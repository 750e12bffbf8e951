"""What the command does with modules of its own; that the product's are all compiled is seen by `make wheel`."""

import importlib
import subprocess
from pathlib import Path

import pytest

from gs2ci.api import preparing
from gs2ci.commands import compile as compiling
from gs2ci.core import kernels
from gs2ci.core.progress import Silent
from tests.wheel import jitted

SMALL = "gs2ci.reconstruct.fit.kernels.gaussian_kernels"


def test_all_modules_with_kernels_are_found_and_no_other():
    found = preparing.modules_with_kernels()
    assert {SMALL, "gs2ci.render.cpu.blend", "gs2ci_sims.rays.meshes"} <= set(found)
    assert len(set(found)) == len(found)
    assert "gs2ci.core.kernels" not in found


def test_every_kernel_of_a_module_is_compiled_with_it():
    for name in preparing.modules_with_kernels():
        path = Path(importlib.import_module(name).__file__)
        assert {f"{path.stem}.{one.__name__}" for one, _ in kernels.declared(name)} == jitted([path]), name


@pytest.fixture
def small(monkeypatch, tmp_path):
    monkeypatch.setattr(preparing, "modules_with_kernels", lambda: (SMALL,))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return tmp_path


def test_they_are_compiled_on_disk_and_told_in_a_line(small, capsys):
    assert compiling.run() > 0
    assert list(small.rglob("*adam_step*.nbc"))
    assert "All kernels are compiled" in capsys.readouterr().out


def test_what_a_process_that_ended_leaves_is_compiled_here(small, monkeypatch):
    monkeypatch.setattr(preparing, "_SERVE", "")
    monkeypatch.setattr(preparing, "_MOMENT_S", 0.0)
    seen = []
    monkeypatch.setattr(kernels, "compile_module", seen.append)
    preparing.compile_kernels(Silent())
    assert seen == [SMALL]


def test_an_interruption_ends_it(small, monkeypatch):
    monkeypatch.setattr(preparing, "_SERVE", "")

    def interrupt(*_args, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr(subprocess, "Popen", interrupt)
    with pytest.raises(KeyboardInterrupt):
        preparing.compile_kernels(Silent())


@pytest.mark.parametrize("kept", [True, False])
def test_a_first_run_compiles_before_it_begins_if_the_code_can_be_kept(small, monkeypatch, kept):
    listener, taken = Silent(), []
    monkeypatch.setattr("gs2ci.render.backend.needs_compiling", lambda name: name == "cpu")
    monkeypatch.setattr(kernels, "cache_folder", lambda module: str(small) if kept else None)
    monkeypatch.setattr(preparing, "compile_kernels", taken.append)
    preparing.prepare_first_run("warp", listener)
    assert not listener.sentences
    preparing.prepare_first_run("cpu", listener)
    assert "compiles its kernels" in listener.sentences[0]
    assert taken == ([listener] if kept else [])
