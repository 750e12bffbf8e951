"""One Gaussian in each format, number by number, worked out from what defines the format and not by a reader.

SPZ    nianticlabs/spz 21715c3 (2026-07-10), load-spz.cc: packGaussians, packQuaternionFirstThree,
       packQuaternionSmallestThree, quantizeSH; axes right, up, back
SOG    playcanvas/splat-transform 3.2.0, write-sog.ts and read-sog.ts; axes of a PLY file
glTF   KhronosGroup/glTF, KHR_gaussian_splatting, text of 2026-04-15; axes right, up, back
PLY    graphdeco-inria/gaussian-splatting, scene/gaussian_model.py: construct_list_of_attributes, save_ply
"""

import gzip
import io
import json
import struct
import zipfile

import cv2
import numpy as np
import pytest
import torch

from gs2ci.render.gaussians import Gaussians
from gs2ci.render.glb import write_glb
from gs2ci.render.ply import write_ply
from gs2ci.render.sog import write_sog
from gs2ci.render.spz import write_spz

# Opacity 0.2; f_dc = (colour - 0.5) / 0.28209479: 0.886227, 0, -0.886227. Harmonics of degree 1: for y, z and x.
ONE = Gaussians(
    torch.tensor([[1.5, -2.25, 3.0]]),
    torch.tensor([[-2.0, -3.0625, 0.5]]),
    torch.tensor([[0.8, 0.36, -0.48, 0.0]]),
    torch.tensor([-1.3862944]),
    torch.tensor([[0.75, 0.5, 0.25]]),
    harmonics=torch.tensor([[[0.25, 0.0, -0.25], [0.5, 0.0, -0.5], [0.125, 0.0, -0.125]]]),
)
F_DC = (0.886227, 0.0, -0.886227)


def spz_of(tmp_path, version):
    whole = gzip.decompress(write_spz(tmp_path / "one.spz", ONE, version=version).read_bytes())
    assert struct.unpack("<IIIBBBB", whole[:16]) == (0x5053474E, version, 1, 1, 20, 0, 0)
    return whole[16:]


@pytest.mark.parametrize("version", [2, 3])
def test_spz_holds_fixed_points_shares_and_logs(tmp_path, version):
    body = spz_of(tmp_path, version)
    # 24 bits, 20 of them fractional; y and z turned: 1.5, 2.25 and -3 times 2**20.
    places = [int.from_bytes(body[k : k + 3], "little", signed=True) for k in (0, 3, 6)]
    assert places == [1572864, 2359296, -3145728]
    assert body[9] == 51  # 255 x 0.2
    assert list(body[10:13]) == [161, 128, 94]  # 255 x (0.15 f_dc + 0.5): 161.4, 127.5, 93.6
    # Harmonics behind the rotation, of which version 3 has one byte more; y and z change their signs: 128 x + 128.
    harmonics = body[16 + version + 1 :]
    assert list(harmonics) == [96, 128, 160, 64, 128, 192, 144, 128, 112]


def test_spz_of_version_three_holds_a_size_in_sixteenths_and_the_three_smallest_parts(tmp_path):
    body = spz_of(tmp_path, 3)
    assert list(body[13:16]) == [128, 111, 168]  # 16 x (ln size + 10)
    # Turned, x y z w = 0.36, 0.48, 0, 0.8: w is largest (3); the others in 9 bits of 1 / sqrt(2), after it.
    packed = 3 << 30 | 260 << 20 | 347 << 10 | 0
    assert int.from_bytes(body[16:20], "little") == packed


def test_spz_of_version_two_holds_three_parts_of_a_rotation_that_is_ours_or_one_of_its_24_names(tmp_path):
    body = spz_of(tmp_path, 2)
    x, y, z = (part / 127.5 - 1 for part in body[16:19])
    w = np.sqrt(max(1 - x * x - y * y - z * z, 0))
    sizes = np.array(list(body[13:16])) / 16 - 10
    assert sorted(sizes) == [-3.0625, -2.0, 0.5]

    def shape(w, x, y, z, logs):
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        return turn @ np.diag(np.exp(2 * np.asarray(logs))) @ turn.T

    wanted = shape(0.8, 0.36, 0.48, 0.0, [-2.0, -3.0625, 0.5])
    np.testing.assert_allclose(shape(w, x, y, z, sizes), wanted, atol=0.02 * np.abs(wanted).max())


