"""Every effect's bound, over a randomised family of scenes and rigs: it holds, and it is not idle."""

import numpy as np
import pytest

from gs2ci_sims.effects.base import Stage
from gs2ci_sims.effects.clock_drift import ClockDrift
from gs2ci_sims.effects.defocus import Defocus
from gs2ci_sims.effects.finite_contrast import FiniteContrast
from gs2ci_sims.effects.illumination_drift import IlluminationDrift
from gs2ci_sims.effects.illumination_flicker import IlluminationFlicker
from gs2ci_sims.effects.lcos_flicker import LcosFlicker
from gs2ci_sims.effects.lcos_response import LcosResponse
from gs2ci_sims.effects.lens_distortion import LensDistortion
from gs2ci_sims.effects.mask_edges import MaskEdges
from gs2ci_sims.effects.mirror_transition import MirrorTransition
from gs2ci_sims.effects.misregistration import Misregistration
from gs2ci_sims.effects.modulator_psf import ModulatorPsf
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.object_motion import ObjectMotion
from gs2ci_sims.effects.optics_psf import OpticsPsf
from gs2ci_sims.effects.stage_backlash import StageBacklash
from gs2ci_sims.effects.stage_ripple import StageRipple
from gs2ci_sims.effects.stage_vibration import StageVibration
from gs2ci_sims.effects.trigger_timing import TriggerTiming
from gs2ci_sims.effects.vignetting import Vignetting
from gs2ci_sims.exposure import integrate, read_out
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import ReversingMove, stage_move_for_parallax
from gs2ci_sims.preview import preview
from gs2ci_sims.rig import Light, Modulator, Optics, Rig, Timing
from gs2ci_sims.scenes.planes import planes

CASES = 6
HOLDS_TO = 1.0
IDLE_BELOW = 0.1


def log_uniform(rng, low, high):
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def draw(rng, scene, rig):
    """Draw one set of figures for every effect."""
    near, far = scene.depth_range()
    width_at_near = near * scene.size[1] / scene.intrinsics[0, 0]
    interval = rig.timing.interval_s
    return {
        effect.name: effect
        for effect in (
            ClockDrift(float(rng.choice([-1, 1])) * log_uniform(rng, 10, 3e4)),
            Defocus(log_uniform(rng, 0.01, 0.3) * width_at_near, float(rng.uniform(near, far))),
            FiniteContrast(log_uniform(rng, 5, 500), float(rng.uniform(0, 0.7)), float(rng.uniform(0, 5))),
            IlluminationDrift(log_uniform(rng, 1e-3, 1) * float(rng.choice([-1, 1])) / rig.exposure_s),
            IlluminationFlicker(log_uniform(rng, 1e-3, 1), log_uniform(rng, 0.05, 20) / interval),
            LcosFlicker(log_uniform(rng, 1e-3, 0.3), log_uniform(rng, 0.2, 20) / interval),
            LcosResponse(log_uniform(rng, 0.003, 3) * interval),
            LensDistortion(float(rng.choice([-1, 1])) * log_uniform(rng, 1e-3, 0.15)),
            MaskEdges(log_uniform(rng, 0.05, 1)),
            MirrorTransition(log_uniform(rng, 0.003, 1) * interval),
            Misregistration(*rng.uniform(-0.7, 0.7, 2), float(rng.uniform(-3, 3)), 1 + float(rng.uniform(-2e-3, 2e-3))),
            ModulatorPsf(log_uniform(rng, 0.05, 1)),
            ObjectMotion((0.0, 0.0, near), 0.5 * width_at_near, (0.2 * width_at_near / rig.exposure_s, 0.0, 0.0)),
            OpticsPsf(log_uniform(rng, 0.05, 1.5)),
            StageBacklash(log_uniform(rng, 1e-3, 0.05) * width_at_near),
            StageRipple(log_uniform(rng, 0.01, 1), log_uniform(rng, 0.2, 5) / interval),
            StageVibration(log_uniform(rng, 1e-4, 0.02) * width_at_near, log_uniform(rng, 0.2, 3) / interval),
            TriggerTiming(float(rng.uniform(-0.5, 0.5)) * interval, log_uniform(rng, 1e-3, 0.2) * interval),
            Vignetting(log_uniform(rng, 0.5, 8)),
        )
    }


