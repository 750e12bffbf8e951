"""Texts of numbers, as other programs write them, are one array; what is none is refused."""

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.opening import load_single, open_foreign
from gs2ci.core.foreign.options import ImportOptions

ROWS = np.array([[1.5, -2, 3], [0, 40.25, 1e-3]])


def lines(mark, point="."):
    return "\n".join(mark.join(f"{value:.6g}" for value in row) for row in ROWS).replace(".", point) + "\n"


@pytest.mark.parametrize(
    "content",
    [
        lines(",").encode(),
        lines(" ").encode(),
        ("\r\n# a remark\r\n" + lines("\t")).encode(),
        lines(";", ",").encode(),
        lines(",").replace("\n", ",\n").encode(),
        b"\xef\xbb\xbf" + lines(",").encode(),
    ],
    ids=["commas", "blanks", "tabs, a remark", "decimal commas", "a comma at each end", "a mark of UTF-8"],
)
def test_a_text_of_numbers_is_one_array(tmp_path, content):
    (tmp_path / "a.txt").write_bytes(content)
    assert np.array_equal(load_single(tmp_path / "a.txt").values, ROWS)


def test_one_column_is_a_list(tmp_path):
    (tmp_path / "a.txt").write_text("820\n820\n64\n48\n")
    assert load_single(tmp_path / "a.txt").values.tolist() == [820, 820, 64, 48]


def test_a_measurement_may_be_a_text_image(tmp_path, scene):
    """ImageJ saves such ones."""
    made = scene(channels=1)
    np.savetxt(tmp_path / "meas.txt", made.meas[..., 0], delimiter="\t")
    np.save(tmp_path / "masks.npy", made.masks)
    shot = import_shots(tmp_path / "meas.txt", tmp_path / "masks.npy", ImportOptions(scale=1.0)).shots[0]
    assert np.allclose(shot.measurement, made.meas)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2\n3\n", "row 2 is no row of numbers like the others"),
        ("# only a remark\n", "no rows; allowed: rows of as many numbers each"),
        ("1 OPENCV 128 96\n", "names, and no rows"),
        ("x,y\n1,2\n", "its content is of no known format"),
    ],
)
def test_what_is_no_text_of_numbers_is_refused(tmp_path, text, message):
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        open_foreign(tmp_path / "a.txt")


def test_a_text_that_would_fill_the_memory_is_refused(tmp_path, monkeypatch):
    (tmp_path / "a.txt").write_text("1 2 3\n")
    monkeypatch.setattr("gs2ci.core.foreign.container.LIMIT_BYTES", 3)
    with pytest.raises(InputError, match="claims shape"):
        open_foreign(tmp_path / "a.txt")
