"""Every format gives the same numbers, and no bytes whatever end in anything but an InputError."""

import io
import struct
import zipfile
import zlib

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from scipy import io as scipy_io

from gs2ci.core.errors import Gs2ciError, InputError
from gs2ci.core.foreign import mat5, mat73
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.mat5 import read_mat5
from gs2ci.core.foreign.opening import open_foreign
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.foreign.roles import names_of
from gs2ci.core.storage import write_shots


def save_mat73(path, **arrays):
    """Write as MATLAB does: a text in front, axes reversed, a class beside each array."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for key, values in arrays.items():
            dataset = file.create_dataset(key, data=np.asarray(values).T)
            name = {"float64": "double", "float32": "single", "bool": "logical"}.get(str(np.asarray(values).dtype))
            dataset.attrs["MATLAB_class"] = np.bytes_(name or str(np.asarray(values).dtype))
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")


SAVERS = {
    "npz": np.savez,
    "npz deflated": np.savez_compressed,
    "mat": lambda path, **arrays: scipy_io.savemat(path, arrays),
    "mat deflated": lambda path, **arrays: scipy_io.savemat(path, arrays, do_compression=True),
    "mat of a struct": lambda path, **arrays: scipy_io.savemat(path, {"s": arrays}),
    "mat of a struct, deflated": lambda path, **arrays: scipy_io.savemat(path, {"s": arrays}, do_compression=True),
    "mat73": save_mat73,
}


@pytest.mark.parametrize("form", SAVERS)
def test_every_format_gives_the_same_shot(tmp_path, scene, form):
    made = scene()
    path = tmp_path / f"file.{form.split()[0].rstrip('73')}"
    SAVERS[form](path, meas=made.meas, masks=made.masks.transpose(1, 2, 0), truth=made.views)
    shot = import_shots(path, None, ImportOptions()).shots[0]
    assert np.array_equal(shot.measurement, made.meas.astype(np.float32))
    assert np.array_equal(shot.masks, made.masks)
    assert np.array_equal(np.rint(shot.truth.views * 255), made.views)


def test_keys_in_groups_may_be_named_by_their_last_name_where_it_is_ones(scene, tmp_path):
    made = scene()
    with h5py.File(tmp_path / "file.h5", "w") as file:
        file["snap/Reading"], file["snap/code"], file["other/code"] = made.meas, made.masks, made.masks
    (shot,) = import_shots(tmp_path / "file.h5", None, ImportOptions(meas_key="reading", mask_key="snap/code")).shots
    assert np.allclose(shot.measurement, made.meas)
    with pytest.raises(InputError, match=r"no key 'code'; allowed: the file holds .*other/code"):
        import_shots(tmp_path / "file.h5", None, ImportOptions(meas_key="reading", mask_key="code"))


def test_hdf5_files_of_other_programs_keep_their_axes(tmp_path, scene, said):
    """h5py writes no class beside an array: its picture, camera and poses stay as they are."""
    made = scene()
    camera = np.array([[60.0, 0, 21.0], [0, 61.0, 13.0], [0, 0, 1]])
    poses = np.tile(np.eye(4), (len(made.masks), 1, 1))
    poses[:, :3, 3] = np.random.default_rng(0).random((len(poses), 3))
    with h5py.File(tmp_path / "file.h5", "w") as file:
        for key, values in (("meas", made.meas), ("masks", made.masks), ("K", camera), ("w2c", poses)):
            file[key] = values
    imported = import_shots(tmp_path / "file.h5", None, ImportOptions())
    (shot,) = imported.shots
    assert np.array_equal(shot.measurement, made.meas.astype(np.float32))
    assert np.array_equal(shot.masks, made.masks)
    assert np.array_equal(shot.intrinsics, camera)
    assert np.array_equal(shot.truth.world_to_camera, poses)
    assert said(imported, "an HDF5 file without MATLAB's classes, whose axes are taken as h5py shows them")
    assert not said(imported, "transposed")
    save_mat73(tmp_path / "file.mat", meas=made.meas, masks=made.masks)
    assert not said(import_shots(tmp_path / "file.mat", None, ImportOptions()), "without MATLAB's classes")


def test_hdf5_without_a_mark_whose_pictures_stand_upright_is_doubted(tmp_path, scene):
    """So come those of MATLAB's h5write and of HDF5.jl, transposed, from a sensor that is wider than high."""
    made = scene(channels=1)
    meas, masks = made.meas[..., 0], made.masks
    for name, kept, counted in (("numpy", (meas, masks), False), ("h5write", (meas.T, masks.transpose(0, 2, 1)), True)):
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            file["meas"], file["masks"] = kept
            file["w2c"] = np.tile(np.eye(4), (len(masks), 1, 1))
        told = import_shots(tmp_path / f"{name}.h5", None, ImportOptions()).guesses
        rows, columns = sorted(meas.shape, reverse=counted)
        doubts = [one for one in told if one.startswith("WARNING") and "h5write" in one]
        assert [f"{rows} pixels high and {columns} wide" in one for one in doubts] == [True] * counted


