"""The laws that every effect of the light path obeys, over one effect of each kind."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci_sims.effects.base import LightStage
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
from gs2ci_sims.light_path import LIGHT_PATH, EffectChain
from gs2ci_sims.moments import one_per_interval
from gs2ci_sims.path import StageMove
from gs2ci_sims.rig import ModulatorFigures, RigFigures
from gs2ci_sims.signals import View, nominal_slices

RIG = RigFigures(modulator=ModulatorFigures(masks=4))
INTERVALS = RIG.timing.intervals_s(4)
ONE_OF_EACH = [
    StageRipple(0.1, 20.0), StageBacklash(0.1), StageVibration(0.01, 30.0),
    ObjectMotion((0.0, 0.0, 3.0), 1.0, (1.0, 0.0, 0.0)),
    RollingShutter(1e-4), ClockDrift(1e3), MirrorTransition(1e-3), LcosResponse(5e-3), LcosFlicker(0.1),
    TriggerTiming(1e-3, 1e-3), IlluminationFlicker(0.3), IlluminationDrift(0.5),
    LensDistortion(-0.05), Defocus(0.05, 2.0), OpticsPsf(0.8), Vignetting(),
    MaskEdges(), FiniteContrast(), Misregistration(0.3, -0.2, 1.0), MotionBlur(3), ModulatorPsf(0.3),
    GhostReflection(0.05, 3.0), Dust(5.0, 2.0, 4.0),
    BayerFilter(), Prnu(0.01), DarkCurrent(10.0), HotPixels(0.01, 1e3),
    Persistence(0.02, 0.1, 0.1, 500.0),
    ShotNoise(), Blooming(0.5), FullWell(250.0), GainNonlinearity(0.02), Dsnu(1.0), ReadNoise(2.0), RowNoise(0.5),
    BlackLevel(1.0), Quantisation(12),
]  # fmt: skip


def signal_at(stage, scene):
    rng = np.random.default_rng(4)
    height, width = scene.size
    return {
        LightStage.MOTION: lambda: StageMove((0.5, 0.1, 0.0)),
        LightStage.SCENE: lambda: lambda _time_s: scene.gaussians,
        LightStage.TIME: lambda: nominal_slices(INTERVALS),
        LightStage.MOMENTS: lambda: one_per_interval(INTERVALS),
        LightStage.RADIANCE: lambda: View(rng.uniform(0, 1, (height, width, 3)), scene.intrinsics, 0, scene.depth),
        LightStage.MASKS: lambda: (rng.random((4, height, width)) < 0.4).astype(np.float32),
        LightStage.PHOTONS: lambda: rng.uniform(0, 300, (height, width, 3)),
        LightStage.CHARGE: lambda: rng.uniform(0, 300, (height, width, 3)),
        LightStage.READOUT: lambda: rng.uniform(0, 300, (height, width, 3)),
    }[stage]()


def numbers(signal, scene):
    """Everything in a signal that a later stage could see, as one array."""
    if isinstance(signal, np.ndarray):
        return signal.astype(np.float64).ravel()
    times = np.linspace(INTERVALS[0, 0], INTERVALS[-1, 1], 17)
    if hasattr(signal, "world_to_camera"):
        return signal.world_to_camera(times).ravel()
    if hasattr(signal, "radiance"):
        return signal.radiance.ravel()
    if hasattr(signal, "times_s"):
        return signal.times_s
    if hasattr(signal, "mix"):
        return np.concatenate([signal.start_s, signal.stop_s, signal.mix.ravel()])
    return np.concatenate([signal(float(t)).means.numpy().ravel() for t in times[::8]])


@pytest.fixture(scope="module")
def scene(small_scene):
    return small_scene


def test_one_effect_of_each_kind_is_tested_here_in_the_order_of_the_light_path():
    assert [type(effect) for effect in ONE_OF_EACH] == list(LIGHT_PATH)


def test_effects_have_names_of_their_own():
    assert len({effect.name for effect in ONE_OF_EACH}) == len(ONE_OF_EACH)


@pytest.mark.parametrize("effect", ONE_OF_EACH, ids=lambda effect: effect.name)
def test_an_effect_leaves_its_argument_alone_repeats_itself_and_stays_finite(effect, scene):
    signal = signal_at(effect.stage, scene)
    before = numbers(signal, scene).copy()
    first, second = (effect.apply(signal, RIG, np.random.default_rng(1)) for _ in range(2))
    assert np.array_equal(numbers(signal, scene), before)
    assert np.array_equal(numbers(first, scene), numbers(second, scene))
    assert np.isfinite(numbers(first, scene)).all()


@pytest.mark.parametrize("effect", ONE_OF_EACH, ids=lambda effect: effect.name)
def test_an_effect_that_is_off_is_the_identity_bit_for_bit(effect, scene):
    others = [other for other in ONE_OF_EACH if other.stage is not effect.stage]
    signal = signal_at(effect.stage, scene)
    assert EffectChain(others, 3, RIG).through(effect.stage, signal) is signal


NEW_IN_EVERY_EXPOSURE = {
    "stage_ripple", "stage_vibration", "trigger_timing", "illumination_flicker",
    "shot_noise", "read_noise", "row_noise",
}  # fmt: skip
OF_THE_DEVICE = {"finite_contrast", "dust", "prnu", "hot_pixels", "dsnu"}


@pytest.mark.parametrize("effect", ONE_OF_EACH, ids=lambda effect: effect.name)
def test_what_an_effect_draws_is_new_in_every_exposure_or_the_devices_own(effect, scene):
    signal = signal_at(effect.stage, scene)

    def seen(seed, device_seed):
        chain = EffectChain([effect], seed, replace(RIG, device_seed=device_seed))
        return numbers(chain.through(effect.stage, signal), scene)

    assert np.array_equal(seen(1, 0), seen(2, 0)) == (effect.name not in NEW_IN_EVERY_EXPOSURE)
    assert np.array_equal(seen(1, 0), seen(1, 7)) == (effect.name not in OF_THE_DEVICE)
