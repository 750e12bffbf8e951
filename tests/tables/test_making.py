"""`python -m tests.tables`: from a table's name to its pages."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.progress import Silent
from tests.tables import __main__ as bench
from tests.tables import case_sets
from tests.tables import catalogue as tables
from tests.tables.cases import Case
from tests.tables.catalogue import Table, TableEntry
from tests.tables.cells import Cell
from tests.tables.columns import Measure
from tests.tables.making import make_table
from tests.tables.variants import VARIANTS


@pytest.fixture
def quick(monkeypatch):
    """A table whose work takes no time."""

    def entries(options):
        return [
            TableEntry(case.name, "line", Cell(dict, {"case": case.name, "value": float(seed)}))
            for case in options.cases
            for seed in range(options.seeds)
        ]

    monkeypatch.setitem(tables.TABLES, "quick", Table("Quick", "About.", entries, (Measure("value", "value", 1),)))
    return "quick"


def test_pages_are_written_and_the_table_is_printed(quick, tmp_path, capsys):
    pages = bench.run(quick, tmp_path, seeds=2, cases=("boxes",))
    assert [page.name for page in pages] == ["quick.md", "quick.csv", "quick.png"]
    assert "0.5 ± 0.7" in pages[0].read_text()
    assert "boxes" in capsys.readouterr().out


def test_an_answer_holds_mean_and_spread_of_each_line(quick, tmp_path, capsys):
    assert bench.main(["ablation", "-o", str(tmp_path), "--cases", "none", "--json"]) == 2
    assert "case 'none'" in capsys.readouterr().err
    made = make_table(quick, tmp_path, seeds=2, cases=("boxes",), progress=Silent())
    spread = {"value": pytest.approx(0.5**0.5)}
    line = {"case": "boxes", "line": "line", "mean": {"value": 0.5}, "spread": spread, "known": {"value": 2}}
    assert made.records() == [line | {"count": 2, "errors": ()}]
    bench.run(quick, tmp_path, seeds=2, cases=("boxes",), json=True)
    answer = json.loads(capsys.readouterr().out)
    assert (answer["table"], answer["lines"][0]["mean"]) == ("quick", {"value": 0.5})
    assert str(tmp_path / "quick.csv") in answer["pages"]


def test_finished_cells_are_found_again_and_fresh_forgets_them(quick, tmp_path):
    bench.run(quick, tmp_path, seeds=1, cases=("boxes",))
    (cell,) = (tmp_path / "cells").iterdir()
    cell.write_text('{"value": 7.0}')
    assert "7.0" in bench.run(quick, tmp_path, seeds=1, cases=("boxes",))[0].read_text()
    assert "7.0" not in bench.run(quick, tmp_path, seeds=1, cases=("boxes",), fresh=True)[0].read_text()


def test_mechanisms_have_a_page_of_what_leaving_them_out_costs(quick, tmp_path, monkeypatch):
    def entries(options):
        rows = {"default": 30.0, **dict.fromkeys(options.lines, 29.0)}
        return [TableEntry("boxes", line, Cell(dict, {"psnr_db": db, "seed": 0})) for line, db in rows.items()]

    monkeypatch.setitem(tables.TABLES, "mechanisms", replace(tables.TABLES["mechanisms"], entries=entries))
    pages = bench.run("ablation", tmp_path, mechanisms=True, only=("margin",), seeds=1)
    assert pages[-1].name == "mechanisms-costs.md"
    assert "| margin | surfaces | 1 | +1.00 |" in pages[-1].read_text()


def test_measurements_of_a_folder_replace_the_simulated_ones(quick, tmp_path):
    (tmp_path / "mine.npz").write_bytes(b"")
    assert "## mine" in bench.run(quick, tmp_path / "out", data=tmp_path, seeds=1)[0].read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"table": "none"}, "table 'none'"),
        ({"table": "seeds", "mechanisms": True}, "mechanisms left out in the table seeds"),
        ({"table": "ablation", "only": ("margin",)}, "ablation --mechanisms"),
        ({"table": "ablation", "mechanisms": True, "only": ("luck",)}, "mechanism 'luck'"),
        ({"table": "seeds", "seeds": 0}, "--seeds 0"),
        ({"table": "seeds", "processes": -1}, "--processes -1"),
        ({"table": "seeds", "size": (0, 8)}, "--size 0"),
        ({"table": "calibrate", "size": (8, 8)}, "--size for the table calibrate"),
        ({"table": "seeds", "cases": ("nowhere",)}, "case 'nowhere'"),
    ],
)
def test_what_does_not_exist_is_refused(arguments, message, tmp_path):
    table = arguments.pop("table")
    with pytest.raises(InputError, match=message):
        bench.run(table, tmp_path, **arguments)


def test_a_small_case_goes_all_the_way(tmp_path, monkeypatch):
    monkeypatch.setattr(case_sets, "simulated_cases", lambda: (Case("small", scene="boxes", size=(24, 32), views=3),))
    monkeypatch.setitem(VARIANTS, "default", lambda given: replace(given, fits=1, fit=replace(given.fit, iterations=5)))
    pages = bench.run("seeds", tmp_path, seeds=1)
    assert "| default |" in pages[0].read_text()


def test_threads_wait_as_they_do_for_the_command_line():
    """Otherwise those of torch and of Numba spin against each other, and seconds in tables are not those of users."""
    unset = {name: value for name, value in os.environ.items() if name not in ("OMP_WAIT_POLICY", "OMP_NUM_THREADS")}
    program = "import os, tests.tables.__main__; print(os.environ['OMP_WAIT_POLICY'])"
    found = subprocess.run(
        [sys.executable, "-c", program],
        env={**unset, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout == "PASSIVE\n"
