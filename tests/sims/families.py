"""Random scenes, rigs, masks and figures of effects, and what an effect changes in them against its bound.

For the tests of bounds and the benchmark `effect_bounds`.
"""

import numpy as np
from hypothesis import strategies as st

from gs2ci_sims.effects.base import Stage
from gs2ci_sims.effects.clock_drift import ClockDrift
from gs2ci_sims.effects.defocus import Defocus
from gs2ci_sims.effects.dust import Dust
from gs2ci_sims.effects.finite_contrast import FiniteContrast
from gs2ci_sims.effects.ghost_reflection import GhostReflection
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
from gs2ci_sims.path import ReversingMove, stage_move_for_parallax
from gs2ci_sims.preview import preview
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import Light, Modulator, Optics, Rig, Timing
from gs2ci_sims.scenes.planes import planes
from tests.sims.adversaries import FAMILIES


def log_uniform(low, high):
    return st.floats(np.log10(low), np.log10(high)).map(lambda exponent: 10.0**exponent)


def either_sign(numbers):
    return st.tuples(st.sampled_from([-1.0, 1.0]), numbers).map(np.prod).map(float)


def shift():
    return st.floats(-0.7, 0.7)


# Figures of every effect, in units of the case: its interval and exposure, and the width seen at the nearest depth.
FAMILY = {
    ClockDrift: lambda case: st.builds(ClockDrift, either_sign(log_uniform(10, 3e4))),
    Defocus: lambda case: st.builds(Defocus, log_uniform(0.01 * case.width, 0.3 * case.width), st.floats(*case.depths)),
    Dust: lambda case: st.builds(Dust, log_uniform(0.1, 30), log_uniform(0.3, 6), log_uniform(0.3, 12)),
    GhostReflection: lambda case: st.builds(GhostReflection, log_uniform(1e-4, 0.3), log_uniform(0.3, 12)),
    FiniteContrast: lambda case: st.builds(FiniteContrast, log_uniform(5, 500), st.floats(0, 0.7), st.floats(0, 5)),
    IlluminationDrift: lambda case: st.builds(
        IlluminationDrift, either_sign(log_uniform(1e-3 / case.exposure, 1 / case.exposure))
    ),
    IlluminationFlicker: lambda case: st.builds(
        IlluminationFlicker, log_uniform(1e-3, 1), log_uniform(0.05 / case.interval, 20 / case.interval)
    ),
    LcosFlicker: lambda case: st.builds(
        LcosFlicker, log_uniform(1e-3, 0.3), log_uniform(0.2 / case.interval, 20 / case.interval)
    ),
    LcosResponse: lambda case: st.builds(LcosResponse, log_uniform(0.003 * case.interval, 3 * case.interval)),
    LensDistortion: lambda case: st.builds(LensDistortion, either_sign(log_uniform(1e-3, 0.15))),
    MaskEdges: lambda case: st.builds(MaskEdges, log_uniform(0.05, 1)),
    MirrorTransition: lambda case: st.builds(MirrorTransition, log_uniform(0.003 * case.interval, case.interval)),
    Misregistration: lambda case: st.builds(
        Misregistration, shift(), shift(), st.floats(-3, 3), st.floats(1 - 2e-3, 1 + 2e-3)
    ),
    ModulatorPsf: lambda case: st.builds(ModulatorPsf, log_uniform(0.05, 1)),
    ObjectMotion: lambda case: log_uniform(0.02, 0.4).map(
        lambda way: ObjectMotion(
            (0.0, 0.0, case.depths[0]), 0.5 * case.width, (way * case.width / case.exposure, 0.0, 0.0)
        )
    ),
    OpticsPsf: lambda case: st.builds(OpticsPsf, log_uniform(0.05, 1.5)),
    StageBacklash: lambda case: st.builds(StageBacklash, log_uniform(1e-3 * case.width, 0.05 * case.width)),
    StageRipple: lambda case: st.builds(
        StageRipple, log_uniform(0.01, 1), log_uniform(0.2 / case.interval, 5 / case.interval)
    ),
    StageVibration: lambda case: st.builds(
        StageVibration,
        log_uniform(1e-4 * case.width, 0.02 * case.width),
        log_uniform(0.2 / case.interval, 3 / case.interval),
    ),
    TriggerTiming: lambda case: st.builds(
        TriggerTiming,
        st.floats(-0.5, 0.5).map(lambda share: share * case.interval),
        log_uniform(1e-3 * case.interval, 0.2 * case.interval),
    ),
    Vignetting: lambda case: st.builds(Vignetting, log_uniform(0.5, 8)),
}


