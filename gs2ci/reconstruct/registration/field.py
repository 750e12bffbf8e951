"""A smooth distortion field beyond the affine, as by a relay lens: which terms of it are accepted.

The affine is estimated along with the field, since a radial field is partly a change of scale. If the remaining
displacement exceeds the range of Gauss-Newton, the displacements of tiles give the start. Here: which terms are
accepted. Not here: the search (`fine`), whether held-out pixels confirm the whole (`register`).
"""

from functools import partial
from typing import Final

import numpy as np

from gs2ci.core.arrays import Size
from gs2ci.reconstruct.measurement.holdout import surely_larger
from gs2ci.reconstruct.registration.coarse import Tile, agreed
from gs2ci.reconstruct.registration.fine import MisfitEstimate, Problem, pixel_weights, refine, settled
from gs2ci.reconstruct.registration.misfit import Misfit
from gs2ci.reconstruct.registration.parameters import AFFINE, BY_NAME, FIELD_AT_PX, HIGHER, LOW
from gs2ci.reconstruct.registration.placement import Placement

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
