"""Reading files that are not what they should be: always one StorageError that names file and key."""

import subprocess
import sys

import h5py
import numpy as np
import pytest

from gs2ci.core.errors import StorageError
from gs2ci.core.storage import (
    ShotWriter,
    count_shots,
    read_shot,
    recover,
    write_shots,
)
from tests.patience import HANG_S


@pytest.fixture
def path(tmp_path, make_shot):
    return write_shots(tmp_path / "shot.h5", [make_shot(saturated=np.zeros((12, 16), bool))])


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    for missing, problem in ((tmp_path / "none.h5", "no such file"), (tmp_path, "is a folder")):
        with pytest.raises(StorageError, match=problem):
            read_shot(missing)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"\x89HDF\r\n\x1a\n", b"\x89HDF\r\n\x1a\n" + bytes(500)])
def test_bytes_that_are_no_hdf5_file_are_refused(tmp_path, content):
    file = tmp_path / "shot.h5"
    file.write_bytes(content)
    for read in (read_shot, count_shots):
        with pytest.raises(StorageError, match=r"shot\.h5"):
            read(file)


def test_a_truncated_file_is_refused(path):
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(StorageError, match="truncated"):
        read_shot(path)


def test_a_wrong_index_says_which_are_allowed(path):
    for index in (1, -1):
        with pytest.raises(StorageError, match=r"no shot -?1; allowed: 0: it holds one shot"):
            read_shot(path, index)


@pytest.mark.parametrize(
    ("schema", "message"),
    [
        ("gs2ci.capture/2", "newer gs2ci"),
        ("gs2ci.calibration/1", "it is a calibration"),
        ("nexus", "gs2ci import"),
        (None, "not a gs2ci capture"),
        ([1, 2], "single value"),
    ],
)
def test_other_schemas_are_refused(path, schema, message):
    with h5py.File(path, "r+") as file:
        del file.attrs["schema"]
        if schema is not None:
            file.attrs["schema"] = schema
    with pytest.raises(StorageError, match=message):
        read_shot(path)


def replace(file: h5py.File, key: str, data: object, **keywords: object) -> None:
    del file[key]
    file.create_dataset(key, data=data, **keywords)


def outside(file: h5py.File, key: str, link: object) -> None:
    del file[key]
    file[key] = link


