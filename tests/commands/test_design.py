"""`gs2ci design` on a small simulated bench."""

import csv
import json
import shlex

import numpy as np
import pytest

from gs2ci.api import designing
from gs2ci.core.errors import GeometryError, InputError, StorageError
from gs2ci.core.progress import Silent
from gs2ci.core.storage import count_shots, read_shot
from gs2ci.evaluate.design import checking
from gs2ci.rig.config import read_rig
from gs2ci_drivers.plan import first_mask

RIG = """
name = "tiny"
[modulator]
kind = "dlpc900"
trigger_out_2_bit = "disables"
port = "simulated"
[sensor]
kind = "v4l2"
port = "simulated"
height = 36
width = 48
format = "Y12"
black_level_dn = 64.0
trigger_adapter = "control"
[stage]
kind = "zaber"
port = "simulated"
[stage.mount]
[capture]
masks = 8          # as the operator wrote it
mask_s = 0.02
shots = 3
axis = "x"
from_mm = 73.0
to_mm = 77.0
[world]
scene = "planes"
height = 36
width = 48
scene_units_per_mm = 0.05
"""
FEW = {"masks": (4,), "open_share": (0.25, 0.5), "element": (1,), "travel_mm": (4.0,), "exposures": (1,)}


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    return tmp_path / "rig.toml"


@pytest.fixture
def judged(monkeypatch):
    """Checks that take no time: the more masks are open, the better; and what was checked."""
    asked = []

    def instead(shots, wanted, intrinsics, name, seed):
        share = float(shots[0].masks.mean())
        asked.append((round(share, 1), len(shots), seed))
        return checking.Checked(30 + 10 * share, 32.0, 2.0)

    monkeypatch.setattr(checking, "checked", instead)
    return asked


def found(bench, **changed):
    return designing.design(bench, scene="boxes", progress=Silent(), **{**FEW, "size": (36, 48), **changed})


def test_a_bench_is_designed_and_the_rig_file_that_is_written_takes_exposures(bench, gs2ci, capsys):
    said = ("--masks", "4", "--open-share", "0.25", "--element", "1", "2", "--travel-mm", "4", "--exposures", "1")
    options = (*said, "--checks", "1", "--size", "36", "48", "--json")
    assert gs2ci("design", "rig.toml", "--scene", "boxes", *options) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["chosen"]["checked_db"] > 15
    assert {path.rpartition(".")[2] for path in answer["pages"]} == {"json", "csv", "png"}
    text = (bench.parent / "designed.toml").read_text(encoding="utf-8")
    assert "masks = 4          # as the operator wrote it" in text
    table, _ = read_rig(bench.parent / "designed.toml")
    assert (table.capture.masks, table.capture.shots) == (4, 1)
    for command in answer["commands"][:-1]:
        assert gs2ci(*command.split()[1:]) == 0
    assert count_shots(bench.parent / "shot.h5") == 1
    assert read_shot(bench.parent / "shot.h5").views == 4


def test_the_best_are_checked_and_the_better_half_of_them_again_under_other_masks(bench, judged):
    made = found(bench, open_share=(0.1, 0.3, 0.5), checks=3)
    assert [seed for _, _, seed in judged] == [42, 42, 42, 43, 43]
    assert {share for share, _, _ in judged[3:]} == {0.3, 0.5}
    assert made.found.chosen.checks == 2
    rows = list(csv.DictReader(made.pages[1].read_text(encoding="utf-8").splitlines()))
    assert [row["chosen"] for row in rows].count("True") == 1


def test_without_checks_the_best_as_foreseen_is_taken(bench, judged):
    made = found(bench, checks=0)
    assert judged == []
    assert made.found.chosen.foreseen_db == max(row.foreseen_db for row in made.found.rows)


def test_the_command_for_a_rig_file_with_a_blank_in_its_name_can_be_pasted(bench, judged):
    made = found(bench, output=bench.parent / "my rig.toml", checks=0)
    assert shlex.split(made.found.commands[0])[3] == str(made.rig_file)


