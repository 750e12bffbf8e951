import importlib
import subprocess
import sys
import threading
from pathlib import Path

import numba
import numpy as np
import pytest
from numba import config

from gs2ci.core import kernels
from gs2ci.core.kernels import f64_1, helper, i64, in_parts, kernel
from gs2ci.render.backend import needs_compiling
from gs2ci.render.cpu.project import project


@helper()
def twice(x):
    return 2 * x


@kernel(i64, i64, f64_1)
def double(start, end, values):
    for i in range(start, end):
        values[i] = twice(values[i])


@pytest.fixture
def nowhere_to_write(monkeypatch):
    monkeypatch.setattr(config, "CACHE_DIR", "")
    monkeypatch.setattr(kernels.os, "access", lambda path, mode: False)


def module_of(folder, name, source):
    (folder / f"{name}.py").write_text(source)
    importlib.invalidate_caches()
    return importlib.import_module(name)


def test_kernels_are_kept_under_a_digest_of_all_their_sources():
    names = kernels._sources("gs2ci.render.cpu.project")
    assert {"gs2ci.render.cpu.project", "gs2ci.render.cpu.projection", "gs2ci.render.simd.vector"} <= set(names)
    assert "gs2ci.render.ply" not in names


def test_a_changed_source_changes_the_digest(monkeypatch):
    before = kernels.sources_digest("gs2ci.render.cpu.project")
    monkeypatch.setattr(kernels, "_digests", {})
    assert kernels.sources_digest("gs2ci.render.cpu.project") == before
    sources = kernels._sources("gs2ci.render.cpu.project")
    digests = {before}
    for name in sources:
        monkeypatch.setattr(kernels, "_digests", {})
        monkeypatch.setattr(kernels, "_sources", lambda module, name=name: {**sources, name: b"changed"})
        digests.add(kernels.sources_digest("gs2ci.render.cpu.project"))
    assert len(digests) == 1 + len(sources)


def test_kernels_of_this_checkout_use_that_folder():
    digest = kernels.sources_digest("gs2ci.render.cpu.project")
    assert f"gs2ci.render.cpu.project-{digest}" in Path(project.stats.cache_path).parts


def test_decorating_leaves_the_users_cache_setting_alone():
    before = config.CACHE_DIR

    @kernel(i64)
    def thrice(x):
        return 3 * x

    assert before == config.CACHE_DIR
    assert thrice(3) == 9


def test_users_cache_setting_is_preferred_to_the_packages_folder(monkeypatch, tmp_path):
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "mine"))
    assert Path(kernels.cache_folder(__name__)).is_relative_to(tmp_path / "mine")


def test_package_that_cannot_be_written_leaves_its_kernels_in_the_users_cache(monkeypatch, tmp_path):
    monkeypatch.setattr(config, "CACHE_DIR", "")
    monkeypatch.setattr(kernels.os, "access", lambda path, mode: Path(path).is_relative_to(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert Path(kernels.cache_folder(__name__)).is_relative_to(tmp_path / "gs2ci")


def test_kernels_still_run_where_nothing_can_be_written(nowhere_to_write):
    assert kernels.cache_folder(__name__) is None

    @kernel(i64)
    def thrice(x):
        return 3 * x

    assert thrice(2) == 6


def test_a_backend_needs_compiling_until_its_kernels_lie_on_disk(monkeypatch, tmp_path):
    monkeypatch.setattr(kernels, "cache_folder", lambda module: str(tmp_path / module))
    assert needs_compiling("cpu")
    folder = tmp_path / "gs2ci.render.cpu.blend" / "cpu_0"
    folder.mkdir(parents=True)
    (folder / "kernel.1.nbc").touch()
    assert not needs_compiling("cpu")
    monkeypatch.setattr(kernels, "cache_folder", lambda module: None)
    assert needs_compiling("cpu")
    assert not needs_compiling("warp")


def test_a_helper_called_from_python_runs_as_it_is_written():
    assert twice(1.5) == 3.0
    assert not twice.signatures


def test_a_kernel_declares_its_arguments():
    assert (double, (i64, i64, f64_1)) in kernels.declared(__name__)


def test_a_module_is_compiled_for_what_its_kernels_declare(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "kept"))
    source = (
        "from gs2ci.core.kernels import kernel, f64\n\n\n@kernel((f64, f64))\ndef first(pair):\n    return pair[0]\n"
    )
    made = module_of(tmp_path, "made_for_kernels", source)
    kernels.compile_module("made_for_kernels")
    assert len(made.first.signatures) == 1
    assert kernels.is_compiled("made_for_kernels")


def test_a_process_compiles_what_it_is_told(tmp_path):
    program = "from gs2ci.core.kernels import serve; serve()"
    module = "gs2ci.reconstruct.fit.kernels.gaussian_kernels"
    environment = {**kernels.os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", program],
        input=f"{module}\n",
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == f"{module}\n"
    assert list(tmp_path.rglob("*adam_step*.nbc"))


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("tasks", [0, 1, 2, 7, 100])
def test_every_task_is_done_once_by_any_number_of_threads(monkeypatch, threads, tasks):
    monkeypatch.setattr(numba, "get_num_threads", lambda: threads)
    values = np.arange(float(tasks))
    in_parts(double, tasks, values)
    np.testing.assert_array_equal(values, 2 * np.arange(tasks))


def test_threads_that_call_kernels_at_once_get_along(monkeypatch):
    monkeypatch.setattr(numba, "get_num_threads", lambda: 3)
    many = [np.ones(50) for _ in range(8)]
    callers = [threading.Thread(target=in_parts, args=(double, 50, values)) for values in many]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert all((values == 2).all() for values in many)


@pytest.mark.parametrize("where", ["caller", "other"])
def test_what_a_part_raises_is_raised_when_no_part_runs_any_more(monkeypatch, where):
    monkeypatch.setattr(numba, "get_num_threads", lambda: 2)
    caller, met = threading.current_thread(), threading.Barrier(2, timeout=10)

    def part(start, end):
        if start < 2:
            met.wait()
            if (threading.current_thread() is caller) == (where == "caller"):
                raise ValueError("a part")

    with pytest.raises(ValueError, match="a part"):
        in_parts(part, 4)


def test_a_process_that_was_split_off_has_threads_of_its_own():
    program = """
import os, numba, numpy as np
import warnings
warnings.simplefilter("ignore")
from gs2ci.core.kernels import in_parts
numba.get_num_threads = lambda: 2
def add(start, end, values):
    values[start:end] += 1
values = np.zeros(10)
in_parts(add, 10, values)
child = os.fork()
in_parts(add, 10, values)
assert (values == 2).all()
if child == 0:
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)