def test_the_missing_values_and_the_signs_of_netcdf_are_its_own(tmp_path, scene):
    """netCDF4 1.7.5: a masked pixel was read as 65535; counts above 32767, kept in signed integers, as less than 0."""
    made = scene(channels=1)
    meas = np.rint(40000 * made.meas[..., 0] / made.meas.max()).astype(np.uint16)
    with h5py.File(tmp_path / "file.nc", "w") as file:
        file["masks"], file["meas"] = made.masks, meas.view(np.int16)
        file["meas"].attrs["_Unsigned"] = "true"
    (shot,) = import_shots(tmp_path / "file.nc", None, ImportOptions(scale=1.0)).shots
    assert np.array_equal(shot.measurement[..., 0], meas)
    missing = meas.copy()
    missing[3, 4] = 65535
    with h5py.File(tmp_path / "file.nc", "w") as file:
        file["masks"], file["meas"] = made.masks, missing
        file["meas"].attrs["_FillValue"] = np.array([65535], np.uint16)
    with pytest.raises(InputError, match=r"1 pixels are NaN.*row 3, column 4"):
        import_shots(tmp_path / "file.nc", None, ImportOptions())


@pytest.mark.parametrize("program", ["rhdf5", "JLD2"])
def test_hdf5_files_of_r_and_julia_have_the_axes_that_are_counted_there(tmp_path, scene, said, program):
    """rhdf5 marks its arrays, JLD2 0.4 begins its files with its name; both were read with rows for columns."""
    made = scene(channels=1)
    with h5py.File(tmp_path / "file.h5", "w", userblock_size=512 if program == "JLD2" else 0) as file:
        for key, values in (("meas", made.meas[..., 0].T), ("masks", made.masks.transpose(0, 2, 1))):
            file[key] = values
            if program == "rhdf5":
                file[key].attrs["rhdf5-NA.OK"] = np.ones(1, "i4")
    if program == "JLD2":
        with (tmp_path / "file.h5").open("r+b") as stream:
            stream.write(b"HDF5-based Julia Data Format, version 0.1.1\0 (Julia 1.10.4 64-bit LE)\0")
    imported = import_shots(tmp_path / "file.h5", None, ImportOptions(scale=1.0))
    assert np.array_equal(imported.shots[0].measurement, made.meas.astype(np.float32))
    assert np.array_equal(imported.shots[0].masks, made.masks)
    assert said(imported, "an HDF5 file of R or Julia")


def test_numbers_that_a_plug_in_compressed_are_named(tmp_path):
    """hdf5plugin 7.1.0's Zstandard (32015): "the file is damaged"."""
    with h5py.File(tmp_path / "file.h5", "w") as file:
        form = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        form.set_chunk((4, 4))
        form.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, (3,))
        h5py.h5d.create(file.id, b"meas", h5py.h5t.NATIVE_INT16, h5py.h5s.create_simple((4, 4)), form)
        file["masks"] = np.ones((2, 4, 4))
    with pytest.raises(InputError, match=r"compressed by a plug-in of HDF5.*hdf5plugin"):
        import_shots(tmp_path / "file.h5", None, ImportOptions())


def test_a_pair_of_npy_files_gives_the_shot(tmp_path, scene):
    made = scene()
    np.save(tmp_path / "meas.npy", made.meas)
    np.save(tmp_path / "mask.npy", made.masks)
    imported = import_shots(tmp_path / "meas.npy", tmp_path / "mask.npy", ImportOptions())
    assert np.array_equal(imported.shots[0].measurement, made.meas.astype(np.float32))
    with pytest.raises(InputError, match=r"measurement and masks at once.*second file"):
        import_shots(tmp_path / "meas.npy", None, ImportOptions())


