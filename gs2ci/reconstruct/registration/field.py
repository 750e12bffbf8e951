"""A smooth distortion field beyond the affine, as by a relay lens, by Gauss-Newton over the whole picture.

A slowly varying displacement acts on a pixel's error like a shift. So the derivatives by all coefficients are the two
derivatives by a shift down and a shift to the right, times polynomials of the position: each round needs five pictures,
whatever the number of coefficients. The affine is estimated along with the field, since a radial field is partly a
change of scale. If the remaining displacement exceeds the range of Gauss-Newton, the displacements of tiles give the
start. Here: the search, and which terms are accepted. Not here: whether held-out pixels confirm the whole (`register`).
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.reconstruct.measurement.holdout import surely_larger
from gs2ci.reconstruct.registration.coarse import Tile
from gs2ci.reconstruct.registration.fine import Problem, deviations_of, pixel_weights
from gs2ci.reconstruct.registration.misfit import Misfit
from gs2ci.reconstruct.registration.parameters import (
    AFFINE,
    BENT,
    BY_NAME,
    FIELD,
    FIELD_AT_PX,
    HIGHER,
    LOW,
    NAMES,
    STEP_PX,
)
from gs2ci.reconstruct.registration.placement import Placement

# The field has to move masks somewhere by so much relative to the best affine: less costs less than 0.05 dB.
MATTERS_PX: Final = 0.05
_ROUNDS: Final = 8
_SETTLED_PX: Final = 2e-3
# Longer steps, beyond the range in which the pattern gives a gradient, are shortened to this at the picture's corner.
_LONGEST_STEP_PX: Final = 1.0
_GROUPS: Final = (("radial_px",), BENT)
_BY_TILES: Final = (*AFFINE, *LOW)
_GRID: Final = 7
# Tiles whose displacement, in whole pixels, deviates by more than this from the field of the others are dropped.
_AGREEMENT_PX: Final = 1.2
_LEAST_TILES: Final = 12


@dataclass(frozen=True)
class FieldEstimate:
    """A placement with its field.

    Args:
        misfit: The given misfit, with the estimated placement.
        errors: Standard errors of the estimated parameters of the affine and terms of the field, by name.
        bent_px: Largest displacement of the masks by the field relative to the best affine.
    """

    misfit: Misfit
    errors: dict[str, float]
    bent_px: float

    @property
    def terms(self) -> tuple[str, ...]:
        """Get the terms of the field that were estimated."""
        return tuple(name for name in FIELD if name in self.errors)

    def value(self, name: str) -> float:
        """Return a parameter by its name."""
        return float(self.misfit.vector()[NAMES.index(name)])

    def is_sure(self, name: str) -> bool:
        """Tell whether a term is significant."""
        return abs(self.value(name)) >= BY_NAME[name].errors * self.errors[name] > 0


def find_field(
    problem: Problem, start: Misfit, tiles: list[Tile]
) -> tuple[FieldEstimate | None, dict[str, tuple[float, float]]]:
    """Estimate a field, keep its significant terms, and report the others.

    Args:
        problem: The whole measurement, including its corners.
        start: The estimate without a field, right to about two pixels everywhere.
        tiles: Displacements of parts of the picture relative to the start, in whole pixels.

    Returns:
        The field, None if no term is significant; and value and standard error of each term that is not in it.
    """
    estimate, near = _refined(problem, start, LOW), start
    nearer = _by_tiles(tiles, start.placement, problem.size)
    if nearer is not None:
        other = _refined(problem, replace(start, placement=nearer), LOW)
        if _predicts_better(problem, estimate.misfit, other.misfit):
            estimate, near = other, other.misfit
    tried = {name: (estimate.value(name), estimate.errors[name]) for name in LOW}
    names = _let_in(estimate)
    while names:  # dropping terms changes the others, which must remain significant
        kept = np.where([name in names for name in FIELD], near.placement.field, 0.0)
        estimate = _refined(problem, replace(near, placement=near.placement.with_field(kept)), names)
        still = _let_in(estimate)
        if still == names:
            break
        names = still
    if not names or not _predicts_better(problem, start, estimate.misfit):
        return None, tried
    return estimate, {name: pair for name, pair in tried.items() if name not in names}


def find_closer(problem: Problem, start: Misfit, terms: tuple[str, ...]) -> FieldEstimate:
    """Estimate a field's terms again, and add those of higher order if they are significant.

    Pixels are now weighted by their errors with the field. Terms that are similar over most of the picture make each
    other uncertain, so the higher order is tried last.

    Args:
        problem: The whole measurement.
        start: The field so far, with the light estimated along with it.
        terms: Accepted terms of the field.
    """
    closer = _refined(problem, start, terms)
    higher = _refined(problem, closer.misfit, (*terms, *HIGHER))
    if any(higher.is_sure(name) for name in HIGHER) and _predicts_better(problem, closer.misfit, higher.misfit):
        return higher
    return closer


def _by_tiles(tiles: list[Tile], placement: Placement, size: tuple[int, int]) -> Placement | None:
    """Return the placement with a field on which tiles agree; None if too few do, or if none is displaced."""
    sure = [tile for tile in tiles if tile.peak.is_sure]
    if not any((tile.peak.down_px, tile.peak.right_px) != (0.0, 0.0) for tile in sure):
        return None
    while len(sure) >= _LEAST_TILES:
        places = np.array([tile.middle for tile in sure]) - (np.array(size) - 1) / 2
        moved = np.array([(tile.peak.down_px, tile.peak.right_px) for tile in sure])
        design = np.moveaxis(_moves(places[:, 0], places[:, 1], _BY_TILES), 0, -1)  # [2, K, P]
        step = np.linalg.lstsq(design.reshape(-1, len(_BY_TILES)), moved.T.ravel(), rcond=None)[0]
        apart = np.linalg.norm(moved.T - design @ step, axis=0)
        worst = int(apart.argmax())
        if apart[worst] <= _AGREEMENT_PX:
            return _moved(placement, _BY_TILES, step)
        del sure[worst]
    return None


def bent_px(placement: Placement, size: tuple[int, int]) -> float:
    """Return the largest displacement of masks by a field relative to the best affine, px."""
    rows, columns = (np.linspace(-0.5, 0.5, _GRID) * (n - 1) for n in size)
    places = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
    moved = placement.field_px(places)
    design = np.column_stack([np.ones(len(places)), places / FIELD_AT_PX])
    left = moved - design @ np.linalg.lstsq(design, moved, rcond=None)[0]
    return float(np.linalg.norm(left, axis=1).max())


def _let_in(estimate: FieldEstimate) -> tuple[str, ...]:
    """Return the significant terms; those of one group are accepted together."""
    if estimate.bent_px < MATTERS_PX:
        return ()
    sought = [tuple(name for name in group if name in estimate.errors) for group in _GROUPS]
    return tuple(name for group in sought if any(estimate.is_sure(one) for one in group) for name in group)


def _predicts_better(problem: Problem, without: Misfit, found: Misfit) -> bool:
    """Tell whether the field surely improves the prediction of readings from those around them."""
    known = found.placement.known(problem.size) & without.placement.known(problem.size)
    errors = problem.errors(without)
    weights = pixel_weights(errors, known)[known]
    return surely_larger(weights * errors[known] ** 2, weights * problem.errors(found)[known] ** 2)


def _refined(problem: Problem, start: Misfit, terms: tuple[str, ...]) -> FieldEstimate:
    """Estimate the affine and some terms of the field by Gauss-Newton."""
    names = (*AFFINE, *terms)
    bases = _bases(problem.size, names)
    misfit, errors = start, problem.errors(start)
    weights = pixel_weights(errors, start.placement.known(problem.size))
    best, share = float(np.sum(weights * errors**2)), 1.0
    jacobian = _jacobian(problem, misfit, bases)
    for _ in range(_ROUNDS):
        normal = np.einsum("ihw,jhw,hw->ij", jacobian, jacobian, weights)
        slope = np.einsum("ihw,hw,hw->i", jacobian, errors, weights)
        step = -share * np.linalg.lstsq(normal, slope, rcond=None)[0]
        longest = _corner_px(bases, step)
        step = step * min(1.0, _LONGEST_STEP_PX / max(longest, 1e-300))
        trial = replace(misfit, placement=_moved(misfit.placement, names, step))
        trial_errors = problem.errors(trial)
        value = float(np.sum(weights * trial_errors**2))
        if value >= best:
            share /= 4
            if share < 0.05:
                break
            continue
        misfit, errors, best, share = trial, trial_errors, value, 1.0
        jacobian = _jacobian(problem, misfit, bases)
        if longest < _SETTLED_PX:
            break
    deviations = deviations_of(jacobian, errors, weights)
    return FieldEstimate(
        misfit, dict(zip(names, deviations.tolist(), strict=True)), bent_px(misfit.placement, problem.size)
    )


def _bases(size: tuple[int, int], names: tuple[str, ...]) -> F64:
    """Return the displacement of masks at each pixel by a unit of each parameter, [P, 2, H, W] as (down, right)."""
    row, column = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in size), indexing="ij")
    return _moves(row, column, names)


def _moves(row: F64, column: F64, names: tuple[str, ...]) -> F64:
    """Return the displacement by a unit of each parameter at positions from the middle, [P, 2, ...]: (down, right)."""
    none, one = np.zeros_like(row), np.ones_like(row)
    degree = np.pi / 180
    moved = {
        "down_px": (one, none),
        "right_px": (none, one),
        "rotation_deg": (degree * column, -degree * row),
        "scale": (row, column),
        "stretch": (-row, column),
        "shear": (column, row),
    }
    places = np.stack([row, column], axis=-1)
    for name in set(names) & set(FIELD):
        moved[name] = tuple(np.moveaxis(Placement(**{name: 1.0}).field_px(places), -1, 0))
    return np.stack([np.stack(moved[name]) for name in names])


def _jacobian(problem: Problem, misfit: Misfit, bases: F64) -> F64:
    """Return the derivative of the errors by each parameter, [P, H, W]."""
    by_shift = [
        (problem.errors(misfit.moved(down, right)) - problem.errors(misfit.moved(-down, -right))) / (2 * STEP_PX)
        for down, right in ((STEP_PX, 0.0), (0.0, STEP_PX))
    ]
    jacobian: F64 = bases[:, 0] * by_shift[0] + bases[:, 1] * by_shift[1]
    return jacobian


def _corner_px(bases: F64, step: F64) -> float:
    """Return the largest displacement of masks at a corner by a step, px, to first order.

    To first order, since steps that are far too long are shortened by it: those of terms that the masks hardly show may
    move corners by thousands of pixels, where the polynomials of the field leave the range of numbers.

    Args:
        bases: The displacement by a unit of each parameter, [P, 2, H, W].
        step: Of each, [P].
    """
    moved = np.einsum("p,pdc->dc", step, bases[:, :, [0, 0, -1, -1], [0, -1, 0, -1]])
    return float(np.linalg.norm(moved, axis=0).max())


def _moved(placement: Placement, names: tuple[str, ...], step: F64) -> Placement:
    """Apply a step to a placement; its affine is applied after the present one."""
    by_name = dict(zip(names, step.tolist(), strict=True))
    more = Placement(**{name: by_name.get(name, 0.0) for name in AFFINE})
    affine = Placement.from_affine(more.matrix @ placement.matrix, more.matrix @ placement.shift_px + more.shift_px)
    return affine.with_field(placement.field + np.array([by_name.get(name, 0.0) for name in FIELD]))
