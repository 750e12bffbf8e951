"""Registration: masks and readings are corrected from the measurement itself, before any other stage.

    clipping ─► unit of reading ─► orientation, coarse shift ─► tiles ─► Gauss-Newton ─► which parameters? ─► sharpening
    ─► short decodes judge ─► unit, open level ─► rim ─► which mask was first?

Here: the order of these steps, and the record of what was tried, found and corrected. Not here: any of the steps.
"""

from dataclasses import dataclass, field, replace
from typing import Annotated, Final

import numpy as np
from pydantic import Field

from gs2ci.core.arrays import Bool, rms_of
from gs2ci.core.bounds import Bounded
from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code, Finding, Findings, finding
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.records import Shot
from gs2ci.core.run_figures import PlacementSection, RegistrationSection
from gs2ci.reconstruct.choices import RegistrationMode
from gs2ci.reconstruct.measurement.coding import white_reading
from gs2ci.reconstruct.registration.coarse import (
    ORIENTATIONS,
    SURE_PEAK,
    Peak,
    element_px,
    find_peak,
    fine_pattern,
    is_flat,
    readable,
)
from gs2ci.reconstruct.registration.fine import MisfitEstimate
from gs2ci.reconstruct.registration.light import find_unit, open_level, untold_clipping
from gs2ci.reconstruct.registration.local_scene import Seen
from gs2ci.reconstruct.registration.misfit import Misfit
from gs2ci.reconstruct.registration.parameters import AFFINE, GEOMETRY
from gs2ci.reconstruct.registration.placement import Placement
from gs2ci.reconstruct.registration.proposals import bent_growth, bent_px, propose
from gs2ci.reconstruct.registration.sequence import LEAST_VIEWS, find_beginning
from gs2ci.reconstruct.registration.sharpen import sources
from gs2ci.reconstruct.registration.ways import brief_views, chosen, from_source, level_of, way_of

# Masks blurred by less than this are recovered by filtering.
_TOO_SOFT_PX2: Final = 0.7
_LEAST_SIDE_PX: Final = 8
# Wrong masks of a few hundred elements reach a sure peak at times. Below twice of it, turned masks are compared too.
_BEYOND_DOUBT: Final = 2 * SURE_PEAK
# A negative mean beyond this share of the root mean square is no noise: light of the wrong sign reaches 0.8 to 1.
_MOST_NEGATIVE: Final = 0.5
# Readings that fall with the open masks are correlated with these by less than minus this: by chance, in pictures of
# 1,500 pixels, it is four standard deviations. Light of the wrong sign reaches −0.5 to −0.9.
_MOST_ALIKE: Final = 0.1
# A picture with fewer elements of the pattern looks like itself turned too often.
_LEAST_ELEMENTS: Final = 36


@dataclass(frozen=True)
class RegistrationSettings(Bounded):
    """Whether masks are registered, and the range of the search.

    Args:
        mode: "auto" corrects what the measurement surely shows; "off" uses masks and readings as stated.
        most_shift_px: Largest shift that is searched for.
        restores: Whether open and closed elements that are stated soft, or crisp with noise, are restored (`sharpen`).
    """

    mode: RegistrationMode = "auto"
    most_shift_px: Annotated[int, Field(ge=0, le=1024)] = 64
    restores: bool = True


