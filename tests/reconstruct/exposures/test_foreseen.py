"""The memory of a joint run is said before it begins."""

from types import SimpleNamespace

import numpy as np
import psutil
import pytest

from gs2ci.core.records import Shot
from gs2ci.reconstruct.exposures.foreseen import foreseen_mib, said


def shot_of(height=264, width=353, views=8):
    return Shot(np.zeros((height, width, 3), np.float32), np.ones((views, height, width), np.float32))


def test_memory_grows_by_the_same_with_each_exposure_and_by_less_than_a_run_takes():
    alone, two, three = (foreseen_mib([shot_of()] * count) for count in (1, 2, 3))
    assert two - alone == pytest.approx(three - two, abs=1)
    assert 0 < two - alone < 0.25 * alone
    assert foreseen_mib([shot_of(views=16)]) > alone
    assert foreseen_mib([shot_of(), shot_of(528, 706)]) > three


@pytest.mark.parametrize(("factor", "said_more"), [(2, False), (0.5, True)])
def test_memory_that_is_not_free_is_said(monkeypatch, factor, said_more):
    shots = [shot_of(48, 64)] * 4
    free = int(factor * foreseen_mib(shots)) * 2**20
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=free))
    sentence = said(shots)
    assert f"4 exposures together take about {foreseen_mib(shots)} MiB" in sentence
    assert ("more than that" in sentence) == said_more
