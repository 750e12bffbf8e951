import pytest

from gs2ci.core.errors import Gs2ciError
from gs2ci_drivers.steps import Steps


def failing(message):
    def undo():
        raise Gs2ciError(message)

    return undo


def test_steps_are_undone_in_reverse():
    done = []
    with Steps() as steps:
        assert steps.do("a", lambda: 1, lambda: done.append("a")) == 1
        steps.do("b", lambda: 2, lambda: done.append("b"))
        steps.do("c", lambda: 3)
    assert done == ["b", "a"]
    assert steps.log == ["a", "b", "c", "undo b", "undo a"]


def test_half_a_step_is_undone_too():
    done = []

    def break_down():
        raise ValueError("half-way")

    with pytest.raises(ValueError, match="half-way"), Steps() as steps:
        steps.do("a", break_down, lambda: done.append("a"))
    assert done == ["a"]


def test_undoing_goes_on_past_errors_and_notes_them_on_the_first_one():
    done = []

    def run():
        with Steps() as steps:
            steps.do("a", lambda: None, lambda: done.append("a"))
            steps.do("b", lambda: None, failing("b is stuck"))
            raise ValueError("first")

    with pytest.raises(ValueError, match="first") as caught:
        run()
    assert done == ["a"]
    assert "undoing «b» failed too: b is stuck" in caught.value.__notes__[0]


def test_an_undo_that_fails_after_success_is_raised_once_all_are_done():
    done = []

    def run():
        with Steps() as steps:
            steps.do("a", lambda: None, lambda: done.append("a"))
            steps.do("b", lambda: None, failing("b is stuck"))

    with pytest.raises(Gs2ciError, match="b is stuck"):
        run()
    assert done == ["a"]


@pytest.mark.parametrize("trouble", [KeyboardInterrupt, ValueError])
def test_undoing_goes_on_past_an_interruption_and_what_nobody_foresaw(trouble):
    done = []

    def interrupted():
        raise trouble

    def run():
        with Steps() as steps:
            steps.do("a", lambda: None, lambda: done.append("a"))
            steps.do("b", lambda: None, interrupted)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        run()
    assert done == ["a"]
    assert caught.value.__notes__ == [f"undoing «b» failed too: {trouble.__name__}"]
