"""The planner: what it leaves out, how finely it samples, and how far that is from simulating everything."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.storage import read_shot, write_shots
from gs2ci_sims import light_path as light_paths
from gs2ci_sims.effects.base import EffectRecord, LightStage
from gs2ci_sims.effects.flicker import IlluminationFlicker
from gs2ci_sims.effects.masks import FiniteContrast, MaskEdges, Misregistration
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.noises import Prnu
from gs2ci_sims.effects.object_motion import ObjectMotion
from gs2ci_sims.effects.photons import ModulatorPsf
from gs2ci_sims.effects.stage import StageVibration
from gs2ci_sims.effects.timing import RollingShutter, TriggerTiming
from gs2ci_sims.effects.transitions import LcosResponse, MirrorTransition
from gs2ci_sims.effects.views import Defocus, LensDistortion, OpticsPsf, Vignetting
from gs2ci_sims.exposure import integrate
from gs2ci_sims.light_path import EffectChain, generator, sensor_effects
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import ReversingMove, StageMove, stage_move_for_parallax
from gs2ci_sims.planner import plan
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures, Timing
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.simulation_plan import PlanChoice, SimulationTask
from tests.exposing import expose
from tests.sims import brute_force
from tests.sims.brute_force import deviation_dn, simulate_everything

pytestmark = pytest.mark.slow

SIZE = (24, 32)
STILL = StageMove((0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def scene():
    return planes(np.random.default_rng(12), SIZE)


def rig_with(masks=4, photons=4000.0, interval_s=0.02, dark_s=0.0):
    return RigFigures(light=Light(photons), modulator=ModulatorFigures(masks=masks), timing=Timing(interval_s, dark_s))


def masks_for(rig):
    return random_masks(rig.modulator.masks, SIZE, 0.3, generator(1, "masks"))


def all_effects(rig, *effects):
    return (MotionBlur(), *sensor_effects(rig.sensor), *effects)


def planned(scene, path, rig, *effects, **options):
    return plan(SimulationTask(scene, path, masks_for(rig), rig, all_effects(rig, *effects)), PlanChoice(**options))


def names(decided):
    return {effect.name for effect in decided.effects}


CASES = {  # from calm to violent: photons, parallax, masks, effects
    "at rest": (4000, 0.0, 4, ()),
    "at rest behind a good lens": (4000, 0.0, 4, (OpticsPsf(1e-3), Vignetting(1e-5), LensDistortion(1e-7))),
    "at rest behind a plain lens": (4000, 0.0, 4, (OpticsPsf(0.5), Vignetting(), LensDistortion(-0.02))),
    "dim": (30, 0.5, 4, (OpticsPsf(0.2), MirrorTransition(1e-5), MaskEdges(0.1))),
    "many masks": (500, 0.1, 16, (Misregistration(0.1, 0.1), ModulatorPsf(0.2))),
    "creeping": (4000, 0.1, 4, (MirrorTransition(1e-5),)),
    "small move": (4000, 1.0, 4, (OpticsPsf(0.4), FiniteContrast())),
    "flickering": (4000, 1.0, 4, (IlluminationFlicker(0.3, 30.0), TriggerTiming(1e-4, 1e-5))),
    "liquid crystals": (4000, 1.0, 4, (LcosResponse(4e-3), MaskEdges(0.4))),
    "shallow focus": (4000, 1.0, 2, (Defocus(0.05, 3.0),)),
    "trembling": (1000, 0.5, 2, (StageVibration(2e-3, 40.0),)),
    "rolling": (4000, 1.0, 2, (RollingShutter(2e-4), Prnu(0.01))),
    "moving object": (1000, 0.5, 2, (ObjectMotion((0.0, 0.0, 2.5), 0.6, (1.0, 0.0, 0.0)),)),
    "saturated": (15000, 1.0, 2, (OpticsPsf(0.4),)),
}


def case(scene, name):
    photons, parallax_px, count, effects = CASES[name]
    rig = rig_with(count, photons)
    path = stage_move_for_parallax(scene, parallax_px, rig.exposure_s, wobble_deg=0.0) if parallax_px else STILL
    return rig, path, all_effects(rig, *effects)


@pytest.mark.parametrize("name", CASES)
def test_a_plan_stays_within_its_tolerance_of_simulating_everything_with_no_more_views(monkeypatch, scene, name):
    rig, path, effects = case(scene, name)
    masks = masks_for(rig)
    everything = simulate_everything(scene, path, masks, rig, effects, seed=5)
    rendered, views = [], Renderer.views
    monkeypatch.setattr(Renderer, "views", lambda *given, **named: rendered.append(given) or views(*given, **named))
    for tolerance_dn in (0.25, 2.0):
        decided = plan(SimulationTask(scene, path, masks, rig, effects, 5), PlanChoice(tolerance_dn))
        rendered.clear()
        photons = integrate(scene, path, masks, EffectChain(decided.effects, 5, rig))
        assert decided.error_dn <= tolerance_dn
        # Both simulations are only as good as float32 and the point at which the full one is called settled.
        assert deviation_dn(everything, photons, decided.effects, 5) <= decided.error_dn + 0.01
        assert len(rendered) == decided.views <= everything.views


@dataclass(frozen=True)
class Veil(EffectRecord):
    """An effect of another package that says nothing of what leaving it out would change."""

    stage = LightStage.PHOTONS
    cost_ns = 1.0

    def apply(self, signal, rig, rng):
        return signal + 1e-6


def test_an_effect_without_a_bound_is_simulated_however_little_it_does(scene, monkeypatch):
    monkeypatch.setattr(light_paths, "light_path", lambda *_: (*light_paths.LIGHT_PATH, Veil))
    decided = planned(scene, STILL, rig_with(), Veil(), tolerance_dn=5.0)
    assert "veil" in names(decided)
    (why,) = (decision.why for decision in decided.decisions if decision.name == "veil")
    assert why == "cannot be left out"
    assert decided.error_dn <= 5.0


def test_a_camera_at_rest_is_rendered_once_for_all_masks(scene):
    decided = planned(scene, STILL, rig_with(masks=16))
    assert decided.views == 1
    assert "nothing moves" in {decision.why for decision in decided.decisions}


def test_a_finer_tolerance_takes_more_effects_and_more_views(scene):
    rig, path, effects = case(scene, "small move")
    task = SimulationTask(scene, path, masks_for(rig), rig, effects)
    plans = [plan(task, PlanChoice(dn)) for dn in (0.05, 1.0, 30.0)]
    assert plans[0].views > plans[1].views > plans[2].views
    assert len(plans[0].effects) >= len(plans[1].effects) > len(plans[2].effects)


def test_an_effect_can_be_forced_on_and_off(scene):
    rig = rig_with()
    effects = (OpticsPsf(1e-6), Vignetting())
    free = planned(scene, STILL, rig, *effects)
    forced = planned(scene, STILL, rig, *effects, on=["optics_psf"], off=["vignetting", "shot_noise"])
    assert "optics_psf" not in names(free)
    assert "vignetting" in names(free)
    assert "optics_psf" in names(forced)
    assert not names(forced) & {"vignetting", "shot_noise"}
    why = {decision.name: decision.why for decision in forced.decisions}
    assert why["optics_psf"] == "forced on"
    assert why["vignetting"] == "forced off"


def test_motion_blur_that_is_forced_off_leaves_one_view_per_mask(scene):
    rig, path, effects = case(scene, "small move")
    decided = plan(SimulationTask(scene, path, masks_for(rig), rig, effects), PlanChoice(off=("motion_blur",)))
    assert decided.views == 4
    assert "motion_blur" not in names(decided)


def test_kernels_are_cut_off_nearer_where_more_is_tolerated(scene):
    rig = rig_with()
    reaches = [
        effect.reach
        for dn in (0.1, 5.0)
        for effect in planned(scene, STILL, rig, OpticsPsf(1.0), tolerance_dn=dn).effects
        if isinstance(effect, OpticsPsf)
    ]
    assert reaches[0] > reaches[1]


def test_a_tolerance_that_nothing_meets_is_said_so_in_the_summary(scene):
    rig, path, effects = case(scene, "small move")
    decided = plan(SimulationTask(scene, path, masks_for(rig), rig, effects), PlanChoice(1e-4))
    assert decided.error_dn > 1e-4
    assert "NOT MET" in decided.summary()


def test_what_a_plan_leaves_out_adds_up_to_no_more_than_half_of_the_tolerance(scene):
    rig, path, effects = case(scene, "dim")
    decided = plan(SimulationTask(scene, path, masks_for(rig), rig, effects), PlanChoice(3.0))
    omitted = [d.bound for d in decided.decisions if not d.simulated and d.name != "motion_blur"]
    systematic = sum(bound.rms_dn for bound in omitted if not bound.random)
    noise = math.sqrt(sum(bound.rms_dn**2 for bound in omitted if bound.random))
    assert 0 < math.hypot(systematic, noise) <= 1.5


def test_the_plan_is_kept_with_the_shot(scene, tmp_path):
    rig = rig_with()
    decided = planned(scene, STILL, rig)
    shot = expose(scene, STILL, masks_for(rig), rig, effects=decided.effects, seed=0, plan=decided.record())
    kept = read_shot(write_shots(tmp_path / "shot.h5", [shot])).provenance["plan"]
    assert kept["tolerance_dn"] == 0.25
    assert kept["effects"]["shot_noise"]["simulated"] is True
    assert kept == decided.record()


def test_the_same_plan_comes_of_the_same_question(scene):
    rig, path, effects = case(scene, "trembling")
    first, second = (plan(SimulationTask(scene, path, masks_for(rig), rig, effects, 3)) for _ in range(2))
    assert first.record() == second.record()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tolerance_dn": 0.0}, "tolerance of 0 DN"),
        ({"tolerance_dn": 1e300}, "at most 65536"),
        ({"tolerance_dn": float("nan")}, "tolerance of nan"),
        ({"on": ["glow"]}, "no effect 'glow'"),
        ({"off": ["glow"]}, "no effect 'glow'"),
        ({"on": ["shot_noise"], "off": ["shot_noise"]}, "both on and off"),
    ],
)
def test_a_question_without_meaning_is_refused(scene, options, words):
    with pytest.raises(InputError, match=words):
        planned(scene, STILL, rig_with(), **options)


def test_a_brute_force_that_never_settles_says_so(scene, monkeypatch):
    monkeypatch.setattr(brute_force, "PARTS_MAX", 1)
    rig, path, effects = case(scene, "small move")
    with pytest.raises(NumericsError, match="still change"):
        simulate_everything(scene, path, masks_for(rig), rig, effects, seed=0)


HARD = {
    "no photons": {"photons": 0.0},
    "a billion photons": {"photons": 1e9, "masks": 2},
    "one mask": {"masks": 1},
    "eight masks": {"masks": 8},
    "gaps as long as masks": {"dark_s": 0.02},
    "a microsecond": {"interval_s": 1e-6},
}


@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize(
    "path",
    [STILL, ReversingMove((0.3, 0.0, 0.0), 0.05), StageMove((0.0, 0.0, 60.0)), StageMove((1e3, 0.0, 0.0))],
    ids=["at rest", "reversing", "through the scene", "out of sight"],
)
def test_hard_cases_give_finite_readings_in_range(scene, name, path):
    rig = rig_with(**HARD[name])
    effects = all_effects(rig, OpticsPsf(0.5), FiniteContrast(), TriggerTiming(1e-7, 1e-8), Vignetting())
    masks = masks_for(rig)
    decided = plan(SimulationTask(scene, path, masks, rig, effects), PlanChoice(50.0))
    shot = expose(scene, path, masks, rig, effects=decided.effects, seed=0)
    top = (2**rig.sensor.bits - 1 - rig.sensor.black_level_dn) * rig.sensor.electrons_per_dn / (rig.full_scale_e or 1)
    assert np.isfinite(shot.measurement).all()
    assert shot.measurement.max() <= top * (1 + 1e-6)
    assert math.isfinite(decided.error_dn)


def test_a_sensor_of_one_pixel_is_exposed():
    tiny = planes(np.random.default_rng(0), (1, 1))
    rig = rig_with(masks=2)
    masks = np.ones((2, 1, 1), dtype=np.float32)
    effects = all_effects(rig, OpticsPsf(0.5), Defocus(0.01, 2.0), Misregistration(0.3, 0.3), ModulatorPsf(0.5))
    decided = plan(SimulationTask(tiny, StageMove((0.1, 0.0, 0.0)), masks, rig, effects))
    shot = expose(tiny, StageMove((0.1, 0.0, 0.0)), masks, rig, effects=decided.effects, seed=0)
    assert np.isfinite(shot.measurement).all()


def test_a_jitter_longer_than_the_exposure_gives_a_shot_or_one_error_before_anything_is_rendered(scene):
    rig = rig_with()
    effects = all_effects(rig, TriggerTiming(0.0, 10.0))
    outcomes = set()
    for seed in range(40):
        try:
            shot = expose(scene, STILL, masks_for(rig), rig, effects=effects, seed=seed)
        except InputError as error:
            outcomes.add("misses all masks" in str(error))
        else:
            assert np.isfinite(shot.measurement).all()
    assert outcomes == {True}
