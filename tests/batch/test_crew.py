"""Workers that die, on a cluster of real processes."""

import logging
import os
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import dask
import distributed
import numpy as np
import psutil
import pytest
from distributed import Client

from gs2ci.batch import cluster
from gs2ci.batch.cluster import local_workers
from gs2ci.batch.crew import complete, workers_by_host
from gs2ci.batch.exposures import list_exposures
from gs2ci.batch.reconstruct import reconstruct_many
from gs2ci.batch.rows import ROWS_NAME, Row, read_row, write_row
from gs2ci.batch.work import Task, work
from gs2ci.core.errors import DeviceError, InputError
from gs2ci.core.records import Shot
from gs2ci.core.storage import write_shots
from gs2ci.reconstruct.presets.named import PRESETS
from tests.batch import dying
from tests.batch.keys import admitted

pytestmark = pytest.mark.slow

QUICK = replace(PRESETS["draft"], fit=replace(PRESETS["draft"].fit, iterations=1))


@pytest.fixture
def tasks(tmp_path):
    """Two exposures that are to be refused, the second only after its first worker's death."""
    masks = np.ones((2, 4, 4), np.float32)
    shots = [Shot(np.ones((4, 4, 1), np.float32), masks, np.ones(2, np.float32), name=name) for name in ("a", "b")]
    exposures = list_exposures([write_shots(tmp_path / "a.h5", shots)], every=True)
    (tmp_path / ROWS_NAME).mkdir()
    return [Task(one, tmp_path, f"key{one.index}", QUICK, prepare=deadly) for one in exposures]


@pytest.fixture
def in_threads(monkeypatch):
    """Local workers that are threads of this process: quick, and nothing of theirs dies."""

    @contextmanager
    def threads(processes):
        options = {"processes": False, "dashboard_address": "127.0.0.1:0", "silence_logs": 50}
        with Client(n_workers=processes, threads_per_worker=1, **options) as client:
            yield client

    monkeypatch.setattr("gs2ci.batch.cluster.local_workers", threads)


def deadly(shot):
    """Die at the first sight of "b"; refuse all else."""
    seen = Path(os.environ["GS2CI_TEST_SEEN"]) / shot.name
    if shot.name == "b" and not seen.exists():
        seen.touch()
        os._exit(1)
    raise InputError(f"{shot.name} is refused")


def killing(task):
    if task.key == "key1":
        raise distributed.KilledWorker("key1", SimpleNamespace(address="tcp://far:1"), 3)
    return work(task)


def forgotten(_task):
    raise CancelledError


def test_a_worker_that_dies_costs_its_own_exposure_which_is_tried_again(tasks, tmp_path, monkeypatch):
    monkeypatch.setenv("GS2CI_TEST_SEEN", str(tmp_path))
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}):
        rows = sorted(complete(tasks, processes=2), key=lambda row: row.name)
    assert [(row.name, row.problem.problem) for row in rows] == [("a-000", "a is refused"), ("a-001", "b is refused")]
    assert (tmp_path / "b").exists()


def test_a_worker_that_dies_while_it_starts_is_replaced(tmp_path, monkeypatch):
    monkeypatch.setenv("GS2CI_TEST_SEEN", str(tmp_path))
    monkeypatch.setattr(cluster, "_serve", dying.at_first)
    with local_workers(1) as client:
        assert client.submit(os.getpid).result() != os.getpid()
    assert (tmp_path / "started").exists()


def test_only_who_has_the_key_of_the_command_can_send_work(monkeypatch):
    """Whoever reaches a Dask scheduler can run programs as its user, and every local user reaches 127.0.0.1."""
    with local_workers(1) as client:
        address = client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        own = client.security.get_connection_args("client")
        client.sync(distributed.comm.connect, address, timeout=30, **own).abort()
        for other in (None, distributed.Security.temporary()):
            shown = {} if other is None else other.get_connection_args("client")
            with pytest.raises((OSError, TypeError)):
                client.sync(distributed.comm.connect, address, timeout=5, **shown)
        assert client.submit(os.getpid).result() != os.getpid()
    monkeypatch.setattr(distributed.Security, "temporary", _without_cryptography)
    with pytest.raises(InputError, match=r"cryptography.*pip install 'gs2ci\[cluster\]'"), local_workers(1):
        pass


