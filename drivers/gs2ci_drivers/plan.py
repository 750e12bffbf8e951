"""The records of a capture's plan: the requested settings and the timeline, line by line. Nothing moves here.

Not here: laying a plan out and checking it (`gs2ci_drivers.planning`), doing it (`gs2ci_drivers.acquisition`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from math import ceil, gcd, sqrt
from typing import Final

from gs2ci.core.arrays import F64, U8, U16
from gs2ci_drivers.axis import Sweep
from gs2ci_drivers.failures import PlanRefusedError
from gs2ci_drivers.pattern_sequence import ModulatorInfo, PatternSequence, TriggerOut
from gs2ci_drivers.sensor import TriggerMode

_GOLDEN: Final = (3 - sqrt(5)) / 2


class Mode(Enum):
    """How modulator and sensor are synchronised (reference section 5)."""

    PER_EXPOSURE = "per-exposure"
    """A: the modulator is master; one edge begins one exposure, which spans all masks."""
    GATE = "gate"
    """B: the modulator holds a level while masks are on show; the sensor exposes as long as it is held."""
    PER_MASK = "per-mask"
    """C: one edge and one frame per mask, for calibration."""


@dataclass(frozen=True)
class Travel:
    """Where the camera goes during one exposure.

    Args:
        axis: The stage's axis.
        from_mm: Where it is when the first mask appears, at the latest.
        to_mm: Where it is when the last mask ends, about.
    """

    axis: str
    from_mm: float
    to_mm: float


@dataclass(frozen=True)
class KnownOptics:
    """What is known about light and scene, for the plan's figures; any field may be missing.

    Args:
        full_scale_e_per_s: Electrons per second in a pixel that sees a white scene through an open mask.
        focal_px: Focal length in pixels.
        nearest_mm: Distance of the nearest object.
        farthest_mm: Distance of the farthest object; None is infinity.
    """

    full_scale_e_per_s: float | None = None
    focal_px: float | None = None
    nearest_mm: float | None = None
    farthest_mm: float | None = None


@dataclass(frozen=True)
class CaptureSettings:
    """What the user wants.

    Args:
        masks: Patterns on the modulator's own pixels, [N, Hm, Wm] uint8 or uint16.
        bit_depth: Bits of each pattern.
        mask_s: How long each mask is shown.
        dark_s: Dark time between masks.
        mode: How modulator and sensor are synchronised.
        shots: How many coded exposures.
        burst: How many of them in one sweep or one start of the modulator.
        travel: The camera's motion, or None for a camera at rest.
        margin_s: By how much the exposure ends before the last mask does.
        jitter_s: The latest start of an exposure after its edge that the plan allows for.
        late_s: Measured delay from an edge to the start of its exposure, a configured delay included; None if not
            measured.
        longer_s: Measured excess of an exposure over the configured one; None if not measured.
        retries: How often a shot is repeated after lost, late, corrupt or stale frames.
        optics: What is known about light and scene.
        continuous: Whether all shots are taken in one run of the modulator, one after another; lost ones are named and
            skipped.
        ring: How many shots may wait for a busy disk, for the plan's figures.
        gated: Whether the sensor exposes as long as its line is held also in `Mode.PER_MASK`; `plan_capture` sets it
            for a sensor that has no other mode.
        measured: Whether the light of each mask was measured with these times, and not only drawn.
        turned: Whether each start of the modulator begins with another mask, the order staying the same.
    """

    masks: U8 | U16
    bit_depth: int = 1
    mask_s: float = 0.01
    dark_s: float = 0.0
    mode: Mode = Mode.PER_EXPOSURE
    shots: int = 1
    burst: int = 1
    travel: Travel | None = None
    margin_s: float = 0.0
    jitter_s: float = 20e-6
    late_s: float | None = None
    longer_s: float = 0.0
    retries: int = 0
    optics: KnownOptics = field(default_factory=KnownOptics)
    gated: bool = False
    continuous: bool = False
    ring: int = 0
    measured: bool = False
    turned: bool = False

    def rounded_for(self, modulator: ModulatorInfo) -> "CaptureSettings":
        """Return the settings with the times for which the modulator will show masks and darkness between them."""
        mask_s, dark_s = modulator.quantise_s(self.mask_s), modulator.quantise_s(self.dark_s)
        return replace(self, mask_s=mask_s, dark_s=dark_s)

    def begin_s(self, modulator_delay_s: float, sensor_delay_s: float) -> float:
        """Return when an exposure begins, from the appearance of its first mask: as measured, otherwise as configured.

        Args:
            modulator_delay_s: From a mask's appearance to its edge.
            sensor_delay_s: From an edge to the start of the exposure, as configured or as known.
        """
        return modulator_delay_s + (sensor_delay_s + self.jitter_s / 2 if self.late_s is None else self.late_s)

    @property
    def trigger_out(self) -> TriggerOut:
        """Get the mode that the modulator's trigger output needs."""
        if self.mode is Mode.PER_MASK:
            return TriggerOut.GATE_PER_MASK if self.gated else TriggerOut.PER_MASK
        return TriggerOut.GATE if self.mode is Mode.GATE else TriggerOut.PER_EXPOSURE

    @property
    def trigger_mode(self) -> TriggerMode:
        """Get the trigger mode that the sensor needs."""
        return TriggerMode.LEVEL if self.gated or self.mode is Mode.GATE else TriggerMode.EDGE


