"""Proposed corrections of masks: all parameters are estimated, and the significant ones that matter are kept.

    coarse shift ─► tiles ─► Gauss-Newton ─► which parameters? ─► these again ─► a field in the rest?

Here: from a coarse shift to estimates without a field and with one. Not here: the steps themselves (`coarse`,
`fine`), the corrected shot, and whether held-out pixels confirm an estimate (`ways`).
"""

from dataclasses import asdict, replace
from functools import partial
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64, Size
from gs2ci.core.linearity import Growth, growth
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import white_reading
from gs2ci.reconstruct.measurement.doubts import SATURATION_WORTH_SAYING, clipped_share
from gs2ci.reconstruct.measurement.holdout import surely_larger
from gs2ci.reconstruct.registration.coarse import (
    Peak,
    Tile,
    agreed,
    element_px,
    find_tiles,
    fine_pattern,
    is_flat,
    place_tiles,
    readable,
)
from gs2ci.reconstruct.registration.fine import LEAST_BLOCKS, MisfitEstimate, Problem, pixel_weights, refine, settled
from gs2ci.reconstruct.registration.local_scene import Seen
from gs2ci.reconstruct.registration.misfit import Misfit
from gs2ci.reconstruct.registration.parameters import (
    AFFINE,
    BY_NAME,
    EDGES,
    FIELD_AT_PX,
    GEOMETRY,
    HIGHER,
    LIGHT,
    LOW,
    NAMES,
    SIGNIFICANT,
)
from gs2ci.reconstruct.registration.placement import Placement
from gs2ci.reconstruct.registration.sharpen import CRISP, one_of, softness
from gs2ci.reconstruct.registration.widening import MaskSum

# Whether readings bend against the open masks, so that no error of the masks explains them.
#
# A leak, a black level, blur and displacement turn the line of readings over open masks; a display's gamma, division
# by the masks' sum or a sum that overflowed bend it. What bends is not estimated as a leak, whatever fits best.

# Right masks with every error that registration knows bend by less (`python -m tests.benchmarks registration imports`).
_BENT: Final = 0.1
_STEEP: Final = 0.9