def _without_cryptography():
    raise ImportError("no cryptography")


def test_a_cluster_that_ends_prints_nothing(monkeypatch):
    printed, handler, closing = [], logging.Handler(), distributed.LocalCluster.__exit__
    monkeypatch.setattr(handler, "emit", printed.append)
    logger = logging.getLogger("distributed")
    logger.addHandler(handler)

    def told_late(cluster, *error):
        closing(cluster, *error)
        logging.getLogger("distributed.batched").info("Batched Comm Closed")

    monkeypatch.setattr(distributed.LocalCluster, "__exit__", told_late)
    before = logger.level
    try:
        with local_workers(1):
            pass
    finally:
        logger.removeHandler(handler)
    assert logger.level == before
    assert printed == []


def test_local_workers_are_reached_from_this_machine_alone():
    """Whoever reaches a Dask worker can run programs as its user."""
    with local_workers(1):
        own = psutil.Process()
        listening = [one.laddr.ip for process in (own, *own.children()) for one in process.net_connections()
                     if one.status == psutil.CONN_LISTEN]  # fmt: skip
    assert len(listening) >= 4
    assert set(listening) == {"127.0.0.1"}


def test_workers_that_do_not_start_are_an_error_that_says_what_else_to_do(monkeypatch):
    monkeypatch.setattr(cluster, "START_S", 0.001)
    refused = pytest.raises(DeviceError, match=r"not all have started after 0 s.* 1, which needs no others")
    with refused, local_workers(1):
        pass


def test_an_exposure_whose_workers_all_die_is_given_up_and_the_others_are_not(tasks, monkeypatch, in_threads, tmp_path):
    (tmp_path / "b").touch()
    monkeypatch.setenv("GS2CI_TEST_SEEN", str(tmp_path))
    monkeypatch.setattr("gs2ci.batch.crew.work", killing)
    rows = sorted(complete(tasks, processes=2), key=lambda row: row.name)
    assert [(row.state, row.problem.kind) for row in rows] == [("failed", "InputError"), ("lost", "WorkersDiedError")]
    assert "the last at tcp://far:1" in rows[1].problem.problem


def test_a_scheduler_that_goes_away_is_said(tasks, monkeypatch, in_threads):
    monkeypatch.setattr("gs2ci.batch.crew.work", forgotten)
    with pytest.raises(DeviceError, match="gone away"):
        list(complete(tasks, processes=2))


def test_a_run_goes_the_same_way_through_a_scheduler(tmp_path):
    draws = np.random.default_rng(0)
    masks = (draws.random((3, 16, 20)) < 0.5).astype(np.float32)
    shot = Shot(draws.random((16, 20, 1), dtype=np.float32), masks, np.ones(3, np.float32))
    exposures = list_exposures([write_shots(tmp_path / "a.h5", [shot])], every=True)
    with local_workers(1) as client, admitted(client):
        (row,) = reconstruct_many(exposures, tmp_path / "runs", QUICK, scheduler=client.scheduler.address)
        assert sum(workers_by_host(client).values()) == 1
    assert row.state == "done"
    assert (tmp_path / "runs" / "a-000" / "report.html").is_file()


def test_what_another_worker_finished_meanwhile_is_not_done_twice(tasks, tmp_path):
    done = Row(name="a-000", state="done", file="a.h5", index=0, key="key0")
    write_row(tmp_path, done)
    (tmp_path / "a-000").mkdir()
    assert work(tasks[0]) == done
    assert read_row(tmp_path, "a-000") == done


def test_where_the_folder_is_not_to_be_seen_the_row_says_so_and_nothing_is_made(tasks, tmp_path):
    elsewhere = tmp_path / "not mounted here"
    row = work(replace(tasks[0], output=elsewhere))
    assert "is not to be seen from" in row.problem.problem
    assert not elsewhere.exists()
