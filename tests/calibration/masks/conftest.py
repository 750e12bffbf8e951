"""A bench without devices, drivers and protocols, of known truth: quick enough to calibrate dozens of them."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci_calibration.bench import Arrangement, Bench, Stack
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.options import CalibrationOptions
from gs2ci_drivers.plan import CaptureSettings
from gs2ci_drivers.sensor import SensorConfig
from gs2ci_sims.effects.kernels import blurred
from gs2ci_sims.effects.masks import FiniteContrast
from gs2ci_sims.registration import MaskAlignment

BLACK_DN = 20.0


@dataclass
class World:
    """The truth, and what can be wrong with it."""

    size: tuple[int, int]
    modulator_size: tuple[int, int]
    registration: MaskAlignment
    seed: int = 0
    sigma_px: float = 0.4
    contrast: float = 30.0
    electrons_per_s: float = 4e5
    electrons_per_dn: float = 2.6
    read_noise_e: float = 3.0
    full_well_e: float = 10_000.0
    bits: int = 12
    drift_per_s: float = 0.0
    drift_per_s2: float = 0.0
    flicker: float = 0.0
    fall_off: float = 0.2
    lit: bool = True
    invert: bool = False
    dead_rows: tuple[int, ...] = ()
    slots: tuple[float, ...] = ()
    bend: float = 0.0
    shuffle: object = None
    now_s: float = 0.0
    rng: np.random.Generator = field(init=False)

    def __post_init__(self):
        self.rng = np.random.default_rng(self.seed)
        self.leak = FiniteContrast(contrast=self.contrast, spread=0.4).leakage(self.size, self.rng)
        y, x = ((np.arange(side) + 0.5) / side - 0.5 for side in self.size)
        self.light = 1 - self.fall_off * (y[:, None] ** 2 + x**2) * 2
        self.blurred_light = blurred(self.light, self.sigma_px, 8.0)
        self.gain = self.blurred_light * self.rng.normal(1, 0.01, self.size)
        self.cache = {}

    @property
    def top_dn(self):
        return 2**self.bits - 1

    def masks(self, patterns, top=1):
        """Return the true transmissions of patterns, [N, H, W]."""
        return np.stack([self._mask(pattern, top) for pattern in patterns])

    def _mask(self, pattern, top):
        key = hash(pattern.tobytes())
        if key not in self.cache:
            seen = self._bent(pattern, top) if self.bend else self.registration.seen(pattern, top, *self.size)
            share = seen.astype(np.float64)
            passed = (self.leak + (1 - self.leak) * share) * self.light
            self.cache[key] = blurred(passed, self.sigma_px, 8.0) / self.blurred_light
        return self.cache[key]

    def looks_at(self, x, y):
        """Return where sensor points look on the modulator, u and v, [...]; `bend` is a barrel distortion."""
        height, width = self.size
        dx, dy = x - width / 2, y - height / 2
        radius = (dx**2 + dy**2) / max(self.size) ** 2
        dx, dy = dx * self.bend * radius, dy * self.bend * radius
        forth = self.registration.sensor_from_modulator(height, width)
        inverse = np.linalg.inv(forth[:, :2])
        return np.tensordot(inverse, np.stack([x + dx - forth[0, 2], y + dy - forth[1, 2]]), axes=1)

    def _bent(self, pattern, top, samples=12):
        """Sample each pixel's square on a grid."""
        fine = [(np.arange(side * samples) + 0.5) / samples for side in self.size]
        u, v = np.floor(self.looks_at(*np.meshgrid(fine[1], fine[0]))).astype(int)
        height, width = self.size
        return pattern[v, u].reshape(height, samples, width, samples).mean(axis=(1, 3)) / top

    def frame(self, exposed):
        """Return one frame in DN; `exposed` is mask times seconds, [H, W]."""
        drift = self.drift_per_s * self.now_s + self.drift_per_s2 * self.now_s**2
        lamp = max(1 + drift + self.flicker * self.rng.standard_normal(), 0.0)
        mean = exposed * self.gain * self.electrons_per_s * lamp * self.lit
        charge = np.minimum(self.rng.poisson(mean), self.full_well_e)
        charge = charge + self.rng.normal(0, self.read_noise_e, self.size)
        charge[list(self.dead_rows)] = self.rng.normal(0, self.read_noise_e, (len(self.dead_rows), self.size[1]))
        return np.clip(np.rint(BLACK_DN + charge / self.electrons_per_dn), 0, self.top_dn)


