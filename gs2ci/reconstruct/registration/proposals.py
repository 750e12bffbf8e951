"""Proposed corrections of masks: all parameters are estimated, and the significant ones that matter are kept.

    coarse shift ─► tiles ─► Gauss-Newton ─► which parameters? ─► these again ─► a field in the rest?

Here: from a coarse shift to estimates without a field and with one. Not here: the steps themselves (`coarse`, `fine`,
`field`), the corrected shot, and whether held-out pixels confirm an estimate (`ways`).
"""

from dataclasses import replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import white_reading
from gs2ci.reconstruct.registration.bent import bent_growth
from gs2ci.reconstruct.registration.coarse import (
    Peak,
    element_px,
    find_tiles,
    fine_pattern,
    is_flat,
    place_tiles,
    readable,
)
from gs2ci.reconstruct.registration.field import find_closer, find_field
from gs2ci.reconstruct.registration.fine import LEAST_BLOCKS, MisfitEstimate, Problem, pixel_weights, refine
from gs2ci.reconstruct.registration.local_scene import Seen
from gs2ci.reconstruct.registration.misfit import Misfit
from gs2ci.reconstruct.registration.parameters import (
    AFFINE,
    EDGES,
    GEOMETRY,
    GROUPS,
    LIGHT,
    LOW,
    NAMES,
    Parameter,
)
from gs2ci.reconstruct.registration.placement import Placement
from gs2ci.reconstruct.registration.sharpen import CRISP, one_of, softness
from gs2ci.reconstruct.registration.widening import MaskSum

# The displacements of tiles are used if they deviate this far from a common shift.
_UNEVEN_PX: Final = 0.7
# Above this share of clipped readings, which bias blur, leak and black level if they are left out, these are not
# estimated. Positions are not affected.
_MOST_CLIPPED: Final = 0.01
# Tiles for a field are smaller than those for a turn, since a field smears them more.
_TILE_ELEMENTS: Final = 32
_TILE_REACH: Final = 8
_LOOKED_AT_PX: Final = 256
# How often a field and the light along with it are estimated in turn.
_TURNS: Final = 3
# A darker leak and a lighter black level are told apart by the scene alone.
_ALIKE: Final = ("leak", "black")


def propose(
    shot: Shot, peak: Peak, *, edges: bool = True
) -> tuple[list[MisfitEstimate], dict[str, tuple[float, float]]]:
    """Estimate all parameters.

    Args:
        shot: The measurement.
        peak: Of the coarse correlation.
        edges: Whether open elements may be wider or narrower than stated.

    Returns:
        The estimates of significant parameters that matter, without a field and, if there is one, with it; and value
        and standard error of the others, by name.
    """
    total = white_reading(shot)
    if is_flat(total) or total.size < LEAST_BLOCKS * 64:
        return [], {}
    element = element_px(total)
    start = _start(shot, peak, total, element)
    if start is None:
        return [], {}
    problem = _problem(shot, element)
    tells_light = _clipped_share(shot) < _MOST_CLIPPED and bent_growth(shot) is None
    sought = (*AFFINE, *LIGHT) if tells_light else AFFINE
    estimate = refine(problem, start, sought)
    names = _let_in(estimate, problem)
    tried = beside(estimate, names)
    found = _settled(problem, estimate, names)
    wider, of_edges = _with_edges(shot, problem, found) if edges and "leak" in sought else (None, {})
    tried |= of_edges
    lit = _with_either(problem, found) if "leak" in sought and wider is None else []
    straightened = [_beside_the_other(one, estimate) for one in (found, *lit, wider) if one is not None]
    closest = straightened[-1] if straightened else None
    straight = Misfit() if closest is None else closest.misfit
    whole = _problem(shot, element, whole=True)
    known = fine_pattern(straight.of_sum(whole.masks), element)
    tiles = find_tiles(readable(shot, element), known, lambda _: np.zeros(2), _TILE_REACH, element, _TILE_ELEMENTS)
    field, of_field = find_field(whole, straight, tiles)
    tried |= of_field
    if field is None:
        return straightened, tried
    light = () if closest is None else tuple(name for name in closest.errors if name in (*LIGHT, *EDGES))
    bent = _with_its_light(problem, whole, field, light)
    return [*straightened, bent], {name: pair for name, pair in tried.items() if name not in bent.errors}


