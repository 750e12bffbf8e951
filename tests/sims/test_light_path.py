import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import LightStage
from gs2ci_sims.effects.charges import FullWell
from gs2ci_sims.effects.noises import Dsnu, ReadNoise, ShotNoise
from gs2ci_sims.effects.readout import Quantisation
from gs2ci_sims.light_path import EffectChain, generator
from gs2ci_sims.rig import RigFigures

CHARGE = np.random.default_rng(3).uniform(0, 500, (40, 50, 3))


class Glow:
    name = "glow"
    stage = LightStage.CHARGE

    def apply(self, signal, rig, rng):
        return signal + 1


@pytest.mark.parametrize("stage", LightStage)
def test_a_chain_without_effects_hands_back_the_very_same_signal(stage):
    assert EffectChain((), seed=0).through(stage, CHARGE) is CHARGE


def test_an_effect_acts_at_its_own_stage_only():
    chain = EffectChain([ReadNoise(1.0)], seed=0)
    assert chain.through(LightStage.READOUT, CHARGE) is CHARGE
    assert chain.through(LightStage.CHARGE, CHARGE) is not CHARGE


def test_effects_come_in_their_physical_order_however_they_are_listed():
    listed = [Quantisation(12), ReadNoise(1.0), FullWell(10.0), ShotNoise()]
    names = [effect.name for effect in EffectChain(listed, seed=0).effects]
    assert names == ["shot_noise", "full_well", "read_noise", "quantisation"]


def test_the_well_clips_before_the_amplifier_adds_its_noise():
    charge = EffectChain([ReadNoise(2.0), FullWell(100.0)], seed=0).through(LightStage.CHARGE, np.full((99, 99), 1e6))
    assert charge.std() == pytest.approx(2.0, rel=0.05)
    assert charge.mean() == pytest.approx(100.0, abs=0.2)


def test_switching_shot_noise_off_does_not_change_what_read_noise_draws():
    both = EffectChain([ShotNoise(), ReadNoise(2.0)], seed=7).through(LightStage.CHARGE, CHARGE)
    shot = EffectChain([ShotNoise()], seed=7).through(LightStage.CHARGE, CHARGE)
    read = EffectChain([ReadNoise(2.0)], seed=7).through(LightStage.CHARGE, CHARGE)
    np.testing.assert_allclose(both - shot, read - CHARGE, atol=1e-9)


def test_switching_an_effect_on_draws_nothing_from_the_generators_of_others():
    full = EffectChain([ShotNoise(), FullWell(1e9)], seed=7).through(LightStage.CHARGE, CHARGE)
    assert np.array_equal(full, EffectChain([ShotNoise()], seed=7).through(LightStage.CHARGE, CHARGE))


def test_generators_differ_by_name_and_by_seed_and_repeat():
    draws = {(seed, name): generator(seed, name).random() for seed in (0, 1) for name in ("a", "b")}
    assert len(set(draws.values())) == 4
    assert generator(1, "b").random() == draws[1, "b"]


def test_effects_draw_independently_also_if_the_exposure_has_the_seed_of_the_device():
    dark, rig = np.zeros((300, 300, 1)), RigFigures(device_seed=5)
    drawn = [EffectChain([one], 5, rig).through(LightStage.CHARGE, dark).ravel() for one in (ReadNoise(1.0), Dsnu(1.0))]
    assert abs(np.corrcoef(*drawn)[0, 1]) < 5 / 300


def test_an_effect_given_twice_is_refused():
    with pytest.raises(InputError, match="'read_noise' is given twice"):
        EffectChain([ReadNoise(1.0), ReadNoise(2.0)], seed=0)


def test_an_effect_without_a_place_in_the_light_path_is_refused():
    with pytest.raises(InputError, match="'glow' has no place"):
        EffectChain([Glow()], seed=0)


def test_a_negative_seed_is_refused():
    with pytest.raises(InputError, match="seed -1"):
        generator(-1, "masks")