@dataclass(frozen=True)
class QuickBench(Bench):
    """A `Bench` whose frames come straight from a `World`."""

    world: World = None

    size = property(lambda self: self.world.size)
    modulator_size = property(lambda self: self.world.modulator_size)
    top_dn = property(lambda self: self.world.top_dn)
    exposure_limits_s = property(lambda self: (1e-5, 2.0))
    capacity = property(lambda self: 40)

    def planned(self):
        return SimpleNamespace(weights=np.ones(len(self.codes)), exposure_s=len(self.codes) * self.capture.mask_s)

    def grab(self, patterns, *, frames, exposure_s, bit_depth=1):
        shown = patterns if self.world.shuffle is None else self.world.shuffle(patterns)
        if self.world.invert:
            shown = 2**bit_depth - 1 - shown
        masks = self.world.masks(shown, 2**bit_depth - 1)
        readings = np.empty((len(masks), frames, *self.size), np.float32)
        time_s = np.empty(readings.shape[:2])
        for k in range(frames):
            for n, mask in enumerate(masks):
                self.world.now_s += exposure_s + 1e-3
                time_s[n, k] = self.world.now_s
                readings[n, k] = self.world.frame(mask * exposure_s)
            self.world.now_s += 0.02
        return Stack(readings, time_s, exposure_s, None)

    def expose(self, patterns, *, mask_s, exposure_s, frames, bit_depth=1):
        masks = self.world.masks(patterns, 2**bit_depth - 1)
        weights = self.world.slots or (1.0,) * len(masks)
        light = np.tensordot(np.array(weights) * mask_s, masks, axes=1)
        readings, time_s = np.empty((1, frames, *self.size), np.float32), np.empty((1, frames))
        self.world.now_s += 1.0  # the upload
        for k in range(frames):
            self.world.now_s += exposure_s + 1e-3
            time_s[0, k] = self.world.now_s
            readings[0, k] = self.world.frame(light)
        return Stack(readings, time_s, exposure_s, None)


@pytest.fixture(scope="session")
def bench_of_truth():
    """Build a bench from what is true of it; what is not given is a good bench."""

    def build(*, size=(48, 60), superpixel=2, masks=4, bit_depth=1, options=None, seed=0, density=0.5, **truth):
        margin = 24 * superpixel
        modulator = tuple(superpixel * side + margin for side in size)
        if truth.get("quarter_turns", 0) % 2:
            modulator = (superpixel * max(size) + margin,) * 2
        row, column = ((there - superpixel * side) // 2 for there, side in zip(modulator, size, strict=True))
        moved = {
            key: truth.pop(key)
            for key in ("mirrored", "quarter_turns", "right_px", "down_px", "turn_mrad", "magnification")
            if key in truth
        }
        world = World(size, modulator, MaskAlignment(superpixel, row, column, **moved), seed=seed, **truth)
        top = 2**bit_depth - 1
        codes = np.where(np.random.default_rng(seed + 1).random((masks, *size)) < density, top, 0).astype(np.uint16)

        def lay_out(drawn):
            laid = np.zeros((len(drawn), *modulator), np.uint8)
            k = superpixel
            height, width = size
            laid[:, row : row + k * height, column : column + k * width] = drawn.repeat(k, 1).repeat(k, 2)
            return laid

        class Silent:
            def please(self, setup, index):
                world.lit = setup is not Arrangement.DARK and truth.get("lit", True)

        clock = SimpleNamespace(now_s=lambda: world.now_s)
        return QuickBench(
            devices=SimpleNamespace(clock=clock),
            operator=Silent(),
            config=SensorConfig(*size),
            capture=CaptureSettings(masks=lay_out(codes), bit_depth=bit_depth, mask_s=0.005),
            codes=codes,
            lay_out=lay_out,
            options=CalibrationOptions(**({"mask_frames": 4} | (options or {}))),
            superpixel=superpixel,
            world=world,
        )

    return build


@pytest.fixture(scope="session")
def dark_known():
    """Return a bundle with a dark-flat section."""

    def known(bench, error_dn=0.05):
        section = Section(
            "dark-flat",
            {
                "offset_dn": Estimate(np.full(bench.size, BLACK_DN), error_dn, "DN"),
                "dark_current_dn_per_s": Estimate(np.zeros(bench.size), 0.0, "DN/s"),
            },
            {key: np.zeros(bench.size, np.uint8) for key in ("dead", "hot")},
        )
        return Bundle().with_section(section)

    return known
