"""Where the masks are and how they met the light, told by the measurement, before anything else looks at it.

    clipping ─► unit of reading ─► orientation, coarse shift ─► tiles ─► Gauss-Newton ─► which parameters? ─► sharpening
    ─► short decodes judge ─► unit, open level ─► rim ─► which mask was first?

Here: the order of these steps, and the record of what was tried, found and taken. Not here: any of them.
"""

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.records import Shot
from gs2ci.reconstruct.choices import REGISTRATION_MODES, RegistrationMode
from gs2ci.reconstruct.measurement.coding import white_reading
from gs2ci.reconstruct.measurement.jury import surely_larger
from gs2ci.reconstruct.registration.admission import Corner, Trial, brief_views
from gs2ci.reconstruct.registration.coarse import (
    ORIENTATIONS,
    Peak,
    element_px,
    find_peak,
    find_tiles,
    fine_pattern,
    place_tiles,
    reach_of,
)
from gs2ci.reconstruct.registration.field import FieldEstimate, bent_px, find_field
from gs2ci.reconstruct.registration.fine import (
    LEAST_BLOCKS,
    MisfitEstimate,
    Problem,
    refine,
)
from gs2ci.reconstruct.registration.light import Unit, find_unit, open_level, untold_clipping
from gs2ci.reconstruct.registration.local_scene import Seen
from gs2ci.reconstruct.registration.misfit import AFFINE, FIELD, GEOMETRY, LIGHT, NAMES, Misfit, sigma_of
from gs2ci.reconstruct.registration.placement import Placement
from gs2ci.reconstruct.registration.rim import Rim, complete
from gs2ci.reconstruct.registration.sequence import LEAST_VIEWS, find_beginning
from gs2ci.reconstruct.registration.sharpen import Source, binary_source, candidates

# A parameter is let in where it is so many of its standard errors away from «absent», and matters: the rest of the
# model is not exact, and what moves masks by less costs less than 0.05 dB.
SIGNIFICANT: Final = 5.0
# Standard errors of light allow for what the scene leans them by.
_SIGNIFICANT_LIGHT: Final = 4.0
_MATTERS_PX: Final = 0.02
_MATTERS_BLUR_PX2: Final = 0.02
_MATTERS_LEAK: Final = 0.005
_MATTERS_BLACK: Final = 0.01
# A sum of masks that varies by less shows no pattern to find.
_LEAST_PATTERN: Final = 1e-3
# Displacements of tiles are believed where the tiles lie this far from where one shift would put them.
_UNEVEN_PX: Final = 0.7
# Readings that are left out because they are high lean blur, leak and black level; they say as much of places.
_MOST_CLIPPED: Final = 0.01
# Filtering gives masks back that were softer by less.
_TOO_SOFT_PX2: Final = 0.7
_LEAST_SIDE_PX: Final = 8
# Tiles that show a field are smaller than those that show a turn: it smears them more.
_TILE_ELEMENTS: Final = 32
_TILE_REACH: Final = 8
_LOOKED_AT_PX: Final = 256
_GROUPS: Final = (
    ("down_px", "right_px"),
    ("rotation_deg", "scale"),
    ("stretch", "shear"),
    ("blur_px2",),
    ("leak",),
    ("black",),
)


@dataclass(frozen=True)
class RegistrationSettings:
    """Whether and how far the measurement is asked.

    Args:
        mode: "auto" corrects what the measurement surely tells; "off" believes masks and readings.
        most_shift_px: How far a shift is sought.
    """

    mode: RegistrationMode = "auto"
    most_shift_px: int = 64

    def check(self) -> "RegistrationSettings":
        """Return self if the settings make sense.

        Raises:
            InputError: An unknown mode, or a reach outside [0, 1024].
        """
        if self.mode not in REGISTRATION_MODES or not 0 <= self.most_shift_px <= 1024:
            raise InputError(
                f"registration {self.mode!r} up to {self.most_shift_px} px",
                allowed="auto or off, and a reach from 0 to 1024 px",
            )
        return self


