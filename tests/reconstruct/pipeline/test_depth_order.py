"""A small motion whose order of depth tracks leave open: whole fits of both orders tell it."""

from gs2ci.core.findings import Code
from gs2ci.reconstruct.hypotheses import jury
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from tests.benchmarks.depth_order import draw
from tests.tables.order import depth_rank


def test_what_hides_what_tells_near_from_far_where_nothing_else_does(monkeypatch):
    """4.8 px of parallax in a field of view of 24°: tracks prefer neither order, and one panel hides the wall."""
    told, told_by = [], jury.told_by

    def watched(*seen):
        told.append(told_by(*seen))
        return told[-1]

    monkeypatch.setattr(jury, "told_by", watched)
    trial = draw(3, 31)
    found = reconstruct(trial.shot, Settings(motion="off")).result
    assert depth_rank(found.depth[trial.shot.views // 2], trial.scene.depth) > 0.4
    codes = [note.code for note in found.notes]
    assert Code.DEPTH_ORDER_LIKELY in codes
    assert Code.DEPTH_ORDER_OPEN not in codes
    assert len(told) == 1
    assert found.geometry.order_errors == told[0][1].errors > 2