def test_sog_holds_logs_of_places_and_indices_into_books(tmp_path):
    with zipfile.ZipFile(io.BytesIO(write_sog(tmp_path / "one.sog", ONE).read_bytes())) as archive:
        meta = json.loads(archive.read("meta.json"))

        def pixel(name, at=0):
            shown = cv2.imdecode(np.frombuffer(archive.read(name), np.uint8), cv2.IMREAD_UNCHANGED)
            blue, green, red, *rest = shown.reshape(-1, shown.shape[2])[at].tolist()
            return [red, green, blue, *rest]

        assert (meta["version"], meta["count"]) == (2, 1)
        # sign(x) ln(1 + |x|), unturned; one Gaussian is its own box.
        np.testing.assert_allclose(meta["means"]["mins"], [0.916291, -1.178655, 1.386294], rtol=1e-6)
        assert meta["means"]["maxs"] == meta["means"]["mins"]
        assert pixel("means_l.webp")[:3] == pixel("means_u.webp")[:3] == [0, 0, 0]
        assert meta["means"]["files"] == ["means_l.webp", "means_u.webp"]
        sizes = [meta["scales"]["codebook"][k] for k in pixel("scales.webp")[:3]]
        np.testing.assert_allclose(sizes, [-2.0, -3.0625, 0.5], rtol=1e-6)
        red, green, blue, opacity = pixel("sh0.webp")
        np.testing.assert_allclose([meta["sh0"]["codebook"][k] for k in (red, green, blue)], F_DC, atol=1e-6)
        assert opacity == 51
        # w is largest, 252 + 0; x, y and z as 255 (0.5 + part / sqrt(2)): 192.4, 41.0, 127.5.
        assert pixel("quats.webp") == [192, 41, 128, 252]
        assert pixel("shN_labels.webp")[:3] == [0, 0, 0]
        assert (meta["shN"]["count"], meta["shN"]["bands"]) == (1, 1)
        book = meta["shN"]["codebook"]
        found = [[book[k] for k in pixel("shN_centroids.webp", at)[:3]] for at in range(3)]
        np.testing.assert_allclose(found, ONE.harmonics[0].numpy(), atol=1e-6)


@pytest.mark.parametrize(("of_light", "red"), [(False, 0.522522), (True, 0.75)])
def test_gltf_holds_sizes_shares_and_harmonics_as_floats_in_its_own_axes(tmp_path, of_light, red):
    whole = write_glb(tmp_path / "one.glb", ONE, of_light=of_light).read_bytes()
    size = int.from_bytes(whole[12:16], "little")
    told, body = json.loads(whole[20 : 20 + size]), whole[28 + size :]
    (primitive,) = told["meshes"][0]["primitives"]

    def values(name):
        accessor = told["accessors"][primitive["attributes"][name]]
        at = told["bufferViews"][accessor["bufferView"]]["byteOffset"]
        count = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        return np.frombuffer(body, "<u2" if name == "COLOR_0" else "<f4", count, at).astype(np.float64)

    own = "KHR_gaussian_splatting:"
    expected = {
        "POSITION": (1.5, 2.25, -3.0),
        own + "ROTATION": (0.36, 0.48, 0.0, 0.8),  # x y z w
        own + "SCALE": (0.135335, 0.046771, 1.648721),
        own + "OPACITY": (0.2,),
        own + "SH_DEGREE_0_COEF_0": F_DC,
        own + "SH_DEGREE_1_COEF_0": (-0.25, 0, 0.25),
        own + "SH_DEGREE_1_COEF_1": (-0.5, 0, 0.5),
        own + "SH_DEGREE_1_COEF_2": (0.125, 0, -0.125),
    }
    assert set(primitive["attributes"]) == {*expected, "COLOR_0"}
    for name, numbers in expected.items():
        np.testing.assert_allclose(values(name), numbers, atol=2e-6, err_msg=name)
    # Of a screen 0.75 is 0.5225 of the light (IEC 61966-2-1); light is written as it is.
    assert values("COLOR_0")[[0, 3]] / 65535 == pytest.approx([red, 0.2], abs=1e-5)
    space = "lin_rec709_display" if of_light else "srgb_rec709_display"
    assert primitive["extensions"] == {"KHR_gaussian_splatting": {"kernel": "ellipse", "colorSpace": space}}


def test_ply_holds_logits_logs_and_red_coefficients_before_green_ones(tmp_path):
    head, body = write_ply(tmp_path / "one.ply", ONE).read_bytes().split(b"end_header\n")
    names = [line.split()[-1] for line in head.decode().splitlines() if line.startswith("property float")]
    rest = [f"f_rest_{k}" for k in range(9)]
    scales, turns = [f"scale_{k}" for k in range(3)], [f"rot_{k}" for k in range(4)]
    assert names == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *rest, "opacity", *scales, *turns]
    wanted = [1.5, -2.25, 3.0, 0, 0, 0, *F_DC, 0.25, 0.5, 0.125, 0, 0, 0, -0.25, -0.5, -0.125, -1.3862944]
    wanted += [-2.0, -3.0625, 0.5, 0.8, 0.36, -0.48, 0.0]
    np.testing.assert_allclose(np.frombuffer(body, "<f4"), wanted, atol=1e-6)