NUMBERS = st.sampled_from(["u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8", "?"])


@settings(max_examples=60, deadline=None)
@given(
    NUMBERS.flatmap(lambda d: npst.arrays(d, npst.array_shapes(min_dims=2, max_dims=4, min_side=0, max_side=5))),
    st.booleans(),
    st.from_regex(r"[a-z][a-z0-9_]{0,20}", fullmatch=True),
)
def test_version_5_arrays_read_as_scipy_writes_them(tmp_path_factory, values, deflated, name):
    path = tmp_path_factory.mktemp("mat") / "file.mat"
    scipy_io.savemat(path, {name: values}, do_compression=deflated)
    loaded = read_mat5(path).load(name).values
    assert loaded.dtype == values.dtype
    assert np.array_equal(loaded, values, equal_nan=values.dtype.kind == "f")


def test_version_5_big_endian_and_shortened_numbers_are_understood(tmp_path):
    # A double stored as bytes, in a file written by a big-endian machine, with small elements.
    body = struct.pack(">IIII", 6, 8, 6, 0) + struct.pack(">IIii", 5, 8, 2, 2)
    body += struct.pack(">HH4s", 1, 1, b"y") + struct.pack(">HH4B", 4, 2, 1, 2, 3, 4)
    data = b"MATLAB 5.0".ljust(124) + b"\x01\x00MI" + struct.pack(">II", 14, len(body)) + body
    path = tmp_path / "big.mat"
    path.write_bytes(data)
    assert open_foreign(path).load("y").values.tolist() == [[1.0, 3.0], [2.0, 4.0]]


def test_objects_and_notes_of_matlab_itself_are_passed_over(tmp_path):
    def element(code, data):
        return struct.pack("<II", code, len(data)) + data + bytes(-len(data) % 8)

    opaque = element(6, struct.pack("<II", 17, 0)) + element(1, b"table") + element(1, b"MCOS")
    note = element(6, struct.pack("<II", 9, 0)) + element(5, struct.pack("<ii", 1, 1)) + element(1, b"")
    data = b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + element(14, opaque) + element(14, note + element(2, b"\1"))
    (tmp_path / "a.mat").write_bytes(data)
    container = open_foreign(tmp_path / "a.mat")
    assert list(container.entries) == ["table"]
    with pytest.raises(InputError, match="a MATLAB object"):
        container.load("table")


def test_too_many_variables_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(mat73, "ENTRY_LIMIT", 1)
    save_mat73(tmp_path / "a.mat", x=np.ones((2, 2)), y=np.ones((2, 2)))
    with pytest.raises(InputError, match="2 variables; allowed: up to 1"):
        open_foreign(tmp_path / "a.mat")


def test_texts_are_read_from_every_format(tmp_path):
    scipy_io.savemat(tmp_path / "a.mat", {"cfa": "RGGB"})
    np.savez(tmp_path / "a.npz", cfa="RGGB")
    save_mat73(tmp_path / "b.mat", cfa=np.array([[ord(c) for c in "RGGB"]], np.uint16))
    with h5py.File(tmp_path / "b.mat", "r+") as file:
        file["cfa"].attrs["MATLAB_class"] = np.bytes_("char")
    for name in ("a.mat", "a.npz", "b.mat"):
        assert open_foreign(tmp_path / name).text("cfa") == "RGGB"
    np.savez(tmp_path / "a.npz", cfa=np.zeros(3))
    with pytest.raises(InputError, match="allowed: a text"):
        open_foreign(tmp_path / "a.npz").text("cfa")


def test_python_objects_are_never_loaded(tmp_path):
    objects = np.array([{"a": 1}, None], object)
    np.savez(tmp_path / "a.npz", meas=objects, masks=np.ones((2, 4, 4)))
    np.save(tmp_path / "a.npy", objects)
    for name in ("a.npz", "a.npy"):
        with pytest.raises(InputError, match="Python objects"):
            import_shots(tmp_path / name, tmp_path / "a.npz", ImportOptions(meas_key=None))


