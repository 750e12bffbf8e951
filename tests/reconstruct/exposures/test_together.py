"""All exposures adjusted to the corners that they see: the solution, its derivatives, wrong corners and depths."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.cameras import pinhole
from gs2ci.reconstruct.exposures import together
from gs2ci.reconstruct.exposures.similarity import CHANGES, Similarity
from gs2ci.reconstruct.exposures.together import Corners, adjusted_together

SIZE = (96, 128)


def drawn_cloud(points):
    return np.random.default_rng(5).uniform((-0.6, -0.4, 1.5), (0.6, 0.4, 2.6), (points, 3))


def drawn(exposures=4, points=150, seed=0, noise_px=0.0, wrong=0.0, stretch=0.0):
    """Draw exposures around a cloud of points, each with its own unit; each hosts some, all see all."""
    rng = np.random.default_rng(seed)
    cloud = drawn_cloud(points)
    matrix, similarities = pinhole(150.0, SIZE), []
    for k in range(exposures):
        turn = Rotation.from_rotvec(0.05 * rng.normal(size=3) * (k > 0)).as_matrix()
        scale = float(rng.uniform(0.6, 1.6)) if k else 1.0
        similarities.append(Similarity(scale, turn, 0.3 * rng.normal(size=3) * (k > 0)))
    hosts = rng.integers(0, exposures, points)
    own = np.stack([similarities[h].inverse.points(p) for h, p in zip(hosts, cloud, strict=True)])
    own *= np.exp(stretch * rng.normal(size=(points, 1)))
    of, by, places = [], [], []
    for p in range(points):
        for k in range(exposures):
            if k != hosts[p]:
                seen = matrix @ similarities[k].inverse.points(cloud[p])
                of.append(p), by.append(k), places.append(seen[:2] / seen[2])
    places = np.array(places) + noise_px * rng.normal(size=(len(of), 2))
    spoilt = rng.random(len(of)) < wrong
    places[spoilt] += 20 * rng.normal(size=(int(spoilt.sum()), 2))
    corners = Corners(
        own,
        hosts,
        np.zeros((points, 3)),
        np.array(of),
        np.array(by),
        np.tile(np.eye(4), (len(of), 1, 1)),
        np.tile(matrix, (len(of), 1, 1)),
        places,
    )
    return similarities, corners


def perturbed(similarities, seed=1):
    rng = np.random.default_rng(seed)
    change = np.array([0.02] * 3 + [0.03] * 3 + [0.1])
    centre = np.array([0, 0, 2.0])
    moved = [
        one.changed(change * rng.normal(size=CHANGES), one.inverse.points(centre), 2.0) for one in similarities[1:]
    ]
    return [similarities[0], *moved]


def adjusted(start, corners):
    return adjusted_together(start, corners, np.tile([0, 0, 2.0], (len(start), 1)), np.full(len(start), 2.0))


def off(found, true):
    """Return how far similarities move a cloud from where the true ones do, at most; their common scale is open."""
    cloud = np.random.default_rng(2).uniform((-0.5, -0.4, 1.5), (0.5, 0.4, 2.6), (40, 3))
    here, there = (np.stack([one.translation for one in side]) for side in (found.similarities, true))
    factor = (here * there).sum() / (there**2).sum()
    pairs = list(zip(found.similarities, true, strict=True))[1:]
    return max(
        np.linalg.norm(one.points(right.inverse.points(cloud)) - factor * cloud, axis=1).max() for one, right in pairs
    )


def test_exact_corners_give_the_true_similarities_from_perturbed_ones():
    true, corners = drawn()
    found = adjusted(perturbed(true), corners)
    assert off(found, true) < 0.02
    assert np.median(found.distances_px) < 0.01
    assert found.covariance.shape == (3 * CHANGES, 3 * CHANGES)
    assert (np.diag(found.covariance) > 0).all()


def test_noise_wrong_corners_and_wrong_depths_change_little():
    true, corners = drawn(noise_px=0.3, wrong=0.1, stretch=0.15)
    found = adjusted(perturbed(true), corners)
    assert off(found, true) < 0.06
    assert np.median(found.distances_px) < 0.5
    # Depths are put right where they were wrong.
    right = np.array([true[h].inverse.points(p) for h, p in zip(corners.hosts, drawn_cloud(150), strict=True)])[:, 2]
    before, after = corners.points[:, 2] / right, corners.points[:, 2] * found.stretches / right
    assert np.std(np.log(after)) < 0.3 * np.std(np.log(before))


def test_the_first_is_held():
    true, corners = drawn()
    found = adjusted(perturbed(true), corners)
    np.testing.assert_array_equal(found.similarities[0].rotation, np.eye(3))
    assert found.similarities[0].scale == 1


def test_the_slopes_are_those_of_differences():
    true, corners = drawn(points=12, noise_px=0.5)
    state = together._State(tuple(perturbed(true)), 0.1 * np.random.default_rng(3).normal(size=12))
    centres, units = np.tile([0, 0, 2.0], (4, 1)), np.full(4, 2.0)
    normal = together._equations(state, corners, centres, units)
    step = 1e-6
    for k in range(4 * CHANGES + 12):
        changes, along = np.zeros(4 * CHANGES), np.zeros(12)
        (changes if k < 4 * CHANGES else along)[k if k < 4 * CHANGES else k - 4 * CHANGES] = step
        ends = [
            together._equations(
                together._moved(state, (s * changes.reshape(-1, CHANGES), s * along), centres, units),
                corners,
                centres,
                units,
            ).cost
            for s in (1, -1)
        ]
        slope = normal.slope[k] if k < 4 * CHANGES else normal.along_slope[k - 4 * CHANGES]
        assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(slope, rel=1e-4, abs=1e-3)
