"""Orders of depth: whose may be wrong."""

from dataclasses import replace

from gs2ci.reconstruct.exposures.tie import turn_the_wrong
from tests.reconstruct.exposures.rooms import exposure, middle


def test_without_pairs_nothing_is_turned():
    one = exposure("one", middle())
    geometry = replace(one.geometry, order_errors=1.0)
    assert turn_the_wrong({0: one.views}, {0: geometry}, {0: ()}, {}) == set()
