"""The effect keeps the laws of every effect."""

from gs2ci_lamp_array.effect import DimCorner

from gs2ci_sims.testing import check_effect


def test_it_keeps_the_laws():
    check_effect(DimCorner(0.3))
