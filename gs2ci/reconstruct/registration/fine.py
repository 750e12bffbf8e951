"""Fractions of a pixel, turns, fields, blur and black level, by Gauss-Newton on the held-out error of every pixel.

The error of a locally constant scene (`local_scene`) depends only on the masks' sum, so that a step costs a few
pictures and no decode. A slowly varying displacement acts on a pixel's error like a shift: the derivatives by all
parameters of position are the two by a shift, times how far each moves what the pixel sees. Errors are weighted by the
inverse of their mean square around a pixel, so that edges do not dominate. Standard errors come from scores summed over
blocks of the picture, since neighbours share their texture.

Here: the search and its errors. Not here: which parameters are accepted (`proposals`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from gs2ci.core.arrays import F64, Bool, Size
from gs2ci.reconstruct.measurement.blocks import BLOCK_PX, block_sums
from gs2ci.reconstruct.registration.local_scene import Seen
from gs2ci.reconstruct.registration.misfit import Misfit
from gs2ci.reconstruct.registration.parameters import BY_NAME, GEOMETRY, MATTERS_PX, STEP_PX, let_in
from gs2ci.reconstruct.registration.placement import from_middle
from gs2ci.reconstruct.registration.widening import MaskSum

_ROUNDS: Final = 12
# Fewer blocks are not enough to estimate the scatter of scores.
LEAST_BLOCKS: Final = 12
# In steps of numerical derivatives: half of the least displacement that matters.
_SETTLED: Final = MATTERS_PX / (2 * STEP_PX)
# Longer steps, beyond the range in which the pattern gives a gradient, are shortened to this at the picture's corner.
_LONGEST_STEP_PX: Final = 1.0


@dataclass(frozen=True)
class MisfitEstimate:
    """Parameters with their standard errors.

    Args:
        misfit: The estimate; parameters that were not estimated are unchanged.
        errors: Standard error of each estimated parameter, by name.
    """

    misfit: Misfit
    errors: dict[str, float]

    @property
    def pairs(self) -> dict[str, tuple[float, float]]:
        """Get value and standard error of the estimated parameters, by name."""
        return {name: (getattr(self.misfit, name), error) for name, error in self.errors.items()}


@dataclass(frozen=True)
class Problem:
    """A measurement, the sum of its masks as stated, and the unit of its light.

    Args:
        seen: The readings.
        masks: Σ wᵢ Mᵢ of the same piece.
        unit: Mean reading of the measurement, the unit for steps of black level and leak.
    """

    seen: Seen
    masks: MaskSum
    unit: float

    @property
    def size(self) -> Size:
        """Get height and width in pixels."""
        return self.masks.stated.shape[0], self.masks.stated.shape[1]

    def errors(self, misfit: Misfit) -> F64:
        """Return the held-out error of each pixel, [H, W]."""
        return self.seen.errors(misfit.of_sum(self.masks), misfit.black)

    @property
    def corner_px(self) -> float:
        """Get the distance of the corners from the middle."""
        return float(np.hypot(*self.size)) / 2

    def let_in(self, estimate: MisfitEstimate) -> tuple[str, ...]:
        """Return the significant parameters that matter, with their groups."""
        return let_in(estimate.pairs, self.corner_px, self.unit)


def pixel_weights(errors: F64, known: Bool) -> F64:
    """Weight pixels by the inverse mean square of the errors around them, [H, W]; mean 1, 0 at unknown pixels."""
    around = cv2.blur(np.minimum(errors**2, 9 * np.mean(errors**2)), (9, 9), borderType=cv2.BORDER_REFLECT)
    weights: F64 = known / (around + 0.1 * float(np.mean(errors**2)) + 1e-300)
    mean = float(weights.mean())
    return weights / mean if mean > 0 else weights


def refine(problem: Problem, start: Misfit, names: tuple[str, ...]) -> MisfitEstimate:
    """Estimate the parameters of these names, from a start that is right to about a pixel everywhere.

    Args:
        problem: The measurement.
        start: Where to start.
        names: Of `NAMES`.
    """
    steps = {name: BY_NAME[name].step_at(max(1.0, problem.corner_px), problem.unit) for name in names}
    scale = np.array([*steps.values()])
    placed = {name: step for name, step in steps.items() if name in GEOMETRY}
    moves = dict(zip(placed, start.derivatives(placed, from_middle(problem.size)), strict=True))
    still = np.zeros((*problem.size, 2))
    at_corners = np.stack([moves.get(name, still)[[0, 0, -1, -1], [0, -1, 0, -1]] for name in names])
    misfit, errors = start, problem.errors(start)
    weights = pixel_weights(errors, start.known(problem.size))
    root = np.sqrt(weights)
    best = float(np.sum((root * errors) ** 2))
    damping = 1e-4
    jacobian = _jacobian(problem, misfit, steps, moves)
    for _ in range(_ROUNDS):
        weighted = (root * jacobian).reshape(len(names), -1)
        normal = weighted @ weighted.T
        slope = weighted @ (root * errors).ravel()
        step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + 1e-300 * np.eye(len(names)), slope)
        # To first order: steps of terms that masks hardly show may move corners by thousands of pixels.
        longest = float(np.linalg.norm(np.tensordot(step, at_corners, axes=1), axis=-1).max())
        step *= min(1.0, _LONGEST_STEP_PX / max(longest, 1e-300))
        trial = misfit.stepped(dict(zip(names, (step * scale).tolist(), strict=True)))
        trial_errors = problem.errors(trial)
        value = float(np.sum((root * trial_errors) ** 2))
        if value < best:
            misfit, errors, best, damping = trial, trial_errors, value, damping / 5
            if np.abs(step).max() < _SETTLED:
                break
            jacobian = _jacobian(problem, misfit, steps, moves)
        else:
            damping = max(damping, 1e-4) * 20
            if damping > 1e4 or np.abs(step).max() < _SETTLED:
                break
    deviations = deviations_of(jacobian, errors, weights) * scale
    deviations *= [BY_NAME[name].inflation for name in names]
    return MisfitEstimate(misfit, dict(zip(names, deviations.tolist(), strict=True)))


def settled(
    problem: Problem,
    estimate: MisfitEstimate,
    which: Callable[[MisfitEstimate], tuple[str, ...]] | None = None,
    always: tuple[str, ...] = (),
) -> MisfitEstimate | None:
    """Estimate again without the parameters that are not let in, until all are; None if none is left.

    Dropping parameters changes the others, which must remain significant.

    Args:
        problem: The measurement.
        estimate: Of all parameters that are asked for.
        which: Returns those that are let in; None: by their list.
        always: Those that are estimated along with them, significant or not.
    """
    which = which or problem.let_in
    asked, names = set(estimate.errors), which(estimate)
    while names:
        start = estimate.misfit.only({*BY_NAME} - asked | {*names, *always})
        estimate = refine(problem, start, (*always, *names))
        still = tuple(name for name in names if name in which(estimate))
        if still == names:
            return estimate
        names = still
    return None


def _jacobian(problem: Problem, misfit: Misfit, steps: Mapping[str, float], moves: Mapping[str, F64]) -> F64:
    """Return the derivative of the errors by each parameter, in steps of it, by central differences, [P, H, W].

    Args:
        problem: The measurement.
        misfit: Where.
        steps: By name.
        moves: How far the steps of parameters of position move what each pixel sees, [H, W, 2].
    """

    def between(one: Misfit, other: Misfit) -> F64:
        return (problem.errors(one) - problem.errors(other)) / 2

    ways = [(STEP_PX, 0.0), (0.0, STEP_PX)] if moves else []
    by_shift = [between(misfit.moved(*way), misfit.moved(-way[0], -way[1])) / STEP_PX for way in ways]
    rows = [
        moves[name][..., 0] * by_shift[0] + moves[name][..., 1] * by_shift[1]
        if name in moves
        else between(misfit.changed(name, step), misfit.changed(name, -step))
        for name, step in steps.items()
    ]
    return np.stack(rows)


def deviations_of(jacobian: F64, errors: F64, weights: F64) -> F64:
    """Return standard errors in steps: the sandwich estimate from the normal matrix and the scores of blocks."""
    count = len(jacobian)
    normal = np.einsum("ihw,jhw,hw->ij", jacobian, jacobian, weights)
    scores = jacobian * (weights * errors)
    height, width = errors.shape
    side = min(BLOCK_PX, max(4, int(np.sqrt(height * width / (4 * LEAST_BLOCKS)))))
    blocks = block_sums(scores, side).reshape(count, -1)
    spread = blocks @ blocks.T * (blocks.shape[1] / max(1, blocks.shape[1] - 1))
    try:
        inverse = np.linalg.inv(normal)
    except np.linalg.LinAlgError:
        return np.full(count, np.inf)
    return np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0.0))
