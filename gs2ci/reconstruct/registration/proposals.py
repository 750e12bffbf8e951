"""What may be wrong with masks: all parameters estimated, and those kept that are surely there and matter.

    coarse shift ─► tiles ─► Gauss-Newton ─► which parameters? ─► the rest again ─► a field in what they leave?

Here: from a coarse shift to estimates without a field and with one. Not here: the steps themselves (`coarse`, `fine`,
`field`), what becomes of the shot, and whether held-out pixels bear an estimate out (`ways`).
"""

from dataclasses import replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import white_reading
from gs2ci.reconstruct.registration.coarse import (
    Peak,
    element_px,
    find_tiles,
    fine_pattern,
    is_flat,
    place_tiles,
    readable,
)
from gs2ci.reconstruct.registration.field import FieldEstimate, find_closer, find_field
from gs2ci.reconstruct.registration.fine import LEAST_BLOCKS, MisfitEstimate, Problem, refine
from gs2ci.reconstruct.registration.local_scene import Seen
from gs2ci.reconstruct.registration.misfit import AFFINE, EDGES, GEOMETRY, LIGHT, LOW, NAMES, Misfit
from gs2ci.reconstruct.registration.placement import Placement
from gs2ci.reconstruct.registration.sharpen import CRISP, softness
from gs2ci.reconstruct.registration.widening import MaskSum

# A parameter is let in where it is so many of its standard errors away from «absent», and matters: the rest of the
# model is not exact, and what moves masks by less costs less than 0.05 dB.
SIGNIFICANT: Final = 5.0
# Standard errors of light allow for what the scene leans them by.
_SIGNIFICANT_LIGHT: Final = 4.0
_MATTERS_PX: Final = 0.02
_MATTERS_BLUR_PX2: Final = 0.02
_MATTERS_LEAK: Final = 0.005
_MATTERS_BLACK: Final = 0.01
_MATTERS_WIDENING_PX: Final = 0.02
# Displacements of tiles are taken where the tiles lie this far from where one shift would put them.
_UNEVEN_PX: Final = 0.7
# Readings that are left out because they are high lean blur, leak and black level; they say as much of places.
_MOST_CLIPPED: Final = 0.01
# Tiles that show a field are smaller than those that show a turn: it smears them more.
_TILE_ELEMENTS: Final = 32
_TILE_REACH: Final = 8
_LOOKED_AT_PX: Final = 256
# A field and the light along it are found by turns, so often.
_TURNS: Final = 3
_GROUPS: Final = (
    ("down_px", "right_px"),
    ("rotation_deg", "scale"),
    ("stretch", "shear"),
    ("blur_px2",),
    ("leak",),
    ("black",),
    ("widening_px",),
)


def propose(
    shot: Shot, peak: Peak, *, edges: bool = True
) -> tuple[list[MisfitEstimate], dict[str, tuple[float, float]]]:
    """Estimate all parameters.

    Args:
        shot: The measurement.
        peak: Of the coarse correlation.
        edges: Whether open elements may be wider or narrower than stated.

    Returns:
        Those that are surely there and matter, without a field and with one, where there is one; and what was found
        of the others.
    """
    total = white_reading(shot)
    if is_flat(total) or total.size < LEAST_BLOCKS * 64:
        return [], {}
    element = element_px(total)
    start = _start(shot, peak, total, element)
    if start is None:
        return [], {}
    problem = _problem(shot, element)
    sought = (*AFFINE, *LIGHT) if _clipped_share(shot) < _MOST_CLIPPED else AFFINE
    estimate = refine(problem, start, sought)
    names = _let_in(estimate, problem)
    tried = beside(estimate, names)
    found = _settled(problem, estimate, names)
    wider, of_edges = _with_edges(shot, problem, found) if edges and "leak" in sought else (None, {})
    tried |= of_edges
    straightened = [one for one in (found, wider) if one is not None]
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
    """Return value and standard error of what was sought beside the parameters of these names, by name."""
    vector = estimate.misfit.vector()
    return {
        name: (float(vector[NAMES.index(name)]), error) for name, error in estimate.errors.items() if name not in names
    }


def _start(shot: Shot, peak: Peak, total: F64, element: float) -> Misfit | None:
    """Return a placement that is right to about a pixel everywhere; None where nothing shows."""
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
    """Look once more at the tiles, the masks turned as they seem to be."""
    turned = replace(placed, down_px=0.0, right_px=0.0)
    known = fine_pattern(turned.sample(total[None])[0], element)
    found = find_tiles(seen, known, lambda _: placed.shift_px, 4, element)
    closer = place_tiles(found, seen.shape)
    if closer is None:
        return placed
    # What is left after the turn moves places that the turn has moved already.
    return Placement.from_affine(closer.matrix @ turned.matrix, closer.shift_px)


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


def _with_its_light(problem: Problem, whole: Problem, field: FieldEstimate, light: tuple[str, ...]) -> MisfitEstimate:
    """Find light along a field, and the field along it, by turns.

    What bends masks was taken for blur before. A fraction of a pixel blurs as well, so that masks that are stated too
    sharp or too soft pull a field towards the pixels' middles or away from them: by 0.03 px with a blur of -0.05 px².
    """
    for _ in range(_TURNS):
        along = _settled(problem, refine(problem, field.misfit, light), light) if light else None
        misfit = _only(field.misfit, GEOMETRY) if along is None else along.misfit
        field = find_closer(whole, misfit, tuple(name for name in field.terms if name in LOW))
        light = () if along is None else tuple(along.errors)
        if not light:
            break
    return MisfitEstimate(field.misfit, {**field.errors, **({} if along is None else along.errors)})


def _with_edges(
    shot: Shot, problem: Problem, found: MisfitEstimate | None
) -> tuple[MisfitEstimate | None, dict[str, tuple[float, float]]]:
    """Ask whether open elements are wider or narrower than stated, and find the rest along with that.

    Asked last, since wider elements of one pixel look much like a blur, and each would hide the other. Blur and leak
    are found anew beside the width, the black level only where there was one before: leak and black level look so much
    alike that, asked together, neither is sure.

    Returns:
        An estimate with the width, None where it is not surely there; and what was found of the width then.
    """
    if softness(shot.masks[:1].astype(np.float64)) > CRISP:
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
    return Problem(part, MaskSum(shot.masks, shot.weights, (rows, columns)), max(unit, 1e-300))


def _clipped_share(shot: Shot) -> float:
    return 0.0 if shot.saturated is None else float(shot.saturated.mean())


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
        "widening_px": _MATTERS_WIDENING_PX,
    }
    return {name: abs(float(vector[NAMES.index(name)])) / least for name, least in matters.items()}


def _let_in(estimate: MisfitEstimate, problem: Problem) -> tuple[str, ...]:
    """Return the parameters that are surely there and matter; those of one group come together."""
    matters = _matters(estimate, problem)
    least = {name: _SIGNIFICANT_LIGHT if name in (*LIGHT, *EDGES) else SIGNIFICANT for name in estimate.errors}
    sure = {name for name in least if matters[name] >= 1 and estimate.significance(name) >= least[name]}
    return tuple(
        name for group in _GROUPS for name in group if name in estimate.errors and any(one in sure for one in group)
    )


def _only(misfit: Misfit, names: tuple[str, ...]) -> Misfit:
    vector = misfit.vector()
    return Misfit.from_vector(np.where([name in names for name in NAMES], vector, 0.0))
