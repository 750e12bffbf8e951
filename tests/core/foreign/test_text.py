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


def labelled(values, mark, head, first=0, quote="{}"):
    """Write a table with what counts its columns, and what counts its rows, as data frames have it."""
    names = mark.join(quote.format(f"{head}{k + first}") for k in range(values.shape[1]))
    return names, [mark.join([quote.format(k + first), *map(str, row)]) for k, row in enumerate(values.tolist())]


@pytest.mark.parametrize(
    "form", ["pandas", "pandas, tabs", "pandas without index", "pandas without names", "polars", "rows with names", "R"]
)
def test_a_data_frame_is_a_measurement_without_its_labels(tmp_path, scene, form, said):
    """pandas 3.1.1, to_csv: "of no known format", or a picture with a row more; R 4.3, write.csv, quotes names."""
    made = scene(channels=1)
    meas = np.rint(100 * made.meas[..., 0]).astype(int)
    if form == "R":
        names, rows = labelled(meas, ",", "V", 1, '"{}"')
        names = f'"",{names}'
    else:
        mark = "\t" if "tabs" in form else ","
        names, rows = labelled(meas, mark, "column_" if form == "polars" else "")
        names = f"{mark}{names}"
        if form == "rows with names":
            rows = [f"r{row}" for row in rows]
        if form == "polars" or form.endswith("index"):
            names, rows = names[1:], [row.partition(mark)[2] for row in rows]
    lines = rows if form == "pandas without names" else [names, *rows]
    (tmp_path / "meas.csv").write_text("\n".join(lines) + "\n")
    np.save(tmp_path / "masks.npy", made.masks)
    imported = import_shots(tmp_path / "meas.csv", tmp_path / "masks.npy", ImportOptions(scale=1.0))
    assert np.array_equal(imported.shots[0].measurement[..., 0], meas.astype(np.float32))
    assert said(imported, "left out")


def test_rows_whose_first_number_counts_keep_it(tmp_path):
    """A trajectory's times, and a camera matrix, are no labels."""
    np.savetxt(tmp_path / "a.txt", np.arange(24).reshape(3, 8))
    assert load_single(tmp_path / "a.txt").values.shape == (3, 8)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2\n3\n", "row 2 is no row of numbers like the others"),
        ("# only a remark\n", "no rows; allowed: rows of as many numbers each"),
        ("1 OPENCV 128 96\n", "names, and no rows"),
        ("x,y\n1,2\n", "columns named x, y"),
        ("a.png,1,2\nb.png,3,4\n", "row 1 is no row of numbers like the others"),
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