@dataclass(frozen=True)
class Registered:
    """A measurement with its masks where they are, and what was found out.

    Args:
        shot: The measurement as it is to be believed: masks, readings and clipped pixels corrected.
        misfit: What was wrong with the masks; all at «absent» where nothing was.
        errors: Standard errors of the parameters that were let in, by name.
        orientation: How the masks had to be turned.
        unit: What the readings were divided by, after the black level was taken off.
        open_level: What the masks were divided by.
        clipped_share: Share of the pixels found clipped without having been told.
        peak: The coarse correlation's peak.
        first_mask: The number, from 0, that the mask that was shown first has in the list as given.
        tried: What was estimated and not let in, with its standard error, by name.
        notes: For the user.
    """

    shot: Shot
    misfit: Misfit = field(default_factory=Misfit)
    errors: dict[str, float] = field(default_factory=dict)
    orientation: str = "as given"
    unit: float = 1.0
    open_level: float = 1.0
    clipped_share: float = 0.0
    peak: Peak = field(default_factory=Peak.nothing)
    first_mask: int = 0
    tried: dict[str, tuple[float, float]] = field(default_factory=dict)
    notes: tuple[Finding, ...] = ()

    @property
    def is_changed(self) -> bool:
        """Get whether anything was corrected."""
        return bool(self.notes)

    def as_given(self, measurement: F32) -> F32:
        """Return readings, [H, W, C], in the unit and above the black level of the measurement as it was given."""
        if self.unit == 1.0 and self.misfit.black == 0.0:
            return measurement
        return (measurement * np.float32(self.unit) + np.float32(self.misfit.black)).astype(np.float32)

    def summary(self) -> dict[str, Any]:
        """Return all that a report says of it, as plain values."""
        placement = asdict(self.misfit.placement)
        corners = np.linalg.norm(self.misfit.placement.displacement_px(self.shot.size), axis=1)
        return {
            "changed": self.is_changed,
            "orientation": self.orientation,
            "peak_ratio": self.peak.ratio,
            "placement": placement,
            "largest_displacement_px": float(corners.max()),
            "bent_px": bent_px(self.misfit.placement, self.shot.size),
            "blur_sigma_px": float(np.sign(self.misfit.blur_px2)) * _sigma(abs(self.misfit.blur_px2)),
            "blur_px2": self.misfit.blur_px2,
            "leak": self.misfit.leak,
            "black": self.misfit.black,
            "unit": self.unit,
            "open_level": self.open_level,
            "clipped_share": self.clipped_share,
            "first_mask": self.first_mask,
            "standard_errors": dict(self.errors),
            "not_let_in": {name: list(pair) for name, pair in self.tried.items()},
        }


def register(
    shot: Shot, settings: RegistrationSettings | None = None, progress: Progress | None = None, seed: int = 0
) -> Registered:
    """Find where the masks are and how they met the light, and correct what the measurement surely tells.

    Args:
        shot: A checked measurement as it is believed; its truth is not read.
        settings: Whether and how far.
        progress: Told of the stage, and of every sentence.
        seed: Of the held-out pixels.

    Returns:
        The corrected measurement; the very same shot where nothing was to be corrected, or nothing tells.

    Raises:
        InputError: The settings make no sense.
    """
    settings, progress = (settings or RegistrationSettings()).check(), progress or Silent()
    if settings.mode == "off":
        return Registered(shot)
    progress.stage("registration")
    found = _Registration(shot, settings, seed).run()
    for note in found.notes:
        progress.say(note.advice)
    return found


@dataclass(frozen=True)
class _Way:
    """One way to correct a measurement, and what is said of it and of its rim; whether masks were filtered sharper."""

    shot: Shot
    misfit: Misfit
    errors: dict[str, float]
    found: str
    rim: Rim
    is_filtered: bool = False

    @property
    def is_bent(self) -> bool:
        """Get whether masks are moved by a smooth field beyond the affine."""
        return bool(self.misfit.placement.field.any())


