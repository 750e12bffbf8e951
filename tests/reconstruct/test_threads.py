"""Work in threads: its order, its errors, and what it leaves of OpenCV's settings."""

import threading

import cv2
import pytest

from gs2ci.reconstruct.threads import in_threads, one_opencv_thread


def test_results_are_in_the_items_order_and_several_threads_work(monkeypatch):
    monkeypatch.setattr("numba.get_num_threads", lambda: 2)
    both = threading.Barrier(2, timeout=60)

    def work(item):
        if item in (0, 1):
            both.wait()  # neither goes on before the other has begun
        return 10 * item

    assert in_threads(work, range(5)) == [0, 10, 20, 30, 40]
    assert in_threads(work, []) == []


def test_no_more_than_allowed_work_at_once(monkeypatch):
    monkeypatch.setattr("numba.get_num_threads", lambda: 8)
    seen = in_threads(lambda _: threading.get_ident(), range(20), at_most=1)
    assert len(set(seen)) == 1


def test_the_first_error_is_raised():
    with pytest.raises(ValueError, match="3"):
        in_threads(lambda item: (_ for _ in ()).throw(ValueError(item)) if item > 2 else item, range(5))


def test_opencv_gets_its_threads_back():
    def fail():
        with one_opencv_thread():
            raise RuntimeError(cv2.getNumThreads())

    before = cv2.getNumThreads()
    with pytest.raises(RuntimeError, match=r"^1$"):
        fail()
    assert cv2.getNumThreads() == before
