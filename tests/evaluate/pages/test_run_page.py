import html
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import StorageError
from gs2ci.core.findings import Code, finding
from gs2ci.core.run_figures import EnsembleSection, RaceEntry
from gs2ci.core.run_records import SECONDS_KEYS
from gs2ci.evaluate.pages.run_evidence import read_run
from gs2ci.evaluate.pages.run_page import run_page, write_run_page
from gs2ci.evaluate.report import Scores


@pytest.fixture(scope="module")
def evidence(whole_run):
    return read_run(whole_run)


@pytest.fixture(scope="module")
def text(whole_run):
    return (whole_run / "report.html").read_text(encoding="utf-8")


def headings(text):
    return re.findall(r"<h2 id=[^>]*>([^<]*)</h2>", text)


def changed(evidence, **changes):
    return replace(evidence, report=evidence.report.model_copy(update=changes))


def test_the_page_of_a_whole_run_has_all_its_sections_in_order(text):
    assert headings(text) == [
        "Views",
        "Scene and cameras",
        "View by view",
        "Depth, error, disagreement",
        "How sure it is",
        "Camera path",
        "Quality against time",
        "Cost",
        "What accuracy costs",
        "Simulated effects",
        "Notes and doubts",
        "Measurement and calibration",
        "Settings",
        "Environment",
        "Files",
    ]


def test_the_error_to_be_expected_of_the_path_stands_beside_it(text):
    facts = text[text.index("poses started from") : text.index("Quality against time</h2>")]
    assert "expected error of the first path" in facts
    assert "0.0123" in facts


@pytest.mark.parametrize(("verdict", "found"), [("full", True), ("static", False), ("unsupported", False)])
def test_cameras_without_a_path_are_not_called_one(evidence, verdict, found):
    geometry = replace(evidence.report.geometry, verdict=verdict)
    without = replace(evidence, true_world_to_camera=None, stage_world_to_camera=None)
    page = run_page(changed(without, geometry=geometry))
    assert ("The recovered path; its unit is the scene" in page) is found
    assert ("No path was found" in page) is not found


def test_a_camera_known_to_be_at_rest_has_no_path(evidence):
    geometry = replace(evidence.report.geometry, verdict="static", method="rest")
    without = replace(evidence, true_world_to_camera=None, stage_world_to_camera=None)
    notes = (*evidence.report.notes, finding(Code.CAMERA_GIVEN_AT_REST))
    page = run_page(changed(without, geometry=geometry, notes=notes))
    assert "The camera was at rest: there is no path" in page
    assert "No path was found" not in page


def test_the_verdict_comes_first_with_figures_and_units(text, evidence):
    report = evidence.report
    top = text[text.index("<header") : text.index("<main")]
    assert "8 views, the camera path and the scene in 3D, from one exposure" in top
    assert f"{report.psnr_db.mean:.2f} dB" in top
    assert "89 s" in top
    assert "13\u2009000" in top
    assert "MiB" in top
    assert "What to try next" in top
    assert "gs2ci view RUN" in top


def test_it_tells_notes_settings_and_what_the_shot_was_simulated_with(text):
    assert "The focal length was estimated from the tracks: 70 px" in text
    assert "shot noise" in text
    assert "exceeds its share" in text
    assert "by at most 0.8 DN rms" in text
    assert "simulated rig" in text
    assert "preset" in text


@pytest.mark.parametrize(
    ("verdict", "ensemble", "sentence"),
    [
        ("refined", {"fits": 3, "averaged": 3, "spread": 0.0123}, "mean of 3 fits, refined .* 0.012 of a view"),
        ("refined", {"fits": 2, "averaged": 1, "spread": 0.0123}, "The views are rendered from the scene and refined"),
        ("refined", None, "The views are rendered from the scene and refined"),
        ("scene", {"fits": 2, "averaged": 2, "spread": 0.0123}, "The views are rendered from the scene[.]"),
        ("decode", {"fits": 2, "averaged": 2, "spread": 0.0123}, "The views are those of the decode"),
    ],
)
def test_it_says_whose_views_are_shown(evidence, verdict, ensemble, sentence):
    page = run_page(changed(evidence, verdict=verdict, ensemble=ensemble and EnsembleSection(**ensemble)))
    assert re.search(sentence, html.unescape(page))


