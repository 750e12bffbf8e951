import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.render.gaussians import rotation_matrices
from gs2ci_sims.scenes.surfels import (
    MAX_STRETCH,
    SPREAD,
    from_inverse_depth,
    from_tangents,
    gaussians_from_parts,
    gaussians_from_surfels,
    join,
    surface_slope,
)

INTRINSICS = np.array([[80.0, 0, 20.0], [0, 90.0, 15.0], [0, 0, 1]])
SHAPE = (30, 40)


def covariances(surfels):
    axes = rotation_matrices(torch.tensor(surfels.quaternions)).numpy()
    return np.einsum("nij,nj,nkj->nik", axes, surfels.scales**2, axes)


def projected(surfels):
    """Screen covariances at the reference camera, [n, 2, 2] px²."""
    x, y, z = surfels.means.T
    zero = np.zeros_like(z)
    fx, fy = INTRINSICS[0, 0], INTRINSICS[1, 1]
    rows = [[fx / z, zero, -fx * x / z**2], [zero, fy / z, -fy * y / z**2]]
    jacobian = np.moveaxis(np.array(rows), -1, 0)
    return jacobian @ covariances(surfels) @ jacobian.transpose(0, 2, 1)


def tilted_plane():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return 0.3 + 0.002 * x - 0.001 * y


def laid(inverse_depth, present=None, jump=np.inf):
    present = np.ones(SHAPE, dtype=bool) if present is None else present
    return from_inverse_depth(inverse_depth, np.full((*SHAPE, 3), 0.5), present, INTRINSICS, jump)


def test_on_a_tilted_plane_every_disc_is_round_on_screen_and_as_wide_as_the_spread():
    screen = projected(laid(tilted_plane()))
    np.testing.assert_allclose(screen, np.tile(SPREAD**2 * np.eye(2), (len(screen), 1, 1)), atol=0.02)


def test_discs_lie_on_the_plane_and_their_thin_axis_is_its_normal():
    surfels = laid(tilted_plane())
    centred = surfels.means - surfels.means.mean(axis=0)
    normal = np.linalg.svd(centred)[2][2] if len(centred) < 100 else np.linalg.eigh(centred.T @ centred)[1][:, 0]
    assert np.abs(centred @ normal).max() < 1e-9
    thin = rotation_matrices(torch.tensor(surfels.quaternions)).numpy()[:, :, 2]
    assert np.abs(thin @ normal).min() > 0.999


def test_centres_project_to_pixel_centres():
    means = laid(tilted_plane()).means
    pixels = means @ INTRINSICS.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    np.testing.assert_allclose(pixels, np.stack([x.ravel(), y.ravel()], 1) + 0.5, atol=1e-9)


def test_discs_do_not_lean_across_a_depth_edge():
    step = np.where(np.arange(SHAPE[1]) < 20, 0.5, 0.25) * np.ones(SHAPE)
    thickness = covariances(laid(step, jump=0.05))[:, 2, 2]
    assert thickness.max() < (0.1 * 4 / 80) ** 2
    assert covariances(laid(step))[:, 2, 2].max() > 100 * thickness.max()


def test_a_grazing_surface_is_stretched_only_so_far():
    steep = 0.05 + 0.05 * np.arange(SHAPE[1]) * np.ones(SHAPE)
    surfels = laid(steep)
    pixel = surfels.means[:, 2] / INTRINSICS[0, 0]
    assert (surfels.scales.max(axis=1) <= 1.3 * SPREAD * (1 + MAX_STRETCH) * pixel).all()


def test_absent_pixels_get_no_disc():
    present = np.zeros(SHAPE, dtype=bool)
    assert len(laid(tilted_plane(), present)) == 0
    present[3, 4] = True
    assert len(laid(tilted_plane(), present)) == 1


def test_skewed_tangents_span_the_covariance_u_ut_plus_v_vt():
    rng = np.random.default_rng(0)
    u, v = rng.normal(size=(2, 50, 3))
    surfels = from_tangents(np.zeros((50, 3)), u, v, np.zeros((50, 3)))
    expected = SPREAD**2 * (np.einsum("ni,nj->nij", u, u) + np.einsum("ni,nj->nij", v, v))
    thickness = surfels.scales[:, 2] ** 2
    error = np.linalg.norm(covariances(surfels) - expected, axis=(1, 2))
    np.testing.assert_allclose(error, thickness, rtol=1e-6)


def test_parallel_tangents_are_refused():
    along = np.array([[1.0, 0, 0]])
    with pytest.raises(InputError, match="parallel or zero"):
        from_tangents(np.zeros((1, 3)), along, 2 * along, np.zeros((1, 3)))


def test_joined_surfels_come_one_after_the_other():
    surfels = laid(tilted_plane())
    both = join([surfels, surfels])
    assert len(both) == 2 * len(surfels)
    assert np.array_equal(both.quaternions[len(surfels) :], surfels.quaternions)


def test_slopes_are_exact_on_a_plane_and_one_sided_at_an_edge():
    values = 0.5 * np.arange(6.0)[None] + np.where(np.arange(6) < 3, 0.0, 100.0)
    everywhere = np.ones((1, 6), dtype=bool)
    assert surface_slope(values, everywhere, 1, jump=1.0).tolist() == [[0.5] * 6]
    assert surface_slope(values, everywhere, 0, jump=1.0).tolist() == [[0.0] * 6]
    lonely = np.array([[True, False, True, False, True, False]])
    assert not surface_slope(values, lonely, 1, jump=1.0).any()


def test_discs_do_not_depend_on_how_many_are_placed_at_once(monkeypatch):
    whole = laid(tilted_plane())
    monkeypatch.setattr("gs2ci_sims.scenes.surfels._AT_ONCE", 7)
    parted = laid(tilted_plane())
    np.testing.assert_array_equal(parted.scales, whole.scales)
    np.testing.assert_array_equal(parted.quaternions, whole.quaternions)


def test_no_points_give_no_discs():
    assert len(from_tangents(*np.zeros((4, 0, 3)))) == 0


def test_parts_give_the_scene_of_all_their_surfels():
    parts = [laid(tilted_plane()), laid(tilted_plane() + 0.1)]
    whole = gaussians_from_surfels(join(parts)).parameters()
    for name, column in gaussians_from_parts(iter(parts)).parameters().items():
        torch.testing.assert_close(column, whole[name], rtol=0, atol=0)
