"""The rig for the simulator: the figures of its parts, in electrons, photons and seconds.

Here: one frozen record per part and `RigFigures`, which holds them. Each is a table of a rig file (`rig_file` reads
it). Not here: imperfections (`effects`; their tables are `[effects.*]`), devices and drivers (`gs2ci.rig`), the scene.
"""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from pydantic import Field, NonNegativeInt, PositiveInt

from gs2ci.core.arrays import F64
from gs2ci.core.bounds import BoundedRecord
from gs2ci.core.config import NotNegative, Positive
from gs2ci_sims.sensor import SensorFigures


@dataclass(frozen=True)
class Timing(BoundedRecord):
    """When the masks are shown: equal intervals, back to back or with dark gaps, centred on time 0.

    Args:
        interval_s: Time that each mask is exposed, more than 0.
        dark_s: Gap between two masks, at least 0; the camera moves on during it.
    """

    interval_s: Positive = 0.1
    dark_s: NotNegative = 0.0

    def intervals_s(self, count: int) -> F64:
        """Get start and stop of each of `count` intervals, [N, 2]."""
        starts = (np.arange(count) - 0.5 * count) * (self.interval_s + self.dark_s) + 0.5 * self.dark_s
        return np.stack([starts, starts + self.interval_s], axis=1)

    def duration_s(self, count: int) -> float:
        """Get the time from the start of the first interval to the stop of the last."""
        return count * self.interval_s + (count - 1) * self.dark_s


@dataclass(frozen=True)
class Light(BoundedRecord):
    """The brightness of the light.

    Args:
        full_scale_photons: Photons that a pixel receives from radiance 1 through an open mask during one interval.
    """

    full_scale_photons: NotNegative = 4180.0


@dataclass(frozen=True)
class Optics(BoundedRecord):
    """The lens between scene and modulator; its focal length in pixels is the scene's camera's.

    Args:
        f_number: Focal length over aperture, more than 0.
        wavelength_nm: Wavelength of the light, for diffraction.
    """

    f_number: Positive = 8.0
    wavelength_nm: Positive = 550.0


@dataclass(frozen=True)
class ModulatorFigures(BoundedRecord):
    """The mask generator, as imaged onto the sensor.

    Args:
        masks: How many are shown during one exposure, at least 1.
        open_share: Share of a random mask's elements that are open, in (0, 1].
        feature_px: Side of one mask element in sensor pixels, at least 1.
        pitch_um: Distance between two mirrors or cells (7.56 um: the DLP6500 chip).
    """

    masks: PositiveInt = 8
    open_share: Annotated[float, Field(gt=0, le=1)] = 0.25
    feature_px: PositiveInt = 1
    pitch_um: Positive = 7.56


@dataclass(frozen=True)
class RigFigures(BoundedRecord):
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
    device_seed: NonNegativeInt = 0

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
