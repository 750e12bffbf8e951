"""Every bound's derivation: its laws give its values, and its last step is the bound."""

import numpy as np
import pytest
from scipy.special import j1

from gs2ci_sims.effects.base import (
    Brightening,
    Charging,
    KernelEffect,
    LightStage,
    Lowering,
    Modulating,
    Moving,
    ViewChange,
    ViewEffect,
    having,
)
from gs2ci_sims.effects.bayer_filter import BayerFilter
from gs2ci_sims.effects.charges import Blooming, DarkCurrent, FullWell, Persistence
from gs2ci_sims.effects.flicker import IlluminationDrift, IlluminationFlicker, LcosFlicker
from gs2ci_sims.effects.masks import FiniteContrast, MaskEdges, Misregistration
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.noises import Dsnu, HotPixels, Prnu, ReadNoise, RowNoise, ShotNoise
from gs2ci_sims.effects.object_motion import ObjectMotion
from gs2ci_sims.effects.photons import Dust, GhostReflection, ModulatorPsf
from gs2ci_sims.effects.readout import BlackLevel, GainNonlinearity, Quantisation
from gs2ci_sims.effects.stage import StageBacklash, StageRipple, StageVibration
from gs2ci_sims.effects.timing import ClockDrift, RollingShutter, TriggerTiming
from gs2ci_sims.effects.transitions import LcosResponse, MirrorTransition
from gs2ci_sims.effects.views import Defocus, LensDistortion, OpticsPsf, Vignetting
from gs2ci_sims.light_path import LIGHT_PATH, EffectChain, generator
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import ReversingMove, StageMove
from gs2ci_sims.preview import preview
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures, Timing
from gs2ci_sims.scenes.planes import planes

SIZE = (20, 26)
RIG = RigFigures(light=Light(9000.0), modulator=ModulatorFigures(masks=3), timing=Timing(0.02, 1e-4))
EFFECTS = (
    BayerFilter(),
    BlackLevel(-3.0),
    Blooming(0.3),
    ClockDrift(-90.0),
    DarkCurrent(40.0, 31.0, 7.0),
    Defocus(0.05, 3.0),
    Dsnu(2.0),
    Dust(12.0, 1.5, 4.0),
    FiniteContrast(30.0),
    FullWell(RIG.sensor.full_well_e),
    GainNonlinearity(-0.01),
    GhostReflection(0.02, 5.0),
    HotPixels(0.01, 300.0),
    IlluminationDrift(-0.2),
    IlluminationFlicker(0.1, 45.0),
    LcosFlicker(0.02, 270.0),
    LcosResponse(3e-3),
    LensDistortion(-0.03, 0.01),
    MaskEdges(0.4),
    MirrorTransition(4e-4),
    Misregistration(0.2, -0.1, 1.0, 1.001),
    ModulatorPsf(0.3),
    MotionBlur(),
    ObjectMotion((0.0, 0.0, 3.0), 0.8, (0.5, 0.0, 0.0)),
    OpticsPsf(0.5),
    Persistence(0.05, 0.04, 0.01, 5000.0),
    Prnu(0.01),
    Quantisation(10),
    ReadNoise(2.9),
    RollingShutter(1e-4),
    RowNoise(0.4),
    ShotNoise(),
    StageBacklash(5e-3),
    StageRipple(0.2, 15.0),
    StageVibration(2e-3, 60.0),
    TriggerTiming(-2e-4, 3e-5),
    Vignetting(),
)
FUNCTIONS = {name: getattr(np, name) for name in ("sqrt", "exp", "log", "hypot", "sinc", "sin", "cos", "pi", "inf")}
FUNCTIONS |= {"min": min, "max": max, "abs": abs, "J1": j1, "__builtins__": {}}


@pytest.fixture(scope="module")
def looks():
    """Previews of one scene with every effect: one behind a stage that turns back, one behind a stage at rest."""
    scene = planes(np.random.default_rng(3), SIZE)
    masks = random_masks(3, SIZE, 0.4, generator(1, "masks"))
    paths = (ReversingMove((0.5, 0.1, 0.0), 0.03), StageMove((0.0, 0.0, 0.0)))
    return [preview(scene, path, masks, RIG, effects=EFFECTS, seed=2) for path in paths]


def test_every_kind_of_effect_is_looked_at():
    assert {type(effect) for effect in EFFECTS} == set(LIGHT_PATH)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_the_laws_of_a_derivation_give_its_values_and_the_last_one_is_the_bound(looks, effect):
    for look in looks:
        bound = effect.bound(look, RIG)
        assert len(bound.steps) > 1
        assert (bound.steps[-1].symbol, bound.steps[-1].value, bound.steps[-1].unit) == ("bound", bound.rms_dn, "DN")
        known = {}
        for step in bound.steps:
            assert step.symbol not in known
            assert step.what
            if step.law:
                assert eval(step.law, FUNCTIONS, known) == pytest.approx(step.value, rel=1e-9)
            known[step.symbol] = step.value


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_a_derivation_holds_every_figure_of_its_effect(looks, effect):
    values = {step.value for step in effect.bound(looks[0], RIG).steps}
    own = {"MotionBlur": {"nodes"}, "FiniteContrast": {"patch_px"}, "StageVibration": {"hertz"}}
    unused = own.get(type(effect).__name__, set()) | {"reach"}
    figures = {name: value for name, value in vars(effect).items() if isinstance(value, float) and name not in unused}
    earlier = {"earlier_e"} if isinstance(effect, Persistence) else set()
    assert all(value in values for name, value in figures.items() if name not in earlier and name != "radius")


def test_masks_reach_each_effect_as_those_before_it_leave_them_in_whatever_order_they_are_asked_about(looks):
    look = looks[0]
    acting = EffectChain(EFFECTS, look.seed, RIG).at(LightStage.MASKS)
    left = [EffectChain(acting[:count], look.seed, RIG).through(LightStage.MASKS, look.masks) for count in range(9)]
    for effect in (*acting, *acting[::-1], acting[0]):
        before, after = look.masks_around(effect)
        place = acting.index(effect)
        np.testing.assert_array_equal(before, left[place])
        np.testing.assert_array_equal(after, left[place + 1])


def test_departures_of_other_times_are_others(looks):
    look = looks[0]
    wider_s = look.intervals_s + np.array([0.0, 0.01])
    own, wider = look._departures(look.intervals_s), look._departures(wider_s)
    assert (wider >= own).all()
    assert (wider > own).any()
    np.testing.assert_array_equal(look._departures(look.intervals_s), own)


@pytest.mark.parametrize(
    "kind", [Brightening, Charging, KernelEffect, Lowering, Modulating, Moving, ViewChange, ViewEffect]
)
def test_effects_of_a_kind_are_those_that_have_its_parts(kind):
    found = having(EFFECTS, kind)
    assert 0 < len(found) < len(EFFECTS)
    assert found == having(EFFECTS, kind) == [effect for effect in EFFECTS if isinstance(effect, kind)]
