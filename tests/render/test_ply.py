from dataclasses import replace

import gsply
import numpy as np
import pytest
import torch
import trimesh

from gs2ci.core.errors import InputError, StorageError
from gs2ci.render.harmonics import SH_DC, coefficients, colours_seen
from gs2ci.render.ply import read_ply, read_ply_scene, write_ply
from tests.render.scenes_in_units import drawn

NAMES = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
NAMES += ["rot_0", "rot_1", "rot_2", "rot_3"]


def header(count=1, names=NAMES, layout="ascii", type_="float", after=""):
    lines = ["ply", f"format {layout} 1.0", "comment made by a test", f"element vertex {count}"]
    lines += [f"property {type_} {name}" for name in names]
    return "\n".join(lines) + "\n" + after + "end_header\n"


def row(values=range(14)):
    return " ".join(str(v) for v in values) + "\n"


@pytest.fixture
def file(tmp_path):
    def write(content):
        path = tmp_path / "scene.ply"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def test_scene_comes_back_from_its_file(tmp_path, make):
    scene = make(count=33).scene
    path = write_ply(tmp_path / "scene.ply", scene)
    back = read_ply(path)
    for name, tensor in scene.parameters().items():
        torch.testing.assert_close(getattr(back, name), tensor, rtol=0, atol=3e-7 if name == "colours" else 0)
    assert [p.name for p in tmp_path.iterdir()] == ["scene.ply"]


def test_written_header_is_the_one_viewers_expect(tmp_path, make):
    path = write_ply(tmp_path / "scene.ply", make(count=2).scene)
    head = path.read_bytes().split(b"end_header\n")[0].decode().splitlines()
    assert head[:3] == ["ply", "format binary_little_endian 1.0", "element vertex 2"]
    assert [line.split()[2] for line in head[3:]] == [*NAMES[:3], "nx", "ny", "nz", *NAMES[3:]]


def test_standard_errors_are_one_more_property_that_a_reader_may_leave(tmp_path, make):
    scene, errors = make(count=5).scene, np.linspace(0.1, 0.5, 5, dtype=np.float32)
    path = write_ply(tmp_path / "scene.ply", scene, standard_errors=errors)
    assert read_ply_scene(path).ignored == ()
    np.testing.assert_array_equal(read_ply_scene(path).standard_errors, errors)
    assert read_ply_scene(write_ply(tmp_path / "without.ply", scene)).standard_errors is None
    np.testing.assert_array_equal(gsply.plyread(str(path)).means, scene.means.float())
    torch.testing.assert_close(read_ply(path).means, scene.means.float(), rtol=0, atol=0)
    vertices = trimesh.load(path).metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(vertices["standard_error"], errors)


def test_a_standard_error_that_is_none_is_refused(tmp_path, make):
    path = write_ply(tmp_path / "scene.ply", make(count=2).scene, standard_errors=np.array([0.1, -1], np.float32))
    with pytest.raises(InputError, match="a standard_error that is none"):
        read_ply(path)


def test_empty_scene_can_be_written_and_read(tmp_path, make):
    empty = make().scene.map(lambda t: t[:0])
    assert len(read_ply(write_ply(tmp_path / "empty.ply", empty))) == 0


def test_text_file_is_read_with_the_conventions_of_splatting(file):
    scene = read_ply(file(header(2) + row() + row(range(100, 114))))
    assert scene.means.tolist() == [[0, 1, 2], [100, 101, 102]]
    torch.testing.assert_close(scene.colours[0], 0.5 + SH_DC * torch.tensor([3.0, 4, 5]))
    assert scene.opacity_logits.tolist() == [6, 106]
    assert scene.log_scales[0].tolist() == [7, 8, 9]
    assert scene.quaternions[0].tolist() == [10, 11, 12, 13]


def test_dc_constant_is_that_of_the_first_spherical_harmonic():
    assert pytest.approx(0.28209479177387814, abs=1e-16) == SH_DC


def test_binary_file_of_doubles_in_another_order_with_extras_is_read(file):
    names = ["extra", *reversed(NAMES)]
    values = np.arange(15, dtype="<f8")
    faces = "element face 1\nproperty list uchar int vertex_indices\n"
    scene = read_ply_scene(
        file(
            header(1, names, "binary_little_endian", "double", after=faces).encode()
            + values.tobytes()
            + b"\x03"
            + b"\0" * 12
        )
    )
    assert scene.gaussians.means.tolist() == [[14, 13, 12]]
    assert scene.ignored == ("extra",)
    assert scene.gaussians.harmonics is None


