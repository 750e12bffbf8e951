from dataclasses import fields, replace
from typing import get_args

import pytest

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.choices import PresetName
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.optimiser.gaussians import StepSizes
from gs2ci.reconstruct.presets.named import PRESETS, preset, rescheduled
from gs2ci.reconstruct.settings import Settings

NAMES = get_args(PresetName)


def test_every_name_has_settings_that_make_sense():
    assert set(PRESETS) == set(NAMES)
    for name in NAMES:
        assert preset(name).check() is PRESETS[name]


def test_standard_is_what_the_pipeline_does_without_being_asked():
    assert preset("standard") == Settings()


def test_presets_go_further_one_after_the_other():
    iterations = [PRESETS[name].fit.iterations for name in NAMES]
    assert iterations == sorted(iterations)
    assert PRESETS["paper"].fit.iterations == 20_000


def test_an_unknown_preset_is_refused_with_the_names():
    with pytest.raises(InputError, match="no preset 'best'"):
        preset("best")


@pytest.mark.parametrize("iterations", [1, 8, 20, 200, 1000, 3000])
def test_a_schedule_of_any_length_has_its_looks_and_turns(iterations):
    fit = rescheduled(CoarseSettings(), iterations).check()
    assert fit.iterations == iterations
    assert 10 <= fit.hold_out.look_every <= 50
    assert 10 <= fit.densify_every <= 100


@pytest.mark.parametrize("name", ["means", "log_scales", "quaternions", "opacity_logits", "colours"])
def test_shorter_schedules_take_longer_steps_within_bounds(name):
    natural = StepSizes()
    steps = {n: rescheduled(CoarseSettings(), n).steps for n in (5, 150, 600, 3000)}
    assert steps[600] == steps[3000] == natural
    assert getattr(steps[150], name) == pytest.approx(2 * getattr(natural, name))
    assert getattr(steps[5], name) == pytest.approx(3.5 * getattr(natural, name))


def test_rescheduling_twice_is_rescheduling_once_and_changes_nothing_else():
    fit = replace(CoarseSettings(), gaussians_per_pixel=0.7)
    assert rescheduled(rescheduled(fit, 100), 600) == rescheduled(fit, 600)
    changed = {f.name for f in fields(fit) if getattr(fit, f.name) != getattr(rescheduled(fit, 100), f.name)}
    assert changed == {"iterations", "densify_every", "steps", "hold_out"}
