"""The interface of effects: parameters, a bound on the change if an effect is left out, and its application.

An effect is a frozen dataclass of its physical parameters, an `EffectRecord`, in electrons and seconds; its table in a
rig file, `[effects.name]`, holds exactly these. An effect is on if it is in the light path; there is no flag. If it is
off, the result is bit-identical to a light path without it, it takes no time and draws no random numbers. Not here: the
order of effects (`light_path`), which of them a measurement needs (`planner`), the types of signals (`signals`).
"""

import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar, runtime_checkable

from numpy.typing import NDArray
from pydantic.alias_generators import to_snake

from gs2ci.core.arrays import F32, F64, Rng
from gs2ci.core.bounds import BoundedRecord
from gs2ci.core.errors import InputError
from gs2ci_sims.rig import RigFigures

if TYPE_CHECKING:  # scenes need torch, which a bench's computer need not have
    from gs2ci_sims.path import CameraPath
    from gs2ci_sims.scene import Scene
    from gs2ci_sims.signals import View
    from gs2ci_sims.spectrum import MovingSpectrum


class LightStage(enum.Enum):
    """The place in the light path where an effect acts, and the signal there."""

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
    """One step of a bound's derivation, with this rig's numbers.

    Args:
        symbol: Symbol of the value in the laws of later steps.
        value: The value, in `unit`.
        unit: Its unit; "" for a pure number.
        what: Description.
        law: How it follows from earlier symbols, as a formula in Python's notation, with numpy's functions and
            J1 for the Bessel function; "" for a figure of the rig file or one that is measured on images.
    """

    symbol: str
    value: float
    unit: str
    what: str
    law: str = ""


def gain_step(rig: RigFigures) -> BoundStep:
    """Return the sensor's gain as a step, K."""
    return BoundStep("K", rig.dn_per_e, "DN/e", "gain of the sensor")


