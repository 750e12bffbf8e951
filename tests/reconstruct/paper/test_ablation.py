"""Each component of the paper's ablation table can be switched off by name, and nothing else changes with it."""

from dataclasses import asdict, replace

import pytest

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.fit.withheld import Withheld
from gs2ci.reconstruct.paper.preset import COMPONENTS, paper_settings, without
from gs2ci.reconstruct.settings import Settings

CHANGED = {
    "points": {"withheld.points"},
    "poses": {"withheld.poses"},
    "opacity-split": {"fit.density.opacity_splits"},
    "opacity-regulation": {"fit.loss.opacity"},
    "count-cap": {"fit.cap_from", "fit.gaussians_per_pixel", "fit.most_gaussians"},
    "pose-refinement": {"fit.poses.refine"},
}


def flat(tree, prefix=""):
    rows = {}
    for key, value in tree.items():
        rows.update(flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value})
    return rows


def changes(before, after):
    rows, others = (flat(asdict(replace(one, withheld=one.withheld or Withheld()))) for one in (before, after))
    assert rows.keys() == others.keys()
    return {key for key, value in rows.items() if others[key] != value}


def test_the_components_are_those_of_the_papers_table_in_its_order():
    assert list(COMPONENTS) == list(CHANGED)


@pytest.mark.parametrize("name", COMPONENTS)
def test_switching_one_off_changes_what_it_says_and_nothing_else(name):
    settings = paper_settings()
    # The paper has no cap per pixel, and the guard that ends a fit without one.
    expected = CHANGED[name] - {"fit.gaussians_per_pixel", "fit.most_gaussians"}
    assert changes(settings, without(settings, (name,)).check()) == expected


@pytest.mark.parametrize("name", COMPONENTS)
def test_every_one_can_be_switched_off_in_the_default_as_well(name):
    changed = changes(Settings(), without(Settings(), (name,)).check())
    # Every second fit of the default has a density rule of its own.
    assert {key.replace("second_density", "fit.density") for key in changed} <= CHANGED[name]
    assert changes(Settings(), without(Settings(), (name,)))


def test_all_can_be_switched_off_together():
    changed = changes(Settings(fits=1, second_density=None), without(Settings(fits=1, second_density=None), COMPONENTS))
    assert changed | {"fit.cap_from"} == set().union(*CHANGED.values())


def test_none_switched_off_changes_nothing():
    settings = Settings()
    assert without(settings, ()) is settings


def test_an_unknown_name_is_refused():
    with pytest.raises(InputError, match="no component 'luck'"):
        without(Settings(), ("points", "luck"))


def test_opacity_splits_can_only_be_switched_off_where_there_are_some():
    settings = Settings()
    with pytest.raises(InputError, match="'adc' without its opacity splits"):
        without(settings.with_density_rule("adc"), ("opacity-split",))
