"""Which cells make which table."""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.mechanisms import MECHANISMS
from gs2ci.reconstruct.paper.preset import COMPONENTS, paper_settings
from gs2ci_sims.scenes.files import scene_names
from tests.tables.calibration import BENCHES, FRAMES
from tests.tables.case_sets import file_cases, resized, simulated_cases
from tests.tables.cases import Case
from tests.tables.catalogue import CONDITIONS, RATIOS, TABLES, VIEWS, TableOptions, chosen_cases, known_cases
from tests.tables.cells import run
from tests.tables.literature import DECODERS
from tests.tables.names import TableName
from tests.tables.variants import ABLATION, FINE, GEOMETRY, ON_PAPERS_SCHEDULE, RULES, VARIANTS, settings_of
from tests.tables.works import initialise_case

CASES = (Case("a", scene="boxes"), Case("b", scene="ball"))
TINY = Case("tiny", scene="planes", size=(24, 32))


LINES = {
    "methods": [name for name in VARIANTS if name not in ON_PAPERS_SCHEDULE],
    "density": ("default", "one fit", "osgr by the book", "adc", "mcmc", "revised"),
    "ablation": ("default", "one fit", *(f"without {name}" for name in COMPONENTS), "without all six"),
    "mechanisms": ("default", *(f"no {one.name}" for one in MECHANISMS)),
    "mask-ratio": RATIOS,
    "compression": VIEWS,
    "conditions": CONDITIONS,
    "literature": ("default", *DECODERS),
    "paper": ("default", "paper"),
    "path": ("default", "one fit", *RULES),
    "seeds": ("default",),
}


@pytest.mark.parametrize(("name", "lines"), LINES.items())
def test_a_table_has_a_cell_for_each_case_line_and_seed(name, lines):
    entries = TABLES[name].entries(TableOptions(CASES, seeds=2))
    assert len(entries) == len(CASES) * len(lines) * 2
    assert len({(entry.case, entry.line, entry.cell.arguments["seed"]) for entry in entries}) == len(entries)
    assert len({entry.cell.key for entry in entries}) == len(entries)


def test_every_table_can_be_asked_for_by_its_name():
    assert tuple(TABLES) == get_args(TableName)


def test_a_mechanism_is_always_compared_with_the_default():
    entries = TABLES["mechanisms"].entries(TableOptions(CASES[:1], seeds=1, lines=("no margin",)))
    assert [entry.line for entry in entries] == ["default", "no margin"]
    entries = TABLES["mechanisms"].entries(TableOptions(CASES[:1], seeds=1, lines=("one fit, no margin",)))
    assert [entry.line for entry in entries] == ["one fit", "one fit, no margin"]
    assert settings_of("one fit, no margin", 0) == replace(settings_of("no margin", 0), fits=1)
    assert len({entry.cell.arguments["seed"] for entry in entries}) == 1


def test_the_measurements_of_mechanisms_are_simulated_and_those_of_a_folder(tmp_path):
    (tmp_path / "one.h5").touch()
    (tmp_path / "one.beside.npz").touch()
    built_in, given = (known_cases("mechanisms", folder, None) for folder in (None, tmp_path))
    assert [case.name for case in given[len(built_in) :]] == ["one"]
    with pytest.raises(InputError, match=r"holds no \.npz or \.mat or \.h5 file"):
        known_cases("mechanisms", tmp_path / "nowhere", None)


def test_a_line_changes_what_it_says():
    entries = TABLES["mask-ratio"].entries(TableOptions(CASES[:1], seeds=1))
    assert [entry.cell.arguments["case"]["open_share"] for entry in entries] == list(RATIOS)
    entries = TABLES["compression"].entries(TableOptions(CASES[:1], seeds=1))
    assert [entry.cell.arguments["case"]["views"] for entry in entries] == list(VIEWS)


@pytest.fixture(scope="module")
def conditions():
    """The shot of each line of the table of hard conditions."""
    entries = TABLES["conditions"].entries(TableOptions((TINY,), seeds=1))
    return {entry.line: Case.of(entry.cell.arguments["case"]).shot(0) for entry in entries}


def test_the_line_as_it_is_is_the_case_untouched(conditions):
    easy = conditions["as it is"]
    assert np.array_equal(easy.measurement, TINY.shot(0).measurement)
    assert easy.intrinsics is not None


