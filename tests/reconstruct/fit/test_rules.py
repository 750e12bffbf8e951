from dataclasses import replace

import pytest

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.choices import RULE_NAMES
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.rules import with_rule


@pytest.mark.parametrize("name", RULE_NAMES)
def test_the_rule_of_a_name_has_that_name(name):
    assert with_rule(CoarseSettings(), name).check().density.name == name


@pytest.mark.parametrize(
    ("name", "opacity", "size"), [("osgr", 0.01, 0), ("adc", 0, 0), ("mcmc", 0.01, 0.01), ("revised", 0, 0)]
)
def test_each_brings_the_terms_of_the_objective_that_its_authors_gave_it(name, opacity, size):
    loss = with_rule(with_rule(CoarseSettings(), "adc"), name).loss
    assert (loss.opacity, loss.size) == (opacity, size)


def test_nothing_else_changes():
    settings = CoarseSettings(iterations=17)
    other = with_rule(settings, "mcmc")
    assert replace(other, density=settings.density, loss=settings.loss) == settings
    assert other.loss.similarity == settings.loss.similarity


def test_settings_that_have_the_rule_are_left_as_they_are():
    tuned = CoarseSettings(density=Osgr(extra_splits=0.2))
    assert with_rule(tuned, "osgr") is tuned


def test_an_unknown_name_is_refused():
    with pytest.raises(InputError, match="no density rule 'abc'"):
        with_rule(CoarseSettings(), "abc")
