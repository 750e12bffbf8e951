"""What leaving a mechanism out costs, from the rows of a table."""

from tests.tables.cases import Case
from tests.tables.catalogue import TableEntry, compared_with, reconstruction
from tests.tables.paired import paired, paired_markdown, write_paired

GOOD = {
    "psnr_db": 30.0,
    "scene_psnr_db": 29.0,
    "between_psnr_db": None,
    "beyond_psnr_db": 25.0,
    "depth_px": 0.1,
    "depth_rank": 0.9,
    "nate": 0.01,
    "heldout_rms": 0.02,
    "processor_seconds": 10.0,
    "verdict": "refined",
    "failure": "",
    "codes": ["smeared"],
}
LINE = "no margin"


def costs_of(*pairs, line=LINE):
    entries, rows = [], []
    for number, (base, without) in enumerate(pairs):
        case = Case(f"case {number}", scene="boxes")
        for name, row in ((compared_with(line), base), (line, without)):
            entries.append(TableEntry(case.name, name, reconstruction(case, name, 1)))
            rows.append(row)
    (found,) = paired(entries, rows)
    return found


def test_a_mechanism_that_changes_nothing_does_not_stay():
    found = costs_of((GOOD, GOOD), (GOOD, GOOD | {"processor_seconds": 5.0}))
    assert found.reasons == ()
    assert found.mean_db("psnr_db") == 0.0
    assert found.mean_db("between_psnr_db") is None
    assert [cost.seconds for cost in found.costs] == [1.0, 0.5]


def test_a_mean_gain_of_a_twentieth_of_a_decibel_is_enough():
    assert costs_of((GOOD, GOOD | {"psnr_db": 29.9}), (GOOD, GOOD)).reasons == ("views +0.05 dB",)
    assert costs_of((GOOD, GOOD | {"psnr_db": 29.92}), (GOOD, GOOD)).reasons == ()


def test_a_large_gain_has_to_be_seen_twice():
    worse, better = GOOD | {"psnr_db": 29.6}, GOOD | {"psnr_db": 31.0}
    assert costs_of((GOOD, worse), (GOOD, better)).reasons == ()
    assert costs_of((GOOD, worse), (GOOD, worse), (GOOD, better)).reasons == ("views ≥ 0.3 dB on 2",)


def test_a_right_path_and_a_right_order_count():
    lost = GOOD | {"nate": 0.4, "depth_rank": -0.5, "codes": ["smeared", "depth-order-open"]}
    assert costs_of((GOOD, lost), (GOOD, lost)).reasons == ("right path on 2", "right order on 2")
    assert costs_of((GOOD, lost), (lost, GOOD)).reasons == ()


def test_what_becomes_silently_wrong_keeps_a_mechanism():
    reversed_scene = GOOD | {"depth_rank": -0.9, "failure": "the depth order is reversed"}
    assert costs_of((GOOD, reversed_scene)).reasons == ("silently wrong on 1",)
    said = reversed_scene | {"codes": ["smeared", "depth-order-open"]}
    assert costs_of((GOOD, said)).reasons == ()


def test_cells_that_failed_are_counted_and_not_compared():
    found = costs_of((GOOD, {"error": "no memory"}), (GOOD, GOOD))
    assert (len(found.costs), found.failed) == (1, 1)


def test_a_real_exposure_is_judged_by_what_it_leaves(tmp_path):
    unknown = dict.fromkeys(GOOD) | {"heldout_rms": 0.02, "verdict": "refined", "processor_seconds": 1.0}
    found = costs_of((unknown, unknown | {"heldout_rms": 0.03, "verdict": "decode"}))
    (cost,) = found.costs
    assert (cost.heldout, cost.verdict, dict(cost.db)) == (1.5, True, {})
    page = write_paired(tmp_path, [found], "the command").read_text()
    assert page == paired_markdown([found], "the command")
    assert "| margin | surfaces | 1 | – | – | – | – | – | – | – | – | +0 | +0 | 1.50 | 1 | 1.00 | no |" in page


def test_a_line_in_one_fit_is_compared_with_one_fit():
    found = costs_of((GOOD, GOOD | {"psnr_db": 29.0}), line="one fit, no margin")
    assert found.mean_db("psnr_db") == 1.0
    assert "| margin, in one fit | surfaces | 1 | +1.00 |" in paired_markdown([found], "the command")
