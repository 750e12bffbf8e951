"""Orders of depth: whose may be wrong."""

from dataclasses import replace

import pytest

from gs2ci.reconstruct.exposures.orders import is_open, turn_the_wrong
from gs2ci.reconstruct.geometry.kinds import PathSource, Verdict
from tests.reconstruct.exposures.rooms import exposure, middle


@pytest.mark.parametrize(
    ("changed", "is_so"),
    [
        ({"order_errors": 1.0}, True),
        ({"order_errors": None}, True),
        ({"order_errors": 20.0}, False),
        ({"order_errors": 1.0, "order_given": True}, False),
        ({"order_errors": 1.0, "source": PathSource.STAGE}, False),
        ({"order_errors": 1.0, "verdict": Verdict.ROTATION_ONLY}, False),
    ],
)
def test_an_estimated_order_is_open_unless_tracks_are_sure_of_it(changed, is_so):
    assert is_open(replace(exposure("one", middle()).geometry, **changed)) == is_so


def test_without_pairs_nothing_is_turned():
    one = exposure("one", middle())
    geometry = replace(one.geometry, order_errors=1.0)
    assert turn_the_wrong({0: one.views}, {0: geometry}, {0: ()}, {}) == set()
