"""Binary glTF with Gaussians, read back as the extension's page says."""

import json
import struct

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.render import glb
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.glb import write_glb
from gs2ci.render.harmonics import SH_DC, turned
from tests.render.scenes_in_units import UNITS, drawn, psnr_db, shown

KINDS = {5126: ("<f4", 1.0), 5123: ("<u2", 65535.0)}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


def read(path):
    """Return the JSON and the attributes by name."""
    whole = path.read_bytes()
    magic, version, length = struct.unpack("<4sII", whole[:12])
    assert (magic, version, length, length % 4) == (b"glTF", 2, len(whole), 0)
    size, kind = struct.unpack("<I4s", whole[12:20])
    assert kind == b"JSON"
    told = json.loads(whole[20 : 20 + size])
    body = whole[28 + size :]
    found = {}
    for name, index in told["meshes"][0]["primitives"][0]["attributes"].items():
        accessor = told["accessors"][index]
        view = told["bufferViews"][accessor["bufferView"]]
        dtype, full = KINDS[accessor["componentType"]]
        width = WIDTHS[accessor["type"]]
        assert view["byteOffset"] % 4 == 0
        values = np.frombuffer(body, dtype, accessor["count"] * width, view["byteOffset"]).reshape(-1, width)
        found[name.removeprefix("KHR_gaussian_splatting:")] = values.astype(np.float64) / full
    return told, found


def as_scene(found):
    flip = torch.diag(torch.tensor([1.0, -1, -1], dtype=torch.float64))
    more = [name for name in found if name.startswith("SH_DEGREE") and "DEGREE_0" not in name]
    harmonics = torch.tensor(np.stack([found[name] for name in more], axis=1)) if more else None
    opacity = np.clip(found["OPACITY"][:, 0], 1e-7, 1 - 1e-7)
    return Gaussians(
        torch.tensor(found["POSITION"]) @ flip,
        torch.tensor(np.log(found["SCALE"])),
        torch.tensor(found["ROTATION"][:, [3, 0, 1, 2]] * (1, 1, -1, -1)),
        torch.tensor(np.log(opacity / (1 - opacity))),
        torch.tensor(0.5 + SH_DC * found["SH_DEGREE_0_COEF_0"]),
        harmonics=None if harmonics is None else turned(harmonics, flip),
    ).map(torch.Tensor.float)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_scene_in_any_unit_looks_as_before(tmp_path, unit, degree):
    scene = drawn(degree, unit, degree)
    told, found = read(write_glb(tmp_path / "scene.glb", scene, metres_per_unit=None if unit == 1 else 1e-3))
    assert psnr_db(shown(as_scene(found), unit), shown(scene, unit)) >= 60
    (primitive,) = told["meshes"][0]["primitives"]
    assert primitive["mode"] == 0
    assert primitive["extensions"] == {
        "KHR_gaussian_splatting": {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    }
    assert told["extensionsUsed"] == ["KHR_gaussian_splatting"]
    assert told["nodes"][0].get("scale") == (None if unit == 1 else [1e-3] * 3)
    np.testing.assert_allclose(np.linalg.norm(found["ROTATION"], axis=1), 1, atol=1e-6)
    accessor = told["accessors"][primitive["attributes"]["POSITION"]]
    np.testing.assert_allclose(accessor["min"], found["POSITION"].min(axis=0), rtol=1e-6)
    # Points of programs without the extension have linear colours: mid grey of a screen is 0.214.
    shade = scene.colours.double().numpy().clip(0, 1)
    wanted = np.where(shade <= 0.04045, shade / 12.92, ((shade + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(found["COLOR_0"][:, :3], wanted, atol=1e-4)


def test_an_empty_scene_is_a_node_and_what_floats_cannot_hold_is_refused(tmp_path, monkeypatch):
    scene = drawn(1, count=3)
    empty = write_glb(tmp_path / "empty.glb", scene.map(lambda tensor: tensor[:0])).read_bytes()
    assert "meshes" not in json.loads(empty[20:])
    monkeypatch.setattr(glb, "_BYTES_MOST", 100)
    with pytest.raises(InputError, match="less than 4 GiB"):
        write_glb(tmp_path / "large.glb", scene)
    scene.log_scales[0, 0] = -120
    with pytest.raises(InputError, match="sizes that 32-bit floats hold"):
        write_glb(tmp_path / "small.glb", scene)
    assert not (tmp_path / "small.glb").exists()
