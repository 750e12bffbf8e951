"""SPZ files, read by a reader of somebody else's (gsply)."""

import gzip
import struct
from dataclasses import replace

import gsply
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import InputError
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.harmonics import SH_DC, basis, coefficients, turned
from gs2ci.render.spz import fitting_scale, write_spz
from tests.render.scenes_in_units import UNITS, drawn, psnr_db, scaled, shown


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
    with pytest.raises(InputError, match="without Gaussians"):  # load-spz.cc: "invalid point count: 0"
        write_spz(tmp_path / "empty.spz", some().map(lambda tensor: tensor[:0]))
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


def as_scene(read, scale=1.0):
    """What a foreign reader found, in our axes and unit."""
    count = len(read.means)
    turn = np.array([1.0, 1, -1, -1])
    harmonics = np.asarray(read.shN if read.shN is not None else np.zeros((count, 0, 3))).reshape(count, -1, 3)
    found = Gaussians(
        torch.tensor(read.means * (1, -1, -1)),
        torch.tensor(read.scales),
        torch.tensor(read.quats * turn),
        torch.tensor(read.opacities.reshape(-1)),
        torch.tensor(0.5 + SH_DC * read.sh0),
        harmonics=turned(torch.tensor(harmonics), torch.diag(torch.tensor([1.0, -1, -1]))) if harmonics.size else None,
    )
    return scaled(found.map(torch.Tensor.float), 1 / scale)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_scene_in_any_unit_looks_as_before_in_a_foreign_reader(tmp_path, unit, degree):
    """A scene in mm, 20 m away, lost 95 % of its sizes, and a small one its positions (E1)."""
    scene = drawn(degree, unit, degree)
    scale = fitting_scale(scene)
    read = gsply.read_spz(str(write_spz(tmp_path / "scene.spz", scene, scale=scale)))
    assert psnr_db(shown(as_scene(read, scale), unit), shown(scene, unit)) >= 45
    assert (scale == 1) == (unit in (1.0, 20.0))


@pytest.mark.parametrize("unit", [1.0, 1e6])
def test_sizes_are_refused_where_they_would_be_clipped(tmp_path, unit):
    scene = drawn(5, unit * 1e4)
    with pytest.raises(InputError, match=r"sizes that SPZ cannot hold.*fitting_scale"):
        write_spz(tmp_path / "clipped.spz", scene)
    small = scaled(drawn(5), 1e-6)
    with pytest.raises(InputError, match="sizes that SPZ cannot hold"):
        write_spz(tmp_path / "clipped.spz", small)
    scene.log_scales[0], scene.log_scales[1] = 18.0, -18.0
    with pytest.raises(InputError, match=r"under one scale for all.*ply, sog or glb"):
        fitting_scale(scene)
    assert not (tmp_path / "clipped.spz").exists()
    assert fitting_scale(scene.map(lambda tensor: tensor[:0])) == 1


def test_the_thickness_of_a_disc_may_be_the_least_size(tmp_path):
    scene = drawn(6)
    scene.log_scales[:, 2] = -16
    assert fitting_scale(scene) == 1
    read = gsply.read_spz(str(write_spz(tmp_path / "discs.spz", scene)))
    assert psnr_db(shown(as_scene(read)), shown(scene)) >= 45


def version_two(path):
    """Read the rotations of a file of version 2, as its format says: x, y and z in 8 bits each."""
    body = gzip.decompress(path.read_bytes())
    magic, version, count, _, bits, _, _ = struct.unpack("<IIIBBBB", body[:16])
    assert (magic, version) == (0x5053474E, 2)
    at = 16 + count * (9 + 1 + 3)
    logs = np.frombuffer(body, np.uint8, 3 * count, at).reshape(-1, 3) / 16 - 10
    three = np.frombuffer(body, np.uint8, 3 * count, at + 3 * count).reshape(-1, 3) / 127.5 - 1
    w = np.sqrt(np.maximum(1 - (three**2).sum(axis=1), 0))
    assert bits >= 1
    assert len(body) == at + 6 * count
    return logs, np.column_stack([w, three])


def test_version_two_holds_the_same_ellipsoids_in_eight_bits_of_rotation(tmp_path):
    """Many readers know version 2 alone (E2)."""
    scene = drawn(7)
    logs, quaternions = version_two(write_spz(tmp_path / "two.spz", scene, version=2))
    turn = np.array([1.0, 1, -1, -1])
    found = replace(scene, log_scales=torch.tensor(logs).float(), quaternions=torch.tensor(quaternions * turn).float())
    assert psnr_db(shown(found), shown(scene)) >= 47
    with pytest.raises(InputError, match=r"version 4 of SPZ.*2 or 3"):
        write_spz(tmp_path / "four.spz", scene, version=4)


def test_opacities_stay_finite_as_logits_and_large_harmonics_are_refused(tmp_path):
    scene = drawn(8, degree=1)
    scene.opacity_logits[:2] = torch.tensor([40.0, -40.0])
    body = gzip.decompress(write_spz(tmp_path / "a.spz", scene).read_bytes())
    opacities = np.frombuffer(body, np.uint8, len(scene), 16 + 9 * len(scene))
    assert (opacities.min(), opacities.max()) == (1, 254)
    scene.harmonics[0, 0, 0] = 1.4
    with pytest.raises(InputError, match=r"coefficient of a harmonic of 1\.4"):
        write_spz(tmp_path / "b.spz", scene)