@dataclass(frozen=True)
class Figure:
    """One line of the plan.

    Args:
        what: What it is about.
        value: Its value in words.
        limit: What is allowed, "" if nothing limits it.
        broken: Whether it is beyond the limit.
        remedy: What to do when it is.
    """

    what: str
    value: str
    limit: str = ""
    broken: bool = False
    remedy: str = ""

    def sentence(self) -> str:
        """Return the line as one sentence for an error."""
        parts = [f"{self.what} is {self.value}"]
        if self.limit:
            parts.append(f"allowed: {self.limit}")
        if self.remedy:
            parts.append(f"what to do: {self.remedy}")
        return ", ".join(parts)


@dataclass(frozen=True)
class CapturePlan:
    """A capture laid out.

    Args:
        settings: What the user wants, its times rounded as the modulator rounds them.
        sequence: What the modulator will be given and will keep as it is.
        exposure_s: Exposure of each frame.
        frames_per_shot: 1, or the number of masks in `Mode.PER_MASK`.
        weights: Share of its interval during which each mask is exposed, [N].
        sweep: The stage's sweep for one burst, or None.
        figures: All that was computed and checked.
    """

    settings: CaptureSettings
    sequence: PatternSequence
    exposure_s: float
    frames_per_shot: int
    weights: F64
    sweep: Sweep | None
    figures: tuple[Figure, ...]

    def _repr_html_(self) -> str:
        from gs2ci.core.notebook import sheet  # noqa: PLC0415  laid out only when shown

        title = f"plan of {self.settings.shots} shot{'s' if self.settings.shots > 1 else ''}"
        return sheet(title, ("plan", "value", "allowed", ""), table(self))

    @property
    def broken(self) -> tuple[Figure, ...]:
        """Get the lines whose limit is exceeded."""
        return tuple(figure for figure in self.figures if figure.broken)

    @property
    def fires(self) -> int:
        """Get how often the modulator is started."""
        return ceil(self.settings.shots / self.settings.burst)

    def first_mask(self, fire: int) -> int:
        """Return the mask with which a start of the modulator begins, from 0."""
        return first_mask(fire, self.sequence.count) if self.turns else 0

    @property
    def turns(self) -> bool:
        """Get whether starts of the modulator begin with different masks."""
        asked = self.settings
        several = asked.shots > asked.burst > 0 and self.sequence.count > 1
        return asked.turned and several and asked.mode is not Mode.PER_MASK

    @property
    def frame_period_s(self) -> float:
        """Get the time between two triggers of one fire."""
        if self.settings.mode is Mode.PER_MASK:
            return self.sequence.exposure_s + self.sequence.dark_s
        return self.sequence.period_s

    def require_sound(self) -> "CapturePlan":
        """Return self if no limit is exceeded.

        Raises:
            PlanRefusedError: Names every exceeded limit.
        """
        if self.broken:
            raise PlanRefusedError([figure.sentence() for figure in self.broken])
        return self


def table(plan: CapturePlan) -> Sequence[tuple[str, str, str, str]]:
    """Return the plan as rows of text: what, value, limit, verdict."""
    return [
        (figure.what, figure.value, figure.limit, "" if not figure.limit else "NO" if figure.broken else "ok")
        for figure in plan.figures
    ]


def with_upload(plan: CapturePlan, upload_s: float, turn_s: float) -> CapturePlan:
    """Return the plan with the upload's estimate as a further line, and with that of beginning with another mask."""
    then = f", and {turn_s:.1f} s to begin with another mask" if plan.turns else ""
    return replace(plan, figures=(*plan.figures, Figure("upload", f"about {upload_s:.1f} s{then}")))


def first_mask(start: int, count: int) -> int:
    """Return the mask with which a start of the modulator begins if each begins with another one, from 0.

    Over as many starts as masks each mask is shown once in each interval, and over fewer the same mask in intervals
    that lie far apart: neighbouring views are alike, so that a code displaced by one interval tells less. So each
    start goes on by a number without a common divisor with that of the masks, the one nearest to their golden section.
    """
    steps = (step for step in range(1, count) if gcd(step, count) == 1)
    return start * min(steps, key=lambda step: abs(step - _GOLDEN * count), default=0) % count
