"""A synthetic sensor whose truth is known: dark frames, flat frames and sweeps without a bench."""

from dataclasses import dataclass

import numpy as np
import pytest

from gs2ci_calibration.dark_flat import Darks
from gs2ci_calibration.frames import Dark
from gs2ci_calibration.transfer_curve import ExposureSweep, Full

TOP_DN = 4095


@dataclass(frozen=True)
class SyntheticSensor:
    """EMVA 1288's linear model, with a response that may bend as s = u (1 + 4 d (1 − u / S))."""

    rng: np.random.Generator
    shape: tuple[int, int] = (16, 24)
    gain_e_per_dn: float = 2.5
    read_noise_e: float = 4.0
    full_well_e: float = 9000.0
    black_dn: float = 64.0
    dsnu_dn: float = 1.0
    prnu: float = 0.01
    dark_e_per_s: float = 20.0
    light_e_per_s: float = 40_000.0
    departure: float = 0.0
    flicker: float = 0.0
    seed: int = 0

    @property
    def offset_dn(self):
        return self.black_dn + self.dsnu_dn * np.random.default_rng(self.seed).standard_normal(self.shape)

    @property
    def response(self):
        return 1 + self.prnu * np.random.default_rng(self.seed + 1).standard_normal(self.shape)

    def frames(self, count, exposure_s, *, lit=True, current_e_per_s=None):
        current = self.dark_e_per_s if current_e_per_s is None else current_e_per_s
        light = self.light_e_per_s * self.response * lit
        steady = 1 + self.flicker * self.rng.standard_normal((count, 1, 1))
        charge = self.rng.poisson((light * steady + current) * exposure_s, (count, *self.shape))
        charge = np.minimum(charge, self.full_well_e)
        share = charge / self.full_well_e
        charge = charge + 4 * self.departure * self.full_well_e * share * (1 - share)
        charge = charge + self.read_noise_e * self.rng.standard_normal(charge.shape)
        return np.clip(np.rint(self.offset_dn + charge / self.gain_e_per_dn), 0, TOP_DN).astype(np.float32)

    def darks(self, count=16, **changes):
        times = (0.5e-3, 0.125, 1.0)
        short, middle, long = (self.frames(count, t, lit=False, **changes) for t in times)
        return Darks(short, middle, long, self.frames(count, 1.0, lit=False, **changes), times)

    @property
    def dark(self):
        flags = np.zeros(self.shape, np.bool_)
        current = np.full(self.shape, self.dark_e_per_s / self.gain_e_per_dn)
        return Dark(self.offset_dn, current, flags, flags)

    @property
    def noise_dn(self):
        return float(np.sqrt((self.read_noise_e / self.gain_e_per_dn) ** 2 + 1 / 12)), 0.002

    @property
    def full(self):
        return Full(self.frames(8, 1.0).mean(axis=0, dtype=float), self.full_well_e / self.light_e_per_s)

    def sweep(self, frames=4, levels=12):
        shares = np.linspace(0.04, 1.04, levels)
        exposures_s = np.array([*shares, *shares[::-1]]) * self.full_well_e / self.light_e_per_s
        stacks = tuple(self.frames(frames, exposure_s) for exposure_s in exposures_s)
        return ExposureSweep(stacks, exposures_s, np.arange(2.0 * levels))


@pytest.fixture
def make_sensor():
    def make(seed=0, **options):
        return SyntheticSensor(np.random.default_rng(seed), seed=1000 * seed + 7, **options)

    return make
