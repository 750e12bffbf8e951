"""SPZ files, read by a reader of somebody else's (gsply)."""

from dataclasses import replace

import gsply
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import InputError
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.harmonics import basis, coefficients
from gs2ci.render.spz import write_spz


def some(count=200, spread=1.0):
    draws = torch.Generator().manual_seed(3)

    def normal(*shape):
        return torch.randn(shape, generator=draws)

    return Gaussians(
        spread * normal(count, 3),
        -3 + normal(count, 3),
        normal(count, 4),
        2 * normal(count),
        torch.rand(count, 3, generator=draws),
    )


@pytest.mark.parametrize("spread", [1e-3, 1.0, 1e5])
def test_a_foreign_reader_finds_the_same_scene(tmp_path, spread):
    scene = some(spread=spread)
    read = gsply.read_spz(str(write_spz(tmp_path / "scene.spz", scene)))
    # SPZ has y up and z behind; ours y down and z ahead.
    farthest = float(scene.means.abs().max())
    np.testing.assert_allclose(read.means * (1, -1, -1), scene.means, atol=max(2.0**-20, farthest * 2.0**-22))
    np.testing.assert_allclose(read.scales, scene.log_scales, atol=1 / 32 + 1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-read.opacities)), torch.sigmoid(scene.opacity_logits), atol=0.005)
    np.testing.assert_allclose(0.5 + 0.28209479 * read.sh0, scene.colours, atol=0.005)
    half_turn = Rotation.from_euler("x", np.pi)
    wanted = half_turn * Rotation.from_quat(scene.quaternions.numpy(), scalar_first=True)
    found = Rotation.from_quat(read.quats, scalar_first=True)
    # Axes of a Gaussian may be turned by half a turn: the ellipsoid is what counts.
    scales = np.exp(scene.log_scales.double().numpy())
    own = [r.as_matrix() @ (s[:, None] ** 2 * np.eye(3)) @ r.as_matrix().T for r, s in zip(wanted, scales, strict=True)]
    his = [r.as_matrix() @ (s[:, None] ** 2 * np.eye(3)) @ r.as_matrix().T for r, s in zip(found, scales, strict=True)]
    errors = np.linalg.norm(np.subtract(own, his), axis=(1, 2)) / np.linalg.norm(own, axis=(1, 2))
    assert errors.max() < 0.08  # scales alone leave 6.4 % of their squares


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_foreign_reader_finds_the_harmonics_in_its_own_axes(tmp_path, degree):
    draws = torch.Generator().manual_seed(5)
    scene = replace(some(50), harmonics=0.3 * torch.randn(50, coefficients(degree), 3, generator=draws).clamp(-3, 3))
    read = gsply.read_spz(str(write_spz(tmp_path / "scene.spz", scene)))
    found = torch.from_numpy(np.asarray(read.shN, np.float64).reshape(50, -1, 3))
    assert found.shape == scene.harmonics.shape
    # Seen from the same place along the same line, in axes with y up and z behind.
    flip = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
    sight = torch.nn.functional.normalize(torch.randn(50, 3, generator=draws, dtype=torch.float64), dim=1)
    own = torch.einsum("gk,gkc->gc", basis(sight)[:, : found.shape[1]], scene.harmonics.double())
    his = torch.einsum("gk,gkc->gc", basis(sight @ flip)[:, : found.shape[1]], found)
    # Each coefficient is off by 1/256 at most.
    torch.testing.assert_close(his, own, rtol=0, atol=found.shape[1] * 0.6 / 256)


def test_the_ends_of_the_range(tmp_path):
    empty = write_spz(tmp_path / "empty.spz", some().map(lambda tensor: tensor[:0]))
    assert empty.stat().st_size < 60
    with pytest.raises(InputError, match=r"units away.*4\.19e\+06"):
        write_spz(tmp_path / "far.spz", some(spread=1e8))
    assert not (tmp_path / "far.spz").exists()
    edge = some(2)
    edge.means[0] = torch.tensor([2.0**21 - 0.25, 0, 0])
    edge.quaternions[:] = 0
    edge.colours[0] = torch.tensor([-9.0, 0, 9])
    read = gsply.read_spz(str(write_spz(tmp_path / "edge.spz", edge)))
    assert read.means[0, 0] == pytest.approx(2.0**21, rel=1e-6)
    np.testing.assert_allclose(np.abs(read.quats[:, 0]), 1, atol=0.001)
