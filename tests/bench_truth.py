"""A simulated bench opened for calibration, and its true parameters: figures and maps that follow from its [world]."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError
from gs2ci.rig.config import RigTable
from gs2ci.rig.simulated import SimulatedBench
from gs2ci_calibration.bench import Bench
from gs2ci_sims.bench_light import BenchLight
from gs2ci_sims.effects.base import Effect
from gs2ci_sims.effects.charges import DarkCurrent
from gs2ci_sims.effects.masks import MaskEdges
from gs2ci_sims.effects.noises import Dsnu, HotPixels, Prnu
from gs2ci_sims.effects.photons import ModulatorPsf
from gs2ci_sims.effects.readout import GainNonlinearity
from gs2ci_sims.effects.views import LensDistortion, Vignetting
from gs2ci_sims.rig import RigFigures as SimulatedRig
from gs2ci_sims.wires.genicam import GenicamModel
from gs2ci_sims.wires.v4l2_camera import CameraModel
from tests.tables import calibration


@dataclass(frozen=True)
class BenchTruth:
    """The truth of a simulated bench at one bit depth of its sensor.

    Args:
        light: Its light path.
        camera: Its camera's data sheet.
        rig: Its figures at this bit depth, for an exposure of one second.
    """

    light: BenchLight
    camera: CameraModel | GenicamModel
    rig: SimulatedRig

    @property
    def gain_e_per_dn(self) -> float:
        """Get the electrons per DN: the electrons from black to saturation over the readings of that range."""
        return self.full_well_e / self._range_dn

    @property
    def read_noise_e(self) -> float:
        """Get the temporal dark noise before quantisation, in electrons by `gain_e_per_dn`."""
        return self.rig.sensor.read_noise_e * self.gain_e_per_dn / self.rig.sensor.electrons_per_dn

    @property
    def full_well_e(self) -> float:
        """Get the saturation capacity: the electrons at which the well or the converter limits the readings."""
        sensor = self.rig.sensor
        top_e = (2.0**sensor.bits - 1 - sensor.black_level_dn) * sensor.electrons_per_dn
        charge_e = min(sensor.full_well_e, top_e)
        for _ in range(20 if top_e < sensor.full_well_e else 0):  # a contraction by 4 `_bend` per iteration
            charge_e = top_e / (1 + 4 * self._bend * (1 - charge_e / sensor.full_well_e))
        return min(charge_e, sensor.full_well_e)

    @property
    def linearity_error(self) -> float:
        """Get the largest departure from the line between black and saturation, as a share of that range."""
        # The largest distance of a parabola from its chord is proportional to the square of the chord's range.
        sensor = self.rig.sensor
        arrow_e = self._bend * self.full_well_e**2 / sensor.full_well_e
        return arrow_e / (self._range_dn * sensor.electrons_per_dn)

    @property
    def dark_noise_dn(self) -> float:
        """Get the temporal noise of dark readings, rounding included."""
        sensor = self.rig.sensor
        return float(np.sqrt((sensor.read_noise_e / sensor.electrons_per_dn) ** 2 + 1 / 12))

    @property
    def dsnu_dn(self) -> float:
        """Get the standard deviation of the offsets, DN."""
        effect = self._effect(Dsnu)
        return 0.0 if effect is None else effect.sigma_e / self.rig.sensor.electrons_per_dn

    @property
    def prnu(self) -> float:
        """Get the relative standard deviation of the pixels' sensitivities."""
        effect = self._effect(Prnu)
        return 0.0 if effect is None else effect.spread

    @property
    def latency_s(self) -> float:
        """Get the mean time from the trigger's edge to the start of exposure."""
        return self.camera.latency_s

    @property
    def jitter_s(self) -> float:
        """Get the standard deviation of that time."""
        return self.camera.jitter_s

    @property
    def exposure_offset_s(self) -> float:
        """Get the difference of a triggered exposure from the time that is set."""
        return self.camera.exposure_offset_s

    @property
    def sensor_from_modulator(self) -> F64:
        """Get the map from modulator to sensor points, [2, 3]; x right, y down, pixel centres at +0.5."""
        return self.light.registration.sensor_from_modulator(*self.light.scene.size)

    @property
    def psf_sigma_px(self) -> float:
        """Get the standard deviation of the masks' blur: by the relay, diffraction included, and at their edges."""
        relay, edges = self._effect(ModulatorPsf), self._effect(MaskEdges)
        return float(
            np.hypot(0.0 if relay is None else relay.total_sigma_px(self.rig), 0.0 if edges is None else edges.sigma_px)
        )

    @property
    def intrinsics(self) -> F64:
        """Get the camera matrix, [3, 3]; pixel centres at +0.5."""
        return self.light.scene.intrinsics

    @property
    def distortion(self) -> tuple[float, float]:
        """Get k1 and k2 of the lens."""
        effect = self._effect(LensDistortion)
        return (0.0, 0.0) if effect is None else (effect.k1, effect.k2)

    @property
    def offset_dn(self) -> F64:
        """Get each pixel's reading without light for an exposure of zero length, [H, W]."""
        dark = np.zeros((*self.light.scene.size, 1))
        return self.rig.sensor.black_level_dn + self._through(dark, Dsnu)[..., 0] * self.rig.dn_per_e

    @property
    def dark_current_dn_per_s(self) -> F64:
        """Get each pixel's mean dark current, hot pixels and the response's nonlinearity included, [H, W]."""
        dark = np.zeros((*self.light.scene.size, 1))
        return self._through(dark, DarkCurrent, HotPixels, GainNonlinearity)[..., 0] * self.rig.dn_per_e

    @property
    def response(self) -> F64:
        """Get each pixel's response to uniform light over the mean one, vignetting included, [H, W].

        It is given at half of the range, because a nonlinear response depends on the level.
        """
        ones = self._through(np.ones((*self.light.scene.size, 1)), Prnu)[..., 0]
        falling = self._effect(Vignetting)
        if falling is not None:
            ones = ones * falling.transmission(self.light.scene.size, self.light.scene.intrinsics)
        half_e = 0.5 * self.full_well_e * ones / ones.max()
        bent = self._through(half_e[..., None], GainNonlinearity)[..., 0]
        return np.asarray(bent / bent.mean())

    def masks(self, patterns: NDArray[Any], top: int = 1) -> F32:
        """Return patterns [N, Hm, Wm] as they fall on the sensor, leakage and blur included, [N, H, W] in [0, 1]."""
        return self.light.true_masks(patterns, top)

    @property
    def _bend(self) -> float:
        effect = self._effect(GainNonlinearity)
        return 0.0 if effect is None else float(effect.departure)

    @property
    def _range_dn(self) -> float:
        """Get the readings from black to saturation; at the full well the bend is none."""
        sensor = self.rig.sensor
        return min(sensor.full_well_e / sensor.electrons_per_dn, 2.0**sensor.bits - 1 - sensor.black_level_dn)

    def _through(self, signal: F64, *kinds: type[Effect]) -> F64:
        for effect in self.light.effects:
            if isinstance(effect, kinds):
                signal = self.light.fixed_pattern(effect, signal, self.rig)
        return signal

    def _effect(self, kind: type[Any]) -> Any:
        return next((effect for effect in self.light.effects if isinstance(effect, kind)), None)


def truth_of(bench: SimulatedBench, bits: int) -> BenchTruth:
    """Return the truth of a simulated bench.

    Args:
        bench: A bench built from a rig file.
        bits: Bit depth of the format in which the sensor is read; the truth in DN depends on it.

    Raises:
        InputError: The bench's light was put in by a test.
    """
    light = bench.light
    if light is None:
        raise InputError("a bench without a rendered light has no truth", remedy="build it from a rig file")
    return BenchTruth(light, bench.sensor.model, light.nominal_rig(bits))


@contextmanager
def opened(table: RigTable) -> Iterator[tuple[Bench, BenchTruth]]:
    """Open a simulated bench for calibration, with its truth; its devices are released afterwards."""
    with calibration.opened(table) as (bench, simulated):
        yield bench, truth_of(simulated, int(bench.devices.sensor.info.formats[0].bits))