def test_other_things_than_numbers_are_named(tmp_path):
    odd = {
        "cell": np.array([["a", 1]], object),
        "struct": np.array([(1.0,), (2.0,)], [("x", "f8")]),
        "complex": np.ones((2, 2)) * 1j,
        "text": "abc",
        "sparse": __import__("scipy.sparse").sparse.csc_array(np.eye(3)),
    }
    scipy_io.savemat(tmp_path / "a.mat", odd)
    container = open_foreign(tmp_path / "a.mat")
    for key, word in zip(odd, ["cell array", "struct", "complex", "text", "sparse"], strict=True):
        with pytest.raises(InputError, match=f"key '{key}': holds .*{word}"):
            container.load(key)
    with pytest.raises(InputError, match="no key 'y'; allowed: the file holds cell"):
        container.load("y")
    np.savez(tmp_path / "a.npz", meas=np.ones((2, 2)) * 1j, named=np.zeros(2, [("x", "f4")]))
    for key, word in (("meas", "complex128"), ("named", "values")):
        with pytest.raises(InputError, match=word):
            open_foreign(tmp_path / "a.npz").load(key)


def test_fields_of_a_struct_lie_beside_variables(tmp_path):
    """As version 7.3 names them; a variable goes before a field of its name, and fields of fields are not read."""
    inner = {"meas": np.ones((2, 3)), "note": "abc", "flag": np.array([[True, False]]), "deep": {"x": 1}, "none": []}
    scipy_io.savemat(tmp_path / "a.mat", {"para": inner, "meas": np.zeros((2, 3))})
    container = open_foreign(tmp_path / "a.mat")
    assert set(container.entries) == {"meas", *(f"para/{name}" for name in inner)}
    assert container.load("para/meas").values.tolist() == np.ones((2, 3)).tolist()
    assert container.load("para/flag").values.dtype == bool
    assert container.text("para/note") == "abc"
    assert names_of(container)["meas"] == "meas"
    with pytest.raises(InputError, match="key 'para/deep': holds a MATLAB struct"):
        container.load("para/deep")


def test_a_struct_whose_fields_are_none_is_refused(tmp_path):
    scipy_io.savemat(tmp_path / "a.mat", {"s": {"x": np.ones(3)}})
    stored = (tmp_path / "a.mat").read_bytes()
    for at in (stored.index(struct.pack("<II", 14, 72)), stored.rindex(struct.pack("<I", 14))):
        (tmp_path / "b.mat").write_bytes(stored[:at] + struct.pack("<I", 9) + stored[at + 4 :])
        with pytest.raises(InputError, match="a field of a struct expected"):
            open_foreign(tmp_path / "b.mat")


def test_links_and_groups_of_version_73_are_not_followed(tmp_path):
    save_mat73(tmp_path / "a.mat", y=np.ones((2, 2)))
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        file["out"] = h5py.ExternalLink("/etc/passwd", "/x")
        file["soft"] = h5py.SoftLink("/y")
        file.create_group("s")
        file.create_dataset("outside", (4,), "u1", external=[("/etc/passwd", 0, 4)])
        file.create_dataset("#refs#/a", data=1)
        empty = file.create_dataset("empty", data=np.zeros(2, "u8"))
        empty.attrs["MATLAB_empty"] = 1
    container = open_foreign(tmp_path / "a.mat")
    assert set(container.entries) == {"y", "out", "soft", "s", "outside", "empty"}
    for key in ("out", "soft", "s", "outside", "empty"):
        with pytest.raises(InputError, match=f"key '{key}': holds a"):
            container.load(key)


def test_a_capture_file_is_recognised(tmp_path, make_shot):
    path = write_shots(tmp_path / "shot.h5", [make_shot()])
    with pytest.raises(InputError, match="reconstruct from it as it is"):
        open_foreign(path)


def npy_header(shape, descr="<f8"):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": descr, "fortran_order": False, "shape": shape})
    return stream.getvalue()


def deflated_npz(path, header):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("meas.npy", header)


def huge_mat5(path, header=b""):
    body = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, 2**30, 2**30)
    body += struct.pack("<HH4s", 1, 1, b"y") + struct.pack("<II", 9, 0)
    element = zlib.compress(struct.pack("<II", 14, len(body)) + body)
    path.write_bytes(b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(element)) + element)


def huge_mat73(path, header=b""):
    with h5py.File(path, "w") as file:
        file.create_dataset("meas", (2**20, 2**20, 2**10), "f8", chunks=(64, 64, 1))


