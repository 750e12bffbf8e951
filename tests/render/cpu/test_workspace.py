import gc
import threading
from types import SimpleNamespace

import numpy as np

from gs2ci.render.cpu import workspace
from gs2ci.render.cpu.workspace import CACHE_LINE_BYTES, Pool, Workspace


def test_buffer_only_grows_and_is_aligned():
    workspace = Workspace()
    small = workspace.get("a", (10, 3))
    assert small.shape == (10, 3)
    assert small.ctypes.data % CACHE_LINE_BYTES == 0
    large = workspace.get("a", (1000,))
    assert workspace.get("a", (20,)).ctypes.data == large.ctypes.data
    assert workspace.capacity("a") >= 1000
    assert workspace.capacity("b") == 0


def test_names_have_buffers_and_types_of_their_own():
    workspace = Workspace()
    workspace.get("a", (4,))[:] = 1
    workspace.get("b", (4,), np.int32)[:] = 2
    assert workspace.get("a", (4,)).tolist() == [1] * 4
    assert workspace.get("b", (4,), np.int32).dtype == np.int32
    assert workspace.get("empty", (0, 5)).shape == (0, 5)


def test_lease_gives_its_workspace_back_once():
    pool = Pool()
    lease = pool.lease()
    workspace = lease.workspace
    lease.release()
    lease.release()
    assert (pool.idle, lease.workspace) == (1, None)
    assert pool.lease().workspace is workspace


def test_forgotten_lease_gives_its_workspace_back():
    pool = Pool()
    lease = pool.lease()
    del lease
    assert pool.idle == 1


def test_pool_keeps_no_more_than_it_was_told():
    pool = Pool(keep=1)
    leases = [pool.lease() for _ in range(3)]
    for lease in leases:
        lease.release()
    assert pool.idle == 1


def test_a_lease_that_the_garbage_collector_frees_while_another_is_handed_out_blocks_nothing(monkeypatch):
    pool, done = Pool(), []

    class Collecting(Workspace):
        """The garbage collector runs when memory is taken, and frees the forgotten lease."""

        def __init__(self):
            super().__init__()
            gc.collect()

    def lease_twice():
        forgotten = SimpleNamespace(lease=pool.lease())
        forgotten.itself = forgotten
        del forgotten
        monkeypatch.setattr(workspace, "Workspace", Collecting)
        done.append(pool.lease())

    gc.collect()
    gc.disable()
    try:
        thread = threading.Thread(target=lease_twice, daemon=True)
        thread.start()
        thread.join(10)
    finally:
        gc.enable()
    assert len(done) == 1
    assert pool.idle == 1
