"""Every effect of sensor and readout changes the readings by no more than its bound says, and the bound is not idle.

Over a random family of scenes, light levels, sensors and figures of the effect. For noises the measured standard
deviation scatters around the law's; the test allows it five of its own standard errors.
"""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gs2ci_sims.effects.base import Stage
from gs2ci_sims.effects.black_level import BlackLevel
from gs2ci_sims.effects.blooming import Blooming
from gs2ci_sims.effects.dark_current import DarkCurrent
from gs2ci_sims.effects.dsnu import Dsnu
from gs2ci_sims.effects.full_well import FullWell
from gs2ci_sims.effects.gain_nonlinearity import GainNonlinearity
from gs2ci_sims.effects.hot_pixels import HotPixels
from gs2ci_sims.effects.persistence import Persistence
from gs2ci_sims.effects.prnu import Prnu
from gs2ci_sims.effects.quantisation import Quantisation
from gs2ci_sims.effects.read_noise import ReadNoise
from gs2ci_sims.effects.row_noise import RowNoise
from gs2ci_sims.effects.shot_noise import ShotNoise
from gs2ci_sims.light_path import LIGHT_PATH
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import StageMove
from gs2ci_sims.preview import preview
from gs2ci_sims.rig import Light, Modulator, Rig, Timing
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.sensor import Sensor

SIZE, MASKS, DRAWS = (16, 24), 4, 8
share = st.floats(0.001, 1.0)


def log_uniform(low, high):
    return st.floats(np.log10(low), np.log10(high)).map(lambda exponent: 10.0**exponent)


def earlier(seed):
    return np.random.default_rng(seed).exponential(1e4, (*SIZE, 3))


FAMILY = {
    Prnu: st.builds(Prnu, st.floats(0.001, 0.1)),
    Dsnu: st.builds(Dsnu, log_uniform(0.1, 100)),
    DarkCurrent: st.builds(DarkCurrent, log_uniform(0.01, 1e5), st.floats(-40, 80), st.floats(5, 10)),
    HotPixels: st.builds(HotPixels, share, log_uniform(0.1, 1e7)),
    Persistence: st.builds(Persistence, share, log_uniform(1e-3, 10), st.floats(0, 1), st.integers(0, 9).map(earlier)),
    ShotNoise: st.builds(ShotNoise),
    Blooming: st.builds(Blooming, share),
    FullWell: st.builds(FullWell, log_uniform(100, 1e5)),
    GainNonlinearity: st.builds(GainNonlinearity, st.floats(-0.2, 0.2)),
    ReadNoise: st.builds(ReadNoise, log_uniform(0.1, 100)),
    RowNoise: st.builds(RowNoise, log_uniform(0.1, 100)),
    BlackLevel: st.builds(BlackLevel, st.floats(-20, 20)),
    Quantisation: st.builds(Quantisation, st.integers(6, 16)),
}


@st.composite
def rigs(draw):
    sensor = Sensor(
        full_well_e=draw(log_uniform(500, 1e5)),
        electrons_per_dn=draw(log_uniform(0.3, 10)),
        quantum_efficiency=draw(st.floats(0.2, 1)),
        black_level_dn=draw(st.floats(0, 64)),
    )
    photons = draw(log_uniform(1e-4, 2)) * sensor.full_well_e / sensor.quantum_efficiency
    timing = Timing(draw(log_uniform(1e-4, 1)), draw(log_uniform(1e-5, 0.1)))
    return Rig(Light(photons), modulator=Modulator(MASKS), timing=timing, sensor=sensor)


@pytest.fixture(scope="module")
def looks():
    move = StageMove((0.3, 0.1, 0.0))
    return [
        preview(
            planes(np.random.default_rng(seed), SIZE),
            move,
            random_masks(MASKS, SIZE, 0.4, np.random.default_rng(seed)),
            Rig(modulator=Modulator(MASKS)),
        )
        for seed in range(3)
    ]


def mean_charge(look, rig):
    """Each mask's light, from the view nearest in time."""
    views = look.views[np.rint(np.linspace(0, len(look.views) - 1, MASKS)).astype(int)]
    return rig.full_scale_e * np.einsum("nhw,nhwc->hwc", look.masks, views)