@pytest.mark.parametrize("count", [3, 8, 15])
def test_harmonics_come_coefficient_by_coefficient_of_red_then_green_then_blue(file, count):
    names = [f"f_rest_{k}" for k in range(3 * count)]
    scene = read_ply_scene(file(header(1, [*NAMES, *names]) + row([*range(14), *range(3 * count)])))
    assert scene.gaussians.harmonics.shape == (1, count, 3)
    assert scene.gaussians.harmonics[0, :, 0].tolist() == list(range(count))
    assert scene.gaussians.harmonics[0, 1].tolist() == [1, 1 + count, 1 + 2 * count]
    assert scene.ignored == ()


def test_harmonics_that_are_all_zero_are_none(file):
    names = [f"f_rest_{k}" for k in range(9)]
    assert read_ply_scene(file(header(1, [*NAMES, *names]) + row([*range(14), *[0] * 9]))).gaussians.harmonics is None


def test_harmonics_come_back_from_their_file(tmp_path, make):
    scene = replace(make(count=5).scene, harmonics=torch.randn(5, 15, 3, generator=torch.Generator().manual_seed(0)))
    back = read_ply(write_ply(tmp_path / "shiny.ply", scene))
    assert torch.equal(back.harmonics, scene.harmonics)
    torch.testing.assert_close(back.quaternions, scene.quaternions)


def test_other_programs_see_the_colour_that_we_see(tmp_path, make):
    """The formula written out, with the constants of the program of Kerbl et al. (2023), `sh_utils.py`."""
    scene = replace(
        make(count=5).scene, harmonics=0.3 * torch.randn(5, 15, 3, generator=torch.Generator().manual_seed(1))
    )
    data = write_ply(tmp_path / "shiny.ply", scene).read_bytes()
    head, body = data.split(b"end_header\n", 1)
    names = [line.split()[2].decode() for line in head.splitlines() if line.startswith(b"property")]
    table = dict(zip(names, np.frombuffer(body, "<f4").reshape(5, -1).T.astype(np.float64), strict=True))
    camera = np.array([0.3, -0.2, 0.1])
    sight = np.stack([table[axis] for axis in "xyz"], axis=1) - camera
    x, y, z = (sight / np.linalg.norm(sight, axis=1, keepdims=True)).T
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    expected = np.zeros((5, 3))
    for channel in range(3):
        sh = [table[f"f_dc_{channel}"], *(table[f"f_rest_{15 * channel + k}"] for k in range(15))]
        result = 0.28209479177387814 * sh[0]
        result = result - 0.4886025119029199 * y * sh[1] + 0.4886025119029199 * z * sh[2]
        result = result - 0.4886025119029199 * x * sh[3]
        result = result + 1.0925484305920792 * xy * sh[4] - 1.0925484305920792 * yz * sh[5]
        result = result + 0.31539156525252005 * (2.0 * zz - xx - yy) * sh[6] - 1.0925484305920792 * xz * sh[7]
        result = result + 0.5462742152960396 * (xx - yy) * sh[8]
        result = result - 0.5900435899266435 * y * (3 * xx - yy) * sh[9] + 2.890611442640554 * xy * z * sh[10]
        result = result - 0.4570457994644658 * y * (4 * zz - xx - yy) * sh[11]
        result = result + 0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy) * sh[12]
        result = result - 0.4570457994644658 * x * (4 * zz - xx - yy) * sh[13]
        result = result + 1.445305721320277 * z * (xx - yy) * sh[14] - 0.5900435899266435 * x * (xx - 3 * yy) * sh[15]
        expected[:, channel] = np.maximum(result + 0.5, 0)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, 3] = -torch.from_numpy(camera)
    seen = colours_seen(scene.map(torch.Tensor.double), pose[None])[0]
    np.testing.assert_allclose(seen.numpy(), expected, atol=1e-6)


@pytest.mark.parametrize(
    "rest", [["f_rest_0"], [f"f_rest_{k}" for k in range(1, 10)], [f"f_rest_{k}" for k in range(72)]]
)
def test_incomplete_harmonics_and_those_of_too_high_a_degree_are_refused(file, rest):
    with pytest.raises(InputError, match="properties f_rest_"):
        read_ply(file(header(1, [*NAMES, *rest]) + row(range(14 + len(rest)))))


def test_harmonics_that_do_not_fit_the_gaussians_are_not_written(tmp_path, make):
    with pytest.raises(InputError, match="harmonics of the Gaussians"):
        write_ply(tmp_path / "shiny.ply", replace(make(count=5).scene, harmonics=torch.zeros(4, 15, 3)))
    assert not list(tmp_path.iterdir())


