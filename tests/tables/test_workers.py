"""Who does the work, and what a death costs."""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import dask
import distributed  # noqa: F401  imported within `dask.config.set`, its defaults would leave Dask's configuration with it
import psutil
import pytest

from gs2ci.batch.cluster import local_workers
from gs2ci.core.errors import InputError, StorageError
from gs2ci.evaluate.tradeoff.store import Store
from tests.batch.keys import admitted
from tests.patience import HANG_S
from tests.tables.cells import Cell, run
from tests.tables.workers import complete
from tests.tables.works import reconstruct_case

DEADLY = Cell(os._exit, {"status": 1})


def counting(values):
    return [Cell(dict, {"value": value}) for value in values]


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "cells")


@pytest.fixture
def cluster():
    # Not Dask's own LocalCluster: its nannies raise if they are closed while they restart a worker that died.
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}), local_workers(1) as client, admitted(client):
        yield client.scheduler.address


def test_rows_come_in_the_order_of_the_cells(store):
    assert [row["value"] for row in complete(counting([3, 1, 2]), store)] == [3, 1, 2]


def test_what_is_in_the_store_is_not_done_again(store):
    cells = counting([1, 2])
    store.put(cells[0].key, {"value": "kept"})
    assert [row["value"] for row in complete(cells, store)] == ["kept", 2]


def lacking(switch):
    if not Path(switch).exists():
        raise InputError("needs a package", remedy="install it")
    return {"value": 1}


def test_a_cell_that_failed_is_tried_again(store, tmp_path):
    cells = [*counting([1]), Cell(lacking, {"switch": str(tmp_path / "installed")})]
    assert "needs a package" in complete(cells, store)[1]["error"]
    (tmp_path / "installed").touch()
    heard = []
    assert complete(cells, store, on_done=lambda done, _: heard.append(done))[1]["value"] == 1
    assert heard == [1, 2]  # the first was there
    (tmp_path / "installed").unlink()
    assert complete(cells, store)[1]["value"] == 1


def test_every_row_is_kept_as_soon_as_it_is_done(store):
    cells = [*counting([1, 2]), Cell(divmod, {})]
    with pytest.raises(TypeError):
        complete(cells, store)
    assert [store.get(cell.key)["value"] for cell in cells[:2]] == [1, 2]


def test_equal_cells_are_done_once(store):
    heard = []
    complete(counting([1, 1, 2]), store, on_done=lambda done, total: heard.append((done, total)))
    assert heard == [(0, 2), (1, 2), (2, 2)]


def test_an_error_of_ours_becomes_a_row_that_says_so():
    row = run(
        Cell(
            reconstruct_case,
            {"case": {"name": "x", "size": [8, 8]}, "variant": "default", "seed": 0},
        )
    )
    assert "case 'x' names" in row["error"]
    assert row["arguments"]["seed"] == 0


def test_a_cell_is_named_by_its_function():
    assert Cell(reconstruct_case, {}).name == "tests.tables.works:reconstruct_case"


@pytest.mark.parametrize(
    "work", [lambda: {"value": 1}, Store.get, Store(None).get], ids=["lambda", "method", "bound method"]
)
def test_work_that_no_other_process_would_find_is_refused(work):
    with pytest.raises(InputError, match="a function of a module"):
        Cell(work, {})


def test_local_processes_give_the_same_rows_as_this_one(store):
    assert [row["value"] for row in complete(counting(range(4)), store, processes=2)] == [0, 1, 2, 3]


def test_a_process_that_dies_costs_only_its_cell(store):
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}):
        rows = complete([DEADLY, *counting([1, 2])], store, processes=2)
    assert "died" in rows[0]["error"]
    assert [row["value"] for row in rows[1:]] == [1, 2]
    assert store.get(DEADLY.key) is None  # so the next run tries it again


def workers_of(parent):
    """The processes that another has spawned; one that is over meanwhile is none."""
    found = []
    for child in parent.children():
        with contextlib.suppress(psutil.Error):
            if "spawn_main" in " ".join(child.cmdline()):
                found.append(child)
    return found


WAITING = """
import signal
from pathlib import Path
from tests.tables.cells import Cell
from gs2ci.evaluate.tradeoff.store import Store
from tests.tables.workers import complete

if __name__ == "__main__":
    cells = [Cell(signal.pause, {}), Cell(signal.pause, {}, ("waiting.py",))]
    complete(cells, Store(Path("cells")), processes=2)
"""


def test_no_process_outlives_a_killed_parent(tmp_path):
    (tmp_path / "waiting.py").write_text(WAITING)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    parent = psutil.Popen([sys.executable, "waiting.py"], cwd=tmp_path, env=environment, stderr=subprocess.DEVNULL)
    workers = []
    while len(workers) < 2 or min(worker.num_threads() for worker in workers) < 2:
        assert parent.poll() is None
        workers = workers_of(parent)
    parent.kill()
    parent.wait()
    _, alive = psutil.wait_procs(workers, timeout=HANG_S)
    assert not alive


def test_a_cluster_gives_the_same_rows_and_a_dead_worker_costs_only_its_cell(store, cluster):
    rows = complete([DEADLY, *counting([1, 2])], store, scheduler=cluster)
    assert "died" in rows[0]["error"]
    assert [row["value"] for row in rows[1:]] == [1, 2]


def test_a_cluster_is_not_asked_for_what_is_kept(store):
    cells = counting([1])
    store.put(cells[0].key, {"value": 1})
    assert complete(cells, store, scheduler="tcp://127.0.0.1:9")[0]["value"] == 1


def test_a_scheduler_that_does_not_answer_is_refused(store, monkeypatch):
    monkeypatch.setattr("gs2ci.batch.cluster.CONNECT_S", 0.2)
    with pytest.raises(InputError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        complete(counting([1]), store, scheduler="tcp://127.0.0.1:9")


@pytest.mark.parametrize(
    "where", [{"scheduler": "tcp://127.0.0.1:9"}, {"processes": 2}], ids=lambda where: next(iter(where))
)
def test_other_processes_without_dask_say_what_to_install(store, monkeypatch, where):
    monkeypatch.setitem(sys.modules, "dask", None)
    with pytest.raises(InputError, match="gs2ci\\[cluster\\]"):
        complete(counting([1]), store, **where)


def test_no_process_at_all_is_refused(store):
    with pytest.raises(InputError, match="0 processes"):
        complete(counting([1]), store, processes=0)


def test_a_table_that_is_ended_waits_for_none_of_its_cells(store, tmp_path):
    marks = [tmp_path / name for name in "abc"]
    for mark in marks:
        mark.write_text(mark.name)  # else equal cells would be one
    cells = [*counting([1]), *(Cell(signal.pause, {}, (str(mark),)) for mark in marks)]

    def full(done, _):
        if done:
            raise StorageError("the disk is full")

    with pytest.raises(StorageError, match="full"):
        complete(cells, store, processes=2, on_done=full)
    assert not workers_of(psutil.Process())


def test_the_key_depends_on_the_content_of_files(tmp_path):
    one, other = tmp_path / "a.npz", tmp_path / "b.npz"
    one.write_bytes(b"1")
    other.write_bytes(b"2")
    keys = {Cell(dict, {"seed": 0}, files).key for files in ((), (str(one),), (str(other),))}
    assert len(keys) == 3
    with pytest.raises(StorageError, match="cannot be read"):
        _ = Cell(dict, {}, (str(tmp_path / "none.npz"),)).key
