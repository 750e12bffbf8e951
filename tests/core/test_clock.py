from contextvars import copy_context

from gs2ci.core.clock import begin_command, command_age_s


def test_without_a_command_nobody_has_waited():
    assert command_age_s() == 0.0


def test_a_command_counts_from_the_start_of_its_process():
    def one_command():
        begin_command()
        first = command_age_s()
        return first, command_age_s()

    first, second = copy_context().run(one_command)
    assert 0 < first <= second
    assert command_age_s() == 0.0