def test_several_exposures_are_one_file_in_which_each_begins_with_another_mask(bench, judged, gs2ci):
    made = found(bench, exposures=(2,), open_share=(0.25,), checks=1)
    assert made.found.commands == (
        "gs2ci capture --rig designed.toml -o shot.h5",
        "gs2ci reconstruct shot.h5 --together -o run/",
    )
    assert gs2ci(*made.found.commands[0].split()[1:]) == 0
    assert count_shots(bench.parent / "shot.h5") == 2
    first, second = (read_shot(bench.parent / "shot.h5", row) for row in range(2))
    assert (first.masks != second.masks).any()
    assert np.array_equal(second.masks, np.roll(first.masks, -first_mask(1, first.views), axis=0))


def test_candidates_that_take_too_long_are_left_out_with_the_reason(bench, judged):
    made = found(bench, masks=(4, 8), exposures=(1, 2), computing="3s", checks=4)
    reasons = {row.left_out for row in made.found.rows}
    assert reasons == {"", "more than 3.0 s of computing"}
    assert made.found.chosen.computing_s <= 3
    late = next(row for row in made.found.rows if row.left_out)
    assert (late.masks, late.exposures) == (8, 2)
    assert late.computing_s > 3
    with pytest.raises(InputError, match="none of 2 candidates is possible, the first because of: more than"):
        found(bench, capture="0.1s", overwrite=True)
    with pytest.raises(InputError, match=r"no candidate is left, the best because of: more than 0.1 s of computing"):
        found(bench, computing="0.1s", overwrite=True)


def test_a_candidate_whose_reconstruction_fails_is_not_chosen(bench, monkeypatch):
    def instead(shots, wanted, intrinsics, name, seed):
        if shots[0].masks.mean() > 0.35:
            raise GeometryError("nothing to see", allowed="something", remedy="look")
        return checking.Checked(30.0, 32.0, 2.0)

    monkeypatch.setattr(checking, "checked", instead)
    made = found(bench, checks=2)
    assert made.found.chosen.density == 0.25
    failed = next(row for row in made.found.rows if row.density == 0.5)
    assert failed.left_out.startswith("its reconstruction failed: nothing to see")
    assert "its reconstruction failed" in made.text
    with pytest.raises(InputError, match="no candidate is left"):
        found(bench, open_share=(0.5,), checks=1, overwrite=True)


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"checks": -1}, "--checks -1"),
        ({"preset": "fine"}, "--preset"),
        ({"seed": -1}, "--seed"),
        ({"wanted_mm": 0.0}, "--wanted-mm"),
        ({"capture": "soon"}, "'soon' is no duration"),
        ({"computing": "1min", "checks": 0}, "--computing with --checks 0"),
        ({"size": (8, 8)}, "a small picture of 8 x 8 px"),
        ({"output": "designed.json"}, "designed.json for a rig file"),
        ({"masks": (0,)}, "--masks 0"),
    ],
)
def test_values_that_cannot_be_used_are_refused_before_anything_is_tried(bench, judged, options, problem):
    with pytest.raises(InputError, match=problem):
        found(bench, **options)
    assert judged == []


def test_earlier_files_are_replaced_only_on_request(bench, judged):
    (bench.parent / "designed.csv").write_text("mine")
    with pytest.raises(StorageError, match=r"designed.csv exists"):
        found(bench, checks=0)
    assert not (bench.parent / "designed.toml").exists()
    found(bench, checks=0, overwrite=True)
    assert (bench.parent / "designed.csv").read_text().startswith("masks,")


def test_a_design_is_shown_as_text_in_a_notebook(bench, judged):
    made = found(bench, checks=0)
    assert made._repr_markdown_() == made.text
    assert made.text.startswith("## Design of tiny for boxes")