def beside(estimate: MisfitEstimate, names: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """Return value and standard error of the estimated parameters other than these, by name."""
    vector = estimate.misfit.vector()
    return {
        name: (float(vector[NAMES.index(name)]), error) for name, error in estimate.errors.items() if name not in names
    }


def _start(shot: Shot, peak: Peak, total: F64, element: float) -> Misfit | None:
    """Return a placement that is right to about a pixel everywhere; None if the pattern is not found."""
    seen, known = readable(shot, element), fine_pattern(total, element)
    shift = np.array([peak.down_px, peak.right_px]) if peak.is_sure else np.zeros(2)
    reach = 16 if peak.is_sure else 32
    placed = place_tiles(find_tiles(seen, known, lambda _: shift, reach, element), shot.size)
    if placed is not None:
        apart = placed.displacement_px(shot.size) - shift
        if np.linalg.norm(apart, axis=1).max() > _UNEVEN_PX:
            return Misfit(_again(placed, seen, total, element))
    if not peak.is_sure:
        return None
    return Misfit().moved(peak.down_px, peak.right_px)


def _again(placed: Placement, seen: F64, total: F64, element: float) -> Placement:
    """Match the tiles again, with the masks turned by the first estimate."""
    turned = replace(placed, down_px=0.0, right_px=0.0)
    known = fine_pattern(turned.sample(total[None])[0], element)
    found = find_tiles(seen, known, lambda _: placed.shift_px, 4, element)
    closer = place_tiles(found, seen.shape)
    if closer is None:
        return placed
    # The second estimate applies to positions that the first has already moved.
    return Placement.from_affine(closer.matrix @ turned.matrix, closer.shift_px)


def _settled(problem: Problem, estimate: MisfitEstimate, names: tuple[str, ...]) -> MisfitEstimate | None:
    """Estimate parameters again without those dropped, until all are significant; None if none is left."""
    kept = tuple(name for name in GEOMETRY if name not in estimate.errors)  # a placement that was found before
    while names:  # dropping parameters changes the others, which must remain significant
        estimate = refine(problem, _only(estimate.misfit, (*names, *kept)), names)
        still = tuple(name for name in names if name in _let_in(estimate, problem))
        if still == names:
            return estimate
        names = still
    return None


def _with_its_light(problem: Problem, whole: Problem, field: MisfitEstimate, light: tuple[str, ...]) -> MisfitEstimate:
    """Estimate light with a field, and the field with that light, in turn.

    Without a field, its displacements were mistaken for blur. And a displacement by a fraction of a pixel blurs as
    well, so that masks stated too sharp or too soft pull a field towards the pixels' centres or away from them: by 0.03
    px with a blur of -0.05 px².
    """
    for _ in range(_TURNS):
        along = _settled(problem, refine(problem, field.misfit, light), light) if light else None
        misfit = _only(field.misfit, GEOMETRY) if along is None else along.misfit
        field = find_closer(whole, misfit, tuple(name for name in field.terms if name in LOW))
        light = () if along is None else tuple(along.errors)
        if not light:
            break
    return MisfitEstimate(field.misfit, {**field.errors, **({} if along is None else along.errors)})


def _with_either(problem: Problem, found: MisfitEstimate | None) -> list[MisfitEstimate]:
    """Estimate a leak and a black level, each without the other, if neither was accepted.

    They are so similar that neither is significant if both are estimated, however large one of them is.

    Returns:
        Estimates with one of them in addition, as far as they are significant; the one that explains more comes last.
    """
    before = () if found is None else tuple(found.errors)
    if set(_ALIKE) & set(before):
        return []
    start = Misfit() if found is None else found.misfit
    asked = [refine(problem, start, tuple(k for k in NAMES if k in {*before, "blur_px2", name})) for name in _ALIKE]
    settled = [_settled(problem, one, _let_in(one, problem)) for one in asked]
    sure = [one for one in settled if one is not None and set(_ALIKE) & set(one.errors)]
    weights = pixel_weights(problem.errors(start), start.placement.known(problem.size))
    return sorted(sure, key=lambda one: -float(np.sum(weights * problem.errors(one.misfit) ** 2)))


def _beside_the_other(found: MisfitEstimate, both: MisfitEstimate) -> MisfitEstimate:
    """Return an estimate of a leak or a black level with the standard error that it has if both are estimated.

    Part of what one of them explains may be the other's.
    """
    kept = set(_ALIKE) & set(found.errors)
    wider = {name: max(found.errors[name], both.errors[name]) for name in kept if len(kept) == 1}
    return replace(found, errors={**found.errors, **wider})


def _with_edges(
    shot: Shot, problem: Problem, found: MisfitEstimate | None
) -> tuple[MisfitEstimate | None, dict[str, tuple[float, float]]]:
    """Estimate whether open elements are wider or narrower than stated, and the other parameters along with it.

    This comes last, since wider elements of one pixel look much like a blur, and each would hide the other. Blur and
    leak are estimated again along with the width, the black level only if there was one before: leak and black level
    are so similar that neither is significant if both are estimated.

    Returns:
        An estimate with the width, None if it is not significant; in that case also its value and standard error.
    """
    if softness(one_of(shot.masks)) > CRISP:
        return None, {}
    before = () if found is None else tuple(found.errors)
    names = tuple(name for name in NAMES if name in {*before, "blur_px2", "leak", *EDGES})
    asked = refine(problem, Misfit() if found is None else found.misfit, names)
    there = _let_in(asked, problem)
    wider = _settled(problem, asked, there) if set(EDGES) <= set(there) else None
    if wider is None or not set(EDGES) <= set(wider.errors):
        return None, {name: pair for name, pair in beside(asked, ()).items() if name in EDGES}
    return wider, {}


def _problem(shot: Shot, element: float, *, whole: bool = False) -> Problem:
    """Take the middle of a measurement, which is enough for most parameters, or the whole."""
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
    return Problem(part, MaskSum(shot.masks, shot.weights, (rows, columns)), max(unit, 1e-300))


def _clipped_share(shot: Shot) -> float:
    return 0.0 if shot.saturated is None else float(shot.saturated.mean())


def _let_in(estimate: MisfitEstimate, problem: Problem) -> tuple[str, ...]:
    """Return the significant parameters that matter; those of one group are accepted together."""
    values, corner_px = estimate.misfit.values(), float(np.hypot(*problem.size)) / 2

    def is_sure(one: Parameter) -> bool:
        return estimate.is_sure(one.name) and abs(values[one.name]) >= one.least_at(corner_px, problem.unit)

    return tuple(
        name
        for group in GROUPS
        for name in group.names
        if name in estimate.errors and any(is_sure(one) for one in group.parameters)
    )


def _only(misfit: Misfit, names: tuple[str, ...]) -> Misfit:
    vector = misfit.vector()
    return Misfit.from_vector(np.where([name in names for name in NAMES], vector, 0.0))
