"""Effects of masks' timing, lamp, trigger and stage against their closed forms."""

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.flicker import IlluminationDrift, IlluminationFlicker, LcosFlicker
from gs2ci_sims.effects.stage import StageBacklash, StageRipple, StageVibration
from gs2ci_sims.effects.timing import ClockDrift, TriggerTiming
from gs2ci_sims.effects.transitions import LcosResponse, MirrorTransition
from gs2ci_sims.path import ReversingMove, StageMove
from gs2ci_sims.rig import ModulatorFigures, RigFigures, Timing
from gs2ci_sims.signals import nominal_slices

INTERVAL_S = 0.01
RIG = RigFigures(modulator=ModulatorFigures(masks=4), timing=Timing(INTERVAL_S))
GAPPED = RigFigures(modulator=ModulatorFigures(masks=4), timing=Timing(INTERVAL_S, 0.002))


def rng(seed=0):
    return np.random.default_rng(seed)


def weights(effect, rig=RIG, seed=0):
    """Return how much of mask m is collected while mask n is nominally on show, in intervals, [n, m]."""
    slices = effect.apply(nominal_slices(rig.timing.intervals_s(4)), rig, rng(seed))
    collected = np.zeros((4, 4))
    np.add.at(collected, slices.shown, slices.weights_s() / INTERVAL_S)
    return collected


def test_a_mirror_transition_gives_half_of_its_time_to_the_mask_before():
    collected = weights(MirrorTransition(0.2 * INTERVAL_S))
    expected = np.diag([0.9] * 4) + np.diag([0.1] * 3, -1)
    np.testing.assert_allclose(collected, expected, atol=1e-12)


def test_after_a_dark_gap_a_mirror_transition_starts_from_darkness():
    np.testing.assert_allclose(weights(MirrorTransition(0.2 * INTERVAL_S), GAPPED), np.diag([0.9] * 4), atol=1e-12)


def test_mirrors_slower_than_the_masks_are_refused():
    with pytest.raises(InputError, match="show each mask for longer"):
        weights(MirrorTransition(1.1 * INTERVAL_S))


@pytest.mark.parametrize("ratio", [0.01, 0.3, 5.0])
def test_an_lcos_mask_keeps_the_mean_of_an_exponential_approach(ratio):
    collected = weights(LcosResponse(ratio * INTERVAL_S))
    left = ratio * (1 - np.exp(-1 / ratio))
    np.testing.assert_allclose(np.diag(collected), 1 - left, rtol=1e-9)
    np.testing.assert_allclose(collected[1, 0], left * (1 - np.exp(-1 / ratio)), rtol=1e-9)
    assert collected.sum() < 4  # the first mask begins from darkness


def test_an_lcos_panel_darkens_in_the_gaps():
    tau = 0.3 * INTERVAL_S
    ratio = weights(LcosResponse(tau), GAPPED)[1, 0] / weights(LcosResponse(tau))[1, 0]
    assert ratio == pytest.approx(np.exp(-0.002 / tau))


@pytest.mark.parametrize(("hertz", "make"), [(100.0, IlluminationFlicker), (37.0, LcosFlicker), (3000.0, LcosFlicker)])
def test_flicker_changes_a_masks_light_by_the_sinc_of_its_periods(hertz, make):
    setting = 0.5 * hertz if make is IlluminationFlicker else hertz
    effect = make(0.4, setting)
    kept = 0.4 * np.abs(np.sinc(hertz * INTERVAL_S))
    found = np.array([np.diag(weights(effect, seed=seed)) - 1 for seed in range(12)])
    assert np.abs(found).max() <= kept + 1e-9
    if make is IlluminationFlicker and kept > 1e-6:
        assert np.abs(found).max() > 0.9 * kept


def test_lcos_flicker_is_in_step_with_the_masks():
    starts = RIG.timing.intervals_s(4)[:, 0] - RIG.timing.intervals_s(4)[0, 0]
    hertz = 37.0
    exact = [
        1 + 0.4 * (np.sin(2 * np.pi * hertz * (t + INTERVAL_S)) - np.sin(2 * np.pi * hertz * t))
        / (2 * np.pi * hertz * INTERVAL_S)
        for t in starts
    ]  # fmt: skip
    np.testing.assert_allclose(np.diag(weights(LcosFlicker(0.4, hertz))), exact, rtol=1e-9)


def test_a_lamp_that_drifts_weighs_each_mask_by_its_middle():
    middles = RIG.timing.intervals_s(4).mean(axis=1)
    np.testing.assert_allclose(np.diag(weights(IlluminationDrift(5.0))), 1 + 5.0 * middles)


def test_a_lamp_never_drifts_below_darkness():
    assert weights(IlluminationDrift(-1e3)).min() == 0.0