class _Registration:
    """One registration under way."""

    def __init__(self, shot: Shot, settings: RegistrationSettings, seed: int) -> None:
        self.given = self.shot = shot
        self.settings = settings
        self.seed = seed
        self.notes: list[Finding] = []
        self.found = Registered(shot)

    def run(self) -> Registered:
        """Go all the way."""
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
        """Find the coarse shift, and how the masks are turned; the shot's masks are turned where that is sure."""
        total = white_reading(self.shot)
        if _is_flat(total) or min(total.shape) < _LEAST_SIDE_PX:
            return Peak.nothing(), "as given"
        element = element_px(total)
        seen = _readable(self.shot, element)
        reach = reach_of(self.shot.size, self.settings.most_shift_px)
        peak = find_peak(seen, fine_pattern(total, element), reach, element)
        if peak.is_sure:
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
        self.shot = replace(self.shot, masks=masks)
        self.notes.append(finding(Code.MASKS_TURNED, how=how, ratio=best.ratio))
        return best, how

    def _geometry_and_light(self, peak: Peak) -> tuple[Misfit, dict[str, float], dict[str, tuple[float, float]]]:
        """Find placement, blur, leak and black level, and correct the shot by what is let in."""
        proposed, tried = self._propose(self.shot, peak)
        for estimate in proposed:
            tried |= _beside(estimate, ())
        proposals = [way for estimate in proposed for way in self._ways(self.shot, estimate)]
        source = binary_source(self.shot.masks) if peak.is_sure else None
        if source is not None:
            sharp = replace(self.shot, masks=source.masks)
            again, _ = self._propose(sharp, peak)
            ways = [way for estimate in again for way in self._ways(sharp, estimate)]
            proposals += [_from_source(way, source) for way in ways or [_Way(sharp, Misfit(), {}, "", Rim.none(sharp))]]
        way = self._chosen([way for way in proposals if not way.is_bent], None)
        way = self._chosen([way for way in proposals if way.is_bent], way)
        if way is None:
            return Misfit(), {}, tried
        self.shot = way.shot
        self.notes += [finding(Code.MASKS_CORRECTED, found=way.found)] if way.found else []
        if way.misfit.blur_px2 <= -_TOO_SOFT_PX2 and way.is_filtered:
            self.notes.append(finding(Code.MASKS_TOO_SOFT, sigma=_sigma(-way.misfit.blur_px2)))
        self.notes += way.rim.notes
        return way.misfit, way.errors, {name: pair for name, pair in tried.items() if name not in way.errors}

    def _chosen(self, ways: list["_Way"], rival: "_Way | None") -> "_Way | None":
        """Return the way whose decode predicts held-out pixels best, if it surely does so better than a rival.

        A field is judged in the corner that it moves most, and against what is known without one: a picture whose
        corner is dark or noisy says nothing there of a shift of the whole.

        Args:
            ways: With a field all of them, or none.
            rival: What is taken otherwise; None stands for the shot as it is.
        """
        if not ways:
            return rival
        bent = max((way.misfit for way in ways), key=lambda one: bent_px(one.placement, self.shot.size))
        trial = Trial(self.shot, _level(ways[0].shot), self.seed, _most_bent(bent, self.shot.size))
        if not trial.can_tell:
            return rival
        squares = [trial.squares(way.shot) for way in ways]
        best = int(np.argmin([float(one.mean()) for one in squares]))
        before = trial.squares(self.shot if rival is None else rival.shot)
        return ways[best] if surely_larger(before, squares[best]) else rival

    def _beginning(self, misfit: Misfit, peak: Peak) -> int:
        """Find the mask that was shown first, and put it first; weights and poses belong to times, and stay."""
        if self.shot.views < LEAST_VIEWS or not (peak.is_sure or misfit != Misfit()):
            return 0
        found = find_beginning(brief_views(self.shot, _level(self.shot)))
        if found is None or not found.is_other:
            return 0
        self.shot = replace(self.shot, masks=np.roll(self.shot.masks, -found.first, axis=0))
        self.notes.append(
            finding(Code.MASKS_BEGIN_ELSEWHERE, first=found.first + 1, rank=found.rank, given=found.rank_as_given)
        )
        return found.first

    def _propose(self, shot: Shot, peak: Peak) -> tuple[list[MisfitEstimate], dict[str, tuple[float, float]]]:
        """Estimate all parameters.

        Returns:
            Those that are surely there and matter, without a field and with one, where there is one; and what was found
            of the others.
        """
        total = white_reading(shot)
        if _is_flat(total) or total.size < LEAST_BLOCKS * 64:
            return [], {}
        element = element_px(total)
        start = self._start(shot, peak, total, element)
        if start is None:
            return [], {}
        problem = _problem(shot, total, element)
        sought = (*AFFINE, *LIGHT) if _clipped_share(shot) < _MOST_CLIPPED else AFFINE
        estimate = refine(problem, start, sought)
        names = _let_in(estimate, problem)
        tried = _beside(estimate, names)
        found = _settled(problem, estimate, names)
        straight = Misfit() if found is None else found.misfit
        whole = _problem(shot, total, element, whole=True)
        known = fine_pattern(straight.of_total(total, whole.weights), element)
        tiles = find_tiles(_readable(shot, element), known, lambda _: np.zeros(2), _TILE_REACH, element, _TILE_ELEMENTS)
        field, beside = find_field(whole, straight, tiles)
        tried |= beside
        straightened = [] if found is None else [found]
        if field is None:
            return straightened, tried
        # What bends masks was taken for blur before.
        light = () if found is None else tuple(name for name in found.errors if name in LIGHT)
        again = _settled(problem, refine(problem, field.misfit, light), light) if light else None
        return [*straightened, _bent(field, again)], tried

    def _ways(self, shot: Shot, estimate: MisfitEstimate) -> list["_Way"]:
        """Return the shot corrected by an estimate; where it asks for sharpening, in all ways of that."""
        misfit, errors = estimate.misfit, dict(estimate.errors)
        found = _in_words(estimate)
        believed = shot.masks.astype(np.float64)
        ways = []
        for one in candidates(believed, misfit) or [None]:
            corrected, rim = _corrected(shot, misfit, one)
            ways.append(_Way(corrected, misfit, errors, found, rim, is_filtered=one is not None))
        return ways

    def _start(self, shot: Shot, peak: Peak, total: F64, element: float) -> Misfit | None:
        """Return a placement that is right to about a pixel everywhere; None where nothing shows."""
        seen, known = _readable(shot, element), fine_pattern(total, element)
        shift = np.array([peak.down_px, peak.right_px]) if peak.is_sure else np.zeros(2)
        reach = 16 if peak.is_sure else 32
        placed = place_tiles(find_tiles(seen, known, lambda _: shift, reach, element), self.shot.size)
        if placed is not None:
            apart = placed.displacement_px(self.shot.size) - shift
            if np.linalg.norm(apart, axis=1).max() > _UNEVEN_PX:
                return Misfit(self._again(placed, seen, total, element))
        if not peak.is_sure:
            return None
        return Misfit().moved(peak.down_px, peak.right_px)

    def _again(self, placed: Placement, seen: F64, total: F64, element: float) -> Placement:
        """Look once more at the tiles, the masks turned as they seem to be."""
        turned = replace(placed, down_px=0.0, right_px=0.0)
        known = fine_pattern(turned.sample(total[None])[0], element)
        found = find_tiles(seen, known, lambda _: placed.shift_px, 4, element)
        closer = place_tiles(found, self.shot.size)
        if closer is None:
            return placed
        # What is left after the turn moves places that the turn has moved already.
        return Placement.from_affine(closer.matrix @ turned.matrix, closer.shift_px)

    def _open_level(self) -> float:
        """Find what a fully open element is believed to let through, and correct the masks by it."""
        opened = open_level(self.shot.masks)
        if opened != 1.0:
            masks = np.minimum(self.shot.masks / np.float32(opened), np.float32(1))
            self.shot = replace(self.shot, masks=masks)
            self.notes.append(finding(Code.MASKS_DIVIDED, opened=float(opened)))
        return opened

    def _unit(self, misfit: Misfit, peak: Peak) -> float:
        """Find the unit, and correct the readings by it."""
        if not peak.is_sure and misfit == Misfit():
            return 1.0
        total = white_reading(self.shot)
        seen = Seen.of(self.shot, element_px(total))
        level = seen.level(total)
        known = (seen.counts > 0) & (total > 0.5 * float(np.median(total)))
        integers = bool(np.all(self.given.measurement == np.rint(self.given.measurement)))
        unit = find_unit(level, known, integers)
        if unit is None:
            return 1.0
        self._divide(unit)
        return unit.factor

    def _divide(self, unit: Unit) -> None:
        self.shot = replace(self.shot, measurement=(self.shot.measurement / unit.factor).astype(np.float32))
        self.notes.append(finding(Code.UNIT_CORRECTED, factor=float(unit.factor), reason=unit.reason))


