"""Whoever asks for a folder for himself waits, is refused, or gets it."""

import threading

import pytest

from gs2ci.core.alone import alone_in
from gs2ci.core.errors import StorageError


def test_a_folder_in_use_is_refused_and_free_again_afterwards(tmp_path):
    taken = StorageError("it is in use")
    with alone_in(tmp_path), pytest.raises(StorageError, match="in use"), alone_in(tmp_path, taken):
        pass
    with alone_in(tmp_path, taken):
        pass


def test_without_a_refusal_the_second_waits_for_the_first(tmp_path):
    order = []

    def second():
        with alone_in(tmp_path):
            order.append("second")

    with alone_in(tmp_path):
        waiting = threading.Thread(target=second)
        waiting.start()
        waiting.join(0.2)
        order.append("first")
    waiting.join()
    assert order == ["first", "second"]


@pytest.mark.parametrize("refused", [None, StorageError("it is in use")])
def test_a_file_system_without_locks_keeps_nothing_out(tmp_path, monkeypatch, refused):
    def refuses(*_):
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr("gs2ci.core.alone.fcntl.flock", refuses)
    with alone_in(tmp_path, refused), alone_in(tmp_path, refused):
        pass
