"""The density rule keeps the laws of every rule."""

from gs2ci_lamp_array.density import Still

from gs2ci.reconstruct.testing import check_density_rule


def test_it_keeps_the_laws():
    check_density_rule(Still())