def _most_bent(misfit: Misfit, size: tuple[int, int]) -> Corner | None:
    """Return the corner that a field moves most; None where there is no field."""
    if not misfit.placement.field.any():
        return None
    corners = [(lower, right) for lower in (False, True) for right in (False, True)]
    places = (np.array(corners) - 0.5) * (np.array(size) - 1)
    return corners[int(np.linalg.norm(misfit.placement.field_px(places), axis=1).argmax())]


def _settled(problem: Problem, estimate: MisfitEstimate, names: tuple[str, ...]) -> MisfitEstimate | None:
    """Find parameters again without those left out, until all that stay are surely there; None where none stays."""
    kept = tuple(name for name in GEOMETRY if name not in estimate.errors)  # a placement that was found before
    while names:  # what is left out moves the others: those that stay must still be sure
        estimate = refine(problem, _only(estimate.misfit, (*names, *kept)), names)
        still = tuple(name for name in names if name in _let_in(estimate, problem))
        if still == names:
            return estimate
        names = still
    return None


def _bent(field: FieldEstimate, light: MisfitEstimate | None) -> MisfitEstimate:
    """Put a placement with its field and the light that was found along it together."""
    if light is None:
        return MisfitEstimate(_only(field.misfit, GEOMETRY), field.errors)
    return MisfitEstimate(light.misfit, {**field.errors, **light.errors})