def test_harmonics_that_are_not_finite_are_named_with_their_file(file):
    names = [f"f_rest_{k}" for k in range(9)]
    with pytest.raises(InputError, match=r"scene\.ply.*harmonics of the Gaussians"):
        read_ply(file(header(1, [*NAMES, *names]) + row([*range(14), *["nan"] * 9])))


def test_further_lines_of_the_header_are_read_over(file):
    text = header(1).replace("comment made by a test\n", "comment a\nobj_info b\n\n")
    assert len(read_ply(file(text + row()))) == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not a PLY file"),
        (b"\x89PNG\r\n\x1a\n\0\0", "not a PLY file"),
        (b"no newline at all", "not a PLY file"),
        (b"ply\nformat ascii 1.0\n", "header has no end"),
        (b"end_header\n", "not a PLY file"),
        (header(layout="binary_big_endian"), "format 'binary_big_endian'.*ascii, binary_little_endian"),
        (header().replace("format ascii 1.0\n", ""), "PLY format ''"),
        (header().replace("element vertex", "element point"), "first element is 'point'"),
        ("ply\nformat ascii 1.0\nend_header\n", "first element is 'none'"),
        (header().replace("vertex 1", "vertex -1"), "'element vertex -1' makes no sense"),
        (header().replace("float x", "quad x"), "'property quad x' makes no sense"),
        (header().replace("property float x", "property list uchar int x"), "makes no sense"),
        (header(names=["x", "y", "z", "red"]), "lacks the properties f_dc_0.*plain point cloud"),
        (header(names=[*NAMES, "x"]) + row(range(15)), "names a property twice"),
        (header(2) + row(), "Gaussian 1 of 2 reads ''"),
        (header(1) + row(range(13)), "Gaussian 0 of 1.*14 numbers"),
        (header(1) + row([*range(13), "blue"]), "Gaussian 0 of 1.*blue"),
        (header(1) + row([*range(13), "nan"]), "quaternions of the Gaussians: 1 of 4 values"),
        (header(1) + row([1e300, *range(13)]), "means of the Gaussians: 1 of 3 values"),
        (header(3, layout="binary_little_endian").encode() + b"\0" * 120, "ends after 2 of 3 Gaussians"),
    ],
)
def test_malformed_file_is_one_clear_error(file, content, message):
    with pytest.raises(InputError, match=message) as caught:
        read_ply(file(content))
    assert "scene.ply" in str(caught.value)


def test_missing_file_is_one_clear_error(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read_ply(tmp_path / "none.ply")


def test_folder_instead_of_a_file_is_one_clear_error(tmp_path):
    with pytest.raises(InputError, match="directory"):
        read_ply(tmp_path)


def test_scene_with_nan_is_not_written(tmp_path, make):
    scene = make().scene
    scene.means[0, 0] = float("nan")
    with pytest.raises(InputError, match="means"):
        write_ply(tmp_path / "scene.ply", scene)
    assert not list(tmp_path.iterdir())


def test_failed_write_leaves_nothing_behind(tmp_path, make):
    (tmp_path / "scene.ply").mkdir()
    with pytest.raises(StorageError, match="cannot be written"):
        write_ply(tmp_path / "scene.ply", make().scene)
    assert [p.name for p in tmp_path.iterdir()] == ["scene.ply"]


def test_missing_folder_is_a_storage_error(tmp_path, make):
    with pytest.raises(StorageError, match="cannot be written"):
        write_ply(tmp_path / "none" / "scene.ply", make().scene)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_zeros_are_written_for_harmonics_that_a_scene_has_not(tmp_path, degree):
    """Viewers of SIBR's kind stop at a file without the 45 coefficients of degree 3 (E10)."""
    scene = drawn(degree, degree=degree, count=5)
    whole = trimesh.load(write_ply(tmp_path / "whole.ply", scene, degree=3)).metadata["_ply_raw"]["vertex"]["data"]
    names = [name for name in whole.dtype.names if name.startswith("f_rest_")]
    assert names == [f"f_rest_{k}" for k in range(45)]
    own = coefficients(degree)
    held = np.stack([whole[name] for name in names], axis=1).reshape(5, 3, 15)
    assert not held[:, :, own:].any()
    if degree:
        np.testing.assert_array_equal(held[:, :, :own], scene.harmonics.transpose(1, 2))
    else:  # what is zero everywhere is none
        assert read_ply(tmp_path / "whole.ply").harmonics is None
    with pytest.raises(InputError, match="harmonics of degree 4"):
        write_ply(tmp_path / "four.ply", scene, degree=4)
