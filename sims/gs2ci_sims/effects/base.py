"""What an effect is: its parameters, what leaving it out would change, and what it does. For this package.

An effect is a frozen dataclass of its physical parameters, in electrons and seconds; its table in a rig file,
`[effects.name]`, holds exactly these. Its presence in a light path switches it on; there is no flag. Off, it is the
identity bit for bit, costs nothing and draws nothing. Not here: the order of effects (`light_path`), which of them
a measurement needs (`planner`), what the signals are made of (`signals`).
"""

import enum
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError

if TYPE_CHECKING:
    from gs2ci_sims.preview import Preview
    from gs2ci_sims.rig import Rig


@enum.unique
class Stage(enum.Enum):
    """Where along the light path an effect acts, and what the signal is there."""

    MOTION = "where the camera is at any time, CameraPath"
    SCENE = "what is seen at any time, MovingScene"
    TIME = "when light is collected and through which masks, Slices"
    MOMENTS = "at which moments views are rendered, Moments"
    RADIANCE = "light on its way to the modulator at one moment, View"
    MASKS = "transmissions of the masks at the sensor's pixels, [N, H, W]"
    PHOTONS = "photons collected by each pixel, [H, W, 3]"
    CHARGE = "electrons in each pixel, [H, W, C]"
    READOUT = "readings, [H, W, C], DN"


@dataclass(frozen=True)
class Bound:
    """At most so much would change in the readings if the effect were left out, or sampled no finer.

    It limits the change that the effect makes to the reading that a pixel has before counting and rounding
    (a noise: the deviations that it adds).

    Args:
        rms_dn: Root mean square over the pixels, DN, at least 0. Infinite: it cannot be left out.
        peak_dn: Largest over the pixels, DN; for a noise, six standard deviations of the noisiest pixel.
        random: Deviations of mean zero, independent of everything else: they add in quadrature.
    """

    rms_dn: float
    peak_dn: float
    random: bool = False

    def __post_init__(self) -> None:
        if not (self.rms_dn >= 0 and self.peak_dn >= 0):
            raise InputError(f"bound of {self.rms_dn} DN rms, {self.peak_dn} DN peak", allowed="0 or more, or infinite")


NOTHING = Bound(0.0, 0.0)
UNAVOIDABLE = Bound(math.inf, math.inf)


class Effect(Protocol):
    """One physical effect.

    `cost_ns` is roughly what it costs per pixel of its stage's signal (of each view at RADIANCE, of each mask at
    MASKS), in nanoseconds on one core; the planner weighs it against the bound.
    `fixed_pattern` effects draw from the device's generator: the same pattern in every exposure of one device.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    cost_ns: ClassVar[float]
    fixed_pattern: ClassVar[bool]

    def bound(self, scene: "Preview", rig: "Rig") -> Bound:
        """Return an upper bound of what leaving the effect out would change. Cheap: nothing is rendered."""
        ...

    def apply(self, signal: Any, rig: "Rig", rng: np.random.Generator) -> Any:
        """Return the signal with the effect; never changes its argument. `rng` belongs to this effect alone."""
        ...


@runtime_checkable
class KernelEffect(Effect, Protocol):
    """An effect that is a convolution: how wide its kernel reaches is the planner's choice.

    Such an effect has a field `reach`: where the kernel is cut off, in its standard deviations.
    """

    @property
    def reach(self) -> float:
        """Get where the kernel is cut off now, in standard deviations."""
        ...

    def kernel_bound(self, scene: "Preview", rig: "Rig", reach: float) -> Bound:
        """Return an upper bound of what a kernel without end would change, against one of this reach."""
        ...


@runtime_checkable
class Brightening(Effect, Protocol):
    """An effect that may make a pixel collect more light than the nominal light path does."""

    def brightest(self, scene: "Preview") -> float:
        """Return the largest factor; one below 1 counts as 1."""
        ...


@runtime_checkable
class Charging(Effect, Protocol):
    """An effect that fills pixels in the dark."""

    def added_e(self, rig: "Rig", size: tuple[int, int]) -> tuple[float, float]:
        """Return how many electrons at most it adds, in the mean over the pixels and in the fullest one."""
        ...


@runtime_checkable
class Modulating(Effect, Protocol):
    """An effect that changes the light of some masks more than that of others."""

    def modulation(self, scene: "Preview") -> float:
        """Return the largest share of a mask's light that it takes away, adds, or collects at another time."""
        ...


@runtime_checkable
class Moving(Effect, Protocol):
    """An effect that moves parts of the scene."""

    def image_px_per_s(self, scene: "Preview") -> float:
        """Return how fast they cross the image, at most."""
        ...


@runtime_checkable
class ViewChange(Effect, Protocol):
    """An effect on views that puts light elsewhere; one that only dims them is none."""

    def view_change(self, scene: "Preview") -> tuple[float, float]:
        """Return rms and peak, radiance, of what it changes in a view."""
        ...


@runtime_checkable
class ViewEffect(Effect, Protocol):
    """An effect on views that looks beyond the sensor's rim, or at depth."""

    needs_depth: ClassVar[bool]

    def margin_px(self, rig: "Rig", size: tuple[int, int], intrinsics: F64) -> int:
        """Return how many pixels beyond the rim of an image of this size the effect looks."""
        ...
