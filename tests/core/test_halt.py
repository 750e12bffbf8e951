"""The wish to have what has been found so far: when it can be asked, and Ctrl-C as the wish."""

import signal
import threading

import pytest

from gs2ci.core.halt import ENDINGS, Halt, end, halted_by_interruption


def test_it_can_be_asked_once_and_only_after_something_has_begun():
    halt = Halt()
    assert not halt.ask()
    assert not halt.asked
    halt.begin()
    assert halt.ask()
    assert halt.asked
    assert not halt.ask()


def unsaid(text):
    raise AssertionError(text)


def test_an_interruption_asks_first_and_ends_the_second_time():
    halt, told = Halt("Ends."), []
    halt.begin()
    with halted_by_interruption(halt, told.append):
        signal.raise_signal(signal.SIGINT)
        assert halt.asked
        assert told == ["Ends."]
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert told == ["Ends."]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interruption_before_anything_has_begun_ends():
    halt = Halt()
    with pytest.raises(KeyboardInterrupt), halted_by_interruption(halt, unsaid):
        signal.raise_signal(signal.SIGINT)
    assert not halt.asked


@pytest.fixture(params=ENDINGS)
def ending(request, monkeypatch):
    """A signal that the command line takes, whose output is files here."""
    monkeypatch.setattr("gs2ci.core.halt._leave_terminal", lambda number: None)
    before = signal.signal(request.param, end)
    yield request.param
    assert signal.getsignal(request.param) is end
    signal.signal(request.param, before)


def test_a_command_that_is_told_to_end_is_asked_first_as_well(ending):
    halt, told = Halt("Ends."), []
    halt.begin()
    with halted_by_interruption(halt, told.append):
        signal.raise_signal(ending)
        assert halt.asked
        assert told == ["Ends."]
        with pytest.raises(SystemExit) as ended:
            signal.raise_signal(ending)
    assert ended.value.code == 128 + ending


def test_what_goes_on_from_a_disk_is_ended_at_once(ending):
    halt = Halt()
    halt.begin()
    with pytest.raises(SystemExit), halted_by_interruption(halt, unsaid, told_to_end=False):
        signal.raise_signal(ending)
    assert not halt.asked


def test_a_program_that_leaves_kill_to_the_system_keeps_it():
    before = signal.getsignal(signal.SIGTERM)
    with halted_by_interruption(Halt(), unsaid):
        assert signal.getsignal(signal.SIGTERM) is before


def test_another_handler_stays():
    heard = []
    before = signal.signal(signal.SIGINT, lambda number, frame: heard.append(number))
    try:
        with halted_by_interruption(Halt(), unsaid):
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
    assert heard == [signal.SIGINT]


def test_a_thread_takes_no_signal():
    failures = []

    def work():
        try:
            with halted_by_interruption(Halt(), unsaid):
                pass
        except BaseException as error:  # signal.signal refuses in a thread
            failures.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert not failures