@dataclass(frozen=True)
class Registered:
    """A measurement with its corrected masks, and all estimates.

    Args:
        shot: The measurement with masks, readings and clipped pixels corrected.
        misfit: The errors of the masks; its defaults if there were none.
        errors: Standard errors of the accepted parameters, by name.
        orientation: How the masks had to be turned.
        unit: Divisor of the readings, applied after the black level was subtracted.
        open_level: Divisor of the masks.
        clipped_share: Share of the pixels that were found clipped but not marked so.
        peak: The peak of the coarse correlation.
        first_mask: Index, from 0, in the given list, of the mask that was displayed first.
        tried: Value and standard error of the parameters that were not accepted, by name.
        averaged: The pixels whose readings are averages over their neighbours, since no mask is known there, [H, W];
            None if there are none. They cannot judge views.
        notes: For the user.
    """

    shot: Shot
    misfit: Misfit = field(default_factory=Misfit)
    errors: dict[str, float] = field(default_factory=dict)
    orientation: str = "as given"
    unit: float = 1.0
    open_level: float = 1.0
    clipped_share: float = 0.0
    peak: Peak = field(default_factory=Peak)
    first_mask: int = 0
    tried: dict[str, tuple[float, float]] = field(default_factory=dict)
    averaged: Bool | None = None
    notes: Findings = ()

    @property
    def is_changed(self) -> bool:
        """Get whether anything was corrected."""
        return bool(self.notes)

    def summary(self) -> RegistrationSection:
        """Return the figures for the report."""
        corners = np.linalg.norm(self.misfit.displacement_px(self.shot.size), axis=1)
        return RegistrationSection(
            changed=self.is_changed,
            orientation=self.orientation,
            peak_ratio=self.peak.ratio,
            placement=PlacementSection(**{name: getattr(self.misfit, name) for name in GEOMETRY}),
            largest_displacement_px=float(corners.max()),
            bent_px=bent_px(self.misfit, self.shot.size),
            blur_sigma_px=self.misfit.blur_sigma_px,
            blur_px2=self.misfit.blur_px2,
            leak=self.misfit.leak,
            widening_px=self.misfit.widening_px,
            black=self.misfit.black,
            unit=self.unit,
            open_level=self.open_level,
            clipped_share=self.clipped_share,
            first_mask=self.first_mask,
            standard_errors=dict(self.errors),
            not_let_in={name: list(pair) for name, pair in self.tried.items()},
        )


def register(
    shot: Shot, settings: RegistrationSettings | None = None, progress: Progress | None = None, seed: int = 0
) -> Registered:
    """Estimate the errors of masks and readings, and correct those that the measurement surely shows.

    Args:
        shot: A checked measurement, masks and readings as stated; its truth is not read.
        settings: Whether, and the range of the search.
        progress: Receives the stage and every sentence.
        seed: Of the held-out pixels.

    Returns:
        The corrected measurement; the same shot object if nothing is corrected.

    Raises:
        InputError: The settings make no sense, the shot is the frame of a single mask, or its light has the wrong sign.
    """
    settings, progress = (settings or RegistrationSettings()).check(), progress or Silent()
    _check_coded(shot)
    _check_positive(shot)
    if settings.mode == "off":
        return Registered(shot)
    progress.stage("registration")
    found = _Registration(shot, settings, seed).run()
    for note in found.notes:
        progress.say(note.advice)
    return found


def _check_coded(shot: Shot) -> None:
    """Refuse a frame that was taken with `mode = "per-mask"`: it is not the sum over the masks beside which it lies.

    Raises:
        InputError: It is such a frame.
    """
    mask = shot.provenance.get("mask_index")
    if mask is not None and shot.views > 1:
        raise InputError(
            f"{shot.name} is the frame of a single mask (mask_index {mask} of {shot.views}), in which nothing is coded",
            allowed='exposures that span all masks: mode = "per-exposure" or "gate" in [capture]',
            remedy="capture again in such a mode",
        )


