"""The path of a small motion from the measurement alone: blocks of the picture are displaced, and a camera explains it.

Displacements of blocks during the exposure are regressed from the measurement (`measurement.displacements`), without
decoding views. They tell of motions by a fraction of a pixel, which drown in the errors of points tracked through
decoded views, and nothing of the masks moves with them. To first order a block at inverse depth ρ and ray (x, y, 1) is
displaced by

    f (ρ (tx − x tz) + ωy (1 + x²) − ωx x y − ωz y,  ρ (ty − y tz) − ωx (1 + y²) + ωy x y + ωz x)

(Longuet-Higgins and Prazdny 1980), with a translation t and a turn ω for each way of moving over time. Given these, the
inverse depth of each block follows in closed form; so only they are searched for (variable projection: Golub and
Pereyra 1973).

Here: the motion, its expected error and the motion in the reverse order of depth. Not here: the displacements, when
this is used (`choose`).
"""

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F32, F64, Bool, Size
from gs2ci.core.cameras import relative_to, rigid
from gs2ci.core.findings import Code, finding
from gs2ci.core.lens import slopes_of
from gs2ci.core.progress import Progress
from gs2ci.reconstruct.geometry.depth.sweep import inverse_depth_range, sweep
from gs2ci.reconstruct.geometry.initialise import PLANE_NOTE, Geometry, OtherOrder
from gs2ci.reconstruct.geometry.kinds import PathSource, Verdict
from gs2ci.reconstruct.geometry.path.halves import LEAST_VIEWS, error_from_halves
from gs2ci.reconstruct.geometry.path.motion import in_standard_errors
from gs2ci.reconstruct.geometry.path.validity import doubts_about_path, halves_agree
from gs2ci.reconstruct.geometry.prior import Request
from gs2ci.reconstruct.geometry.sources.direct import at_rest
from gs2ci.reconstruct.measurement.displacements import FIRST_ORDER_PX, BlockDisplacements, displacements, over_blocks
from gs2ci.reconstruct.measurement.lens import straightened

# Rounds of the regression: twice as many changed those of pans by 3 % at most.
_ROUNDS: Final = 3
# Displacements err by this share of them, too, since fine detail seems to move farther than the rest.
_FIRST_ORDER_SHARE: Final = 0.1
# Inverse depths have a mean of 1 and this standard deviation, and stay in this range: this sets the unit of the path.
_DEPTH_SPREAD: Final = 0.5
_TIGHT: Final = 1 / _DEPTH_SPREAD**2
_DEPTH_RANGE: Final = (0.05, 5.0)
# A block whose displacement is off by more standard errors than this counts less (pseudo-Huber).
_OUTLIER: Final = 3.0
# Blocks of a still scene are off by this at most, in the mean over the blocks: 2 to 3.6 for cameras that move, 4 to 18
# where something else moves (docs/decisions/sources-of-geometry.md).
_MOST_OFF: Final = 3.6
# A camera that turns must leave so many times more: one that turns by a degree left up to 1.7 times more than with a
# parallax of its own, motions with a parallax of a pixel and more 1.8 times and more.
_LEAST_PARALLAX: Final = 1.75
# What tracks say of the motion no longer holds.
_OVERRULED: Final = (Code.CAMERA_STOOD_STILL, Code.CAMERA_ONLY_TURNED, Code.PARALLAX_MAY_DROWN, Code.PATH_UNCERTAIN)


@dataclass(frozen=True)
class BlockMotion:
    """A motion of the camera that explains displaced blocks.

    Args:
        moves: Translation and turn for each way of moving over time, [F, 6]; the unit is that of 1 / inverse depth.
        inverse_depth: Of each block, [B].
        off: Cost of each block, [B]: squares of what its displacement and its inverse depth are off by, in standard
            errors.
    """

    moves: F64
    inverse_depth: F64
    off: F64

    @property
    def cost(self) -> float:
        """Get the mean cost of a block."""
        return float(self.off.mean())