BROKEN = {
    "meas missing": ("meas", lambda f: f.__delitem__("meas")),
    "meas is a group": ("meas", lambda f: (f.__delitem__("meas"), f.create_group("meas"))),
    "meas is text": ("meas", lambda f: replace(f, "meas", ["a"], dtype=h5py.string_dtype())),
    "meas has one axis": ("meas", lambda f: replace(f, "meas", np.zeros(1))),
    "meas has two axes": ("meas", lambda f: replace(f, "meas", np.zeros((1, 4)))),
    "meas is complex": ("meas", lambda f: replace(f, "meas", np.zeros((1, 12, 16), complex))),
    "too few flags": ("meas_valid", lambda f: replace(f, "meas_valid", np.ones(0, np.uint8))),
    "too many flags": ("meas_valid", lambda f: replace(f, "meas_valid", np.ones(5, np.uint8))),
    "no masks": ("masks/calib", lambda f: f.__delitem__("masks")),
    "masks is a dataset": ("masks/calib", lambda f: replace(f, "masks", np.zeros(1))),
    "masks with a bad scale": ("masks/calib", lambda f: f["masks/calib"].attrs.__setitem__("full_scale", "big")),
    "masks with scale nan": ("masks/calib", lambda f: f["masks/calib"].attrs.__setitem__("full_scale", np.nan)),
    "masks of scale 0.5": ("transmissions", lambda f: f["masks/calib"].attrs.__setitem__("full_scale", 0.5)),
    "masks of another size": ("masks", lambda f: replace(f, "masks/calib", np.ones((4, 3, 3), "f4"))),
    "no weights": ("calib/weights", lambda f: f.__delitem__("calib/weights")),
    "negative scale": ("scale_dn", lambda f: f["meas"].attrs.__setitem__("scale_dn", -1.0)),
    "cfa is a number": ("camera/cfa", lambda f: f.create_dataset("camera/cfa", data=3)),
    "cfa is empty": ("camera/cfa", lambda f: f.create_dataset("camera/cfa", data=h5py.Empty(h5py.string_dtype()))),
    "cfa is a book": ("a text of", lambda f: f.create_dataset("camera/cfa", (), "S20000000")),
    "weights are empty": ("damaged", lambda f: replace(f, "calib/weights", h5py.Empty("f8"))),
    "unknown cfa": ("XYZW", lambda f: f.create_dataset("camera/cfa", data="XYZW")),
    "intrinsics zero": ("intrinsics", lambda f: replace(f, "camera/intrinsics", np.zeros((3, 3)))),
    "lens without a camera": (
        "without intrinsics",
        lambda f: (f.__delitem__("camera/intrinsics"), f.create_dataset("camera/distortion", data=np.zeros(5))),
    ),
    "lens of four": ("k1 k2 p1 p2 k3", lambda f: f.create_dataset("camera/distortion", data=np.zeros(4))),
    "lens of many": ("k1 k2 p1 p2 k3", lambda f: f.create_dataset("camera/distortion", data=np.zeros(10**5))),
    "lens of two axes": ("camera/distortion", lambda f: f.create_dataset("camera/distortion", data=np.zeros((1, 5)))),
    "lens of text": ("camera/distortion", lambda f: f.create_dataset("camera/distortion", data="k1")),
    "lens is nan": ("finite", lambda f: f.create_dataset("camera/distortion", data=np.full(5, np.nan))),
    "lens that folds": ("folds", lambda f: f.create_dataset("camera/distortion", data=np.full(5, -9.0))),
    "provenance no json": ("truncated", lambda f: replace(f, "provenance", ["{"], dtype=h5py.string_dtype())),
    "provenance no object": ("provenance", lambda f: replace(f, "provenance", ["[]"], dtype=h5py.string_dtype())),
    "provenance odd": (
        "provenance",
        lambda f: replace(f, "provenance", ['{"name": 1}'], dtype=h5py.string_dtype()),
    ),
    "truth flags short": ("views_valid", lambda f: replace(f, "truth/views_valid", np.ones(0, np.uint8))),
    "truth rows short": ("truth/views", lambda f: replace(f, "truth/views", np.ones((0, 4, 12, 16, 3), "f4"))),
    "saturated of another size": ("saturated", lambda f: replace(f, "saturated", np.zeros((1, 2, 2), "u1"))),
    "soft link": ("link", lambda f: outside(f, "meas", h5py.SoftLink("/truth/views"))),
    "external link": ("link", lambda f: outside(f, "meas", h5py.ExternalLink("/etc/passwd", "/x"))),
    "linked group": ("link", lambda f: outside(f, "masks", h5py.SoftLink("/calib"))),
    "huge masks": (
        "claims",
        lambda f: (
            f.__delitem__("masks/calib"),
            f.create_dataset("masks/calib", (4, 2**20, 2**20), "f4", chunks=(1, 64, 64), compression="gzip"),
        ),
    ),
    "huge chunk": (
        "claims",
        lambda f: (
            f.__delitem__("masks/calib"),
            f.create_dataset(
                "masks/calib",
                (4, 12, 16),
                "u1",
                maxshape=(None, None, None),
                chunks=(1, 30000, 30000),
                compression="gzip",
            ),
        ),
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_part_is_named(path, case):
    word, damage = BROKEN[case]
    with h5py.File(path, "r+") as file:
        damage(file)
    with pytest.raises(StorageError, match=word) as caught:
        read_shot(path)
    assert "shot.h5" in str(caught.value)


def test_data_that_lie_in_another_file_are_refused(path, tmp_path):
    secret = tmp_path / "secret.bin"
    secret.write_bytes(bytes(12 * 16 * 3 * 4))
    with h5py.File(path, "r+") as file:
        del file["meas"]
        file.create_dataset("meas", (1, 12, 16, 3), "f4", external=[(str(secret), 0, h5py.h5f.UNLIMITED)])
    with pytest.raises(StorageError, match="another file"):
        read_shot(path)
    layout = h5py.VirtualLayout((1, 12, 16, 3), "f4")
    layout[0] = h5py.VirtualSource(path, "truth/views", (1, 4, 12, 16, 3))[0, 0]
    with h5py.File(path, "r+") as file:
        del file["meas"]
        file.create_virtual_dataset("meas", layout)
    with pytest.raises(StorageError, match="another file"):
        read_shot(path)


def test_changed_pixels_are_found_out_by_their_checksum(path):
    with h5py.File(path) as file:
        at = file["meas"].id.get_chunk_info(0).byte_offset
    data = bytearray(path.read_bytes())
    data[at + 40] ^= 1
    path.write_bytes(data)
    with pytest.raises(StorageError, match="damaged"):
        read_shot(path)


def test_damaged_bytes_give_a_shot_or_a_typed_error(path, mutations):
    # Seeds are fixed: HDF5 is C, and a new crash of its own must not come and go between two runs of the tests.
    copy = path.with_name("copy.h5")
    outcomes = set()
    for content in mutations(path.read_bytes(), 250, seed=1):
        copy.write_bytes(content)
        try:
            read_shot(copy)
            outcomes.add("shot")
        except StorageError:
            outcomes.add("error")
    assert outcomes == {"shot", "error"}


def read_apart(path):
    """Read a file in a process of its own, which a fault of the library may end or hold up; return what came of it."""
    script = (
        "import sys; from pathlib import Path; from gs2ci.core.storage import read_shot\n"
        "try: read_shot(Path(sys.argv[1]))\n"
        "except Exception as error: print(type(error).__name__, error)"
    )
    return subprocess.run(
        [sys.executable, "-c", script, str(path)], capture_output=True, text=True, timeout=HANG_S, check=False
    )


def test_a_text_heap_that_would_be_walked_for_ever_is_refused(path):
    data = bytearray(path.read_bytes())
    at = data.index(b"GCOL")
    data[at + 16 : at + 32] = bytes(16)  # a free object of size zero, first in the heap
    path.write_bytes(data)
    done = read_apart(path)
    assert done.returncode == 0
    assert "StorageError" in done.stdout
    assert "damaged text storage" in done.stdout


@pytest.mark.parametrize("kind", [0x53, 0x02, 0x00])
def test_an_attribute_whose_text_is_damaged_into_a_list_is_refused(path, kind):
    # HDF5 ends the process by a segmentation fault when it reads such a list.
    data = bytearray(path.read_bytes())
    text = data.index(b"\x19\x01\x01\x00\x10", data.index(b"schema\0"))
    data[text + 1] = kind
    path.write_bytes(data)
    done = read_apart(path)
    assert done.returncode == 0
    assert "StorageError" in done.stdout
    assert "attribute schema is object; allowed: a number or a text" in done.stdout


def test_recovery_skips_rows_that_cannot_be_read_and_says_so(tmp_path, make_shot):
    first = make_shot()
    path = write_shots(tmp_path / "shot.h5", [first, make_shot(measurement=first.measurement * 2)])
    with h5py.File(path) as file:
        at = file["meas"].id.get_chunk_info(0).byte_offset
    data = bytearray(path.read_bytes())
    data[at + 40] ^= 1
    path.write_bytes(data)
    recover(path, tmp_path / "saved.h5")
    assert count_shots(tmp_path / "saved.h5") == 1
    assert np.array_equal(read_shot(tmp_path / "saved.h5").measurement, first.measurement * 2)
    with h5py.File(tmp_path / "saved.h5") as file:
        assert b'"lost": [{"row": 0' in file["events"][-1]


def test_recovery_refuses_what_it_cannot_save(path, tmp_path):
    with pytest.raises(StorageError, match="replace the damaged file itself"):
        recover(path, path)
    with h5py.File(path, "r+") as file:
        file["meas_valid"][0] = 0
    with pytest.raises(StorageError, match="no whole row"):
        recover(path, tmp_path / "saved.h5")
    with h5py.File(path, "r+") as file:
        file["meas_valid"][0] = 1
        replace(file, "meas", np.zeros((1, 12)))
    with pytest.raises(StorageError, match="stack of images"):
        recover(path, tmp_path / "saved.h5")
    assert not list(tmp_path.glob("saved*"))
    with h5py.File(path, "r+") as file:
        file["meas_valid"][0] = 0
    with pytest.raises(StorageError, match="no shot 0; allowed: none"):
        read_shot(path)


def test_a_recovery_that_fails_leaves_nothing_behind(path, tmp_path, monkeypatch):
    def refuse(self: ShotWriter) -> None:
        raise StorageError("disk full")

    monkeypatch.setattr(ShotWriter, "finish", refuse)
    with pytest.raises(StorageError, match="disk full"):
        recover(path, tmp_path / "saved.h5")
    assert not list(tmp_path.glob("saved*"))
