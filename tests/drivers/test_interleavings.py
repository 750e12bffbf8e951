import pytest
from hypothesis.stateful import run_state_machine_as_test

from tests.drivers.interleavings import STAGES, limits


@pytest.mark.parametrize("stage", sorted(STAGES))
def test_whatever_happens_nothing_moves_after_a_stop_and_no_wrong_position_is_trusted(stage):
    run_state_machine_as_test(STAGES[stage], settings=limits(40, derandomize=True))
