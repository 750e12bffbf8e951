"""Files by programs that are not ours are read to the bit, or refused by name with the way out."""

import pickle
import struct
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.opening import UNREAD, open_foreign
from gs2ci.core.foreign.options import ImportOptions

FILES = Path(__file__).parent / "files"
DOCS = Path(__file__).parents[3] / "docs"

ROWS, COLUMNS = np.mgrid[:12, :20]


def counts(bits):
    return ((ROWS * 20 + COLUMNS) * 997 + 31 * ROWS * ROWS) % 2**bits


READ = {
    "tifffile_10bit.tif": counts(10),
    "tifffile_12bit.tif": counts(12),
    "tifffile_14bit.tif": counts(14),
    "tifffile_lzw.tif": counts(16),
    "tifffile_deflate.tif": counts(16),
    "tifffile_big.tif": counts(16),
    "tifffile_ome.ome.tif": (counts(16) + np.arange(3)[:, None, None]) % 2**16,
    "tifffile_imagej.tif": (counts(16) + np.arange(3)[:, None, None]) % 2**16,
    "tifffile_i16.tif": counts(12) - 50,
    "tifffile_f64.tif": counts(12),
    "tifffile_orient6.tif": np.rot90(counts(16), -1),
    "tiffcp_tiles.tif": counts(16),
    "tiffcp_bigend.tif": counts(16),
    "tiffcp_packbits.tif": counts(16),
    "tiffcp_zip.tif": counts(16),
    "gm.bmp": counts(8),
    "gm_16.pgm": counts(16),
    "gm_16.png": counts(16),
}
REFUSED = {
    "tifffile_4bit.tif": "a TIFF, of 4 bits.*16-bit TIFF",
    "tifffile_f16.tif": "floating point of 16 bits.*16-bit TIFF",
    "tifffile_zstd.tif": "compressed by Zstandard.*16-bit TIFF",
    "tifffile_jpeg.tif": "compressed as JPEG.*neither exact nor proportional to light",
    "tiffcp_jpeg.tif": "compressed as JPEG.*neither exact nor proportional to light",
    "tifffile_palette.tif": "a palette.*names of colours",
    "gm.gif": "a GIF, which is not read",
    "gm.pam": "a PAM, which is not read",
    "gm.dpx": "a DPX picture, which is not read",
    "astropy_u16.fits": r"a FITS file, which is not read.*astropy\.io\.fits\.getdata",
    "pidng_12.dng": "a DNG or another raw file.*dcraw -4 -D -T",
    "zarr.zarr": r"a Zarr store, which is not read.*np\.savez",
    "octave_v4.mat": r"a \.mat of version 4, which is not read.*save -v7",
    "octave_text.mat": "a text file of Octave, which is not read.*save -v7",
    "octave_binary.mat": "a binary file of Octave, which is not read.*save -v7",
}
BY_KEY = ("octave_v6.mat", "octave_v7.mat", "octave_hdf5.h5")


@pytest.mark.parametrize("name", READ)
def test_numbers_come_as_they_are_stored(name):
    """F5: 12 bits came out times 16, 10 times 64, 14 times 4, silently."""
    values = open_foreign(FILES / name).load("").values
    assert np.array_equal(values, READ[name])


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_read_is_refused_by_name_with_the_way_out(name):
    with pytest.raises(InputError, match=REFUSED[name]):
        open_foreign(FILES / name)


@pytest.mark.parametrize("name", BY_KEY)
def test_octave_is_read_with_its_axes(name):
    container = open_foreign(FILES / name)
    prefix = "/value" if name.endswith(".h5") else ""
    meas = np.arange(240.0).reshape(12, 20)
    assert np.array_equal(container.load(f"meas{prefix}").values, meas)
    assert np.array_equal(container.load(f"masks{prefix}").values, np.repeat(meas[..., None] % 2, 3, axis=2))
    assert "axes" not in container.note
    shot = import_shots(FILES / name, None, ImportOptions(scale=255.0)).shots[0]
    assert shot.masks.shape == (3, 12, 20)


def test_the_fields_of_a_struct_are_read():
    """F10: "name the key"."""
    shot = import_shots(FILES / "octave_struct.mat", None, ImportOptions(scale=255.0)).shots[0]
    assert shot.masks.shape == (3, 12, 20)


def test_bits_and_a_turn_are_said():
    assert open_foreign(FILES / "tifffile_12bit.tif").note == "12 bits"
    assert "tag of orientation says (6)" in open_foreign(FILES / "tifffile_orient6.tif").note