def _level(shot: Shot) -> float:
    """Return what to divide readings by, so that twice the scene's level is about full scale."""
    total = white_reading(shot)
    level = Seen.of(shot, element_px(total)).level(total)
    return max(2 * abs(float(np.median(level))), 1e-12)


def _from_source(way: _Way, source: Source) -> _Way:
    """Say of a way with sharp masks how it differs from the believed ones."""
    misfit = way.misfit.moved(*source.shift_px)
    return replace(
        way,
        is_filtered=False,
        misfit=replace(misfit, blur_px2=misfit.blur_px2 - source.blur_px2),
        found="; ".join(filter(None, (f"they were believed {source.how} from where and what they were", way.found))),
    )


def _is_flat(total: F64) -> bool:
    """Tell whether a sum of masks, [H, W], shows no pattern."""
    return float(total.std()) <= _LEAST_PATTERN * float(np.abs(total).max())


def _clipped_share(shot: Shot) -> float:
    return 0.0 if shot.saturated is None else float(shot.saturated.mean())


def _readable(shot: Shot, element: float) -> F64:
    """Return the fine pattern of a measurement, [H, W]: colours of a mosaic levelled, clipped readings left out."""
    seen = Seen.of(shot, element)
    patterns = np.zeros(shot.size)
    for plane, counts in zip(seen.planes, seen.counts, strict=True):
        around = np.maximum(seen.blur(counts), 1e-9)
        level = seen.blur(counts * plane) / around
        filled = np.where(counts > 0, plane, level)
        patterns += counts * fine_pattern(filled, element, relative=True)
    return patterns