@pytest.mark.parametrize(
    "write",
    [lambda path, header: path.write_bytes(header), deflated_npz, huge_mat5, huge_mat73],
    ids=["npy", "npz", "mat5", "mat73"],
)
def test_sizes_that_cannot_be_true_are_refused_before_room_is_made(tmp_path, write):
    path = tmp_path / "huge.bin"
    write(path, npy_header((2**30, 2**30)))
    with pytest.raises(InputError, match="claims shape"):
        open_foreign(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"hello", "of no known format"),
        (b"\x93NUMPY", "cannot be read"),
        (b"\x93NUMPY\x03\x00", "fields"),
        (b"PK\x03\x04", "cannot be read"),
        (b"MATLAB 5.0", "byte order"),
        (b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 14, 10**6), "truncated"),
        (b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 3, 0), "damaged"),
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "cannot be read"),
    ],
)
def test_broken_files_are_refused(tmp_path, content, message):
    path = tmp_path / "broken.mat"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        import_shots(path, None, ImportOptions())
    assert "broken.mat" in str(caught.value)


def test_one_key_for_measurement_and_masks_is_refused(tmp_path):
    np.savez(tmp_path / "one.npz", meas=np.ones((6, 8, 3)), masks=np.ones((3, 6, 8)))
    with pytest.raises(InputError, match=r"key 'meas' for the measurement and for the masks.*--mask-key"):
        import_shots(tmp_path / "one.npz", None, ImportOptions(mask_key="meas"))


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        open_foreign(tmp_path / "none.npz")


def test_two_arrays_of_one_name_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("meas.npy", npy_header((0,)))
        with pytest.warns(UserWarning, match="Duplicate name"):
            archive.writestr("meas.npy", npy_header((0,)))
    with pytest.raises(InputError, match="two of one name"):
        open_foreign(tmp_path / "a.npz")
    scipy_io.savemat(tmp_path / "a.mat", {"y": np.ones((2, 2))})
    data = (tmp_path / "a.mat").read_bytes()
    (tmp_path / "a.mat").write_bytes(data + data[128:])
    with pytest.raises(InputError, match="'y' is there twice; what to do: save it again"):
        open_foreign(tmp_path / "a.mat")


def test_a_matlab_file_of_too_many_variables_is_refused(tmp_path, monkeypatch):
    scipy_io.savemat(tmp_path / "a.mat", {"meas": np.ones((2, 2)), "masks": np.ones((2, 2))})
    monkeypatch.setattr(mat5, "ENTRY_LIMIT", 1)
    with pytest.raises(InputError, match="too many variables; allowed: up to 1; what to do: save fewer"):
        open_foreign(tmp_path / "a.mat")


def test_a_wrong_checksum_in_a_zip_is_found(tmp_path):
    np.savez(tmp_path / "a.npz", meas=np.ones((4, 4)))
    data = bytearray((tmp_path / "a.npz").read_bytes())
    data[data.index(np.ones(2).tobytes()) + 3] ^= 1
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(InputError, match="CRC"):
        open_foreign(tmp_path / "a.npz").load("meas")


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=400), st.sampled_from([b"", b"\x93NUMPY\x01\x00", b"PK\x03\x04", b"MATLAB 5.0".ljust(126)]))
def test_any_bytes_give_an_input_error(tmp_path_factory, content, start):
    path = tmp_path_factory.mktemp("any") / "file.mat"
    path.write_bytes(start + content)
    with pytest.raises(InputError):
        import_shots(path, None, ImportOptions())


@pytest.mark.parametrize("form", SAVERS)
def test_damaged_files_give_shots_or_typed_errors(tmp_path, scene, mutations, form):
    made = scene(n=2, height=8, width=9)
    path = tmp_path / f"file.{form.split()[0].rstrip('73')}"
    SAVERS[form](path, meas=made.meas, masks=made.masks)
    outcomes = set()
    # Fixed seeds: the libraries below are C, and a crash of theirs must not come and go between two runs.
    for content in mutations(path.read_bytes(), 120, seed=2):
        path.write_bytes(content)
        try:
            import_shots(path, None, ImportOptions())
            outcomes.add("shot")
        except Gs2ciError:
            outcomes.add("error")
    assert "error" in outcomes
