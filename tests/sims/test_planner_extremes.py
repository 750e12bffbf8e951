"""Every effect at the end of its range: planned and exposed, finite and in range, or one error before any view."""

import math

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.bayer_filter import BayerFilter
from gs2ci_sims.effects.charges import Blooming, DarkCurrent, FullWell, Persistence
from gs2ci_sims.effects.flicker import IlluminationDrift, IlluminationFlicker, LcosFlicker
from gs2ci_sims.effects.masks import FiniteContrast, MaskEdges, Misregistration
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.noises import Dsnu, HotPixels, Prnu, ReadNoise, RowNoise
from gs2ci_sims.effects.object_motion import ObjectMotion
from gs2ci_sims.effects.photons import Dust, GhostReflection, ModulatorPsf
from gs2ci_sims.effects.readout import BlackLevel, GainNonlinearity
from gs2ci_sims.effects.stage import StageBacklash, StageRipple, StageVibration
from gs2ci_sims.effects.timing import ClockDrift, RollingShutter, TriggerTiming
from gs2ci_sims.effects.transitions import LcosResponse, MirrorTransition
from gs2ci_sims.effects.views import Defocus, LensDistortion, OpticsPsf, Vignetting
from gs2ci_sims.light_path import LIGHT_PATH, sensor_effects
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import StageMove
from gs2ci_sims.planner import plan
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures, Timing
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.simulation_plan import PlanChoice, SimulationTask
from tests.exposing import expose

SIZE, MASKS = (12, 16), 2
MOVE = StageMove((0.5, 0.1, 0.0))
WIDEST = OpticsPsf(100.0)
EXTREMES = [
    StageRipple(1.0, 1e6), StageRipple(1.0, 1e-6), StageBacklash(0.0), StageBacklash(1e9),
    StageVibration(1e3, 1e-3), StageVibration(1e-12, 1e9), StageVibration(10.0, 1e6),
    ObjectMotion((0.0, 0.0, 3.0), 1e6, (1e6, 0.0, 0.0)), ObjectMotion((0.0, 0.0, 3.0), 1e-9, (0.0, 0.0, 1e9)),
    ClockDrift(1e9), ClockDrift(-999_999.0), MirrorTransition(0.0), MirrorTransition(0.02), MirrorTransition(1.0),
    LcosResponse(0.0), LcosResponse(1e9), LcosFlicker(1.0, 1e9), LcosFlicker(1.0, 1e-9),
    TriggerTiming(1e9, 0.0), TriggerTiming(-1e9, 0.0), TriggerTiming(0.0, 1e9),
    IlluminationFlicker(1.0, 1e9), IlluminationFlicker(1.0, 1e-9), IlluminationDrift(1e12), IlluminationDrift(-1e12),
    LensDistortion(1e3), LensDistortion(-1e3), Defocus(1e9, 1e-9), Defocus(0.0, 1e9), WIDEST, OpticsPsf(0.0),
    Vignetting(1e9), MaskEdges(100.0), FiniteContrast(1 + 1e-9, 2.0, 100.0), FiniteContrast(1e30, 0.0, 0.0),
    Misregistration(1e6, -1e6, 1e6, 1e6), Misregistration(0.0, 0.0, 0.0, 1e-6), ModulatorPsf(100.0),
    GhostReflection(0.5, 64.0), GhostReflection(0.0), Dust(300.0, 128.0, 128.0), Dust(1e4, 0.0, 0.0),
    RollingShutter(1e9), BayerFilter("GBRG"), Prnu(0.5), DarkCurrent(1e30, 100.0, 1.0), HotPixels(1.0, 1e30),
    Persistence(1.0, 1e-9, 1e9, 1e30), Blooming(1.0), FullWell(1e-9), FullWell(1e30), GainNonlinearity(0.2499),
    Dsnu(1e30), ReadNoise(1e30), RowNoise(1e30), BlackLevel(1e30), BlackLevel(-1e30),
]  # fmt: skip


@pytest.fixture(scope="module")
def scene():
    return planes(np.random.default_rng(5), SIZE)


@pytest.mark.parametrize("effect", EXTREMES, ids=str)
def test_an_effect_at_the_end_of_its_range_gives_readings_in_range_or_one_error(scene, effect):
    rig = RigFigures(light=Light(4000.0), modulator=ModulatorFigures(MASKS), timing=Timing(0.02))
    masks = random_masks(MASKS, SIZE, 0.4, np.random.default_rng(6))
    own = [other for other in sensor_effects(rig.sensor) if other.name != effect.name]
    effects = (MotionBlur(), *own, effect)
    # A blur that looks hundreds of pixels beyond the sensor makes every view of it ten megapixels: one is enough.
    path = StageMove((0.0, 0.0, 0.0)) if effect == WIDEST else MOVE
    try:
        decided = plan(SimulationTask(scene, path, masks, rig, effects), PlanChoice(50.0))
        shot = expose(scene, path, masks, rig, effects=decided.effects, seed=0)
    except InputError:
        return
    sensor = rig.sensor
    top = (2**sensor.bits - 1 - sensor.black_level_dn) * sensor.electrons_per_dn / rig.full_scale_e
    assert np.isfinite(shot.measurement).all()
    assert shot.measurement.max() <= top * (1 + 1e-6)
    assert math.isfinite(decided.error_dn)


def test_a_sensor_full_of_dark_charge_keeps_the_limits_that_clip_it(scene):
    rig = RigFigures(light=Light(100.0), modulator=ModulatorFigures(MASKS), timing=Timing(0.02))
    masks = random_masks(MASKS, SIZE, 0.4, np.random.default_rng(6))
    for current, clipped in ((10.0, False), (1e6, True)):
        effects = (MotionBlur(), *sensor_effects(rig.sensor), DarkCurrent(current))
        decided = plan(SimulationTask(scene, MOVE, masks, rig, effects), PlanChoice(5.0))
        assert ({"full_well", "quantisation"} <= {effect.name for effect in decided.effects}) == clipped


def test_every_effect_with_a_figure_is_taken_to_an_end_of_its_range():
    tested = {type(effect) for effect in EXTREMES}
    without_figures = {"motion_blur", "shot_noise", "quantisation"}
    assert {kind.name for kind in LIGHT_PATH if kind not in tested} == without_figures