@pytest.mark.parametrize("percent", [1, 2, 5])
def test_a_line_of_noise_has_that_share_of_full_scale(conditions, percent):
    easy, noisy = conditions["as it is"], conditions[f"noise {percent} %"]
    added = (noisy.measurement - easy.measurement)[~easy.saturated]
    assert added.std() == pytest.approx(percent / 100, rel=0.05)


@pytest.mark.parametrize(("line", "share"), [("half open", 0.5), ("three quarters open", 0.75), ("grey masks", 0.25)])
def test_a_line_of_masks_is_as_open_as_it_says(conditions, line, share):
    assert conditions[line].masks.mean() == pytest.approx(share, abs=0.02)
    assert (len(np.unique(conditions[line].masks)) > 2) == (line == "grey masks")


@pytest.mark.parametrize("views", [16, 32])
def test_a_line_of_views_has_so_many(conditions, views):
    shot = conditions[f"{views} views"]
    assert shot.views == len(shot.truth.views) == len(shot.truth.world_to_camera) == views


def test_only_the_line_without_a_focal_length_tells_no_camera_matrix(conditions):
    assert [line for line, shot in conditions.items() if shot.intrinsics is None] == ["focal unknown"]


def test_no_line_shows_clipped_readings_instead_of_its_condition(conditions):
    assert max(shot.saturated.mean() for shot in conditions.values()) < 0.03


def test_a_line_that_a_file_cannot_have_says_why(tmp_path):
    views, masks = np.full((4, 8, 8, 3), 0.5, np.float32), np.ones((4, 8, 8), np.float32)
    np.savez(tmp_path / "four.npz", meas=views.sum(axis=0), masks=masks, truth=views)
    options = TableOptions(file_cases(tmp_path), seeds=1, lines=("16 views", "focal unknown", "grey masks"))
    rows = [run(entry.cell) for entry in TABLES["conditions"].entries(options)]
    for row, why in zip(rows, ("1 to 4 views", "no camera matrix", "transmission of 1"), strict=True):
        assert why in row["error"]


def test_hard_conditions_come_with_a_scene_that_is_hard_by_itself_and_files_with_none(tmp_path):
    simulated = TABLES["conditions"].known(None)
    assert [case.name for case in simulated] == [*(case.name for case in simulated_cases()), "textureless"]
    assert simulated[-1].scene in scene_names()
    (tmp_path / "a.npz").write_bytes(b"")
    assert [case.name for case in TABLES["conditions"].known(tmp_path)] == ["a"]


def test_calibration_has_its_own_benches_measured_and_predicted():
    table = TABLES["calibrate"]
    entries = table.entries(TableOptions(table.known(None), seeds=1))
    assert {entry.case for entry in entries} == set(BENCHES)
    assert len({entry.line for entry in entries}) == 2 * len(FRAMES)
    assert len({entry.cell.key for entry in entries}) == len(entries) == len(BENCHES) * 2 * len(FRAMES)


def test_only_the_lines_asked_for_are_made():
    entries = TABLES["mask-ratio"].entries(TableOptions(CASES, seeds=1, lines=("50% open",)))
    assert {entry.line for entry in entries} == {"50% open"}


@pytest.mark.parametrize(
    ("table", "line", "variant", "changed"),
    [
        ("mask-ratio", "75% open, adc", "adc", {"open_share": 0.75}),
        ("compression", "16 views, paper, mcmc", "paper, mcmc", {"views": 16}),
        ("density", "paper, revised", "paper, revised", {}),
        ("path", "paper", "paper", {}),
        ("paper", "paper, bounded at 5,000", "paper, bounded at 5,000", {}),
        ("literature", "scisplat", "scisplat", {}),
    ],
)
def test_a_line_that_is_made_only_where_it_is_named(table, line, variant, changed):
    assert line not in {entry.line for entry in TABLES[table].entries(TableOptions(CASES, seeds=1))}
    (entry,) = TABLES[table].entries(TableOptions(CASES[:1], seeds=1, lines=(line,)))
    assert entry.line == line
    assert entry.cell.arguments["variant"] == variant
    assert changed.items() <= entry.cell.arguments["case"].items()


def test_a_simulated_table_takes_any_scene_of_the_library_by_name(tmp_path):
    chosen = chosen_cases("density", None, (24, 32), ("moving", "boxes"))
    assert [(case.name, case.scene, case.size) for case in chosen] == [(s, s, (24, 32)) for s in ("moving", "boxes")]
    assert chosen_cases("density", None, None, ()) == simulated_cases()
    (tmp_path / "a.npz").write_bytes(b"")
    for table, folder, name in (("density", None, "nowhere"), ("density", tmp_path, "boxes"), ("calibrate", None, "a")):
        with pytest.raises(InputError, match=f"case '{name}' is unknown") as caught:
            chosen_cases(table, folder, None, (name,))
        assert ("moving" in caught.value.allowed) == (folder is None and table == "density")


