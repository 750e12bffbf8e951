"""`python -m tests.tables simulate`: its cases, and the work of its cells."""

import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.rigs import library
from tests.sims.rig_files import read_rig_file
from tests.tables.catalogue import TABLES, TableOptions
from tests.tables.pages import Figures, draw
from tests.tables.simulation import EVERYTHING, TOLERANCES_DN, rig_cases, simulate_rig

TABLE = TABLES["simulate"]
SMALL = """
[scene]
height = 16
width = 20
[path]
parallax_px = 1.0
[modulator]
masks = 2
[effects.vignetting]
"""


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return str(path)


def test_the_simulators_own_rigs_are_at_least_twelve_and_can_all_be_read():
    assert len(library()) >= 12
    assert [case.name for case in rig_cases(None)] == [path.stem for path in library()]
    for path in library():
        read_rig_file(path)


def test_rig_files_of_a_folder_replace_them(rig, tmp_path):
    (case,) = TABLE.known(tmp_path)
    assert (case.name, case.file) == ("small", rig)


def test_a_folder_without_rig_files_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"no \.toml file"):
        rig_cases(tmp_path)


def test_there_is_a_line_for_everything_and_one_for_each_tolerance(tmp_path, rig):
    entries = TABLE.entries(TableOptions(TABLE.known(tmp_path), seeds=2))
    assert len(entries) == 2 * (1 + len(TOLERANCES_DN))
    assert {entry.line for entry in entries} == {EVERYTHING, *(f"{dn:g} DN" for dn in TOLERANCES_DN)}
    assert all(entry.cell.files == (rig,) for entry in entries)


def test_a_plan_is_off_by_no_more_than_its_bound_and_everything_by_nothing(rig):
    everything = simulate_rig(rig, None, seed=3)
    assert everything["off_dn"] == 0
    for tolerance_dn in (0.05, 1.0):
        row = simulate_rig(rig, tolerance_dn, seed=3)
        assert row["off_dn"] <= row["bound_dn"] <= tolerance_dn
        assert row["views"] <= everything["views"]
        assert row["effects"] <= everything["effects"]
        assert min(row["seconds"], row["faster"], row["faster_than_all_rounds"]) > 0


def test_lines_that_begin_with_a_number_are_drawn_as_curves_on_logarithmic_axes():
    none = (None,) * 6
    figures = [
        Figures("a", line, (value, *none), (None, *none), 1, ())
        for line, value in ((EVERYTHING, 3.0), ("0.05 DN", 2.0), ("5 DN", 1.0))
    ]
    (axes,) = draw(TABLE, figures).axes
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    curve, dash = axes.get_lines()
    assert list(curve.get_xdata()) == [0.05, 5.0]
    assert list(dash.get_ydata()) == [3.0]
    assert axes.get_ylabel() == "s (dashes: everything)"