class DisplacedBlocks:
    """Displaced blocks, whitened by their errors, and the motions that explain them.

    Args:
        displaced: The blocks.
        slopes: Of the rays to their centres, [B, 2].
        focal_px: Along x and y, [2].
    """

    def __init__(self, displaced: BlockDisplacements, slopes: F64, focal_px: F64) -> None:
        self.displaced, self._slopes, self._focal_px = displaced, slopes, focal_px
        count, size = displaced.px.shape
        vague = FIRST_ORDER_PX**2 + _FIRST_ORDER_SHARE**2 * np.mean(displaced.px**2, axis=1)
        whiten = np.linalg.cholesky(np.linalg.inv(displaced.covariance + vague[:, None, None] * np.eye(size)))
        whiten = whiten.swapaxes(1, 2)
        x, y = slopes.T
        zero, one = np.zeros(count), np.ones(count)
        travels = np.stack([np.stack([one, zero, -x], axis=1), np.stack([zero, one, -y], axis=1)], axis=1)
        turns = np.stack([np.stack([-x * y, 1 + x * x, -y], axis=1), np.stack([-1 - y * y, x * y, x], axis=1)], axis=1)
        self._degrees = len(displaced.over_time)
        ways = np.concatenate([travels, turns], axis=2)
        of_each = np.einsum("fg,i,bij->bfigj", np.eye(self._degrees), focal_px, ways).reshape(count, size, -1)
        # Whitened displacements, and their derivatives by the travels and the turns of moves, [B, 2 F, 6 F].
        self._px, by_moves = np.einsum("bij,bj->bi", whiten, displaced.px), whiten @ of_each
        travels = np.arange(by_moves.shape[2]) % 6 < 3
        self._by_travels, self._by_turns = by_moves * travels, by_moves * ~travels

    def __len__(self) -> int:
        """Get the number of blocks."""
        return len(self._slopes)

    def motion(self) -> BlockMotion:
        """Find the motion that explains the blocks best, from several starts."""
        return min((self.adjusted(start) for start in self._starts()), key=lambda motion: motion.cost)

    def turn(self) -> BlockMotion:
        """Find the turn of a camera that stays in place that explains the blocks best."""
        return self._searched(np.zeros((self._degrees, 6)), np.s_[:, 3:])

    def subset(self, chosen: Bool) -> "DisplacedBlocks":
        """Return some of the blocks."""
        some = replace(
            self.displaced,
            centres_px=self.displaced.centres_px[chosen],
            px=self.displaced.px[chosen],
            covariance=self.displaced.covariance[chosen],
        )
        return DisplacedBlocks(some, self._slopes[chosen], self._focal_px)

    def adjusted(self, start: F64) -> BlockMotion:
        """Search for the motion near a start, [F, 6]."""
        return self._searched(start, np.s_[:, :])

    def _searched(self, start: F64, free: tuple[slice, slice]) -> BlockMotion:
        """Search for some of the moves, [F, 6], near a start, and keep the others."""
        columns = np.arange(start.size).reshape(start.shape)[free].ravel()

        def moves(found: F64) -> F64:
            moved = start.copy()
            moved.flat[columns] = found
            return moved

        def errors(found: F64) -> F64:
            return self._errors(moves(found))[0]

        def derivative(found: F64) -> F64:
            return self._derivative(moves(found))[:, columns]

        found = moves(least_squares(errors, start.flat[columns], derivative, max_nfev=100, x_scale="jac").x)
        return BlockMotion(found, *self._errors(found)[1:])

    def _starts(self) -> list[F64]:
        """Return moves to start from, [F, 6] each: pure travel, and travel along the largest parallax, both ways."""
        px = self.displaced.px[:, :2]
        weights = 1 / np.trace(self.displaced.covariance, axis1=1, axis2=2)
        mean = np.median(px, axis=0)
        apart = px - mean
        way = np.linalg.eigh((apart.T * weights) @ apart)[1][:, -1]
        length = 2 * float(np.sqrt(np.median((apart @ way) ** 2))) + FIRST_ORDER_PX
        return [
            self._start(mean, np.zeros(2)),
            *(self._start(side * length * way, mean - side * length * way) for side in (1, -1)),
        ]

    def depth_map(self, motion: BlockMotion, size: Size) -> F32:
        """Return a smooth map of the blocks' inverse depths, [H, W], on the sensor; each counts by its precision."""
        along = self._along(motion.moves)
        precision = (along**2).sum(axis=1)
        block_px = self.displaced.block_px
        columns, rows = self.displaced.centres_px.T.astype(np.int64) // block_px
        weight = np.zeros(tuple(-(-side // block_px) for side in size))
        weighted = weight.copy()
        weight[rows, columns], weighted[rows, columns] = precision, precision * motion.inverse_depth
        smooth, smooth_weighted = over_blocks(weight), over_blocks(weighted)
        coarse = (smooth_weighted + _TIGHT) / (smooth + _TIGHT)
        found: F32 = cv2.resize(coarse.astype(np.float32), None, fx=block_px, fy=block_px)
        return found[: size[0], : size[1]]

    def _along(self, moves: F64) -> F64:
        """Return whitened displacements by the travel of moves, [F, 6], at an inverse depth of 1, [B, 2 F]."""
        return self._by_travels @ moves.ravel()

    def _start(self, travel_px: F64, turn_px: F64) -> F64:
        """Return even motion, [F, 6], that displaces the middle of the picture by so much by travel, and by turning."""
        moves = np.zeros((self._degrees, 6))
        moves[0, :2] = travel_px / self._focal_px
        moves[0, 3:5] = -turn_px[1] / self._focal_px[1], turn_px[0] / self._focal_px[0]
        return moves

    def _explained(self, moves: F64) -> tuple[F64, F64, F64, F64]:
        """Return what turns leave, what travel explains at inverse depth 1, [B, 2 F], best depths, and errors."""
        left, along = self._px - self._by_turns @ moves.ravel(), self._along(moves)
        depth = ((along * left).sum(axis=1) + _TIGHT) / ((along**2).sum(axis=1) + _TIGHT)
        depth = np.clip(depth, *_DEPTH_RANGE)
        return left, along, depth, np.column_stack([left - depth[:, None] * along, (depth - 1) / _DEPTH_SPREAD])

    def _errors(self, moves: F64) -> tuple[F64, F64, F64]:
        """Return what moves, [F, 6], are off by: errors to be squared and added; inverse depths and costs, [B]."""
        _, _, depth, errors = self._explained(moves)
        off = (errors**2).sum(axis=1)
        weight = 2 / (1 + np.sqrt(1 + off / _OUTLIER**2))
        return (errors * np.sqrt(weight)[:, None]).ravel(), depth, weight * off

    def _derivative(self, moves: F64) -> F64:
        """Return the derivative of these errors by moves, [errors, 6 F]."""
        left, along, depth, errors = self._explained(moves)
        free = ((depth > _DEPTH_RANGE[0]) & (depth < _DEPTH_RANGE[1])) / ((along**2).sum(axis=1) + _TIGHT)
        by_depth = np.einsum("bi,bik->bk", left - 2 * depth[:, None] * along, self._by_travels)
        by_depth = free[:, None] * (by_depth - np.einsum("bi,bik->bk", along, self._by_turns))
        by_left = -self._by_turns - depth[:, None, None] * self._by_travels - along[..., None] * by_depth[:, None]
        by_moves = np.concatenate([by_left, by_depth[:, None] / _DEPTH_SPREAD], axis=1)
        root = np.sqrt(1 + (errors**2).sum(axis=1) / _OUTLIER**2)
        # The weight is √(2 / (1 + root)); its logarithm falls by this with half of the squares' sum.
        falls = errors / (2 * _OUTLIER**2 * root * (1 + root))[:, None]
        by_moves -= falls[..., None] * np.einsum("bi,bik->bk", errors, by_moves)[:, None]
        return (by_moves * np.sqrt(2 / (1 + root))[:, None, None]).reshape(-1, moves.size)


def displaced_motion(request: Request, tracks: Geometry) -> Geometry:
    """Estimate the motion from displacements of blocks, and the depth along it from the decoded views.

    Args:
        request: The measurement, and its decoded views.
        tracks: The tracks' geometry, of which only the camera matrix and the middle view are used.

    Returns:
        The geometry; a camera at rest, "unsupported", if too few blocks tell, no camera explains them, one that
        only turned nearly does, or halves of them disagree.
    """
    still, criteria = at_rest(tracks), request.settings.criteria
    without = replace(still, source=PathSource.DISPLACEMENTS, notes=(*still.notes, PLANE_NOTE))
    blocks = blocks_of(request, tracks)
    if blocks is None or len(blocks) < criteria.tracks or len(request.views) < LEAST_VIEWS:
        return without
    here = blocks.motion()
    if here.cost > _MOST_OFF or blocks.turn().cost < _LEAST_PARALLAX * here.cost:
        return without
    expected = expected_error(blocks, here, tracks.reference)
    if expected is None or not halves_agree(expected, criteria):
        return without
    there = blocks.adjusted(_reversed(here))
    notes = (
        finding(Code.PATH_BY_DISPLACEMENTS, blocks=len(blocks), share=expected),
        *doubts_about_path(expected, criteria),
    )
    found = _seen_along(request, replace(without, verdict=Verdict.FULL, path_error_expected=expected), blocks, here)
    kept = tuple(note for note in still.notes if note.code not in _OVERRULED)
    found = replace(found, notes=(*kept, *notes))
    if np.corrcoef(here.inverse_depth, there.inverse_depth)[0, 1] >= 0:
        return found
    # Each block has a vote.
    errors = in_standard_errors(there.off - here.off)
    reverse = replace(_seen_along(request, found, blocks, there), order_errors=-errors)
    return replace(
        found, order_errors=errors, other_order=OtherOrder.of(reverse) if errors < criteria.order_errors else None
    )


def say_how_found(found: Geometry, progress: Progress) -> None:
    """Say where a path comes from, after the tracks have said why they have none; nothing if there is none."""
    for note in found.notes:
        if note.code == Code.PATH_BY_DISPLACEMENTS:
            progress.say(note.sentence)


def blocks_of(request: Request, found: Geometry) -> DisplacedBlocks | None:
    """Return the displaced blocks of a measurement; None if none tells.

    Args:
        request: The measurement.
        found: A geometry with the camera matrix.
    """
    displaced = displacements(request.shot, _ROUNDS)
    if displaced is None:
        return None
    places = displaced.centres_px
    if request.lens is not None:
        places, displaced = _straightened(displaced, request.lens.sampling.places)
    focal_px = np.diag(found.intrinsics)[:2].astype(np.float64)
    return DisplacedBlocks(displaced, slopes_of(places, found.intrinsics), focal_px)


def _straightened(displaced: BlockDisplacements, on_canvas: F64) -> tuple[F64, BlockDisplacements]:
    """Return where blocks lie behind a lens, [B, 2] px, and their displacements, as on the canvas of straight views.

    A lens stretches displacements by where they are, which would look like parallax.

    Args:
        displaced: On the sensor.
        on_canvas: Where each pixel of the sensor lies on the canvas, [H, W, (x, y)].
    """
    height, width = on_canvas.shape[:2]
    columns, rows = np.minimum(displaced.centres_px, (width - 1, height - 1)).astype(np.int64).T
    down, right = (np.gradient(on_canvas, axis=axis) for axis in (0, 1))
    stretch = np.stack([right[rows, columns], down[rows, columns]], axis=-1)  # [B, (x, y), by (x, y)]
    ways = np.eye(len(displaced.over_time))
    whole = np.einsum("fg,bij->bfigj", ways, stretch).reshape(len(stretch), 2 * len(ways), 2 * len(ways))
    moved = replace(
        displaced,
        px=np.einsum("bij,bj->bi", whole, displaced.px),
        covariance=whole @ displaced.covariance @ whole.swapaxes(1, 2),
    )
    return on_canvas[rows, columns], moved


def _seen_along(request: Request, geometry: Geometry, blocks: DisplacedBlocks, motion: BlockMotion) -> Geometry:
    """Return the geometry with the poses of a motion, and the depth along it.

    The depth is the mean of two maps: that at which the decoded views agree, fine where the parallax is several pixels
    and noise where it is one, and that of the blocks, coarse and never noise. Of 27 small motions the mean's rank
    correlation with the true depth was that of the better map or more in 21
    (docs/decisions/sources-of-geometry.md).
    """
    settings = request.settings.sweep
    poses = _poses(motion.moves, blocks.displaced.over_time, geometry.reference)
    span = inverse_depth_range(motion.inverse_depth, settings)
    swept = sweep(request.views, poses, geometry.intrinsics, geometry.reference, span, settings)
    coarse = straightened(blocks.depth_map(motion, request.shot.size)[None, ..., None], request.lens)[0, ..., 0]
    depth = 0.5 * (swept + coarse)
    median = float(np.median(depth))
    poses[:, :3, 3] *= median
    return replace(geometry, world_to_camera=poses, inverse_depth=(depth / median).astype(np.float32))


def _poses(moves: F64, over_time: F64, reference: int) -> F64:
    """Return world-to-camera poses, [N, 4, 4], of moves, [F, 6]; the identity for the reference view."""
    each = over_time.T @ moves
    found = relative_to(rigid(Rotation.from_rotvec(each[:, 3:]).as_matrix(), each[:, :3]), reference)
    found[reference] = np.eye(4)
    return found


def expected_error(blocks: DisplacedBlocks, motion: BlockMotion, reference: int) -> float | None:
    """Return the expected error of a path, from halves of the blocks; see `halves`.

    None if the camera stays in place.
    """

    def path(moves: F64) -> F64:
        return _poses(moves, blocks.displaced.over_time, reference)

    def again(half: Bool) -> F64:
        return path(blocks.subset(half).adjusted(motion.moves).moves)

    return error_from_halves(path(motion.moves), np.arange(len(blocks)), again)


def _reversed(motion: BlockMotion) -> F64:
    """Return moves, [F, 6], near those of the reverse order of depth; see `reversal`."""
    c = 2 * float(np.median(motion.inverse_depth))
    moves = motion.moves.copy()
    moves[:, :3] *= -1
    moves[:, 3] += -c * motion.moves[:, 1]
    moves[:, 4] += c * motion.moves[:, 0]
    return moves