def _problem(shot: Shot, total: F64, element: float, *, whole: bool = False) -> Problem:
    """Take the middle of a measurement, as much of it as tells enough, or the whole."""
    # Sides keep their parity, so that the middle stays where it is.
    sides = [n if whole else min(n, _LOOKED_AT_PX + (n - _LOOKED_AT_PX) % 2) for n in shot.size]
    rows, columns = (slice((n - s) // 2, (n - s) // 2 + s) for n, s in zip(shot.size, sides, strict=True))
    seen = Seen.of(shot, element)
    part = Seen(
        np.ascontiguousarray(seen.planes[:, rows, columns]),
        np.ascontiguousarray(seen.counts[:, rows, columns]),
        seen.window_px,
    )
    unit = float(np.mean(np.abs(part.planes)))
    return Problem(part, np.ascontiguousarray(total[rows, columns]), float(shot.weights.sum()), max(unit, 1e-300))


def _matters(estimate: MisfitEstimate, problem: Problem) -> dict[str, float]:
    """Return how many times what matters each parameter is."""
    vector = estimate.misfit.vector()
    arm = float(np.hypot(*problem.size)) / 2
    matters = {
        "down_px": _MATTERS_PX,
        "right_px": _MATTERS_PX,
        "rotation_deg": float(np.rad2deg(_MATTERS_PX / arm)),
        **dict.fromkeys(("scale", "stretch", "shear"), _MATTERS_PX / arm),
        "blur_px2": _MATTERS_BLUR_PX2,
        "leak": _MATTERS_LEAK,
        "black": _MATTERS_BLACK * problem.unit,
    }
    return {name: abs(float(vector[NAMES.index(name)])) / least for name, least in matters.items()}


def _let_in(estimate: MisfitEstimate, problem: Problem) -> tuple[str, ...]:
    """Return the parameters that are surely there and matter; those of one group come together."""
    matters = _matters(estimate, problem)
    least = {name: _SIGNIFICANT_LIGHT if name in LIGHT else SIGNIFICANT for name in estimate.errors}
    sure = {name for name in least if matters[name] >= 1 and estimate.significance(name) >= least[name]}
    return tuple(
        name for group in _GROUPS for name in group if name in estimate.errors and any(one in sure for one in group)
    )


def _beside(estimate: MisfitEstimate, names: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    vector = estimate.misfit.vector()
    return {
        name: (float(vector[NAMES.index(name)]), error) for name, error in estimate.errors.items() if name not in names
    }


def _only(misfit: Misfit, names: tuple[str, ...]) -> Misfit:
    vector = misfit.vector()
    return Misfit.from_vector(np.where([name in names for name in NAMES], vector, 0.0))


def _corrected(shot: Shot, misfit: Misfit, masks: F64 | None) -> tuple[Shot, Rim]:
    """Correct masks and readings; masks, [N, H, W], are those given, or the believed ones moved."""
    readings = shot.measurement - np.float32(misfit.black)
    black = replace(shot, measurement=readings.astype(np.float32)) if misfit.black else shot
    return complete(black, misfit, masks)


def _sigma(variance_px2: float) -> float:
    return 0.0 if variance_px2 == 0 else sigma_of(variance_px2)


def _terms(misfit: Misfit) -> list[tuple[str, float]]:
    return list(zip(FIELD, misfit.placement.field.tolist(), strict=True))


def _in_words(estimate: MisfitEstimate) -> str:
    """Say what was found, with standard errors."""
    misfit, errors = estimate.misfit, estimate.errors
    place, parts = misfit.placement, []
    if "down_px" in errors:
        parts.append(
            f"they lie {place.down_px:+.3f} ± {errors['down_px']:.3f} px down and {place.right_px:+.3f} ± "
            f"{errors['right_px']:.3f} px to the right of where they were believed"
        )
    if "rotation_deg" in errors:
        parts.append(
            f"turned by {place.rotation_deg:+.4f} ± {errors['rotation_deg']:.4f}° and scaled by "
            f"{1 + place.scale:.5f} ± {errors['scale']:.5f}"
        )
    if "stretch" in errors:
        parts.append(
            f"stretched by {place.stretch:+.5f} ± {errors['stretch']:.5f} and sheared by {place.shear:+.5f} ± "
            f"{errors['shear']:.5f}"
        )
    if any(name in errors for name in FIELD):
        terms = ", ".join(
            f"{name} {value:+.3f} ± {errors[name]:.3f}" for name, value in _terms(misfit) if name in errors
        )
        parts.append(f"bent by a smooth field beyond that, px at 100 px from the middle: {terms}")
    if "blur_px2" in errors:
        sigma = _sigma(abs(misfit.blur_px2))
        parts.append(f"{'softer' if misfit.blur_px2 > 0 else 'sharper'} than believed by σ {sigma:.2f} px")
    if "leak" in errors:
        parts.append(f"closed elements pass {misfit.leak:+.3f} ± {errors['leak']:.3f} more of the light")
    if "black" in errors:
        parts.append(f"the reading without light is {misfit.black:+.4g} ± {errors['black']:.2g}")
    return "; ".join(parts)
