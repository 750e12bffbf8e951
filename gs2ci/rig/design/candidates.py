"""The captures that may be taken on a bench, and which of them its devices can take.

Here: what is varied, the capture that each candidate is, its limits and its time. The bench's devices are asked by
their twins, so that nothing needs to be connected. Not here: what a candidate tells of a scene (`telling`).
"""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Final

from gs2ci.core.config import SIMULATED
from gs2ci.core.durations import spoken_duration
from gs2ci.core.errors import InputError
from gs2ci.rig.config import CaptureTable, RigTable, WorldTable
from gs2ci.rig.design.exposing import full_size
from gs2ci.rig.intent import intended
from gs2ci.rig.opening import Rig
from gs2ci.rig.simulated import build_bench
from gs2ci_drivers.acquisition import Devices
from gs2ci_drivers.failures import DriverError
from gs2ci_drivers.plan import CapturePlan, CaptureSettings, Travel
from gs2ci_drivers.planning import lay_out, sensor_exposure_s
from gs2ci_drivers.sensor import SensorSettings
from gs2ci_sims.world import Darkness

DENSITIES: Final = (0.125, 0.25, 0.5)
ELEMENTS: Final = (1, 2)
EXPOSURES: Final = (1, 2, 4)
MOST: Final = 1000
MOST_MASKS: Final = 1024
# `gs2ci doctor` settles these on the bench itself, whatever the capture.
_SETTLED_ON_THE_BENCH: Final = ("trigger pulses", "unit of exposure")


@dataclass(frozen=True)
class CaptureCandidate:
    """One capture that may be taken.

    Args:
        masks: Masks of an exposure.
        density: Their open share.
        element: Sensor pixels per side of their elements.
        travel_mm: How far the camera goes during an exposure.
        exposures: How many of the same path, each beginning with another mask.
    """

    masks: int
    density: float
    element: int
    travel_mm: float
    exposures: int

    def __str__(self) -> str:
        """Return it in words."""
        many = "exposure" if self.exposures == 1 else "exposures"
        return (
            f"{self.exposures} {many} of {self.masks} masks, {self.density:g} open, elements of {self.element} px, "
            f"{self.travel_mm:g} mm"
        )

    def capture(self, own: CaptureTable) -> CaptureTable:
        """Return the [capture] of one of its exposures, which takes as long as one of the rig file's own.

        Raises:
            InputError: No time is left for a mask.
        """
        mask_s = own.masks * (own.mask_s + own.dark_s) / self.masks - own.dark_s
        if mask_s <= 0:
            raise InputError(
                f"{self.masks} masks in the rig file's exposure with dark_s = {own.dark_s:g} between them",
                allowed="fewer masks, or a longer exposure in [capture]",
            )
        forth = -1 if own.to_mm < own.from_mm else 1
        middle_mm = (own.from_mm + own.to_mm) / 2
        return own.model_copy(
            update={
                "masks": self.masks,
                "density": self.density,
                "element": self.element,
                "mask_s": round(mask_s, 9),
                "from_mm": round(middle_mm - forth * self.travel_mm / 2, 6),
                "to_mm": round(middle_mm + forth * self.travel_mm / 2, 6),
                "shots": 1,
                "burst": 1,
                "turn_masks": self.exposures > 1 or own.turn_masks,
            }
        )


