import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.faults import KNOWN, FaultSet

SPLASH = "test.splash"


@pytest.fixture(autouse=True)
def _declared(monkeypatch):
    monkeypatch.setitem(KNOWN, SPLASH, "water on the bench")


def test_a_fault_strikes_after_its_skips_as_often_as_told_and_is_remembered():
    faults = FaultSet()
    faults.inject("test.splash", skip=1, times=2, value=3.0)
    struck = [faults.take(SPLASH, f"turn {i}") for i in range(5)]
    assert [injected is not None for injected in struck] == [False, True, True, False, False]
    assert struck[1].value == 3.0
    assert faults.struck == [("test.splash", "turn 1"), ("test.splash", "turn 2")]


def test_a_fault_about_something_waits_for_it():
    faults = FaultSet()
    faults.inject("test.splash", about="move")
    assert faults.take(SPLASH, "get pos") is None
    assert faults.take(SPLASH, "move abs 3") is not None


def test_cleared_faults_are_gone():
    faults = FaultSet()
    faults.inject("test.splash")
    faults.clear()
    assert faults.take(SPLASH) is None


def test_an_unknown_fault_names_the_nearest():
    with pytest.raises(InputError, match=r"test\.splosh.*did you mean 'test\.splash'"):
        FaultSet().inject("test.splosh")