def test_a_detector_writes_its_frames_in_groups(tmp_path, scene):
    """The layout of EPICS areaDetector (NeXus): /entry/data/data, links and texts beside it. Written by h5py."""
    made = scene(channels=1)
    with h5py.File(tmp_path / "detector.h5", "w") as file:
        entry = file.create_group("entry")
        entry.create_group("data")["data"] = np.rint(made.meas[None, ..., 0] * 255).astype(np.uint16)
        entry["instrument/detector/description"] = "SimDetector"
        entry["instrument/detector/again"] = h5py.SoftLink("/entry/data/data")
    np.save(tmp_path / "masks.npy", made.masks)
    imported = import_shots(tmp_path / "detector.h5", tmp_path / "masks.npy", ImportOptions(scale=255.0))
    assert np.abs(imported.shots[0].measurement - made.meas).max() < 0.01
    with h5py.File(tmp_path / "detector.h5", "a") as file:
        file["entry/other"] = np.zeros((3, 24, 32))
    named = ImportOptions(scale=255.0, meas_key="entry/data/data")
    assert len(import_shots(tmp_path / "detector.h5", tmp_path / "masks.npy", named).shots) == 1


def test_an_array_in_a_group_is_known_by_its_last_name(tmp_path, scene):
    made = scene()
    with h5py.File(tmp_path / "nested.h5", "w") as file:
        file["camera/meas"], file["dmd/masks"] = made.meas, made.masks
    assert np.array_equal(import_shots(tmp_path / "nested.h5", None, ImportOptions()).shots[0].masks, made.masks)


def test_python_objects_are_refused_with_the_way_out(tmp_path):
    """F10: "name the key" where a .npy has none."""
    np.save(tmp_path / "dict.npy", {"meas": np.zeros((3, 4))}, allow_pickle=True)
    with pytest.raises(InputError, match=r"holds Python objects.*np\.savez\('FILE\.npz', \*\*np\.load"):
        import_shots(tmp_path / "dict.npy", None, ImportOptions())
    for protocol in (2, 3, 4, 5):
        (tmp_path / "a.pkl").write_bytes(pickle.dumps({"meas": 1}, protocol=protocol))
        with pytest.raises(InputError, match=r"a file of Python objects.*np\.savez"):
            open_foreign(tmp_path / "a.pkl")


def test_a_file_of_torch_is_refused_with_the_way_out(tmp_path):
    with zipfile.ZipFile(tmp_path / "masks.pt", "w") as archive:
        archive.writestr("masks/data.pkl", b"")
    with pytest.raises(InputError, match=r"a file of PyTorch.*torch\.load"):
        open_foreign(tmp_path / "masks.pt")


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (b"\0\0\0\x20ftypisom", r"a film \(MP4, MOV\), which is not read.*ffmpeg -i FILE"),
        (b"RIFF\0\0\0\0AVI LIST", "an AVI film, which is not read.*if it was stored without loss"),
        (b"\x1a\x45\xdf\xa3", "a film .Matroska, WebM., which is not read.*ffmpeg"),
        (b"\x12\x34", r"no known format.*np\.fromfile\(PATH, '<u2'\)"),
    ],
)
def test_films_and_raw_numbers_are_told_a_way_in(tmp_path, start, message):
    (tmp_path / "a").write_bytes(start + bytes(64))
    with pytest.raises(InputError, match=message):
        open_foreign(tmp_path / "a")


