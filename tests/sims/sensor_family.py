"""Random sensors, light levels and figures of the effects on charge and readout, and what of a bound an effect reaches.

For the tests of bounds and the benchmark `effect_bounds`. Every bound is compared with several exposures, each of
another device, one by one. Only noises that are alike in all pixels are stated as standard deviations: their variance
is measured over these exposures, and six of its own standard errors are allowed.
"""

import dataclasses
from functools import cache

import numpy as np
from hypothesis import strategies as st

from gs2ci_sims.effects.base import LightStage
from gs2ci_sims.effects.charges import Blooming, DarkCurrent, FullWell, Persistence
from gs2ci_sims.effects.noises import ChargeNoise, Dsnu, HotPixels, Prnu, ReadNoise, RowNoise, ShotNoise
from gs2ci_sims.effects.readout import BlackLevel, GainNonlinearity, Quantisation
from gs2ci_sims.light_path import LIGHT_PATH
from gs2ci_sims.path import StageMove
from gs2ci_sims.preview import preview
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures, Timing
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.sensor import SensorFigures
from tests.sims.adversaries import FAMILIES
from tests.sims.families import log_uniform

SIZE, MASKS, DRAWS = (16, 24), 4, 8
# Before the last of these scenes the camera stands still: there the charge is known.
SCENES = 4
# Standard errors that the variance of a noise may be off by.
ERRORS = 6
share = st.floats(0.001, 1.0)


def earlier(seed):
    """Return the charge of an earlier exposure."""
    return np.random.default_rng(seed).exponential(1e4, (*SIZE, 3))


SENSOR_FAMILY = {
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
    """Draw a sensor, light between next to none and twice the full well, and a timing."""
    sensor = SensorFigures(
        full_well_e=draw(log_uniform(500, 1e5)),
        electrons_per_dn=draw(log_uniform(0.3, 10)),
        quantum_efficiency=draw(st.floats(0.2, 1)),
        black_level_dn=draw(st.floats(0, 64)),
    )
    photons = draw(log_uniform(1e-4, 2)) * sensor.full_well_e / sensor.quantum_efficiency
    timing = Timing(draw(log_uniform(1e-4, 1)), draw(log_uniform(1e-5, 0.1)))
    return RigFigures(Light(photons), modulator=ModulatorFigures(MASKS), timing=timing, sensor=sensor)


@cache
def look_at(scene, masks):
    """Return a preview of one of `SCENES` scenes behind a family of masks."""
    travel = (0.0, 0.0, 0.0) if scene == SCENES - 1 else (0.3, 0.1, 0.0)
    seen, path = planes(np.random.default_rng(scene), SIZE), StageMove(travel)
    rig = RigFigures(modulator=ModulatorFigures(MASKS))
    image = preview(seen, path, np.ones((MASKS, *SIZE), np.float32), rig).views[-1].mean(axis=2)
    return preview(seen, path, FAMILIES[masks](MASKS, image, np.random.default_rng(scene)), rig)


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
    if effect.stage is LightStage.READOUT:
        signal = rig.sensor.dn_from_electrons(signal)
        return effect.apply(signal, rig, rng), signal
    changed = effect.apply(signal, rig, rng)
    if place < LIGHT_PATH.index(FullWell):
        changed, signal = np.minimum(changed, well_e), np.minimum(signal, well_e)
    return rig.dn_per_e * changed, rig.dn_per_e * signal


def sensor_ratios(look, rig, effect, seed):
    """Return what the effect changed, rms and peak, each over its bound (with what a noise's measurement scatters)."""
    look = dataclasses.replace(look, rig=rig)
    bound = effect.bound(look, rig)
    squares, peak = [], 0.0
    for draw in range(DRAWS):
        changed, plain = readings_with_and_without(effect, look, rig, DRAWS * seed + draw)
        assert np.isfinite(changed).all()
        squares.append(np.square(changed - plain).mean())
        peak = max(peak, float(np.abs(changed - plain).max()))
    square, slack = max(squares), 1.0
    if isinstance(effect, ChargeNoise):
        independent = DRAWS * (SIZE[0] if isinstance(effect, RowNoise) else np.prod(SIZE))
        square, slack = np.mean(squares), np.sqrt(1 + ERRORS * np.sqrt(2 / independent))
    # Differences of readings of 1e4 DN are rounded to 1e-9 of them or so.
    return _share(float(np.sqrt(square)), slack * bound.rms_dn), _share(peak, bound.peak_dn * (1 + 1e-9))


def _share(change, bound):
    return (change if change > 1e-9 else 0.0) / (bound + 1e-9)
