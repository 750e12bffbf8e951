import threading
import time

import pytest

from gs2ci.core.errors import InputError
from gs2ci.rig.ring import WritingRing
from gs2ci_drivers.acquisition import Taken


def shots(count):
    return [Taken(index, (), index) for index in range(count)]


def test_everything_is_written_in_order_before_it_is_left():
    written = []
    with WritingRing(lambda taken: written.append(taken.index), 3) as ring:
        for taken in shots(50):
            ring.put(taken)
    assert written == list(range(50))
    assert ring.fullest <= 3


def test_a_slow_disk_holds_up_whoever_takes_and_memory_holds_no_more_than_the_ring():
    begun, gate, written = threading.Event(), threading.Event(), []

    def write(taken):
        begun.set()
        gate.wait()
        written.append(taken.index)

    first, *others = shots(20)
    with WritingRing(write, 4) as ring:
        ring.put(first)
        # Before the writer has this one, the ring may be full once more than it is afterwards.
        assert begun.wait(10)
        taker = threading.Thread(target=lambda: [ring.put(taken) for taken in others])
        taker.start()
        until = time.monotonic() + 10
        while not ring.waits and time.monotonic() < until:
            time.sleep(0.005)
        seen = ring.waits, ring.fullest, list(written)
        gate.set()
        taker.join()
    assert seen == (1, 4, [])
    assert written == list(range(20))
    assert ring.waited_s > 0


def test_what_the_disk_refuses_is_raised_where_shots_are_taken_and_nothing_hangs():
    def refuse(taken):
        raise OSError(28, "No space left on device")

    for count in (50, 1):  # while they are taken, and at the end at the latest
        with pytest.raises(OSError, match="No space"):
            fill(refuse, shots(count))


def fill(sink, taken):
    with WritingRing(sink, 2) as ring:
        for one in taken:
            ring.put(one)


def test_an_error_of_the_taker_is_the_one_that_is_told():
    def refuse(taken):
        raise OSError(28, "No space left on device")

    with pytest.raises(TypeError, match="not iterable"):
        fill(refuse, Broken())


class Broken(list):
    def __iter__(self):
        yield shots(1)[0]
        raise TypeError("not iterable")


def test_a_ring_of_nothing_is_refused():
    with pytest.raises(InputError, match="ring of 0"):
        WritingRing(print, 0)
