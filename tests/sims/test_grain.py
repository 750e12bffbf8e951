"""The grain that is measured in bursts of views, and where a plan uses it."""

import numpy as np
import pytest

from gs2ci_sims import sampling
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.noises import Prnu
from gs2ci_sims.effects.photons import ModulatorPsf
from gs2ci_sims.effects.views import OpticsPsf
from gs2ci_sims.exposure import integrate
from gs2ci_sims.grain import BURSTS, LENGTH_PX, MeasuredGrain
from gs2ci_sims.light_path import EffectChain, generator, sensor_effects
from gs2ci_sims.masks import random_masks
from gs2ci_sims.moments import Moments, one_per_interval
from gs2ci_sims.path import stage_move_for_parallax
from gs2ci_sims.planner import plan
from gs2ci_sims.preview import preview
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures, Timing
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.signals import nominal_slices
from gs2ci_sims.simulation_plan import PlanChoice, SimulationTask
from tests.sims.brute_force import deviation_dn, simulate_everything

SIZE = (24, 32)
MASKS = 4
SIGMA = 1e-3


@pytest.fixture(scope="module")
def scene():
    return planes(np.random.default_rng(12), SIZE)


class Shaky(Renderer):
    """A flat image plus white noise of known size that is another in each view."""

    def views(self, scene, world_to_camera, *, gaussians=None, margin=0):
        size = (len(world_to_camera), SIZE[0] + 2 * margin, SIZE[1] + 2 * margin)
        rng = np.random.default_rng(np.frombuffer(world_to_camera.tobytes(), np.uint32))
        noise = SIGMA * rng.standard_normal((*size, 3))
        return (0.5 + noise).astype(np.float32), np.ones(size, np.float32)


def setup(scene, photons=4000.0, parallax_px=4.0):
    rig = RigFigures(light=Light(photons), modulator=ModulatorFigures(masks=MASKS), timing=Timing(0.02, 0.0))
    path = stage_move_for_parallax(scene, parallax_px, rig.exposure_s, wobble_deg=0.0)
    return rig, path, random_masks(MASKS, SIZE, 0.3, generator(1, "masks"))


def measured(scene, *effects):
    rig, path, masks = setup(scene)
    look = preview(scene, path, masks, rig, effects=effects)
    times = np.linspace(look.intervals_s[0, 0], look.intervals_s[-1, 1], 65)
    slices = nominal_slices(look.intervals_s)
    return look, MeasuredGrain(look, Shaky(), slices, (times, look.travel_px(times)))


def test_grain_of_known_size_is_measured_as_what_it_makes_of_the_readings(scene):
    look, grain = measured(scene)
    expected = SIGMA * look.full_scale_dn * np.sqrt(np.square(look.masks).mean(axis=(1, 2)).sum())
    assert grain.rms_dn(one_per_interval(look.intervals_s)) == pytest.approx(expected, rel=0.1)


def test_more_views_average_grain(scene):
    look, grain = measured(scene)
    edges = np.linspace(look.intervals_s[0, 0], look.intervals_s[-1, 1], 4 * MASKS + 1)
    four_times = grain.rms_dn(Moments(edges, 1))
    assert four_times == pytest.approx(grain.rms_dn(one_per_interval(look.intervals_s)) / 2, rel=1e-6)


def test_views_of_what_hardly_moves_do_not_average_grain(scene):
    look, grain = measured(scene)
    begin, end = look.intervals_s[0, 0], look.intervals_s[-1, 1]
    few, many = (grain.rms_dn(Moments(np.linspace(begin, end, count + 1), 1)) for count in (2000, 8000))
    assert many == pytest.approx(few, rel=0.05)


def test_lens_and_relay_blur_grain_and_a_gain_after_them_enlarges_it(scene):
    plain, blurred, enlarged = (
        measured(scene, *effects)[1]
        for effects in ((), (OpticsPsf(0.8), ModulatorPsf(0.8, diffraction=False)), (Prnu(0.05),))
    )
    moments = one_per_interval(measured(scene)[0].intervals_s)
    assert blurred.rms_dn(moments) < 0.5 * plain.rms_dn(moments)
    assert enlarged.rms_dn(moments) == pytest.approx(1.3 * plain.rms_dn(moments), rel=1e-6)


@pytest.fixture
def counted(monkeypatch):
    """Count the measurements."""
    made = []

    class Counted(MeasuredGrain):
        def __init__(self, *args):
            made.append(args)
            super().__init__(*args)

    monkeypatch.setattr(sampling, "MeasuredGrain", Counted)
    return made


def test_a_bright_moving_rig_measures_and_stays_within_its_tolerance(scene, counted):
    rig, path, masks = setup(scene, photons=60000.0, parallax_px=3.0)
    effects = (MotionBlur(), *sensor_effects(rig.sensor), OpticsPsf(0.4), ModulatorPsf(0.4))
    decided = plan(SimulationTask(scene, path, masks, rig, effects, 5), PlanChoice(0.25))
    photons = integrate(scene, path, masks, EffectChain(decided.effects, 5, rig))
    everything = simulate_everything(scene, path, masks, rig, effects, seed=5, settle_dn=0.05)
    assert len(counted) == 1
    assert deviation_dn(everything, photons, decided.effects, 5) <= decided.error_dn <= 0.25


@pytest.mark.parametrize(("photons", "parallax_px"), [(400.0, 3.0), (60000.0, 0.5 * BURSTS * LENGTH_PX)])
def test_grain_is_not_measured_where_it_decides_nothing_or_too_little_moves(scene, counted, photons, parallax_px):
    rig, path, masks = setup(scene, photons, parallax_px)
    effects = (MotionBlur(), *sensor_effects(rig.sensor))
    plan(SimulationTask(scene, path, masks, rig, effects, 5), PlanChoice(0.25))
    assert not counted