def _check_positive(shot: Shot) -> None:
    """Refuse light of the wrong sign, which every decoder explains by black views.

    Noise around 0 has no such mean, and an offset that was subtracted twice is not larger where more masks are open.

    Raises:
        InputError: The mean of the readings is negative and more than half of their root mean square, and they fall
            where more masks are open.
    """
    readings = shot.measurement.mean(axis=2, dtype=np.float64)[shot.usable]
    if readings.size == 0 or readings.mean() >= -_MOST_NEGATIVE * rms_of(readings):
        return
    opened = white_reading(shot).astype(np.float64)[shot.usable]
    beside, more = readings - readings.mean(), opened - opened.mean()
    if beside @ more < -_MOST_ALIKE * np.sqrt((beside @ beside) * (more @ more)):
        raise InputError(
            f"the readings of {shot.name} are negative, {readings.mean():.3g} on average, and the more so where more "
            "masks are open",
            allowed="sums of light, which are positive but for noise",
            remedy="turn their sign, or subtract a dark frame that is not brighter than the exposure",
        )


class _Registration:
    """One registration in progress."""

    def __init__(self, shot: Shot, settings: RegistrationSettings, seed: int) -> None:
        self.given = self.shot = shot
        self.settings = settings
        self.seed = seed
        self.averaged: Bool | None = None
        self.notes: list[Finding] = []

    def run(self) -> Registered:
        """Do all steps."""
        clipped = self._clipping()
        opened = self._open_level()
        peak, orientation = self._orientation()
        misfit, errors, tried = self._geometry_and_light(peak)
        unit = self._unit(misfit, peak)
        first = self._beginning(misfit, peak)
        return Registered(
            shot=self.shot,
            misfit=misfit,
            errors=errors,
            orientation=orientation,
            unit=unit,
            open_level=opened,
            clipped_share=clipped,
            peak=peak,
            first_mask=first,
            tried=tried,
            averaged=self.averaged,
            notes=tuple(self.notes),
        )

    def _clipping(self) -> float:
        clipped = untold_clipping(self.shot)
        if clipped is None:
            return 0.0
        share = float(clipped.mean())
        self.shot = replace(self.shot, saturated=clipped)
        self.notes.append(
            finding(Code.UNTOLD_CLIPPING, share=share, reading=float(self.shot.measurement.max())),
        )
        return share

    def _orientation(self) -> tuple[Peak, str]:
        """Find the coarse shift and the orientation of the masks; turn the shot's masks if that is sure.

        Sure is a clear peak whose masks, turned and shifted, also decode better: in small pictures of wide elements a
        wrong orientation correlates by chance.
        """
        total = white_reading(self.shot)
        if is_flat(total) or min(total.shape) < _LEAST_SIDE_PX:
            return Peak(), "as given"
        element = element_px(total)
        seen = readable(self.shot, element)
        # Half the picture must still overlap.
        most_px, (height, width) = self.settings.most_shift_px, total.shape
        reach = min(most_px, height // 2), min(most_px, width // 2)
        peak = find_peak(seen, fine_pattern(total, element), reach, element)
        if peak.ratio >= _BEYOND_DOUBT or total.size < _LEAST_ELEMENTS * element**2:
            return peak, "as given"
        best, how = peak, "as given"
        for name, turn in ORIENTATIONS.items():
            if name == "as given" or turn(total).shape != total.shape:
                continue
            other = find_peak(seen, fine_pattern(np.ascontiguousarray(turn(total)), element), reach, element)
            if other.ratio > best.ratio:
                best, how = other, name
        if how == "as given" or not best.is_sure:
            return peak, "as given"
        masks = np.ascontiguousarray(ORIENTATIONS[how](self.shot.masks.astype(np.float64))).astype(np.float32)
        turned = replace(self.shot, masks=masks)
        moved = MisfitEstimate(Misfit().moved(best.down_px, best.right_px), {})
        if chosen(self.shot, [way_of(turned, moved)], None, self.seed) is None:
            return peak, "as given"
        self.shot = turned
        self.notes.append(finding(Code.MASKS_TURNED, how=how, ratio=best.ratio))
        return best, how

    def _geometry_and_light(self, peak: Peak) -> tuple[Misfit, dict[str, float], dict[str, tuple[float, float]]]:
        """Estimate placement, blur, leak and black level, and correct the shot by what is accepted."""
        bent = bent_growth(self.shot)
        if bent is not None:
            self.notes.append(finding(Code.READINGS_BEND, slope=bent.slope, curvature=bent.curvature))
        proposed, asked = propose(self.shot, peak)
        tried = {name: pair for estimate in (*asked, *proposed) for name, pair in estimate.pairs.items()}
        proposals = [way_of(self.shot, estimate) for estimate in proposed]
        place = Placement(**{name: getattr(asked[0].misfit, name) for name in AFFINE}) if asked else None
        for source in sources(self.shot.masks, place) if peak.is_sure and self.settings.restores else ():
            # The edges of the sharp masks were derived from the soft ones: their width is not estimated again.
            there = peak if source.placement.is_identity else replace(peak, down_px=0.0, right_px=0.0)
            again, _ = propose(replace(self.shot, masks=source.masks), there, edges=False)
            estimates = again or [MisfitEstimate(Misfit(), {})]
            proposals += [from_source(self.shot, estimate, source) for estimate in estimates]
        way = chosen(self.shot, [way for way in proposals if not way.is_bent], None, self.seed)
        way = chosen(self.shot, [way for way in proposals if way.is_bent], way, self.seed)
        if way is None:
            return Misfit(), {}, tried
        self.shot = way.shot
        self.averaged = way.rim.unknown if way.rim.averaged else None
        self.notes += [finding(Code.MASKS_CORRECTED, found=way.found)] if way.found else []
        if way.misfit.blur_px2 <= -_TOO_SOFT_PX2 and way.is_filtered:
            self.notes.append(finding(Code.MASKS_TOO_SOFT, sigma=-way.misfit.blur_sigma_px))
        if "widening_px" in way.errors:
            self.notes.append(finding(Code.MASKS_AS_DRAWN, width=way.misfit.widening_px))
        self.notes += way.rim.notes
        return way.misfit, way.errors, {name: pair for name, pair in tried.items() if name not in way.errors}

    def _beginning(self, misfit: Misfit, peak: Peak) -> int:
        """Find the mask displayed first, and put it first; weights and poses belong to times and keep their order."""
        if self.shot.views < LEAST_VIEWS or not (peak.is_sure or misfit != Misfit()):
            return 0
        found = find_beginning(brief_views(self.shot, level_of(self.shot)))
        if found is None or not found.is_other:
            return 0
        self.shot = replace(self.shot, masks=np.roll(self.shot.masks, -found.first, axis=0))
        self.notes.append(
            finding(Code.MASKS_BEGIN_ELSEWHERE, first=found.first + 1, rank=found.rank, given=found.rank_as_given)
        )
        return found.first

    def _open_level(self) -> float:
        """Find the transmission of a fully open element in the stated masks, and divide the masks by it."""
        opened = open_level(self.shot.masks)
        if opened != 1.0:
            masks = np.minimum(self.shot.masks / np.float32(opened), np.float32(1))
            self.shot = replace(self.shot, masks=masks)
            self.notes.append(finding(Code.MASKS_DIVIDED, opened=float(opened)))
        return opened

    def _unit(self, misfit: Misfit, peak: Peak) -> float:
        """Find the unit, and divide the readings by it."""
        if not peak.is_sure and misfit == Misfit():
            return 1.0
        total = white_reading(self.shot)
        seen = Seen.of(self.shot, element_px(total))
        level = seen.level(total)
        known = (seen.counts > 0) & (total > 0.5 * float(np.median(total)))
        integers = bool(np.all(self.given.measurement == np.rint(self.given.measurement)))
        unit = find_unit(level, known, integers, stated=bool(self.given.provenance.get("unit_stated")))
        if unit is None:
            return 1.0
        self.shot = replace(self.shot, measurement=(self.shot.measurement / unit.factor).astype(np.float32))
        self.notes.append(finding(Code.UNIT_CORRECTED, factor=float(unit.factor), reason=unit.reason))
        return unit.factor