def test_an_unknown_line_is_refused():
    with pytest.raises(InputError, match="line '51% open'"):
        TABLES["mask-ratio"].entries(TableOptions(CASES, lines=("51% open",)))


def test_cells_of_files_depend_on_the_file(tmp_path):
    for name in ("b", "a"):
        (tmp_path / f"{name}.npz").write_bytes(b"")
    cases = file_cases(tmp_path)
    assert [case.name for case in cases] == ["a", "b"]
    assert all(entry.cell.files for entry in TABLES["seeds"].entries(TableOptions(cases)))


def test_a_folder_without_measurements_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"no \.npz file"):
        file_cases(tmp_path)


def test_simulated_cases_name_scenes_of_the_library():
    assert all(case.scene and not case.file for case in simulated_cases())


def test_the_table_of_first_geometries_fits_nothing():
    entries = TABLES["init"].entries(TableOptions(CASES[:1], seeds=1))
    assert [entry.line for entry in entries] == ["default", *GEOMETRY]
    assert {entry.cell.work for entry in entries} == {initialise_case}


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


def test_each_change_to_the_papers_system_changes_that_alone():
    paper = settings_of("paper", 7)

    def back(changed):
        """Undo what a change may change."""
        fit = replace(changed.fit, density=paper.fit.density, loss=paper.fit.loss, cap_from=paper.fit.cap_from)
        fit = replace(fit, gaussians_per_pixel=None, most_gaussians=paper.fit.most_gaussians, poses=paper.fit.poses)
        return replace(changed, fit=fit, proxy=paper.proxy, withheld=paper.withheld)

    for name in ON_PAPERS_SCHEDULE:
        changed = settings_of(name, 7)
        assert changed != paper, name
        assert back(changed) == paper, name
    assert settings_of("paper, bounded at 9,000", 7).fit.cap_from * 20_000 == pytest.approx(9_000)
    assert settings_of("paper, opacities kept", 7).fit.density == replace(paper.fit.density, preserving="neither")
    assert settings_of("paper, adc", 7).fit.density.name == "adc"
    assert settings_of("paper, naive", 7).proxy == "naive"


def test_the_papers_variant_is_the_papers_settings():
    assert settings_of("paper", 7) == replace(paper_settings(), seed=7)


def test_an_unknown_variant_is_refused():
    with pytest.raises(InputError, match="variant 'x'"):
        settings_of("x", 0)


def test_scenes_are_simulated_at_the_size_that_is_asked_for():
    assert {case.shot(0).size for case in resized(CASES[:1], (24, 32))} == {(24, 32)}


def test_of_files_the_middle_is_left(tmp_path):
    masks = np.ones((2, 8, 12), np.float32)
    np.savez(tmp_path / "a.npz", meas=np.ones((8, 12, 3), np.float32), masks=masks)
    assert {case.shot(0).size for case in resized(file_cases(tmp_path), (4, 6))} == {(4, 6)}


def test_a_size_is_refused_where_no_pixel_is_left():
    with pytest.raises(InputError, match="size"):
        resized(CASES, (0, 32))


@pytest.mark.parametrize(
    ("table", "options", "option"),
    [
        ("calibrate", {"size": (24, 32)}, "--size"),
        ("simulate", {"size": (24, 32)}, "--size"),
        ("calibrate", {"folder": Path("benches")}, "--data"),
    ],
)
def test_an_option_that_a_table_cannot_heed_is_refused_with_the_tables_that_can(table, options, option):
    with pytest.raises(InputError, match=f"{option} for the table {table}") as caught:
        known_cases(table, **{"folder": None, "size": None, **options})
    assert "methods, init, density" in caught.value.allowed
    assert table not in caught.value.allowed


def test_the_cases_of_a_table_are_had_at_another_size():
    assert {case.size for case in known_cases("methods", None, (24, 32))} == {(24, 32)}
    assert known_cases("methods", None, None) == simulated_cases()


def test_benches_are_calibrated_by_name():
    benches = known_cases("calibrate", None, None)
    entries = TABLES["calibrate"].entries(TableOptions(benches[:1], 1))
    assert {entry.cell.arguments["bench"] for entry in entries} == {benches[0].name}