def bent_growth(shot: Shot) -> Growth | None:
    """Return how the readings of a shot grow with its open masks if they bend; None if not, or if it cannot be told."""
    readings = shot.measurement[:, :, shot.measurement.shape[2] // 2].astype(np.float64)
    clip = np.inf
    if shot.saturated is not None and shot.saturated.any():
        clip = float(readings[shot.saturated].min())
    found = growth(readings, white_reading(shot), clip=clip, is_mosaic=shot.cfa is not None)
    if found is None or found.is_biased or found.slope > _STEEP:
        return None
    return found if found.curvature < -_BENT - SIGNIFICANT * found.curvature_error else None


# A smooth distortion field beyond the affine, as by a relay lens: which terms of it are accepted.
#
# The affine is estimated along with the field, since a radial field is partly a change of scale. If the remaining
# displacement exceeds the range of Gauss-Newton, the displacements of tiles give the start.

# The field has to move masks somewhere by so much relative to the best affine: less costs less than 0.05 dB.
MATTERS_PX: Final = 0.05
_BY_TILES: Final = (*AFFINE, *LOW)
_GRID: Final = 7


def find_field(problem: Problem, start: Misfit, tiles: list[Tile]) -> tuple[MisfitEstimate | None, MisfitEstimate]:
    """Estimate a field, and keep its significant terms.

    Args:
        problem: The whole measurement, including its corners.
        start: The estimate without a field, right to about two pixels everywhere.
        tiles: Displacements of parts of the picture relative to the start, in whole pixels.

    Returns:
        The field, None if no term is significant; and the estimate of all terms.
    """
    estimate, nearer = refine(problem, start, _BY_TILES), _by_tiles(tiles, start, problem.size)
    if nearer is not None:
        other = refine(problem, nearer, _BY_TILES)
        estimate = other if _predicts_better(problem, estimate.misfit, other.misfit) else estimate
    found = settled(problem, estimate, partial(_let_in, problem), AFFINE)
    better = found is not None and _predicts_better(problem, start, found.misfit)
    return found if better else None, estimate


def find_closer(problem: Problem, start: Misfit, terms: tuple[str, ...]) -> MisfitEstimate:
    """Estimate a field's terms again, and add those of higher order if they are significant.

    Pixels are now weighted by their errors with the field. Terms that are similar over most of the picture make each
    other uncertain, so the higher order is tried last.

    Args:
        problem: The whole measurement.
        start: The field so far, with the light estimated along with it.
        terms: Accepted terms of the field.
    """
    closer = refine(problem, start, (*AFFINE, *terms))
    higher = refine(problem, closer.misfit, (*AFFINE, *terms, *HIGHER))
    if {*HIGHER} & {*problem.let_in(higher)} and _predicts_better(problem, closer.misfit, higher.misfit):
        return higher
    return closer


def _by_tiles(tiles: list[Tile], placement: Misfit, size: Size) -> Misfit | None:
    """Return a placement with a field on which tiles agree; None if too few do, or if none is displaced."""
    if not any((tile.peak.down_px, tile.peak.right_px) != (0.0, 0.0) for tile in tiles if tile.peak.is_sure):
        return None
    steps = {name: one.step_at(float(np.hypot(*size)) / 2, 1.0) for name, one in BY_NAME.items() if name in _BY_TILES}
    found = agreed(tiles, size, lambda places: placement.derivatives(steps, places))
    if found is None:
        return None
    changes = zip(steps.items(), found.tolist(), strict=True)
    return placement.stepped({name: step * times for (name, step), times in changes})


def bent_px(placement: Placement, size: Size) -> float:
    """Return the largest displacement of masks by a field relative to the best affine, px."""
    rows, columns = (np.linspace(-0.5, 0.5, _GRID) * (n - 1) for n in size)
    places = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
    moved = placement.field_px(places)
    design = np.column_stack([np.ones(len(places)), places / FIELD_AT_PX])
    left = moved - design @ np.linalg.lstsq(design, moved, rcond=None)[0]
    return float(np.linalg.norm(left, axis=1).max())


def _let_in(problem: Problem, estimate: MisfitEstimate) -> tuple[str, ...]:
    """Return the significant terms, if they matter together."""
    if bent_px(estimate.misfit, problem.size) < MATTERS_PX:
        return ()
    return tuple(name for name in problem.let_in(estimate) if name in LOW)


def _predicts_better(problem: Problem, without: Misfit, found: Misfit) -> bool:
    """Tell whether the field surely improves the prediction of readings from those around them."""
    known = found.known(problem.size) & without.known(problem.size)
    errors = problem.errors(without)
    weights = pixel_weights(errors, known)[known]
    return surely_larger(weights * errors[known] ** 2, weights * problem.errors(found)[known] ** 2)


# The displacements of tiles are used if they deviate this far from a common shift.
_UNEVEN_PX: Final = 0.7
# Tiles for a field are smaller than those for a turn, since a field smears them more.
_TILE_ELEMENTS: Final = 32
_TILE_REACH: Final = 8
_LOOKED_AT_PX: Final = 256
# A darker leak and a lighter black level are told apart by the scene alone.
_ALIKE: Final = ("leak", "black")


def propose(shot: Shot, peak: Peak, *, edges: bool = True) -> tuple[list[MisfitEstimate], list[MisfitEstimate]]:
    """Estimate all parameters.

    Args:
        shot: The measurement.
        peak: Of the coarse correlation.
        edges: Whether open elements may be wider or narrower than stated.

    Returns:
        The estimates of significant parameters that matter, without a field and, if there is one, with it; and those of
        all parameters, significant or not.
    """
    total = white_reading(shot)
    if is_flat(total) or total.size < LEAST_BLOCKS * 64:
        return [], []
    element = element_px(total)
    start = _start(shot, peak, total, element)
    if start is None:
        return [], []
    problem = _problem(shot, element)
    # Clipped readings bias blur, leak and black level if they are left out; positions are not affected.
    tells_light = clipped_share(shot) < SATURATION_WORTH_SAYING and bent_growth(shot) is None
    estimate = refine(problem, start, (*AFFINE, *LIGHT) if tells_light else AFFINE)
    asked, found = [estimate], settled(problem, estimate) or MisfitEstimate(Misfit(), {})
    more: list[MisfitEstimate] = []
    # Soft masks have no edges, and what their noise takes from the pattern looks like a leak or a black level as well.
    is_crisp = tells_light and softness(one_of(shot.masks)) <= CRISP
    if edges and is_crisp:
        # Last, since wider elements of one pixel look much like a blur, and each would hide the other. Blur and leak
        # are estimated again along with the width, the black level only if there was one before: it looks like a leak.
        (width,) = EDGES
        wider, all_edges = _with(problem, found, {width, "blur_px2", "leak"}, width)
        more = [] if wider is None else [wider]
        asked.append(replace(all_edges, errors={width: all_edges.errors[width]}))
    if is_crisp and not more:
        more = _with_either(problem, found)
    straightened = [_beside_the_other(one, estimate) for one in (found, *more) if one.errors]
    closest = straightened[-1] if straightened else found
    whole = _problem(shot, element, whole=True)
    known = fine_pattern(closest.misfit.of_sum(whole.masks), element)
    tiles = find_tiles(readable(shot, element), known, np.zeros(2), _TILE_REACH, element, _TILE_ELEMENTS)
    field, all_terms = find_field(whole, closest.misfit, tiles)
    asked.append(replace(all_terms, errors={name: all_terms.errors[name] for name in LOW}))
    if field is None:
        return straightened, asked
    light = tuple(name for name in closest.errors if name in (*LIGHT, *EDGES))
    return [*straightened, _with_its_light(problem, whole, field, light)], asked


def _start(shot: Shot, peak: Peak, total: F64, element: float) -> Misfit | None:
    """Return a placement that is right to about a pixel everywhere; None if the pattern is not found."""
    seen, known = readable(shot, element), fine_pattern(total, element)
    shift = np.array([peak.down_px, peak.right_px]) if peak.is_sure else np.zeros(2)
    reach = 16 if peak.is_sure else 32
    placed = place_tiles(find_tiles(seen, known, shift, reach, element), shot.size)
    if placed is not None:
        apart = placed.displacement_px(shot.size) - shift
        if np.linalg.norm(apart, axis=1).max() > _UNEVEN_PX:
            return Misfit(**asdict(_again(placed, seen, total, element)))
    if not peak.is_sure:
        return None
    return Misfit().moved(peak.down_px, peak.right_px)


def _again(placed: Placement, seen: F64, total: F64, element: float) -> Placement:
    """Match the tiles again, with the masks turned by the first estimate."""
    turned = replace(placed, down_px=0.0, right_px=0.0)
    known = fine_pattern(turned.sample(total[None])[0], element)
    found = find_tiles(seen, known, placed.shift_px, 4, element)
    closer = place_tiles(found, seen.shape)
    if closer is None:
        return placed
    # The second estimate applies to positions that the first has already moved.
    return Placement.from_affine(closer.matrix @ turned.matrix, closer.shift_px)


def _with_its_light(problem: Problem, whole: Problem, field: MisfitEstimate, light: tuple[str, ...]) -> MisfitEstimate:
    """Estimate light with a field, and the field with that light.

    Without a field, its displacements were mistaken for blur. And a displacement by a fraction of a pixel blurs as
    well, so that masks stated too sharp or too soft pull a field towards the pixels' centres or away from them: by 0.03
    px with a blur of -0.05 px². Further turns change nothing (docs/decisions/registration.md).
    """
    along = settled(problem, refine(problem, field.misfit, light)) if light else None
    misfit, errors = (field.misfit.only(GEOMETRY), {}) if along is None else (along.misfit, along.errors)
    field = find_closer(whole, misfit, tuple(name for name in LOW if name in field.errors))
    return MisfitEstimate(field.misfit, {**field.errors, **errors})


def _with_either(problem: Problem, found: MisfitEstimate) -> list[MisfitEstimate]:
    """Estimate a leak and a black level, each without the other, if neither was accepted.

    They are so similar that neither is significant if both are estimated, however large one of them is.

    Returns:
        Estimates with one of them in addition, as far as they are significant; the one that explains more comes last.
    """
    if set(_ALIKE) & set(found.errors):
        return []
    asked = [_with(problem, found, {name, "blur_px2"}, name)[0] for name in _ALIKE]
    start = found.misfit
    weights = pixel_weights(problem.errors(start), start.known(problem.size))
    return sorted(
        (one for one in asked if one is not None),
        key=lambda one: -float(np.sum(weights * problem.errors(one.misfit) ** 2)),
    )


def _beside_the_other(found: MisfitEstimate, both: MisfitEstimate) -> MisfitEstimate:
    """Return an estimate of a leak or a black level with the standard error that it has if both are estimated.

    Part of what one of them explains may be the other's.
    """
    kept = set(_ALIKE) & set(found.errors)
    wider = {name: max(found.errors[name], both.errors[name]) for name in kept if len(kept) == 1}
    return replace(found, errors={**found.errors, **wider})


def _with(
    problem: Problem, found: MisfitEstimate, more: set[str], wanted: str
) -> tuple[MisfitEstimate | None, MisfitEstimate]:
    """Estimate more parameters along with those found, of which one is wanted.

    Returns:
        An estimate with that one, None if it is not significant; and that of all parameters.
    """
    asked = refine(problem, found.misfit, tuple(name for name in NAMES if name in {*found.errors, *more}))
    kept = settled(problem, asked) if wanted in problem.let_in(asked) else None
    return kept if kept is not None and wanted in kept.errors else None, asked


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
    is_soft = softness(one_of(shot.masks)) > CRISP
    return Problem(part, MaskSum(shot.masks, shot.weights, (rows, columns), is_soft=is_soft), max(unit, 1e-300))