class Case:
    """One scene, path, mask set and rig out of the family."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        size = (int(rng.integers(20, 37)), int(rng.integers(24, 41)))
        count = int(rng.choice([1, 2, 4, 6]))
        self.seed = seed
        self.scene = planes(rng, size)
        self.rig = Rig(
            light=Light(log_uniform(rng, 50, 8000)),
            optics=Optics(f_number=log_uniform(rng, 2, 16)),
            modulator=Modulator(masks=count),
            timing=Timing(log_uniform(rng, 1e-3, 0.1), float(rng.choice([0.0, 0.0, 2e-4]))),
        )
        share = float(rng.uniform(0.2, 0.7))
        self.masks = random_masks(count, size, share, rng, feature_px=int(rng.choice([1, 1, 2])))
        angle = rng.uniform(0, 2 * np.pi)
        parallax = float(rng.choice([0.0, 0.5, 2.0])) + 1e-9
        self.path = stage_move_for_parallax(
            self.scene,
            parallax,
            self.rig.exposure_s,
            direction=(np.cos(angle), np.sin(angle), 0.1),
            wobble_deg=0.01,
        )
        self.effects = draw(rng, self.scene, self.rig)

    def readings(self, effects, path=None):
        chain = EffectChain(effects, self.seed, self.rig)
        return read_out(integrate(self.scene, path or self.path, self.masks, chain).photons, chain)


@pytest.fixture(scope="module")
def family():
    return [Case(seed) for seed in range(CASES)]


SAMPLED = (MotionBlur(5),)


def ratios(case, effect, path=None, sampled=SAMPLED):
    """Return what the effect changed, rms and peak, each over its bound."""
    look = preview(case.scene, path or case.path, case.masks, case.rig)
    bound = effect.bound(look, case.rig)
    change = case.readings([*sampled, effect], path) - case.readings(sampled, path)
    rms, peak = np.sqrt(np.square(change).mean()), np.abs(change).max()
    if bound.rms_dn == 0:
        assert rms == peak == 0
        return 0.0, 0.0
    # Views elsewhere carry the rasteriser's graininess, which is no effect of the light path.
    grain = 1.5 * look.graininess(len(case.masks)) if effect.stage in (Stage.MOTION, Stage.MOMENTS) else 0.0
    return max(rms - grain, 0.0) / bound.rms_dn, max(peak - 20 * grain, 0.0) / bound.peak_dn


NAMES = [
    "clock_drift", "defocus", "finite_contrast", "illumination_drift", "illumination_flicker", "lcos_flicker",
    "lcos_response", "lens_distortion", "mask_edges", "mirror_transition", "misregistration", "modulator_psf",
    "object_motion", "optics_psf", "stage_ripple", "stage_vibration", "trigger_timing", "vignetting",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_leaving_an_effect_out_changes_no_more_than_its_bound_and_somewhere_a_tenth_of_it(family, name):
    found = np.array([ratios(case, case.effects[name]) for case in family])
    assert found.max() <= HOLDS_TO
    assert found[:, 0].max() >= IDLE_BELOW


def test_the_bound_of_backlash_holds_on_a_stage_that_reverses(family):
    found = []
    for case in family:
        path = ReversingMove(case.path.velocity, 0.6 * case.rig.exposure_s)
        found.append(ratios(case, case.effects["stage_backlash"], path))
    assert np.max(found) <= HOLDS_TO
    assert np.max(found, axis=0)[0] >= IDLE_BELOW


def test_one_view_per_mask_is_off_from_motion_blur_by_no_more_than_its_bound(family):
    found = np.array([ratios(case, MotionBlur(15), sampled=()) for case in family])
    assert found.max() <= HOLDS_TO
    assert found[:, 0].max() >= IDLE_BELOW
