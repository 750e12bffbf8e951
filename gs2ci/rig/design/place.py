"""One place of a scene: what readings tell of its texture and its depth together (Gauss-Newton), and of wanted views.

Here: the linear readings of a square of the middle wanted view, their normal matrix, its inverse. Not here: which
places are looked at, and what no view shows (`telling`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.ndimage import map_coordinates
from scipy.sparse import coo_matrix, csr_matrix

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.uncertainty.factors import factors

Numbers = NDArray[np.int64]

SIDE_PX: Final = 6
"""Of a place, px."""
REPRESENTED: Final = 0.016
"""What a fitted scene errs by in each view however well it is determined, full scale 1; on three sets of eighteen
captures of the scenes planes and blocks."""
# What is known of a depth beforehand, as a share of it.
_DEPTH_PRIOR: Final = 0.3
# A flow's change with depth is that over so small a share of it.
_SMALL: Final = 0.01
_LEAST_POWER: Final = 1e-12
_AHEAD: Final = 1e-9


@dataclass(frozen=True, eq=False)
class Readings:
    """The readings of a candidate's exposures.

    Args:
        masks: Of each, [K, N, H, W].
        element: Pixels per side of their elements.
        poses: Of the camera at each mask, [N, 4, 4].
        depth: Of the first and the last view, [2, H, W].
        full_scale_e: Electrons of white through one open mask.
        full_well_e: Electrons that a pixel holds.
        dark_e2: Variance of a reading in the dark, electrons squared.
    """

    masks: F32
    element: int
    poses: F64
    depth: F32
    full_scale_e: float
    full_well_e: float
    dark_e2: float


@dataclass(frozen=True)
class Texture:
    """What is known of a texture beforehand.

    Args:
        variance: About the mean of its place, full scale 1.
        alike: Correlation from pixel to pixel.
    """

    variance: float
    alike: float

    @classmethod
    def of(cls, picture: F64) -> "Texture":
        """Return that of a whole picture, [H, W]."""
        variance = float(picture.var())
        steps = 0.5 * (np.square(np.diff(picture, axis=0)).mean() + np.square(np.diff(picture, axis=1)).mean())
        alike = 1 - float(steps) / (2 * max(variance, _LEAST_POWER))
        return cls(max(variance, _LEAST_POWER), float(np.clip(alike, 0.3, 0.995)))


@dataclass(frozen=True)
class PlaceErrors:
    """Powers of the errors of a place in the wanted views; full scale 1.

    Args:
        texture: If its depth were known.
        depth: Beyond that.
        clipped: Share of the readings that are clipped.
    """

    texture: float
    depth: float
    clipped: float


@dataclass(frozen=True, eq=False)
class Place:
    """A square of the middle wanted view, and how it moves.

    Args:
        row: First row of the square.
        column: First column.
        flows: To each recorded view, (right, down) px, [N, 2].
        by_depth: The flows' change with the logarithm of depth, [N, 2].
        wanted_by_depth: That of the flows to the wanted views, [S, 2].
    """

    row: int
    column: int
    flows: F64
    by_depth: F64
    wanted_by_depth: F64

    def errors(self, picture: F64, of: Readings, prior: Texture) -> PlaceErrors:
        """Return how the place errs in the wanted views.

        Args:
            picture: The middle wanted view, grey, [H, W].
            of: The readings.
            prior: What is known of its texture.
        """
        rows, columns = self._read_pixels(picture.shape)
        if not rows.size or not columns.size:  # no reading shows it
            return PlaceErrors(prior.variance, 0.0, 0.0)
        low, grid = self._grid(rows, columns)
        ys, xs = (part.ravel() for part in np.meshgrid(rows, columns, indexing="ij"))
        seen = _Seen.by(picture, self, ys, xs, low, grid)
        information = np.zeros((grid[0] * grid[1] + 1,) * 2)
        information[:-1, :-1] = _precision(grid, prior)
        information[-1, -1] = 1 / _DEPTH_PRIOR**2
        clipped = [seen.add(information, masks[:, ys, xs].astype(np.float64), of) for masks in of.masks]
        texture, depth = self._of_wanted(information, picture, low, grid)
        return PlaceErrors(texture, depth, float(np.mean(clipped)))

    def _read_pixels(self, size: tuple[int, ...]) -> tuple[Numbers, Numbers]:
        """Return the rows and columns of the pixels whose readings hold light of the place."""
        (right, down), (left, up) = self.flows.max(axis=0), self.flows.min(axis=0)
        rows = np.arange(max(0, int(self.row + up) - 1), min(size[0], int(self.row + SIDE_PX + down) + 2))
        columns = np.arange(max(0, int(self.column + left) - 1), min(size[1], int(self.column + SIDE_PX + right) + 2))
        return rows, columns

    def _grid(self, rows: Numbers, columns: Numbers) -> tuple[Numbers, tuple[int, int]]:
        """Return the first row and column of the texture that these readings ask for, and its size."""
        (right, down), (left, up) = self.flows.max(axis=0), self.flows.min(axis=0)
        own = np.array((self.row, self.column))
        low = np.minimum(np.floor((rows[0] - down, columns[0] - right)).astype(np.int64), own) - 1
        high = np.maximum(np.ceil((rows[-1] - up, columns[-1] - left)).astype(np.int64), own + SIDE_PX) + 2
        return low, (int(high[0] - low[0]), int(high[1] - low[1]))

    def _of_wanted(self, information: F64, picture: F64, low: Numbers, grid: tuple[int, int]) -> tuple[float, float]:
        """Return the mean powers of the errors in the wanted views: with the depth known, and beyond that."""
        inside = np.arange(SIDE_PX)
        ys, xs = (part.ravel() for part in np.meshgrid(self.row + inside, self.column + inside, indexing="ij"))
        numbers = (ys - int(low[0])) * grid[1] + xs - int(low[1])
        asked = np.zeros((len(information), len(numbers) + 1))
        asked[numbers, np.arange(len(numbers))] = 1
        asked[-1, -1] = 1
        covariance = cho_solve(cho_factor(information), asked)
        texture = covariance[numbers, np.arange(len(numbers))]
        of_depth, between = covariance[-1, -1], covariance[numbers, -1]
        down, across = _slopes(picture)
        moved = -(
            np.outer(self.wanted_by_depth[:, 0], across[ys, xs]) + np.outer(self.wanted_by_depth[:, 1], down[ys, xs])
        )
        whole = texture + 2 * moved * between + moved**2 * of_depth
        # What texture and depth have in common is taken out.
        known = texture - between**2 / of_depth
        return float(known.mean()), float(np.maximum(whole - known, 0).mean())


@dataclass(frozen=True, eq=False)
class _Seen:
    """What pixels see of a place through each mask if it is open.

    Args:
        looks: Matrices from the texture to their values, one for each mask.
        values: These values, [N, P].
        slopes: Their change with the logarithm of depth, [N, P].
        alike: How much what a scene lacks is alike in two views, [N, N].
    """

    looks: Sequence[csr_matrix]
    values: F64
    slopes: F64
    alike: F64

    @classmethod
    def by(cls, picture: F64, place: Place, ys: Numbers, xs: Numbers, low: Numbers, grid: tuple[int, int]) -> "_Seen":
        down, across = _slopes(picture)
        looks, values, slopes = [], [], []
        for (right_px, down_px), (right, below) in zip(place.flows, place.by_depth, strict=True):
            at = ys - down_px, xs - right_px
            looks.append(_interpolation(at[0] - low[0], at[1] - low[1], grid))
            values.append(_read(picture, at))
            slopes.append(-(_read(across, at) * right + _read(down, at) * below))
        apart = np.square(place.flows[:, None] - place.flows[None]).sum(axis=-1)
        return cls(looks, np.array(values), np.array(slopes), np.exp(-apart / (2 * factors.alike_px**2)))

    def add(self, information: F64, light: F64, of: Readings) -> float:
        """Add what one exposure's readings tell to a normal matrix; return the share of them that is clipped.

        Args:
            information: Of texture and depth, [U + 1, U + 1].
            light: Transmissions of the masks at the pixels, [N, P].
            of: The readings.
        """
        charge_e = of.full_scale_e * (light * self.values).sum(axis=0)
        clipped = charge_e >= of.full_well_e
        # What a scene lacks is attached to surfaces: alike in views that move little, and at neighbouring pixels, all
        # of which an element of several pixels reads alike.
        lacking = (REPRESENTED * of.element) ** 2 * (light * (self.alike @ light)).sum(axis=0)
        noise = (charge_e + of.dark_e2) / of.full_scale_e**2 + lacking
        weight = np.where(clipped, 0.0, 1 / np.sqrt(np.maximum(noise, _LEAST_POWER)))
        by_texture = csr_matrix(self.looks[0].shape)
        for share, look in zip(light, self.looks, strict=True):
            by_texture = by_texture + look.multiply((share * weight)[:, None])
        by_texture = by_texture.tocsr()
        by_depth = weight * (light * self.slopes).sum(axis=0)
        between = by_texture.T @ by_depth
        information[:-1, :-1] += (by_texture.T @ by_texture).toarray()
        information[:-1, -1] += between
        information[-1, :-1] += between
        information[-1, -1] += by_depth @ by_depth
        return float(clipped.mean())


def flows(matrix: F64, middle: F64, poses: F64, row: int, column: int, depth: float) -> tuple[F64, F64]:
    """Return how far what a pixel shows moves to other poses, and by how much more per logarithm of depth.

    Args:
        matrix: Of the camera, [3, 3].
        middle: Its pose, [4, 4].
        poses: The other poses, [P, 4, 4].
        row: Of the pixel.
        column: Of the pixel.
        depth: What it shows, along the optical axis.

    Returns:
        (right, down) px, [P, 2] each.
    """
    ray = np.linalg.solve(matrix, np.array([column + 0.5, row + 0.5, 1.0]))
    found = []
    for scaled in (depth, depth * (1 + _SMALL)):
        point = np.linalg.solve(middle, np.append(ray * scaled, 1.0))
        there = (poses @ point)[:, :3] @ matrix.T
        found.append(there[:, :2] / np.maximum(there[:, 2:], _AHEAD) - (column + 0.5, row + 0.5))
    return found[0], (found[1] - found[0]) / np.log1p(_SMALL)


def _interpolation(ys: F64, xs: F64, grid: tuple[int, int]) -> csr_matrix:
    """Return the matrix that reads a texture on a grid at places by bilinear interpolation, [P, pixels of the grid]."""
    top, left = np.floor(ys).astype(np.int64), np.floor(xs).astype(np.int64)
    below, beside = ys - top, xs - left
    values, columns = [], []
    for down, of_row in ((0, 1 - below), (1, below)):
        for right, of_column in ((0, 1 - beside), (1, beside)):
            y, x = np.clip(top + down, 0, grid[0] - 1), np.clip(left + right, 0, grid[1] - 1)
            values.append(of_row * of_column)
            columns.append(y * grid[1] + x)
    entries = np.concatenate(values), (np.tile(np.arange(len(ys)), 4), np.concatenate(columns))
    return coo_matrix(entries, shape=(len(ys), grid[0] * grid[1])).tocsr()


def _slopes(picture: F64) -> tuple[F64, F64]:
    """Return how a picture changes downwards and to the right, [H, W] each."""
    down, across = np.gradient(picture, axis=0), np.gradient(picture, axis=1)
    return np.asarray(down, np.float64), np.asarray(across, np.float64)


def _read(image: F64, at: tuple[F64, F64]) -> F64:
    return map_coordinates(image, at, order=1, mode="nearest")


def _precision(grid: tuple[int, int], prior: Texture) -> F64:
    """Return the inverse covariance of a texture whose neighbours are alike, and farther pixels by powers of it.

    Such a field is Markov along rows and columns: the inverse is the product of two tridiagonal ones.
    """
    rows, columns = _along(grid[0], prior.alike), _along(grid[1], prior.alike)
    return np.asarray(np.kron(rows, columns) / prior.variance, np.float64)


def _along(count: int, alike: float) -> F64:
    found = np.asarray(np.diag(np.full(count, 1 + alike**2)), np.float64)
    found[[0, -1], [0, -1]] = 1
    for beside in (-1, 1):
        found -= alike * np.eye(count, k=beside)
    found /= 1 - alike**2
    return found
