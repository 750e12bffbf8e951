import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import LightStage
from gs2ci_sims.effects.flicker import IlluminationDrift
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.timing import ClockDrift, RollingShutter, TriggerTiming
from gs2ci_sims.effects.transitions import MirrorTransition
from gs2ci_sims.exposure import integrate
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import StageMove
from gs2ci_sims.preview import preview
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import ModulatorFigures, RigFigures, Timing
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.signals import Shutter, nominal_slices
from tests.exposing import weights_of

SIZE = (16, 24)
RIG = RigFigures(modulator=ModulatorFigures(4), timing=Timing(0.1, 0.02))
INTERVALS = RIG.timing.intervals_s(4)
MASKS = random_masks(4, SIZE, 0.4, np.random.default_rng(0))
SCENE = planes(np.random.default_rng(1), SIZE)


def photons(path, effects):
    return integrate(SCENE, path, MASKS, EffectChain(effects, 0, RIG))


def test_row_y_opens_and_closes_y_line_delays_later():
    shutter = Shutter(opens_s=-1.0, closes_s=1.0, line_delay_s=0.25)
    fine = np.linspace(-1, 4, 5001)
    share = shutter.open_share(fine[:-1], fine[1:], 5)
    np.testing.assert_allclose(share.sum(axis=0) * np.diff(fine)[0], 2.0)
    opened = fine[:-1][share.argmax(axis=0)]
    np.testing.assert_allclose(opened, -1 + 0.25 * np.arange(5), atol=1e-3)


def test_a_row_loses_the_light_of_the_first_masks_in_proportion_to_its_delay():
    still = StageMove((0.0, 0.0, 0.0))
    delay_s = 0.13 / (SIZE[0] - 1)  # the last row misses the first mask, the gap and 1 % of the exposure of the second
    without, rolling = photons(still, []), photons(still, [RollingShutter(delay_s)])
    bare = Renderer().views(SCENE, np.eye(4)[None])[0][0].astype(float)
    late_s = delay_s * np.arange(SIZE[0])
    lost = np.stack([np.clip(late_s - start, 0, 0.1) for start in (0.0, 0.12, 0.24, 0.36)]) * RIG.photons_per_s
    expected = np.einsum("nh,nhw->hw", lost, MASKS)[..., None] * bare
    np.testing.assert_allclose(without - rolling, expected, atol=0.01)
    np.testing.assert_allclose(rolling[0], without[0], rtol=1e-12)


def test_a_row_that_opens_after_the_last_mask_sees_nothing():
    dark = photons(StageMove((0.0, 0.0, 0.0)), [RollingShutter(1.0)])
    assert not dark[1:].any()
    assert dark[0].any()


def light_of_rows(effects, rig, rows):
    """Return for how long each row collects light of the one mask, [rows] seconds."""
    slices = EffectChain(effects, 0, rig).through(LightStage.TIME, nominal_slices(rig.timing.intervals_s(1)))
    return slices.weights_s()[:, 0] @ slices.shutter.open_share(slices.start_s, slices.stop_s, rows)


@pytest.mark.parametrize("latency_ms", [-3.0, -1.0, 0.0, 1.0, 9.5])
@pytest.mark.parametrize("ppm", [-2e5, 0.0, 1e5, 2e5])
@pytest.mark.parametrize("transition_s", [0.0, 1e-4])
def test_a_row_collects_what_of_the_mask_lies_within_its_own_window(latency_ms, ppm, transition_s):
    rig, delay_s, rows = RigFigures(modulator=ModulatorFigures(1), timing=Timing(10e-3)), 0.2e-3, 11
    effects = [ClockDrift(ppm), TriggerTiming(1e-3 * latency_ms), RollingShutter(delay_s)]
    effects += [MirrorTransition(transition_s)] if transition_s else []
    late_s = 1e-3 * latency_ms + delay_s * np.arange(rows)
    begin_s, end_s = -5e-3, -5e-3 + 10e-3 * (1 + 1e-6 * ppm)
    expected = np.clip(np.minimum(end_s, 5e-3 + late_s) - np.maximum(begin_s, -5e-3 + late_s), 0, None)
    # While the mirrors turn, half of the light comes through: a row that opens meanwhile is off by a quarter at most.
    np.testing.assert_allclose(light_of_rows(effects, rig, rows), expected, atol=max(1e-12, 0.5 * transition_s + 1e-9))


def test_the_weights_of_a_late_exposure_are_those_of_its_first_row():
    effects = [RollingShutter(1e-3), TriggerTiming(0.03)]
    weights = weights_of(EffectChain(effects, 0, RIG), RIG.timing.intervals_s(len(MASKS)), SIZE[0])
    np.testing.assert_allclose(weights, [0.7, 1, 1, 1])
    with pytest.raises(InputError, match="misses all masks"):
        photons(StageMove((0.0, 0.0, 0.0)), [RollingShutter(1e-3), TriggerTiming(1.0)])


@pytest.mark.parametrize(("late_s", "most"), [(0.01, 2e-5), (0.05, 6e-5), (0.3, 3e-4)])
def test_how_the_time_of_a_moving_image_is_cut_hardly_matters(late_s, most):
    """A lamp without drift has the slices cut in four once more, and changes nothing else."""
    fast, rolling = StageMove((2.0, 0.6, 0.0)), RollingShutter(late_s / (SIZE[0] - 1))
    coarse, fine = (photons(fast, [*more, MotionBlur(5), rolling]) for more in ([], [IlluminationDrift(1e-12)]))
    assert np.abs(fine - coarse).max() < most * coarse.max()


def test_no_line_delay_changes_nothing():
    still = StageMove((0.0, 0.0, 0.0))
    np.testing.assert_allclose(photons(still, [RollingShutter(0.0)]), photons(still, []), rtol=1e-12)
    assert RollingShutter(0.0).bound(preview(SCENE, still, MASKS, RIG), RIG).rms_dn == 0.0


def test_the_bound_holds_and_is_not_idle():
    reached = []
    paths = [StageMove((speed, 0.3 * speed, 0.0)) for speed in (0.0, 0.3, 2.0)]
    looks = [preview(SCENE, path, MASKS, RIG) for path in paths]
    plain = [photons(path, []) for path in paths]
    dn = RIG.sensor.quantum_efficiency * RIG.dn_per_e

    @settings(max_examples=25, deadline=None, derandomize=True, database=None)
    @given(move=st.integers(0, 2), readout_s=st.floats(-4, 0.3).map(lambda exponent: 10**exponent))
    def over_the_family(move, readout_s):
        effect = RollingShutter(readout_s / SIZE[0])
        bound = effect.bound(looks[move], RIG)
        change_dn = dn * (photons(paths[move], [effect]) - plain[move])
        rms = np.sqrt(np.square(change_dn).mean())
        assert rms <= bound.rms_dn
        assert np.abs(change_dn).max() <= bound.peak_dn
        reached.append(rms / bound.rms_dn)

    over_the_family()
    assert max(reached) >= 0.1


def test_slices_that_are_cut_keep_their_shutter():
    shutter = Shutter(0.0, 1.0, 0.1)
    slices = dataclasses.replace(nominal_slices(INTERVALS), shutter=shutter)
    assert slices.split(3).shutter is shutter
    assert slices.split_at(np.zeros((4, 1))).shutter is shutter


@pytest.mark.parametrize("delay_s", [-1e-6, float("inf"), float("nan")])
def test_a_line_delay_out_of_range_is_refused(delay_s):
    with pytest.raises(InputError, match="allowed"):
        RollingShutter(delay_s)
