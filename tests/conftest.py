"""Options of the whole test suite, how many threads each of its processes takes, a small shot, commands as typed."""

import ctypes
import gc
import os
import signal
import sys
from collections.abc import Generator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace

import hypothesis
import numba
import numpy as np
import pytest

from gs2ci import cli
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.environment import machine
from tests.nightly import by_night, listed
from tests.skipping import Skips, load

# On a busy machine an example may take any time. The same examples every time: what `make test` says of a commit is
# what it says again. `--hypothesis-profile=explore` draws others.
_UNTIMED = {"deadline": None, "suppress_health_check": [hypothesis.HealthCheck.too_slow]}
hypothesis.settings.register_profile("suite", derandomize=True, database=None, **_UNTIMED)
hypothesis.settings.register_profile("explore", **_UNTIMED)
hypothesis.settings.load_profile("suite")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--rig",
        type=Path,
        default=None,
        metavar="FILE",
        help="rig file of real devices on which tests/contracts/test_on_rig.py also runs; the stage moves by 1 mm",
    )

    parser.addoption(
        "--nightly",
        action="store_true",
        help="also run what is too dear for every commit (marker `nightly`)",
    )
    parser.addoption(
        "--skips",
        type=Path,
        default=None,
        metavar="FILE",
        help="fail where a test is skipped that this list does not allow (tests/skips.toml)",
    )
    parser.addoption(
        "--lacking",
        action="append",
        default=[],
        metavar="WHAT",
        help="what this machine cannot have, so that entries of the list of skips for that hold",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Count skips, and share the processors among the suite's processes: each would otherwise take all of them."""
    if config.option.skips is not None and not hasattr(config, "workerinput"):  # xdist's workers report to this process
        config.pluginmanager.register(Skips(load(config.option.skips, config.option.lacking)))
    processes = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    threads = max(1, machine().usable_cores // processes)
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    with suppress(ModuleNotFoundError):  # `python -m tests.newest` goes without
        import torch  # noqa: PLC0415

        torch.set_num_threads(threads)
    # A shell that starts the suite in the background has it ignore Ctrl-C, which tests of interruptions send.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what runs by night, and begin with the files that take long: two processes then end together."""
    for item, late in zip(items, by_night([item.nodeid for item in items], listed()), strict=True):
        if late:
            item.add_marker("nightly")
    left_out = set() if config.option.nightly else {item for item in items if item.get_closest_marker("nightly")}
    config.hook.pytest_deselected(items=[item for item in items if item in left_out])
    items[:] = [item for item in items if item not in left_out]
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: (item.path not in slow, item.path if _is_one_of_several(config) else Path()))


def _is_one_of_several(config: pytest.Config) -> bool:
    return hasattr(config, "workerinput")


def _begin_elsewhere(config: pytest.Config) -> None:
    """Let every second process collect from the end: files that pytest has to rewrite are then rewritten by one alone.

    In a fresh checkout that takes as long as all else before the first test. All processes sort what they have found.
    """
    if _is_one_of_several(config) and int(config.workerinput["workerid"].strip("gw")) % 2:
        named = [(name, sorted(Path(name).glob("[!_.]*"), reverse=True)) for name in reversed(config.args)]
        config.args = [
            one
            for name, inside in named
            for one in ([str(path) for path in inside if path.is_dir() or path.match("test_*.py")] or [name])
        ]


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None, object, object]:
    """Spare the garbage collector what stays until the end: thousands of tests, and all that they import."""
    gc.disable()
    _begin_elsewhere(session.config)
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


def pytest_collection_finish() -> None:
    """Draw each scene of simulated benches once: that takes as long as most of what is then asked of a bench."""
    if (simulated := sys.modules.get("gs2ci.rig.simulated")) is not None:
        draw = simulated.scene_of

        @lru_cache(maxsize=8)
        def drawn(scene: str, seed: int, height: int, width: int) -> object:
            return draw(SimpleNamespace(scene=scene, seed=seed, height=height, width=width))

        simulated.scene_of = lambda table: drawn(table.scene, table.seed, table.height, table.width)


# To look for what a file has left behind takes as long as a dozen tests: worth it for so much memory.
_WORTH_MIB = 64.0
_kept_mib = 0.0


def _resident_mib() -> float:
    pages = Path("/proc/self/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE") / 2**20


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Give back, at the end of a file, what it has left behind: the C library keeps hundreds of megabytes otherwise."""
    global _kept_mib  # noqa: PLW0603
    if nextitem is None or nextitem.path != item.path:
        with suppress(OSError, AttributeError):  # another system, another C library
            if _resident_mib() > _kept_mib + _WORTH_MIB:
                gc.collect()
                ctypes.CDLL(None).malloc_trim(0)
                _kept_mib = _resident_mib()


@pytest.fixture
def rig(tmp_path, monkeypatch, request):
    """A rig file in the folder in which commands are typed: the text `RIG` of the module that asks for it."""
    path = tmp_path / "rig.toml"
    path.write_text(request.module.RIG)
    monkeypatch.chdir(tmp_path)
    return path


@pytest.fixture
def gs2ci(monkeypatch):
    """Type a command; returns its exit status."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["gs2ci", *map(str, arguments)])
        return cli.main()

    return run


@pytest.fixture
def undrawn(monkeypatch):
    """Leave the pictures of runs empty: drawing takes longer than all else that becomes of a small one.

    tests/evaluate/test_overview.py looks at them, and fixtures of whole files, which come before this, have theirs.
    """
    monkeypatch.setattr("gs2ci.evaluate.run_folder.write_overview", lambda path, *_: path.touch())


@pytest.fixture
def random_shot():
    """A shot of six random views, 16 x 20 px, whose views and path are known."""
    draws = np.random.default_rng(0)
    views = draws.random((6, 16, 20, 3), dtype=np.float32)
    masks = (draws.random((6, 16, 20)) < 0.5).astype(np.float32)
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, 0, 3] = np.arange(6)
    return Shot(
        measurement=np.einsum("nhw,nhwc->hwc", masks, views),
        masks=masks,
        weights=np.full(6, 0.5, np.float32),
        truth=Truth(views, poses),
    )