def test_a_zip_archive_without_arrays_is_no_empty_file(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("zarr.json", "{}")
    with pytest.raises(InputError, match=r"a zip archive without an array of numpy.*unpack it"):
        open_foreign(tmp_path / "a.zip")


@pytest.mark.parametrize("mark", [row[0] for row in UNREAD])
def test_every_known_beginning_is_refused_by_its_name(tmp_path, mark):
    (tmp_path / "a").write_bytes(mark + b"\0" * 64)
    with pytest.raises(InputError, match="which is not read"):
        open_foreign(tmp_path / "a")


def test_jpeg_2000_and_its_like_are_refused_by_name(tmp_path):
    (tmp_path / "a").write_bytes(b"\0\0\0\x0cjP  \r\n\x87\n" + b"\0" * 64)
    with pytest.raises(InputError, match="a JPEG 2000, AVIF or HEIC picture, which is not read"):
        open_foreign(tmp_path / "a")


def test_a_file_that_is_nothing_is_no_mat_of_version_4(tmp_path):
    for content in (b"\0" * 64, b"\0" * 20 + b"?" * 20, b"abc"):
        (tmp_path / "a").write_bytes(content)
        with pytest.raises(InputError, match="of no known format"):
            open_foreign(tmp_path / "a")


def test_the_table_of_formats_names_every_file_and_no_other():
    table = (DOCS / "formats.md").read_text()
    for name in [*READ, *REFUSED, *BY_KEY, "octave_struct.mat"]:
        assert f"`{name}`" in table, name
    assert {path.name for path in FILES.iterdir()} == {*READ, *REFUSED, *BY_KEY, "octave_struct.mat", "README.md"}


def packed(values, bits, order, rows_per_strip):
    """Write a TIFF of packed numbers, rows padded to whole bytes, in strips (TIFF 6.0, sections 2 and 3)."""
    height, width = values.shape
    planes = (values[..., None] >> np.arange(bits - 1, -1, -1)) & 1
    rows = [np.packbits(row.reshape(-1).astype(np.uint8)).tobytes() for row in planes]
    strips = [b"".join(rows[at : at + rows_per_strip]) for at in range(0, height, rows_per_strip)]
    stored = bytearray((b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, 0))
    places = []
    for strip in strips:
        places.append(len(stored))
        stored += strip + b"\0" * (len(strip) % 2)
    lists = {}
    for name, numbers in (("places", places), ("sizes", [len(strip) for strip in strips])):
        lists[name] = len(stored) if len(numbers) > 1 else numbers[0]
        stored += struct.pack(f"{order}{len(numbers)}I", *numbers) if len(numbers) > 1 else b""
    stored[4:8] = struct.pack(order + "I", len(stored))
    tags = [(256, 1, width), (257, 1, height), (258, 1, bits), (259, 1, 1), (262, 1, 1)]
    tags += [
        (273, len(strips), lists["places"]),
        (277, 1, 1),
        (278, 1, rows_per_strip),
        (279, len(strips), lists["sizes"]),
    ]
    stored += struct.pack(order + "H", len(tags))
    for tag, count, value in tags:
        short = tag in (258, 259, 262, 277)
        body = struct.pack(order + "H", value) + b"\0\0" if short else struct.pack(order + "I", value)
        stored += struct.pack(order + "HHI", tag, 3 if short else 4, count) + body
    return bytes(stored) + struct.pack(order + "I", 0)


@pytest.mark.parametrize("seed", range(24))
def test_drawn_packed_pictures_come_as_counts(tmp_path, seed):
    """Any size, bits, order of bytes and strips; one frame alone and a folder of them."""
    rng = np.random.default_rng(seed)
    bits = int(rng.choice([10, 12, 14]))
    size = tuple(int(side) for side in rng.integers(5, 40, 2))
    frames = rng.integers(0, 2**bits, (3, *size))
    order, strip = str(rng.choice(["<", ">"])), int(rng.integers(1, size[0] + 1))
    for k, frame in enumerate(frames):
        (tmp_path / f"{k - 1}.tif").write_bytes(packed(frame, bits, order, strip))
    assert np.array_equal(open_foreign(tmp_path / "0.tif").load("").values, frames[1])
    together = open_foreign(tmp_path)
    assert np.array_equal(together.load("").values, frames)
    assert f"{bits} bits" in together.note


def test_numbers_that_netcdf_packs_into_integers_are_unpacked(tmp_path):
    """As xarray writes them with an encoding of "i2" and a scale_factor."""
    with h5py.File(tmp_path / "packed.nc", "w") as file:
        file["meas"] = np.array([[-1000, 0, 2000], [5, -32768, 7]], np.int16)
        attributes = {"scale_factor": [0.5], "add_offset": [100.0], "_FillValue": np.array([-32768], np.int16)}
        file["meas"].attrs.update(attributes)
    found = open_foreign(tmp_path / "packed.nc").load("meas").values
    assert np.array_equal(found, [[-400, 100, 1100], [102.5, np.nan, 103.5]], equal_nan=True)


def test_numbers_with_a_sign_of_imagej_get_it_back(tmp_path):
    """ImageJ stores -5 as 32763, beside c0=-32768: 32768 too much, with a warning that named other causes."""
    signed = counts(12).astype(np.int32) - 50
    words = "ImageJ=1.54f\nunit=pixel\ncf=0\nc0=-32768.0\nc1=1.0\nvunit=gray value\n"
    tifffile.imwrite(tmp_path / "signed.tif", (signed + 32768).astype(np.uint16), description=words, metadata=None)
    container = open_foreign(tmp_path / "signed.tif")
    assert np.array_equal(container.load("").values, signed)
    assert "as ImageJ's calibration says" in container.note