def readings_with_and_without(effect, look, rig, seed):
    """The effect alone among shot noise and the full well, which come where they do on the light path."""
    rng, well_e = np.random.default_rng(seed), rig.sensor.full_well_e
    place = LIGHT_PATH.index(type(effect))
    signal = mean_charge(look, rig)
    if place > LIGHT_PATH.index(ShotNoise):
        signal = ShotNoise().apply(signal, rig, np.random.default_rng(seed + 1000))
    if place > LIGHT_PATH.index(FullWell):
        signal = np.minimum(signal, well_e)
    if effect.stage is Stage.READOUT:
        signal = rig.sensor.dn_from_electrons(signal)
        return effect.apply(signal, rig, rng), signal
    changed = effect.apply(signal, rig, rng)
    if place < LIGHT_PATH.index(FullWell):
        changed, signal = np.minimum(changed, well_e), np.minimum(signal, well_e)
    return rig.dn_per_e * changed, rig.dn_per_e * signal


@pytest.mark.parametrize("kind", FAMILY, ids=lambda kind: kind.name)
def test_the_bound_of_a_sensor_effect_holds_and_is_not_idle(kind, looks):
    reached = []

    @settings(max_examples=60, deadline=None, derandomize=True, database=None)
    @given(effect=FAMILY[kind], rig=rigs(), scene=st.integers(0, 2), seed=st.integers(0, 99))
    def over_the_family(effect, rig, scene, seed):
        look = dataclasses.replace(looks[scene], rig=rig)
        bound = effect.bound(look, rig)
        squares, peak = [], 0.0
        for draw in range(DRAWS if bound.random else 1):
            changed, plain = readings_with_and_without(effect, look, rig, DRAWS * seed + draw)
            assert np.isfinite(changed).all()
            squares.append(np.square(changed - plain).mean())
            peak = max(peak, float(np.abs(changed - plain).max()))
        rms = float(np.sqrt(np.mean(squares)))
        independent = DRAWS * (SIZE[0] if kind is RowNoise else np.prod(SIZE))
        slack = 1 + 5 / np.sqrt(2 * independent) if bound.random else 1.0
        assert rms <= slack * bound.rms_dn + 1e-9, (effect, rig)
        assert peak <= bound.peak_dn * (1 + 1e-9) + 1e-9, (effect, rig)
        reached.append(rms / bound.rms_dn if bound.rms_dn else 0.0)

    over_the_family()
    assert max(reached) >= 0.1


@pytest.mark.parametrize("kind", FAMILY, ids=lambda kind: kind.name)
@pytest.mark.parametrize("photons", [0.0, 1e9])
def test_no_light_and_far_too_much_give_finite_bounds_and_finite_readings(kind, photons, looks):
    rig = Rig(Light(photons), modulator=Modulator(MASKS))
    effect = {
        Prnu: Prnu(0.01), Dsnu: Dsnu(2.0), DarkCurrent: DarkCurrent(1e9, 100.0), HotPixels: HotPixels(1.0, 1e12),
        Persistence: Persistence(1.0, 1e-6, 0.0, 1e12), FullWell: FullWell(1e4), Blooming: Blooming(1.0),
        GainNonlinearity: GainNonlinearity(0.24), ReadNoise: ReadNoise(1e6), RowNoise: RowNoise(1e6),
        BlackLevel: BlackLevel(-1e6), Quantisation: Quantisation(1), ShotNoise: ShotNoise(),
    }[kind]  # fmt: skip
    bound = effect.bound(dataclasses.replace(looks[0], rig=rig), rig)
    assert np.isfinite([bound.rms_dn, bound.peak_dn]).all()
    changed, _ = readings_with_and_without(effect, looks[0], rig, 0)
    assert np.isfinite(changed).all()


@pytest.mark.parametrize(
    "effect", [Prnu(0.0), Dsnu(0.0), DarkCurrent(0.0), HotPixels(0.0, 1e3), RowNoise(0.0), BlackLevel(0.0)],
    ids=lambda effect: effect.name,
)  # fmt: skip
def test_an_effect_of_no_strength_is_bounded_by_nothing_and_changes_nothing(effect, looks):
    assert effect.bound(looks[0], looks[0].rig).rms_dn == 0.0
    changed, plain = readings_with_and_without(effect, looks[0], looks[0].rig, 0)
    assert np.array_equal(changed, plain)
