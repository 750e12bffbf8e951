"""What an effect is: its parameters, what leaving it out would change, and what it does.

An effect is a frozen dataclass of its physical parameters, in electrons and seconds; its table in a rig file,
`[effects.name]`, holds exactly these. Its presence in a light path switches it on; there is no flag. Off, it is the
identity bit for bit, costs nothing and draws nothing. Not here: the order of effects (`light_path`), which of them
a measurement needs (`planner`), what the signals are made of (`signals`).
"""

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError
from gs2ci_sims.rig import Rig

if TYPE_CHECKING:  # scenes take torch, which a bench's computer need not have
    from gs2ci_sims.path import CameraPath
    from gs2ci_sims.scene import Scene
    from gs2ci_sims.spectrum import MovingSpectrum


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
class BoundStep:
    """One step of a bound's derivation, with this rig's numbers in it.

    Args:
        symbol: Stands for the value in the laws of later steps.
        value: In `unit`.
        unit: "" for a pure number.
        what: What it is.
        law: How it follows from the symbols before it, as a formula in Python's notation, with numpy's functions and
            J1 for the Bessel function; "" for a figure of the rig file or one that is measured on images.
    """

    symbol: str
    value: float
    unit: str
    what: str
    law: str = ""


def gain_step(rig: Rig) -> BoundStep:
    """Return the sensor's gain as a step, K."""
    return BoundStep("K", rig.dn_per_e, "DN/e", "gain of the sensor")