def test_views_that_are_mostly_the_decodes_are_not_said_to_be_the_scenes(evidence):
    note = finding(Code.VIEWS_COMBINED, refined=0.25, scene=0.0, decode=0.75)
    page = html.unescape(run_page(changed(evidence, verdict="refined", ensemble=None, notes=[note])))
    assert "The views are mostly those of the decode (75%)" in page
    assert "The views are rendered from the scene" not in page


def test_a_unit_stays_on_the_line_of_its_number(text):
    assert re.search(r"fit \d+\.\d\u00a0s", text)


def test_nothing_comes_from_elsewhere(text):
    addresses = re.findall(r"""(?:src|href|url|xlink:href)\s*[=(]\s*["']?([^"'\s>)]+)""", text)
    assert addresses
    assert all(address.startswith(("data:", "#")) for address in addresses)
    assert not re.search(r"@import|https?://|<link|<iframe|<object", text)
    assert "default-src 'none'" in text


def test_what_the_run_does_not_know_is_left_out(evidence):
    unscored = Scores(psnr_db=None, ssim=None)
    unknown = changed(
        evidence,
        psnr_db=None,
        ssim=None,
        scene=unscored,
        decode=unscored,
        trajectory=None,
        geometry=None,
        curve=[],
        notes=[],
        provenance={},
        simulation=None,
    )
    bare = replace(
        unknown,
        depth=None,
        disagreement=None,
        measurement=None,
        true_views=None,
        true_world_to_camera=None,
        stage_world_to_camera=None,
    )
    page = run_page(bare)
    assert "View by view" not in headings(page)
    assert "Simulated effects" not in headings(page)
    assert "No depth was found, the true views are not known, and there was one fit." in page
    assert "Nothing was fitted" in page
    assert "There is nothing to doubt or to add." in page
    assert "its unit is the scene's own" in page.replace("&#39;", "'")
    assert "PSNR" not in page
    assert 'value="truth"' not in page
    assert 'class="measurement"' not in page


def test_a_decode_that_won_is_compared_with_the_others_and_said_to_have_won(evidence):
    page = run_page(changed(evidence, verdict="decode"))
    assert "Views only" in page
    assert "its residual on the held-out pixels is smaller" in page
    assert 'value="decode"' not in page
    assert 'value="truth"' in page


def test_a_decode_that_won_and_is_all_there_is_stays(evidence):
    alone = replace(changed(evidence, verdict="decode"), measurement=None, true_views=None)
    assert 'data-left="decode"' in run_page(alone)


def test_one_view_needs_no_picker(tmp_path, make_run, scene, write_quickly):
    folder = write_quickly(tmp_path / "run", *make_run(count=1), scene)
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "1 view, the camera path" in page
    assert 'class="picker"' not in page


def test_many_views_are_thinned_and_it_says_so(tmp_path, make_run, scene, write_quickly):
    folder = write_quickly(tmp_path / "run", *make_run(count=24, size=(12, 16)), scene)
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "16 of 24 views are shown here." in page
    (names,) = re.findall(r'data-names="([\d ]+)"', page)
    assert names.startswith("1 3 ")
    # The camera that is marked while a view is shown is that view's.
    marked = re.findall(r'data-index="(\d+)"><title>recovered, view (\d+)<', page)
    assert marked == 2 * [(str(place), name) for place, name in enumerate(names.split())]


def test_mono_measurements_have_a_page_too(tmp_path, make_run, scene, write_quickly):
    folder = write_quickly(tmp_path / "run", *make_run(channels=1), scene)
    assert "64 × 48, mono" in (folder / "report.html").read_text(encoding="utf-8")


