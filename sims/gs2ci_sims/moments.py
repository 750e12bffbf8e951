"""At which moments views are rendered, and how they stand for all the others: product integration over time.

What a pixel collects is ∫ g(t) L(t) dt: the light L that the scene sends there, weighted by what masks, shutter and
lamp let through, g. L is smooth in time (the image moves), g is not (masks switch); so L alone is sampled, at the
Gauss-Legendre nodes of a few panels of time, interpolated between them by Lagrange's polynomials, and g is integrated
against these exactly (product integration: Davis and Rabinowitz, Methods of Numerical Integration, section 2.5.6).
A camera at rest needs one view for all masks; a slow one fewer views than there are masks. Not here: who chooses the
panels (`planner`), who renders (`exposure`).
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci_sims.signals import Slices


@dataclass(frozen=True)
class Moments:
    """Panels of time with the same number of views in each.

    Args:
        edges_s: Ends of the panels, [P + 1], increasing; times outside belong to the first or last panel.
        nodes: Views per panel, at least 1.
    """

    edges_s: F64
    nodes: int

    def __post_init__(self) -> None:
        if self.nodes < 1 or len(self.edges_s) < 2 or not (np.diff(self.edges_s) > 0).all():
            raise InputError(
                f"{self.nodes} views in each of {len(self.edges_s) - 1} panels of time",
                allowed="1 or more views in 1 or more panels of positive length",
            )

    @property
    def times_s(self) -> F64:
        """Get the moments, [P * nodes], increasing."""
        start, length = self.edges_s[:-1, None], np.diff(self.edges_s)[:, None]
        return np.asarray(start + length * gauss_nodes(self.nodes)).ravel()

    def weights_s(self, slices: Slices) -> F64:
        """Return for how much of each slice each moment stands, [K, S] seconds; columns add up to the durations."""
        first, last = self._panel(slices.start_s), self._panel(slices.stop_s)
        # One piece per slice and panel that it meets.
        pieces = last - first + 1
        of_slice = np.repeat(np.arange(len(first)), pieces)
        panel = first[of_slice] + np.arange(len(of_slice)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        start = np.where(panel == first[of_slice], slices.start_s[of_slice], self.edges_s[panel])
        stop = np.where(panel == last[of_slice], slices.stop_s[of_slice], self.edges_s[panel + 1])
        # Polynomials of degree nodes - 1 are integrated exactly by half as many Gauss points on each piece.
        enough = -(-self.nodes // 2)
        points, gauss, width = gauss_nodes(enough), gauss_weights(enough), np.diff(self.edges_s)[panel]
        place = (start[:, None] + (stop - start)[:, None] * points - self.edges_s[panel][:, None]) / width[:, None]
        basis = lagrange(gauss_nodes(self.nodes), place.ravel()).reshape(*place.shape, self.nodes)
        weights = np.zeros((len(self.edges_s) - 1, self.nodes, len(first)))
        weights[panel, :, of_slice] = (stop - start)[:, None] * np.einsum("g,pgn->pn", gauss, basis)
        return weights.reshape(-1, len(first))

    def _panel(self, times_s: F64) -> NDArray[np.intp]:
        """Return to which panel each time belongs."""
        return np.clip(np.searchsorted(self.edges_s, times_s, side="right") - 1, 0, len(self.edges_s) - 2)


def one_per_interval(intervals_s: F64) -> Moments:
    """Return the moments of a simulation without motion blur: the middle of each mask interval [N, 2].

    With dark gaps between the intervals, panels meet in the middle of the gaps, and their middles with them.
    """
    between = 0.5 * (intervals_s[1:, 0] + intervals_s[:-1, 1])
    half_gap = 0.5 * (intervals_s[1, 0] - intervals_s[0, 1]) if len(intervals_s) > 1 else 0.0
    return Moments(np.concatenate([[intervals_s[0, 0] - half_gap], between, [intervals_s[-1, 1] + half_gap]]), 1)


@cache
def gauss_nodes(count: int) -> F64:
    """Return the Gauss-Legendre nodes on [0, 1]."""
    return 0.5 + 0.5 * np.polynomial.legendre.leggauss(count)[0]


@cache
def gauss_weights(count: int) -> F64:
    """Return the Gauss-Legendre weights on [0, 1]; they add up to 1."""
    return 0.5 * np.polynomial.legendre.leggauss(count)[1]


def lagrange(nodes: F64, places: F64) -> F64:
    """Evaluate Lagrange's basis polynomials of the nodes [n] at the places [T], [T, n].

    By the barycentric formula (Berrut and Trefethen, SIAM Review 46, 2004, section 4).
    """
    apart = nodes[:, None] - nodes + np.eye(len(nodes))
    difference = places[:, None] - nodes
    at_node = difference == 0
    share = 1 / (apart.prod(axis=1) * np.where(at_node, 1.0, difference))
    hit = at_node.any(axis=1)
    share[hit] = at_node[hit]
    return share / share.sum(axis=1, keepdims=True)
