"""The wish to have what has been found so far: when it can be asked, and Ctrl-C as the wish."""

import signal
import threading

import pytest

from gs2ci.core.halt import Halt, halted_by_interruption


def test_it_can_be_asked_once_and_only_after_something_has_begun():
    halt = Halt()
    assert not halt.ask()
    assert not halt.asked
    halt.begin()
    assert halt.ask()
    assert halt.asked
    assert not halt.ask()


def test_an_interruption_asks_first_and_ends_the_second_time():
    halt = Halt()
    halt.begin()
    with halted_by_interruption(halt):
        signal.raise_signal(signal.SIGINT)
        assert halt.asked
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interruption_before_anything_has_begun_ends():
    halt = Halt()
    with pytest.raises(KeyboardInterrupt), halted_by_interruption(halt):
        signal.raise_signal(signal.SIGINT)
    assert not halt.asked


def test_another_handler_stays():
    heard = []
    before = signal.signal(signal.SIGINT, lambda number, frame: heard.append(number))
    try:
        with halted_by_interruption(Halt()):
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
    assert heard == [signal.SIGINT]


def test_a_thread_takes_no_signal():
    failures = []

    def work():
        try:
            with halted_by_interruption(Halt()):
                pass
        except BaseException as error:  # signal.signal refuses in a thread
            failures.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert not failures