def test_hostile_names_stay_text(evidence):
    hostile = '</title><script>alert("x")</script>\u202egnp.\x00'
    note = finding(Code.FINE_UNCHANGED, why=hostile)
    page = run_page(changed(evidence, name=hostile, notes=[note], provenance={hostile: {hostile: hostile}}))
    assert "<script>alert" not in page
    assert page.count("<script>") == 1
    assert "\u202e" not in page
    assert "\x00" not in page
    assert "&lt;script&gt;alert(&#34;x&#34;)" in page


def test_endless_reports_are_cut_and_it_says_so(evidence):
    note = finding(Code.FINE_UNCHANGED, why="word " * 10_000)
    page = run_page(changed(evidence, notes=[note], settings={f"key {i}": i for i in range(400)}))
    assert "151 more are left out here." in page
    assert page.count("word") < 200


def test_it_is_built_again_from_the_folder_alone(own_run, text):
    (own_run / "report.html").unlink()
    assert write_run_page(own_run).read_text(encoding="utf-8") == text


def test_it_can_be_written_elsewhere(own_run, tmp_path):
    page = write_run_page(own_run, tmp_path / "there.html")
    assert page == tmp_path / "there.html"
    assert page.is_file()


def test_a_folder_without_what_was_given_gets_a_page_of_what_it_holds(own_run):
    (own_run / "given.npz").unlink()
    assert 'class="measurement"' not in write_run_page(own_run).read_text(encoding="utf-8")


def test_a_run_of_an_older_version_is_one_typed_error(own_run):
    before = (own_run / "report.html").read_bytes()
    report = json.loads((own_run / "report.json").read_text())
    (own_run / "report.json").write_text(json.dumps({**report, "schema": "gs2ci.report/1"}))
    with pytest.raises(StorageError, match="with the version of gs2ci that wrote it"):
        write_run_page(own_run)
    assert (own_run / "report.html").read_bytes() == before


def test_a_report_at_the_ends_of_its_numbers_gets_a_page(evidence):
    extremes = {"gaussians": 10**15, "peak_mib": 1e100, "seconds": {**dict.fromkeys(SECONDS_KEYS, 0.0), "more": 1e100}}
    curve = [replace(look, seconds=1e100, heldout=1e100) for look in evidence.report.curve]
    assert "Recovered" in run_page(changed(evidence, curve=curve, **extremes))


def test_what_is_no_run_is_refused(tmp_path):
    with pytest.raises(StorageError, match="cannot be read"):
        write_run_page(tmp_path)


def test_arrays_that_are_not_finite_get_a_page(evidence):
    """The run folder's writer refuses them, another program's may not."""
    views, depth = np.array(evidence.views), np.array(evidence.depth)
    views[0, :5], depth[0] = np.nan, np.inf
    assert "Recovered" in run_page(replace(evidence, views=views, depth=depth))


def test_the_race_shows_who_led_when_and_who_fell_out(evidence):
    first = RaceEntry(
        hypothesis="first look",
        path="tracks",
        began=0,
        iterations=200,
        schedule=400,
        heldout=[(50, 0.04), (100, 0.03)],
        refined_rms=0.03,
        outcome="far behind after a quarter of its schedule",
    )
    again = replace(first, hypothesis="second look", outcome="taken", iterations=400)
    text = run_page(changed(evidence, race=[first, again]))
    assert "1 first look" in text
    assert "2 second look" in text
    assert "200 of 400" in text
    assert "far behind after a quarter of its schedule" in text
    assert "200 of 400" not in run_page(changed(evidence, race=[first]))


def test_it_says_what_rendered(text, evidence):
    assert re.search(r"rendered on.{0,80}?cpu", text, re.DOTALL)
    assert "cuda:0 (NVIDIA H100 PCIe)" in run_page(changed(evidence, device="cuda:0 (NVIDIA H100 PCIe)"))