def drawn(rng, low, high):
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


class Case:
    """One scene, path, mask set and rig out of the family.

    Args:
        seed: Of all of them.
        masks: Which family of masks (`adversaries.FAMILIES`).
    """

    def __init__(self, seed, masks):
        rng = np.random.default_rng(seed)
        size = (int(rng.integers(20, 37)), int(rng.integers(24, 41)))
        count = int(rng.choice([1, 2, 4, 6]))
        self.seed = seed
        self.scene = planes(rng, size)
        self.rig = Rig(
            light=Light(drawn(rng, 50, 8000)),
            optics=Optics(f_number=drawn(rng, 2, 16)),
            modulator=Modulator(masks=count),
            timing=Timing(drawn(rng, 1e-3, 0.1), float(rng.choice([0.0, 0.0, 2e-4]))),
        )
        angle = rng.uniform(0, 2 * np.pi)
        parallax = float(rng.choice([0.0, 0.5, 2.0])) + 1e-9
        self.path = stage_move_for_parallax(
            self.scene,
            parallax,
            self.rig.exposure_s,
            direction=(np.cos(angle), np.sin(angle), 0.1),
            wobble_deg=0.01,
        )
        self.depths = self.scene.depth_range()
        self.width = self.depths[0] * size[1] / self.scene.intrinsics[0, 0]
        self.interval, self.exposure = self.rig.timing.interval_s, self.rig.exposure_s
        ends_s = self.rig.timing.intervals_s(count)[-1:, 1]
        view = Renderer().views(self.scene, self.path.world_to_camera(ends_s))[0][0]
        self.masks = FAMILIES[masks](count, view.mean(axis=2).astype(np.float64), rng)

    def readings(self, effects, path=None, renderer=None):
        """Return the readings before counting and rounding, [H, W, 3] DN."""
        chain = EffectChain(effects, self.seed, self.rig)
        return read_out(integrate(self.scene, path or self.path, self.masks, chain, renderer=renderer).photons, chain)


SAMPLED = (MotionBlur(5),)


def reversing(case):
    """Return the path of a stage that turns back twice."""
    return ReversingMove(case.path.velocity, 0.6 * case.exposure)


def ratios(case, effect, *, path=None, sampled=SAMPLED, company=(), renderer=None):
    """Return what the effect changed, rms and peak, each over its bound.

    Args:
        case: Where.
        effect: Which.
        path: Another than the case's.
        sampled: How the motion is sampled.
        company: Other effects that the rig has; they are on with and without this one.
        renderer: Draws all views.
    """
    options = {"effects": (*company, effect), "seed": case.seed}
    look = preview(case.scene, path or case.path, case.masks, case.rig, renderer, **options)
    bound = effect.bound(look, case.rig)
    others = (*sampled, *company)
    change = case.readings([*others, effect], path, renderer) - case.readings(others, path, renderer)
    rms, peak = float(np.sqrt(np.square(change).mean())), float(np.abs(change).max())
    # Views elsewhere carry the rasteriser's graininess, which is no effect of the light path; the rest is rounding.
    grain = 2 * look.graininess(len(case.masks)) if effect.stage in (Stage.MOTION, Stage.MOMENTS) else 0.0
    rounding = 1e-9 * look.full_scale_dn * len(case.masks)
    return _share(rms - grain - rounding, bound.rms_dn), _share(peak - 20 * grain - rounding, bound.peak_dn)


def _share(change, bound):
    """Return which share of a bound a change reaches; of a bound of nothing, nothing may be reached."""
    if change <= 0:
        return 0.0
    return change / bound if bound > 0 else np.inf
