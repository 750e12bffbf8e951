"""SOG files, read back as the format's page says; the newest reader of somebody else's is asked by `tests.clients`."""

import io
import json
import zipfile

import imageio.v3 as imageio
import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.render import sog
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.harmonics import SH_DC, coefficients
from gs2ci.render.sog import write_sog
from tests.render.scenes_in_units import UNITS, drawn, psnr_db, shown


def read(path):
    with zipfile.ZipFile(path) as archive:
        meta = json.loads(archive.read("meta.json"))
        names = [name for name in archive.namelist() if name.endswith(".webp")]
        held = {name[:-5]: imageio.imread(io.BytesIO(archive.read(name)), extension=".webp") for name in names}
    count = meta["count"]
    flat = {name: picture.reshape(-1, picture.shape[2])[:count].astype(np.int64) for name, picture in held.items()}
    fine = (flat["means_l"] + 256 * flat["means_u"]) / 65535
    place = np.array(meta["means"]["mins"]) + fine * np.subtract(meta["means"]["maxs"], meta["means"]["mins"])
    three, mode = (flat["quats"][:, :3] / 255 - 0.5) * np.sqrt(2), flat["quats"][:, 3] - 252
    quaternions = np.zeros((count, 4))
    for one in range(4):
        own = mode == one
        quaternions[np.ix_(own, [k for k in range(4) if k != one])] = three[own]
        quaternions[own, one] = np.sqrt(np.maximum(1 - (three[own] ** 2).sum(axis=1), 0))
    opacity = np.clip(flat["sh0"][:, 3] / 255, 1e-4, 1 - 1e-4)
    harmonics = None
    if "shN" in meta:
        known = coefficients(meta["shN"]["bands"])
        label = flat["shN_labels"][:, 0] + 256 * flat["shN_labels"][:, 1]
        row, column = np.divmod(label, 64)
        indices = held["shN_centroids"][row[:, None], (column * known)[:, None] + np.arange(known)]
        harmonics = torch.tensor(np.array(meta["shN"]["codebook"])[indices]).float()
    return Gaussians(
        torch.tensor(np.sign(place) * np.expm1(np.abs(place))).float(),
        torch.tensor(np.array(meta["scales"]["codebook"])[flat["scales"]]).float(),
        torch.tensor(quaternions).float(),
        torch.tensor(np.log(opacity / (1 - opacity))).float(),
        torch.tensor(0.5 + SH_DC * np.array(meta["sh0"]["codebook"])[flat["sh0"][:, :3]]).float(),
        harmonics=harmonics,
    )


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_scene_in_any_unit_looks_as_before(tmp_path, unit, degree):
    scene = drawn(degree, unit, degree)
    found = read(write_sog(tmp_path / "scene.sog", scene))
    assert psnr_db(shown(found, unit), shown(scene, unit)) >= 50


@pytest.mark.parametrize("count", [1, 2, 17])
def test_few_gaussians_fill_a_picture_of_whole_sides(tmp_path, count):
    scene = drawn(3, count=count, degree=1)
    scene.quaternions[0] = 0
    found = read(write_sog(tmp_path / "few.sog", scene))
    torch.testing.assert_close(found.log_scales, scene.log_scales, rtol=0, atol=1e-3)
    torch.testing.assert_close(found.harmonics, scene.harmonics, rtol=0, atol=1e-3)
    with pytest.raises(InputError, match=r"0 Gaussians.*in a SOG file"):
        write_sog(tmp_path / "none.sog", scene.map(lambda tensor: tensor[:0]))


def test_more_harmonics_than_the_palette_holds_are_grouped(tmp_path, monkeypatch):
    scene = drawn(4, degree=1, count=300)
    kinds = torch.randint(0, 40, (300,), generator=torch.Generator().manual_seed(2))
    scene.harmonics = scene.harmonics[:40][kinds] + 1e-4 * scene.harmonics
    monkeypatch.setattr(sog, "_PALETTE_MOST", 64)
    found = read(write_sog(tmp_path / "grouped.sog", scene))
    assert len(np.unique(found.harmonics.reshape(300, -1).numpy(), axis=0)) <= 64
    assert psnr_db(shown(found), shown(scene)) >= 38


def test_the_same_scene_gives_the_same_file(tmp_path):
    one, other = (write_sog(tmp_path / name, drawn(5)).read_bytes() for name in ("a.sog", "b.sog"))
    assert one == other
