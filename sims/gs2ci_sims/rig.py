"""The rig for the simulator: the figures of its parts, in electrons, photons and seconds.

Here: one frozen record per part and `RigFigures`, which holds them. Each is a table of a rig file (`rig_file` reads
it). Not here: imperfections (`effects`; their tables are `[effects.*]`), devices and drivers (`gs2ci.rig`), the scene.
"""

from dataclasses import dataclass, field

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci_sims.sensor import SensorFigures


@dataclass(frozen=True)
class Timing:
    """When the masks are shown: equal intervals, back to back or with dark gaps, centred on time 0.

    Args:
        interval_s: Time that each mask is exposed, more than 0.
        dark_s: Gap between two masks, at least 0; the camera moves on during it.
    """

    interval_s: float = 0.1
    dark_s: float = 0.0

    def __post_init__(self) -> None:
        if not 0 < self.interval_s < np.inf or not 0 <= self.dark_s < np.inf:
            raise InputError(
                f"mask intervals of {self.interval_s} s with gaps of {self.dark_s} s",
                allowed="interval_s > 0, dark_s >= 0, both finite",
            )

    def intervals_s(self, count: int) -> F64:
        """Get start and stop of each of `count` intervals, [N, 2]."""
        starts = (np.arange(count) - 0.5 * count) * (self.interval_s + self.dark_s) + 0.5 * self.dark_s
        return np.stack([starts, starts + self.interval_s], axis=1)

    def duration_s(self, count: int) -> float:
        """Get the time from the start of the first interval to the stop of the last."""
        return count * self.interval_s + (count - 1) * self.dark_s


@dataclass(frozen=True)
class Light:
    """The brightness of the light.

    Args:
        full_scale_photons: Photons that a pixel receives from radiance 1 through an open mask during one interval.
    """

    full_scale_photons: float = 4180.0

    def __post_init__(self) -> None:
        if not 0 <= self.full_scale_photons < np.inf:
            raise InputError(f"a light level of {self.full_scale_photons} photons", allowed="finite, 0 or more")


@dataclass(frozen=True)
class Optics:
    """The lens between scene and modulator; its focal length in pixels is the scene's camera's.

    Args:
        f_number: Focal length over aperture, more than 0.
        wavelength_nm: Wavelength of the light, for diffraction.
    """

    f_number: float = 8.0
    wavelength_nm: float = 550.0

    def __post_init__(self) -> None:
        if not 0 < self.f_number < np.inf or not 0 < self.wavelength_nm < np.inf:
            raise InputError(f"f/{self.f_number} at {self.wavelength_nm} nm", allowed="finite numbers above 0")


@dataclass(frozen=True)
class ModulatorFigures:
    """The mask generator, as imaged onto the sensor.

    Args:
        masks: How many are shown during one exposure, at least 1.
        open_share: Share of a random mask's elements that are open, in (0, 1].
        feature_px: Side of one mask element in sensor pixels, at least 1.
        pitch_um: Distance between two mirrors or cells (7.56 um: the DLP6500 chip).
    """

    masks: int = 8
    open_share: float = 0.25
    feature_px: int = 1
    pitch_um: float = 7.56

    def __post_init__(self) -> None:
        if self.masks < 1 or not 0 < self.open_share <= 1 or self.feature_px < 1 or not self.pitch_um > 0:
            raise InputError(
                f"modulator with {self.masks} masks, {self.open_share} open, {self.feature_px} px features, "
                f"{self.pitch_um} um pitch",
                allowed="masks and feature_px >= 1, 0 < open_share <= 1, pitch_um > 0",
            )


@dataclass(frozen=True)
class RigFigures:
    """All figures that the light path and the bounds of its effects need.

    Args:
        light: The brightness of the light.
        optics: The lens.
        modulator: The masks.
        timing: When the masks are shown.
        sensor: The sensor's data sheet.
        device_seed: Identifies the individual device: seeds fixed patterns (PRNU, hot pixels, contrast maps).
    """

    light: Light = field(default_factory=Light)
    optics: Optics = field(default_factory=Optics)
    modulator: ModulatorFigures = field(default_factory=ModulatorFigures)
    timing: Timing = field(default_factory=Timing)
    sensor: SensorFigures = field(default_factory=SensorFigures)
    device_seed: int = 0

    def __post_init__(self) -> None:
        if self.device_seed < 0:
            raise InputError(f"device_seed {self.device_seed}", allowed="0 or more")

    @property
    def photons_per_s(self) -> float:
        """Get the rate of photons in a pixel at radiance 1 through an open mask."""
        return self.light.full_scale_photons / self.timing.interval_s

    @property
    def full_scale_e(self) -> float:
        """Get the electrons of one view's full scale: radiance 1, open mask, one interval."""
        return self.light.full_scale_photons * self.sensor.quantum_efficiency

    @property
    def dn_per_e(self) -> float:
        """Get the system gain K of EMVA 1288, DN per electron."""
        return 1.0 / self.sensor.electrons_per_dn

    @property
    def exposure_s(self) -> float:
        """Get the time for which the sensor collects: all masks and the gaps between them."""
        return self.timing.duration_s(self.modulator.masks)