@dataclass(frozen=True)
class Varied:
    """What is varied, each with each; an empty part takes values about the rig file's own.

    Args:
        masks: Masks of an exposure.
        open_shares: Open shares of the masks.
        elements: Sensor pixels per side of their elements.
        travels_mm: Travels of the camera during an exposure.
        exposures: Numbers of exposures.
    """

    masks: Sequence[int] = ()
    open_shares: Sequence[float] = ()
    elements: Sequence[int] = ()
    travels_mm: Sequence[float] = ()
    exposures: Sequence[int] = ()

    def candidates(self, table: RigTable) -> list[CaptureCandidate]:
        """Return the candidates for a bench.

        Raises:
            InputError: A value cannot be one, the rig file's capture is of another kind, or they are too many.
        """
        own = _random(table)
        own_mm = round(abs(own.to_mm - own.from_mm), 6) if own.axis else 0.0
        if any(travel > 0 for travel in self.travels_mm) and not own.axis:
            raise InputError(
                f"a travel of {max(self.travels_mm):g} mm on a bench whose [capture] names no axis",
                remedy="set axis, from_mm and to_mm in [capture], or leave --travel-mm out",
            )
        masks = tuple(self.masks) or tuple(sorted({max(own.masks // 2, 1), own.masks, 2 * own.masks}))
        travels = tuple(self.travels_mm) or ((own_mm / 2, own_mm, 2 * own_mm) if own_mm else (0.0,))
        lists = (
            _checked("--masks", masks, 1, MOST_MASKS),
            _checked("--open-share", tuple(self.open_shares) or DENSITIES, 1e-3, 1.0),
            _checked("--element", tuple(self.elements) or ELEMENTS, 1, 64),
            _checked("--travel-mm", travels, 0.0, 1e4),
            _checked("--exposures", tuple(self.exposures) or EXPOSURES, 1, 64),
        )
        found = [CaptureCandidate(int(n), float(d), int(e), float(t), int(k)) for n, d, e, t, k in product(*lists)]
        if len(found) > MOST:
            raise InputError(f"{len(found)} candidates", allowed=f"at most {MOST}", remedy="give fewer values to vary")
        return found


def _checked(option: str, values: Sequence[float], least: float, most: float) -> Sequence[float]:
    for value in values:
        if not least <= value <= most:
            raise InputError(f"{option} {value:g}", allowed=f"{least:g} to {most:g}")
    return list(dict.fromkeys(values))


def _random(table: RigTable) -> CaptureTable:
    """Return the [capture], whose masks can be varied.

    Raises:
        InputError: They cannot.
    """
    own = table.capture
    if own.pattern_file:
        raise InputError(
            f"pattern_file = {own.pattern_file!r} in [capture]",
            allowed="random masks, whose number, open share and elements can be varied",
            remedy="take pattern_file out of a copy of the rig file",
        )
    if own.mode == "per-mask" or own.continuous:
        kind = "continuous = true" if own.continuous else f"mode = {own.mode!r}"
        raise InputError(
            f"{kind} in [capture]",
            allowed="coded exposures that are taken one after another",
            remedy="change [capture]",
        )
    return own


@dataclass(frozen=True)
class Possible:
    """A candidate that the bench can take.

    Args:
        candidate: It.
        capture: The [capture] of one of its exposures, with times that the modulator keeps.
        capture_s: What all its exposures take on the bench: uploads, sweeps there and back, masks.
    """

    candidate: CaptureCandidate
    capture: CaptureTable
    capture_s: float


@dataclass(frozen=True)
class NotTried:
    """A candidate that is not tried.

    Args:
        candidate: It.
        reason: Why, as a sentence without a full stop.
    """

    candidate: CaptureCandidate
    reason: str


class Asked:
    """The twins of a bench's devices, which are asked what they can do.

    Args:
        table: The rig file.
        longest_s: The longest time of capture; None: any.

    Raises:
        InputError: A device has no twin, or the rig file of a real bench states no size of the picture.
    """

    def __init__(self, table: RigTable, longest_s: float | None = None) -> None:
        self._longest_s = longest_s
        self._table = _all_simulated(table)
        self._rig = Rig(self._table, "", Path(), build_bench(self._table, Darkness()))
        # Of one number of masks, since masks on the modulator's pixels take megabytes each.
        self._drawn: dict[float, tuple[CaptureSettings, SensorSettings]] = {}
        self._plans: dict[tuple[float, float], CapturePlan] = {}
        self._upload_s: dict[int, tuple[float, float]] = {}
        self._number = 0

    def of(self, candidates: Sequence[CaptureCandidate]) -> Iterator[Possible | NotTried]:
        """Ask of each candidate whether the bench can take it, and how long that takes."""
        with closing(self._rig.open()) as devices:
            for candidate in candidates:
                try:
                    yield self._asked(devices, candidate)
                except (InputError, DriverError) as error:
                    yield NotTried(candidate, error.problem)

    def _asked(self, devices: Devices, candidate: CaptureCandidate) -> Possible | NotTried:
        info = devices.modulator.connect()
        capture = candidate.capture(self._table.capture)
        most = info.capacity.get(capture.bit_depth)
        if most is not None and capture.masks > most:  # not even drawn: they may take gigabytes
            return NotTried(candidate, f"{capture.masks} masks, of which the modulator holds {most}")
        if max(full_size(self._table)) < candidate.element:
            return NotTried(candidate, f"elements of {candidate.element} px are larger than the picture")
        capture = capture.model_copy(update={"mask_s": round(info.quantise_s(capture.mask_s), 9)})
        plan = self._plan(devices, candidate, capture)
        broken = [figure for figure in plan.broken if figure.what not in _SETTLED_ON_THE_BENCH]
        if broken:
            return NotTried(candidate, "; ".join(f"{one.what}: {one.value}, allowed: {one.limit}" for one in broken))
        if candidate.masks not in self._upload_s:
            modulator = devices.modulator
            self._upload_s[candidate.masks] = modulator.upload_eta_s(plan.sequence), modulator.turn_eta_s(plan.sequence)
        upload_s, turn_s = self._upload_s[candidate.masks]
        seconds = upload_s + (candidate.exposures - 1) * turn_s + candidate.exposures * _seconds(plan)
        if self._longest_s is not None and seconds > self._longest_s:
            return NotTried(candidate, f"more than {spoken_duration(self._longest_s)} of capture")
        return Possible(candidate, capture, seconds)

    def _plan(self, devices: Devices, candidate: CaptureCandidate, capture: CaptureTable) -> CapturePlan:
        """Lay one exposure out; elements and further exposures make no difference to any limit."""
        if candidate.masks != self._number:
            self._drawn, self._plans, self._number = {}, {}, candidate.masks
        settings, setup = self._settings(devices, candidate, capture)
        key = candidate.density, candidate.travel_mm
        if key not in self._plans:
            moves = candidate.travel_mm > 0
            travel = Travel(capture.axis, capture.from_mm, capture.to_mm) if moves else None
            stage = None if devices.stage is None else devices.stage.connect()
            plan = lay_out(
                replace(settings, travel=travel), devices.modulator.connect(), devices.sensor.connect(), setup, stage
            )
            self._plans[key] = plan
        return self._plans[key]

    def _settings(
        self, devices: Devices, candidate: CaptureCandidate, capture: CaptureTable
    ) -> tuple[CaptureSettings, SensorSettings]:
        """Draw masks of an open share, and set the sensor up for them."""
        if candidate.density not in self._drawn:
            self._rig.table = self._table.model_copy(update={"capture": capture.model_copy(update={"element": 1})})
            _, settings, config = intended(self._rig, devices)
            needed_s = sensor_exposure_s(settings.rounded_for(devices.modulator.connect()))
            info = devices.sensor.prepare()
            exposure_s = min(max(needed_s, info.min_exposure_s), info.max_exposure_s)
            setup = devices.sensor.configure(replace(config, exposure_s=exposure_s, trigger=settings.trigger_mode))
            self._drawn[candidate.density] = settings, setup
        return self._drawn[candidate.density]


def _seconds(plan: CapturePlan) -> float:
    """Return how long one exposure takes on the bench without its upload: masks, and the sweep there and back."""
    sweep = plan.sweep
    return max(plan.sequence.period_s, 0.0 if sweep is None else 2 * (sweep.cruise_s + 2 * sweep.lead_s))


def _all_simulated(table: RigTable) -> RigTable:
    """Return a rig whose devices are twins.

    Raises:
        InputError: The rig file of a real bench states no size of the picture.
    """
    ports = {
        name: device.model_copy(update={"port": SIMULATED})
        for name in ("modulator", "sensor", "stage")
        if (device := getattr(table, name)) is not None
    }
    if table.world is not None:
        return table.model_copy(update=ports)
    height, width = full_size(table)
    return table.model_copy(update={**ports, "world": WorldTable(height=height, width=width)})