def test_a_late_trigger_loses_the_begin_of_the_first_mask():
    np.testing.assert_allclose(np.diag(weights(TriggerTiming(0.3 * INTERVAL_S))), [0.7, 1, 1, 1])
    np.testing.assert_allclose(np.diag(weights(TriggerTiming(-1.5 * INTERVAL_S))), [1, 1, 0.5, 0], atol=1e-12)


def test_trigger_jitter_has_its_standard_deviation_and_keeps_within_three():
    collected = [np.diag(weights(TriggerTiming(0.0, 0.1 * INTERVAL_S), seed=seed)) for seed in range(400)]
    # Late windows miss the begin of the first mask, early ones the end of the last.
    late = np.array([last - first for first, *_, last in collected])
    assert np.abs(late).max() <= 0.3 + 1e-9
    assert late.std() == pytest.approx(0.1, rel=0.1)
    assert abs(late.mean()) < 4 * 0.1 / 400**0.5


def test_a_window_far_off_collects_nothing_and_stays_finite():
    collected = weights(TriggerTiming(1.0, 100.0))
    assert np.isfinite(collected).all()


def test_a_slow_modulator_clock_lengthens_masks_until_the_sensor_closes():
    np.testing.assert_allclose(np.diag(weights(ClockDrift(1e4))), [1.01, 1.01, 1.01, 0.97])
    np.testing.assert_allclose(np.diag(weights(ClockDrift(-1e4))), [0.99] * 4)


def test_velocity_ripple_swings_the_velocity_by_its_share():
    path = StageRipple(0.2, 7.0).apply(StageMove((1.0, 0.0, 0.0)), RIG, rng())
    times = np.linspace(0, 1, 5001)
    velocity = np.diff(-path.world_to_camera(times)[:, 0, 3]) / np.diff(times)
    assert velocity.max() == pytest.approx(1.2, rel=1e-3)
    assert velocity.min() == pytest.approx(0.8, rel=1e-3)
    assert path.highest_hz == 7.0


def test_vibration_displaces_the_camera_by_its_amplitude_along_both_axes():
    path = StageVibration(0.02, 50.0).apply(StageMove((0.0, 0.0, 0.0)), RIG, rng())
    shift = path.world_to_camera(np.linspace(0, 0.1, 2001))[:, :3, 3]
    np.testing.assert_allclose(np.abs(shift).max(axis=0), [0.02, 0.02, 0.0], rtol=1e-3)
    power = np.abs(np.fft.rfft(shift[:-1, :2], axis=0))
    assert power.argmax(axis=0).tolist() == [5, 5]  # periods in 0.1 s
    assert path.highest_hz == 50.0


def test_backlash_holds_the_camera_back_after_a_reversal_until_the_play_is_used_up():
    rig = RigFigures(modulator=ModulatorFigures(masks=8), timing=Timing(0.1))
    path = ReversingMove((1.0, 0.0, 0.0), 0.8)
    lagging = StageBacklash(0.05).apply(path, rig, rng())
    # The drive turns at -0.2 s and at 0.2 s; the camera waits there until 0.05 of way are used up.
    times = np.array([-0.3, -0.175, -0.1, 0.0, 0.19, 0.225, 0.3])
    lag = lagging.world_to_camera(times)[:, 0, 3] - path.world_to_camera(times)[:, 0, 3]
    assert lagging.highest_hz == path.highest_hz
    np.testing.assert_allclose(lag, [0.0, 0.025, 0.05, 0.05, 0.05, 0.025, 0.0], atol=1e-3)


def test_backlash_changes_nothing_on_a_path_that_never_turns_back():
    path = StageMove((0.3, 0.1, 0.0))
    times = np.linspace(-0.02, 0.02, 9)
    lagging = StageBacklash(0.05).apply(path, RIG, rng())
    np.testing.assert_allclose(lagging.world_to_camera(times), path.world_to_camera(times), atol=1e-12)


def test_a_stage_that_runs_to_and_fro_is_back_after_a_period():
    path = ReversingMove((2.0, 0.0, 0.0), 0.8)
    places = -path.world_to_camera(np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8]))[:, 0, 3]
    np.testing.assert_allclose(places, [0, 0.2, 0.4, 0.2, 0, -0.4, 0], atol=1e-12)


@pytest.mark.parametrize(
    "make",
    [
        lambda: MirrorTransition(-1.0),
        lambda: LcosResponse(np.inf),
        lambda: LcosFlicker(1.1),
        lambda: IlluminationFlicker(-0.1),
        lambda: IlluminationDrift(np.nan),
        lambda: TriggerTiming(np.nan),
        lambda: TriggerTiming(0.0, -1.0),
        lambda: ClockDrift(-1e6),
        lambda: StageRipple(1.1, 1.0),
        lambda: StageVibration(-1.0, 1.0),
        lambda: StageBacklash(-1.0),
        lambda: ReversingMove((0.0, 0.0, 0.0), 0.0),
    ],
)
def test_figures_out_of_range_are_refused_when_the_effect_is_made(make):
    with pytest.raises(InputError, match="allowed"):
        make()
