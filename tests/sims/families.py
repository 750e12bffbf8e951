"""Random scenes, rigs, masks and figures of effects, and what an effect changes in them against its bound.

For the tests of bounds and the benchmark `effect_bounds`.
"""

from collections import OrderedDict
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from hypothesis import strategies as st

from gs2ci_sims.effects.base import NOTHING, LightStage, ViewEffect
from gs2ci_sims.effects.flicker import IlluminationDrift, IlluminationFlicker, LcosFlicker
from gs2ci_sims.effects.masks import FiniteContrast, MaskEdges, Misregistration
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.object_motion import ObjectMotion
from gs2ci_sims.effects.photons import Dust, GhostReflection, ModulatorPsf
from gs2ci_sims.effects.stage import StageBacklash, StageRipple, StageVibration
from gs2ci_sims.effects.timing import ClockDrift, RollingShutter, TriggerTiming
from gs2ci_sims.effects.transitions import LcosResponse, MirrorTransition
from gs2ci_sims.effects.views import Defocus, LensDistortion, OpticsPsf, Vignetting
from gs2ci_sims.exposure import integrate, read_out
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.path import ReversingMove, stage_move_for_parallax
from gs2ci_sims.preview import preview
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import Light, ModulatorFigures, Optics, RigFigures, Timing
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
    # The largest drawn may be an interval and a rounding error.
    MirrorTransition: lambda case: log_uniform(0.003 * case.interval, case.interval).map(
        lambda transition_s: MirrorTransition(min(transition_s, case.interval))
    ),
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
    RollingShutter: lambda case: log_uniform(1e-3, 1).map(
        lambda share: RollingShutter(share * case.exposure / case.scene.size[0])
    ),
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


VIEWS_KEPT = 6000


@dataclass(frozen=True)
class RememberingRenderer(Renderer):
    """The rasteriser, with its latest views kept: the same scene is looked at in hundreds of draws."""

    skips = False
    _views: OrderedDict = field(default_factory=OrderedDict, init=False, repr=False, compare=False)

    def views(self, scene, world_to_camera, *, gaussians=None, margin=0):
        if gaussians is not None and gaussians is not scene.gaussians:
            return super().views(scene, world_to_camera, gaussians=gaussians, margin=margin)
        each = [self._view(scene, pose, margin) for pose in world_to_camera]
        return np.stack([view for view, _ in each]), np.stack([covered for _, covered in each])

    def supersampled_views(self, scene, world_to_camera, *, margin=0):
        draw = super().supersampled_views
        return self._kept(scene, world_to_camera, (margin, "fine"), lambda: draw(scene, world_to_camera, margin=margin))

    def _view(self, scene, pose, margin):
        draw = super().views

        def one():
            radiance, coverage = draw(scene, pose[None], margin=margin)
            return radiance[0], coverage[0]

        return self._kept(scene, pose, (margin,), one)

    def _kept(self, scene, poses, options, draw):
        key = (id(scene), poses.tobytes(), *options)
        if key in self._views:
            self._views.move_to_end(key)
        else:
            # The scene is kept too: while it is, no other has its id.
            self._views[key] = (scene, draw())
            if len(self._views) > VIEWS_KEPT:
                self._views.popitem(last=False)
        return self._views[key][1]


RENDERER = RememberingRenderer()


@cache
def _bench(seed):
    """Return scene, rig, path, what the camera sees at the end, and the state of the generator that drew them."""
    rng = np.random.default_rng(seed)
    size = (int(rng.integers(20, 37)), int(rng.integers(24, 41)))
    count = int(rng.choice([1, 2, 4, 6]))
    scene = planes(rng, size)
    rig = RigFigures(
        light=Light(drawn(rng, 50, 8000)),
        optics=Optics(f_number=drawn(rng, 2, 16)),
        modulator=ModulatorFigures(masks=count),
        timing=Timing(drawn(rng, 1e-3, 0.1), float(rng.choice([0.0, 0.0, 2e-4]))),
    )
    angle = rng.uniform(0, 2 * np.pi)
    parallax = float(rng.choice([0.0, 0.5, 2.0])) + 1e-9
    path = stage_move_for_parallax(
        scene, parallax, rig.exposure_s, direction=(np.cos(angle), np.sin(angle), 0.1), wobble_deg=0.01
    )
    ends_s = rig.timing.intervals_s(count)[-1:, 1]
    view = RENDERER.views(scene, path.world_to_camera(ends_s))[0][0].mean(axis=2).astype(np.float64)
    return scene, rig, path, view, rng.bit_generator.state


class Case:
    """One scene, path, mask set and rig out of the family.

    Args:
        seed: Of all of them.
        masks: Which family of masks (`adversaries.FAMILIES`).
    """

    def __init__(self, seed, masks):
        self.seed = seed
        self.scene, self.rig, self.path, view, state = _bench(seed)
        rng = np.random.default_rng()
        rng.bit_generator.state = state
        self.depths = self.scene.depth_range()
        self.width = self.depths[0] * self.scene.size[1] / self.scene.intrinsics[0, 0]
        self.interval, self.exposure = self.rig.timing.interval_s, self.rig.exposure_s
        self.masks = FAMILIES[masks](self.rig.modulator.masks, view, rng)

    def readings(self, effects, path=None, renderer=RENDERER):
        """Return the readings before counting and rounding, [H, W, 3] DN."""
        chain = EffectChain(effects, self.seed, self.rig)
        return read_out(integrate(self.scene, path or self.path, self.masks, chain, renderer=renderer), chain)


SAMPLED = (MotionBlur(5),)


def reversing(case):
    """Return the path of a stage that turns back twice."""
    return ReversingMove(case.path.velocity, 0.6 * case.exposure)


def ratios(case, effect, *, path=None, sampled=SAMPLED, company=(), renderer=RENDERER):
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
    # So do views with another margin, which show where an effect on views changes nothing at all.
    drawn_anew = effect.stage in (LightStage.MOTION, LightStage.MOMENTS) or (
        isinstance(effect, ViewEffect) and bound == NOTHING
    )
    grain = 2 * look.graininess(len(case.masks)) if drawn_anew else 0.0
    rounding = 1e-9 * look.full_scale_dn * len(case.masks)
    return _share(rms - grain - rounding, bound.rms_dn), _share(peak - 20 * grain - rounding, bound.peak_dn)


def _share(change, bound):
    """Return which share of a bound a change reaches; of a bound of nothing, nothing may be reached."""
    if change <= 0:
        return 0.0
    return change / bound if bound > 0 else np.inf