@dataclass(frozen=True)
class Bound:
    """A bound on the change of the readings if the effect is left out, or sampled no finer.

    It limits the effect's change of a pixel's reading before photons are counted and readings are rounded (for a noise:
    the deviations that it adds).

    Masks may leave light in few pixels. So if the change depends on the light, the bound holds for each exposure of
    each device, with a probability of at most 1e-7 that one exceeds it. If a noise is alike in all pixels, the bound is
    its standard deviation; the rms of one exposure over n independent values scatters by 1 / sqrt(2 n) of that.

    Args:
        rms_dn: Root mean square over the pixels, DN, at least 0. Infinite: it cannot be left out.
        peak_dn: Largest over the pixels, DN; for a noise, six standard deviations of the noisiest pixel.
        random: Whether it consists of deviations with mean zero that are independent of all others: these add in
            quadrature.
        steps: The derivation of `rms_dn`; its own step is the last.
    """

    rms_dn: float
    peak_dn: float
    random: bool = False
    steps: tuple[BoundStep, ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        if not (self.rms_dn >= 0 and self.peak_dn >= 0):
            raise InputError(f"bound of {self.rms_dn} DN rms, {self.peak_dn} DN peak", allowed="0 or more, or infinite")

    def after(self, *steps: BoundStep) -> "Bound":
        """Return the same bound, with these steps in front of its own."""
        return replace(self, steps=(*steps, *self.steps))

    def by(self, law: str, *steps: BoundStep) -> "Bound":
        """Return the same bound, derived from these steps by a law."""
        return replace(self, steps=(*steps, *self.steps, BoundStep("bound", self.rms_dn, "DN", "rms", law)))


NOTHING = Bound(0.0, 0.0)
UNAVOIDABLE = Bound(math.inf, math.inf)


class ViewPreview(Protocol):
    """The part of a preview that is available to effects which state how they change light, views or motion.

    It contains no charge and no scale of readings, because these follow from the effects' statements.
    """

    @property
    def scene(self) -> "Scene":
        """Get the scene."""

    @property
    def path(self) -> "CameraPath":
        """Get the camera path, before effects."""

    @property
    def masks(self) -> F32:
        """Get the masks as nominally shown, [N, H, W]."""

    @property
    def rig(self) -> RigFigures:
        """Get the figures of the rig."""

    @property
    def intervals_s(self) -> F64:
        """Get start and stop of the mask intervals, [N, 2]."""

    @property
    def shown(self) -> NDArray[Any]:
        """Get the masks with all effects on masks, [N, H, W]."""

    def filtered(self, change: Callable[[F64], F64]) -> tuple[float, float]:
        """Return rms and peak, radiance, of a linear filter's change of a view, by its spectrum on the sensor."""

    @property
    def deviation(self) -> tuple[float, float]:
        """Get limits of the rms and the peak of a view less its mean, radiance, on the sensor or as far beside it."""

    @property
    def spectrum(self) -> "MovingSpectrum":
        """Get the power of a view by the frequency and direction with which its phase changes in a moving image."""

    def shifted(self, shift_px: float) -> tuple[float, float]:
        """Return rms and peak of the change of a view by a shift of up to `shift_px` in any direction."""


class MotionPreview(ViewPreview, Protocol):
    """The part of a preview that is available to effects which state how they change views."""

    def changed(
        self, effect: "Effect", change: "Callable[[View], F64]", shares: Callable[[F64], F64]
    ) -> tuple[float, float]:
        """Return rms and peak, radiance, of what an effect on views changes in one."""


class Previewed(MotionPreview, Protocol):
    """The data on a measurement that bounds may use (`gs2ci_sims.preview.Preview` explains each)."""

    def view_change(self, effect: "ViewChange") -> tuple[float, float]:
        """Return rms and peak, radiance, of what an effect changes in a view."""

    @property
    def most_open(self) -> NDArray[Any]:
        """Get the maximum of the nominal masks and those shown, [N, H, W]."""

    @property
    def full_scale_dn(self) -> float:
        """Get the reading above black of radiance 1 through one open mask, with all light that effects may add."""

    @property
    def motion_px(self) -> F64:
        """Get the largest motion in the image within each mask interval, [N] pixels."""

    @property
    def object_px_per_s(self) -> float:
        """Get the largest speed in the image of objects that move by themselves."""

    @property
    def charge_e(self) -> F64:
        """Get the charge of each pixel under the previewed views, [H, W, C] electrons."""

    @property
    def charge_error_e(self) -> float:
        """Get a bound on the rms difference of the charge from `charge_e` over the pixels."""

    @property
    def most_e(self) -> F64:
        """Get the charge that no pixel exceeds, [H, W, 1] electrons."""

    @property
    def charge_rms_e(self) -> float:
        """Get a bound on the rms of the charge over the pixels."""

    @property
    def light_rms_e(self) -> float:
        """Get a bound on the rms of the charge, wherever an effect may move the light before it is recorded."""

    @property
    def charge_mean_e(self) -> float:
        """Get a bound on the mean of the charge over the pixels."""

    @property
    def added_e(self) -> tuple[float, float]:
        """Get the charge that is added in the dark, its mean over the pixels and its largest value."""

    @property
    def lowered_dn(self) -> float:
        """Get by how much readings may be below the data sheet's black level, DN."""

    def gain_after(self, effect: "Effect") -> float:
        """Return by how much the effects after this one may enlarge a change, at least 1."""

    def excess_e(self, effect: "Effect", capacity_e: float) -> tuple[float, float, float]:
        """Bound the pixels' charge beyond a capacity at an effect: mean, rms and peak over the pixels, electrons."""

    def of_views(self, rms: float | F64, peak: float) -> Bound:
        """Bound the readings by fields of this rms (of each, [N], or of all) and peak, radiance, behind the masks."""

    def of_masks(self, effect: "Effect", change: NDArray[Any], most: NDArray[Any] | None = None) -> Bound:
        """Bound the change of the readings by a change of the masks, [N, H, W]."""

    def of_mask_effect(self, effect: "Effect") -> Bound:
        """Bound the change by an effect on masks, applied to the masks that reach it."""

    def of_photon_effect(self, effect: "Effect", most: float) -> Bound:
        """Bound the change by a linear effect on the photons: at most the share `most` of its input, rms."""

    def of_shares(self, effect: "Effect", mean: F64, swing: F64, most: float, intervals_s: F64 | None = None) -> Bound:
        """Bound the change of the readings if the light behind each mask changes by a share, [N]."""


def enlarging_step(scene: Previewed, effect: "Effect") -> BoundStep:
    """Return by how much the effects after this one may enlarge its change, as a step, A."""
    return BoundStep("A", scene.gain_after(effect), "", "by how much the effects after it may enlarge a change")


def of_charge(
    scene: Previewed, effect: "Effect", rms_e: float, peak_e: float, law: str, *steps: BoundStep, random: bool = False
) -> Bound:
    """Bound the readings by a change of the charge, electrons, derived from these steps by a law in them, A and K."""
    dn = scene.rig.dn_per_e * scene.gain_after(effect)
    steps = (*steps, enlarging_step(scene, effect), gain_step(scene.rig))
    return Bound(dn * rms_e, dn * peak_e, random).by(law, *steps)


class EffectRecord(BoundedRecord):
    """Base of effects: bounded parameters, a name, and a bound where an effect states none: it cannot be left out.

    The name is the class's in lower case with underscores, `dark_current` for `DarkCurrent`, unless it states another.
    """

    name: ClassVar[str]
    stage: ClassVar[LightStage]
    cost_ns: ClassVar[float]
    fixed_pattern: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "name" not in vars(cls):
            cls.name = to_snake(cls.__name__)

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Return that nothing is known of what leaving the effect out would change: every plan simulates it."""
        return UNAVOIDABLE.by("inf")


class Effect(Protocol):
    """One physical effect.

    `cost_ns` is its approximate time per pixel of its stage's signal (of each view at RADIANCE, of each mask at MASKS),
    in nanoseconds on one core; the planner compares it with the bound.
    `fixed_pattern` effects draw from the device's generator: the same pattern in every exposure of one device.
    """

    name: ClassVar[str]
    stage: ClassVar[LightStage]
    cost_ns: ClassVar[float]
    fixed_pattern: ClassVar[bool]

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Return an upper bound on the change if the effect is left out. Cheap: nothing is rendered."""

    def apply(self, signal: Any, rig: RigFigures, rng: Rng) -> Any:
        """Return the signal with the effect; never changes its argument. `rng` belongs to this effect alone."""


@runtime_checkable
class KernelEffect(Effect, Protocol):
    """An effect that is a convolution, whose kernel's size is chosen by the planner.

    Such an effect has a field `reach`: where the kernel is truncated, in its standard deviations.
    """

    @property
    def reach(self) -> float:
        """Get where the kernel is truncated now, in standard deviations."""

    def kernel_bound(self, scene: Previewed, rig: RigFigures, reach: float) -> Bound:
        """Return an upper bound on the difference between the full kernel and one of this reach."""


@runtime_checkable
class Brightening(Effect, Protocol):
    """An effect that may make a pixel collect more light than the nominal light path does."""

    def brightest(self, scene: ViewPreview) -> float:
        """Return the largest factor; one below 1 counts as 1."""


@runtime_checkable
class Charging(Effect, Protocol):
    """An effect that fills pixels in the dark."""

    def added_e(self, rig: RigFigures, size: tuple[int, int]) -> tuple[float, float]:
        """Return an upper bound on the electrons added, in the mean over the pixels and in the fullest one."""


@runtime_checkable
class Lowering(Effect, Protocol):
    """An effect that may take a reading below the data sheet's black level."""

    def lowered_dn(self, rig: RigFigures) -> float:
        """Return by how much at most, DN; for a noise, six standard deviations."""


@runtime_checkable
class Modulating(Effect, Protocol):
    """An effect that changes the light of some masks more than that of others."""

    def modulation(self, scene: ViewPreview) -> float:
        """Return the largest share of a mask's light that it removes, adds, or shifts to another time, summed.

        Light that passes another mask than its own counts twice: it is missing at one mask and added at the other.
        """


@runtime_checkable
class Moving(Effect, Protocol):
    """An effect that moves parts of the scene."""

    def image_px_per_s(self, scene: ViewPreview) -> float:
        """Return their largest speed in the image."""


@runtime_checkable
class ViewChange(Effect, Protocol):
    """An effect on views that moves light to other pixels; an effect that only dims views is not one."""

    def view_change(self, scene: MotionPreview) -> tuple[float, float]:
        """Return rms and peak, radiance, of its change of a view."""


@runtime_checkable
class ViewEffect(Effect, Protocol):
    """An effect on views that needs pixels beyond the sensor's border, or depth."""

    needs_depth: ClassVar[bool]

    def margin_px(self, rig: RigFigures, size: tuple[int, int], intrinsics: F64) -> int:
        """Return how many pixels beyond the border of an image of this size the effect needs."""


_Kind = TypeVar("_Kind")
_answers: dict[tuple[type, Any], bool] = {}


def having(effects: Sequence[Effect], kind: Callable[..., _Kind]) -> list[_Kind]:
    """Return those effects that are of one of the kinds above.

    The answer is kept per type: `isinstance` takes 20 us for a protocol, and a plan asks two hundred times. For mypy a
    protocol is no type but something that would return one.
    """
    protocol: Any = kind
    for effect in effects:
        if (type(effect), kind) not in _answers:
            _answers[type(effect), kind] = isinstance(effect, protocol)
    wanted: list[Any] = [effect for effect in effects if _answers[type(effect), kind]]
    return wanted
