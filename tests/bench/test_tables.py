"""Which cells make which table."""

import itertools
from dataclasses import replace

import pytest

from gs2ci.bench.calibration import BENCHES, FRAMES
from gs2ci.bench.cases import Case
from gs2ci.bench.tables import RATIOS, TABLES, VIEWS, Options, file_cases, simulated_cases
from gs2ci.bench.variants import ABLATION, FINE, GEOMETRY, RULES, VARIANTS, settings_of
from gs2ci.core.errors import InputError
from gs2ci.reconstruct.ablation import COMPONENTS
from gs2ci.reconstruct.fit.paper import paper_settings

CASES = (Case("a", scene="boxes"), Case("b", scene="ball"))


LINES = {
    "methods": VARIANTS,
    "density": ("default", "one fit", "osgr by the book", "adc", "mcmc", "revised"),
    "ablation": ("default", "one fit", *(f"without {name}" for name in COMPONENTS), "without all six"),
    "mask-ratio": RATIOS,
    "compression": VIEWS,
    "seeds": ("default",),
}


@pytest.mark.parametrize(("name", "lines"), LINES.items())
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


def test_calibration_has_its_own_benches_measured_and_predicted():
    entries = TABLES["calibrate"].entries(Options(CASES, seeds=1))
    assert {entry.case for entry in entries} == set(BENCHES)
    assert len({entry.line for entry in entries}) == 2 * len(FRAMES)
    assert len({entry.cell.key for entry in entries}) == len(entries) == len(BENCHES) * 2 * len(FRAMES)


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


def test_the_table_of_first_geometries_fits_nothing():
    entries = TABLES["init"].entries(Options(CASES[:1], seeds=1))
    assert [entry.line for entry in entries] == ["default", *GEOMETRY]
    assert {entry.cell.work for entry in entries} == {"gs2ci.bench.works:initialise_case"}


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_makes_settings_that_check(variant):
    assert settings_of(variant, 7).check().seed == 7


def test_variants_of_one_kind_differ_from_the_default_and_from_each_other():
    settings = [settings_of(variant, 7) for variant in VARIANTS]
    assert all(a != b for a, b in itertools.combinations(settings, 2))


@pytest.mark.parametrize("variant", [*GEOMETRY, *FINE, *RULES, *ABLATION, "paper"])
def test_what_changes_one_thing_changes_it_in_one_fit(variant):
    assert settings_of(variant, 7).fits == settings_of("one fit", 7).fits == 1


@pytest.mark.parametrize("rule", ["adc", "mcmc", "revised"])
def test_a_rules_variant_has_that_rule_on_the_schedule_of_the_default(rule):
    fit, default = settings_of(rule, 7).fit, settings_of("default", 7).fit
    assert fit.density.name == rule
    assert (fit.iterations, fit.gaussians_per_pixel) == (default.iterations, default.gaussians_per_pixel)


def test_the_papers_variant_is_the_papers_settings():
    assert settings_of("paper", 7) == replace(paper_settings(), seed=7)


def test_an_unknown_variant_is_refused():
    with pytest.raises(InputError, match="variant 'x'"):
        settings_of("x", 0)
