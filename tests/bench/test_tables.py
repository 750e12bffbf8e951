"""Which cells make which table."""

import pytest

from gs2ci.bench.cases import Case
from gs2ci.bench.tables import RATIOS, TABLES, VIEWS, Options, file_cases, simulated_cases
from gs2ci.bench.variants import VARIANTS, settings_of
from gs2ci.core.errors import InputError

CASES = (Case("a", scene="boxes"), Case("b", scene="ball"))


@pytest.mark.parametrize(
    ("name", "lines"), [("methods", VARIANTS), ("mask-ratio", RATIOS), ("compression", VIEWS), ("seeds", ["default"])]
)
def test_a_table_has_a_cell_for_each_case_line_and_seed(name, lines):
    entries = TABLES[name].entries(Options(CASES, seeds=2))
    assert len(entries) == len(CASES) * len(lines) * 2
    assert len({(entry.case, entry.line, entry.cell.arguments["seed"]) for entry in entries}) == len(entries)
    assert len({entry.cell.key for entry in entries}) == len(entries)


def test_a_line_changes_what_it_says():
    entries = TABLES["mask-ratio"].entries(Options(CASES[:1], seeds=1))
    assert [entry.cell.arguments["case"]["open_share"] for entry in entries] == list(RATIOS)
    entries = TABLES["compression"].entries(Options(CASES[:1], seeds=1))
    assert [entry.cell.arguments["case"]["views"] for entry in entries] == list(VIEWS)


def test_only_the_lines_asked_for_are_made():
    entries = TABLES["mask-ratio"].entries(Options(CASES, seeds=1, lines=("50% open",)))
    assert {entry.line for entry in entries} == {"50% open"}


def test_an_unknown_line_is_refused():
    with pytest.raises(InputError, match="line '51% open'"):
        TABLES["mask-ratio"].entries(Options(CASES, lines=("51% open",)))


def test_cells_of_files_depend_on_the_file(tmp_path):
    for name in ("b", "a"):
        (tmp_path / f"{name}.npz").write_bytes(b"")
    cases = file_cases(tmp_path)
    assert [case.name for case in cases] == ["a", "b"]
    assert all(entry.cell.files for entry in TABLES["seeds"].entries(Options(cases)))


def test_a_folder_without_measurements_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"no \.npz file"):
        file_cases(tmp_path)


def test_simulated_cases_name_scenes_of_the_library():
    assert all(case.scene and not case.file for case in simulated_cases())


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_makes_settings_that_check(variant):
    assert settings_of(variant, 7).check().seed == 7


def test_an_unknown_variant_is_refused():
    with pytest.raises(InputError, match="variant 'x'"):
        settings_of("x", 0)