@dataclass(frozen=True)
class Bound:
    """At most so much would change in the readings if the effect were left out, or sampled no finer.

    It limits the change that the effect makes to the reading that a pixel has before counting and rounding
    (a noise: the deviations that it adds).

    Args:
        rms_dn: Root mean square over the pixels, DN, at least 0. Infinite: it cannot be left out.
        peak_dn: Largest over the pixels, DN; for a noise, six standard deviations of the noisiest pixel.
        random: Deviations of mean zero, independent of everything else: they add in quadrature.
        steps: How `rms_dn` came about; its own step is the last.
    """

    rms_dn: float
    peak_dn: float
    random: bool = False
    steps: tuple[BoundStep, ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        if not (self.rms_dn >= 0 and self.peak_dn >= 0):
            raise InputError(f"bound of {self.rms_dn} DN rms, {self.peak_dn} DN peak", allowed="0 or more, or infinite")

    def after(self, *steps: BoundStep) -> "Bound":
        """Return the same bound, of which these steps come first."""
        return replace(self, steps=(*steps, *self.steps))

    def by(self, law: str, *steps: BoundStep) -> "Bound":
        """Return the same bound as it follows by a law from these steps."""
        return replace(self, steps=(*steps, *self.steps, BoundStep("bound", self.rms_dn, "DN", "rms", law)))


NOTHING = Bound(0.0, 0.0)
UNAVOIDABLE = Bound(math.inf, math.inf)


class ViewPreview(Protocol):
    """What an effect may know of a preview that itself says how it changes light, views or motion.

    No charge and no scale of readings: these follow from what the effects say.
    """

    @property
    def scene(self) -> "Scene":
        """Get what is seen."""

    @property
    def path(self) -> "CameraPath":
        """Get where the camera is at any time, before effects."""

    @property
    def masks(self) -> F32:
        """Get the masks as nominally shown, [N, H, W]."""

    @property
    def rig(self) -> Rig:
        """Get the figures."""

    @property
    def intervals_s(self) -> F64:
        """Get start and stop of the mask intervals, [N, 2]."""

    @property
    def shown(self) -> NDArray[Any]:
        """Get the masks with all effects on masks, [N, H, W]."""

    def filtered(self, change: Callable[[F64], F64]) -> tuple[float, float]:
        """Return rms and peak, radiance, of what a linear filter changes in a view."""

    @property
    def spectrum(self) -> "MovingSpectrum":
        """Get the power of a view by frequency and direction, as it turns in phase while the image moves."""

    def shifted(self, shift_px: float) -> tuple[float, float]:
        """Return rms and peak of what shifting a view by up to `shift_px` in any direction changes."""


class Previewed(ViewPreview, Protocol):
    """What a bound may know of a measurement (`gs2ci_sims.preview.Preview`, where each is explained)."""

    @property
    def most_open(self) -> NDArray[Any]:
        """Get the larger of the nominal masks and those shown, [N, H, W]."""

    @property
    def full_scale_dn(self) -> float:
        """Get the reading above black of radiance 1 through one open mask, with all light that effects may add."""

    @property
    def motion_px(self) -> F64:
        """Get how far the image moves within each mask interval, at most over the frame, [N] pixels."""

    @property
    def object_px_per_s(self) -> float:
        """Get how fast objects move across the image by themselves, at most."""

    @property
    def charge_e(self) -> F64:
        """Get the charge of each pixel under the previewed views, [H, W, 3] electrons."""

    @property
    def charge_error_e(self) -> float:
        """Get how far the charge may be from `charge_e`, rms over the pixels."""

    @property
    def most_e(self) -> F64:
        """Get the charge that no pixel exceeds, [H, W, 1] electrons."""

    @property
    def charge_rms_e(self) -> float:
        """Get a bound of the rms over the pixels of the charge."""

    @property
    def charge_mean_e(self) -> float:
        """Get a bound of the mean over the pixels of the charge."""

    @property
    def added_e(self) -> tuple[float, float]:
        """Get the charge that comes in the dark, its mean over the pixels and its largest."""

    def excess_e(self, capacity_e: float) -> tuple[float, float, float]:
        """Bound what the pixels have beyond a capacity: mean, rms and peak over the pixels, electrons."""

    def of_views(self, rms: float | F64, peak: float) -> Bound:
        """Bound what fields of this rms (of each, [N], or of all) and peak, radiance, make behind the masks."""

    def of_masks(self, effect: "Effect", change: NDArray[Any]) -> Bound:
        """Bound what a change of the masks, [N, H, W], makes of the readings."""

    def of_mask_effect(self, effect: "Effect") -> Bound:
        """Bound what an effect on masks changes: applied to the masks that it meets."""

    def of_photon_effect(self, effect: "Effect", most: float) -> Bound:
        """Bound what a linear effect on the photons changes: at most the share `most` of what it acts on, rms."""

    def of_shares(self, effect: "Effect", mean: F64, swing: F64, intervals_s: F64 | None = None) -> Bound:
        """Bound what changing the light behind each mask by a share, [N], makes of the readings."""


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

    def bound(self, scene: Previewed, rig: Rig) -> Bound:
        """Return an upper bound of what leaving the effect out would change. Cheap: nothing is rendered."""

    def apply(self, signal: Any, rig: Rig, rng: np.random.Generator) -> Any:
        """Return the signal with the effect; never changes its argument. `rng` belongs to this effect alone."""


@runtime_checkable
class KernelEffect(Effect, Protocol):
    """An effect that is a convolution: how wide its kernel reaches is the planner's choice.

    Such an effect has a field `reach`: where the kernel is cut off, in its standard deviations.
    """

    @property
    def reach(self) -> float:
        """Get where the kernel is cut off now, in standard deviations."""

    def kernel_bound(self, scene: Previewed, rig: Rig, reach: float) -> Bound:
        """Return an upper bound of what a kernel without end would change, against one of this reach."""


@runtime_checkable
class Brightening(Effect, Protocol):
    """An effect that may make a pixel collect more light than the nominal light path does."""

    def brightest(self, scene: ViewPreview) -> float:
        """Return the largest factor; one below 1 counts as 1."""


@runtime_checkable
class Charging(Effect, Protocol):
    """An effect that fills pixels in the dark."""

    def added_e(self, rig: Rig, size: tuple[int, int]) -> tuple[float, float]:
        """Return how many electrons at most it adds, in the mean over the pixels and in the fullest one."""


@runtime_checkable
class Modulating(Effect, Protocol):
    """An effect that changes the light of some masks more than that of others."""

    def modulation(self, scene: ViewPreview) -> float:
        """Return the largest share of a mask's light that it takes away, adds, or collects at another time."""


@runtime_checkable
class Moving(Effect, Protocol):
    """An effect that moves parts of the scene."""

    def image_px_per_s(self, scene: ViewPreview) -> float:
        """Return how fast they cross the image, at most."""


@runtime_checkable
class ViewChange(Effect, Protocol):
    """An effect on views that puts light elsewhere; one that only dims them is none."""

    def view_change(self, scene: ViewPreview) -> tuple[float, float]:
        """Return rms and peak, radiance, of what it changes in a view."""


@runtime_checkable
class ViewEffect(Effect, Protocol):
    """An effect on views that looks beyond the sensor's rim, or at depth."""

    needs_depth: ClassVar[bool]

    def margin_px(self, rig: Rig, size: tuple[int, int], intrinsics: F64) -> int:
        """Return how many pixels beyond the rim of an image of this size the effect looks."""
