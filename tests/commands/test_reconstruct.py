import json
import tempfile
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci.api.overrides import Overrides
from gs2ci.commands import reconstruct
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.findings import Code
from gs2ci.core.records import Shot, Truth
from gs2ci.core.storage import sealing, write_shots
from gs2ci.evaluate import run_folder
from gs2ci.evaluate.report import read_report
from gs2ci.reconstruct.measurement.brightness import BrightnessSettings
from gs2ci.reconstruct.presets.named import PRESETS
from gs2ci.reconstruct.settings import Settings
from gs2ci.render import backend

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("undrawn")]

SIZE = (24, 32)
CAMERA = np.array([[30.0, 0, 15], [0, 33, 13], [0, 0, 1]])


def shot(seed=0, **parts):
    rng = np.random.default_rng(seed)
    views = np.repeat(rng.random((3, *SIZE, 1)), 3, axis=3).astype(np.float32)
    masks = np.tile((np.arange(3)[:, None, None] == (np.arange(SIZE[1]) % 3)), (1, SIZE[0], 1)).astype(np.float32)
    given = Shot(
        measurement=(masks[..., None] * views).sum(axis=0),
        masks=masks,
        weights=np.ones(3, np.float32),
        intrinsics=CAMERA,
        truth=Truth(views=views),
        name=f"noise {seed}",
    )
    return replace(given, **parts).check()


@pytest.fixture
def measured(tmp_path):
    return write_shots(tmp_path / "shot.h5", [shot(0), shot(1)])


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The report of a run with nothing but its iterations named."""
    folder = tmp_path_factory.mktemp("plain")
    return read_report(reconstruct.run(write_shots(folder / "shot.h5", [shot(0)]), folder / "run", iterations=2))


def quickly(measured, output, **options):
    """Reconstruct as fast as can be, where the fit is not what is looked at."""
    return reconstruct.run(measured, output, **{"iterations": 2, "fits": 1, "geometry": "tracks", **options})


def camera_of(folder):
    return json.loads((folder / "cameras.json").read_text())


def test_it_returns_the_folder_it_wrote_and_prints_the_figures(measured, tmp_path, capsys):
    folder = quickly(measured, tmp_path / "deep" / "run")
    assert folder == tmp_path / "deep" / "run"
    assert read_report(folder).name == "noise 0"
    assert str(folder / "overview.png") in capsys.readouterr().out


def test_a_first_run_says_what_it_waits_for(measured, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(backend, "needs_compiling", lambda name: name == "cpu")
    quickly(measured, tmp_path / "run", iterations=1)
    assert "compiles its kernels" in capsys.readouterr().out


def test_an_earlier_run_is_replaced_only_when_asked_and_the_index_chooses_the_shot(measured, tmp_path, capsys):
    folder = quickly(measured, tmp_path / "run")
    assert "holds 2 exposures, and this is the first: --together" in capsys.readouterr().err
    with pytest.raises(StorageError, match="not empty"):
        quickly(measured, folder)
    capsys.readouterr()
    quickly(measured, folder, index=1, overwrite=True)
    assert "exposures" not in capsys.readouterr().err
    assert read_report(folder).name == "noise 1"


def test_the_curve_is_scored_only_where_the_truth_is_known(plain, tmp_path):
    assert plain.curve[-1].psnr_db is not None
    blind = write_shots(tmp_path / "blind.h5", [shot(truth=Truth())])
    without = read_report(quickly(blind, tmp_path / "blind"))
    assert without.curve[-1].psnr_db is None
    assert without.psnr_db is None


def test_a_focal_length_replaces_the_files_and_keeps_its_principal_point_and_pixel_shape(measured, tmp_path):
    camera = camera_of(quickly(measured, tmp_path / "run", focal_px=60.0))
    assert [camera[key] for key in ("fl_x", "fl_y", "cx", "cy")] == pytest.approx([60, 66, 15, 13])


def test_a_focal_length_where_the_file_has_none_puts_the_principal_point_in_the_middle(tmp_path):
    unknown = write_shots(tmp_path / "shot.h5", [shot(intrinsics=None)])
    camera = camera_of(quickly(unknown, tmp_path / "run", focal_px=60.0))
    assert [camera[key] for key in ("fl_x", "fl_y", "cx", "cy")] == pytest.approx([60, 60, 16, 12])


@pytest.mark.parametrize("focal_px", [0.0, -3.0, float("nan"), float("inf")])
def test_a_focal_length_that_is_none_is_refused(measured, tmp_path, focal_px):
    with pytest.raises(InputError, match="--focal-px"):
        reconstruct.run(measured, tmp_path / "run", focal_px=focal_px)
    assert not (tmp_path / "run").exists()


def test_settings_other_than_the_iterations_are_the_standard_ones(plain):
    standard = Settings()
    assert plain.settings["fit"]["iterations"] == 2
    assert plain.settings["decode"]["iterations"] == standard.decode.iterations
    assert plain.settings["seed"] == standard.seed == 42


def test_a_preset_sets_every_stage_and_options_override_it(measured, tmp_path):
    report = read_report(quickly(measured, tmp_path / "run", preset="draft"))
    assert report.settings["decode"]["iterations"] == PRESETS["draft"].decode.iterations
    assert report.settings["fit"]["iterations"] == 2


def overridden(**options):
    given = {
        "geometry": None,
        "proxy": None,
        "first_look": None,
        "density": None,
        "without": (),
        "iterations": None,
        "fits": None,
        "fine": False,
        "prior": None,
        "distance": None,
        "trust_weights": False,
        "light": None,
        "within_mask": None,
        "registration": None,
        "seed": 42,
    }
    return Overrides(**{**given, **options})


@pytest.mark.parametrize("name", PRESETS)
def test_nothing_named_on_the_command_line_leaves_a_preset_as_it_is(name):
    assert overridden().on(PRESETS[name]) == PRESETS[name]


@pytest.mark.parametrize(
    ("options", "changed"),
    [
        ({"geometry": "tracks"}, {"poses"}),
        ({"proxy": "gap-tv"}, {"proxy"}),
        ({"first_look": "patches"}, {"first_look"}),
        ({"registration": "auto"}, {"registration"}),
        ({"iterations": 50}, {"fit"}),
        ({"fine": True}, {"fine"}),
        ({"seed": 7}, {"seed"}),
        ({"device": "cuda:1"}, {"device"}),
    ],
)
def test_what_is_named_overrides_the_paper_and_only_that(options, changed):
    paper = PRESETS["paper"]
    found = overridden(**options).on(paper)
    assert {
        field.name for field in fields(paper) if getattr(found, field.name) != getattr(paper, field.name)
    } == changed
    if "fine" in options:
        assert found.fine == paper.fine_if_asked
        assert (found.fine.iterations, found.fine.gated) == (3000, False)


def test_within_a_budget_one_run_folder_is_written_and_what_is_left_goes_to_the_fit(
    measured, tmp_path, capsys, monkeypatch
):
    written, write_overview = [], run_folder.write_overview

    def counted(path, *given):
        written.append(path)
        write_overview(path, *given)

    monkeypatch.setattr(run_folder, "write_overview", counted)
    monkeypatch.setattr(tempfile, "TemporaryDirectory", lambda *_, **__: pytest.fail("a folder to rehearse in"))
    report = read_report(reconstruct.run(measured, tmp_path / "run", budget="10min", fits=1))
    said = capsys.readouterr().out.replace("\n", " ")
    assert "Of 10 min 00 s" in said
    assert "the rest allows the fit of preset" in said
    assert len(written) == 1
    assert report.settings["seed"] == 42
    assert report.settings["decode"]["iterations"] == PRESETS["standard"].decode.iterations


def test_a_budget_beside_what_it_decides_is_refused(measured, tmp_path):
    for other in ({"preset": "draft"}, {"iterations": 5}):
        with pytest.raises(InputError, match="budget"):
            reconstruct.run(measured, tmp_path / "run", budget="60s", **other)
    with pytest.raises(InputError, match="no duration"):
        reconstruct.run(measured, tmp_path / "run", budget="soon")


def test_a_disk_without_room_for_the_run_is_told_before_anything_is_fitted(measured, tmp_path, monkeypatch):
    monkeypatch.setattr(sealing.shutil, "disk_usage", lambda _: SimpleNamespace(free=1_100_000))
    monkeypatch.setattr(reconstruct.reconstruction, "reconstruct", lambda *_, **__: pytest.fail("it was fitted"))
    with pytest.raises(StorageError, match=r"new/run: the disk has 1.1 MB free; allowed: 1.2 MB or more"):
        reconstruct.run(measured, tmp_path / "new" / "run")  # 56 bytes for each of 3 x 24 x 32 pixels, and 1 MB
    assert not (tmp_path / "new").exists()


def test_a_budget_that_is_over_after_the_decode_delivers_its_views_and_says_so(measured, tmp_path, capsys):
    report = read_report(reconstruct.run(measured, tmp_path / "run", budget="0.1s"))
    note = report.found(Code.TIME_TOO_SHORT)
    assert note.sentence in capsys.readouterr().out.replace("\n", " ")
    assert report.settings["fit"]["iterations"] == report.curve[-1].iteration == 1
    assert np.isfinite(np.load(tmp_path / "run" / "views.npy")).all()


def test_the_fine_stage_is_switched_on_by_its_name_or_that_of_a_distance(measured, tmp_path):
    standard = PRESETS["standard"]
    assert overridden().on(standard).fine is None
    assert overridden(fine=True).on(standard).fine.prior == "none"
    named = read_report(quickly(measured, tmp_path / "run", distance="structure")).settings["fine"]
    assert (named["prior"], named["distance"]) == ("none", "structure")
    with pytest.raises(InputError, match="prior 'dream'"):
        quickly(measured, tmp_path / "other", prior="dream")


@pytest.mark.parametrize("rule", ["adc", "mcmc", "revised", "osgr"])
def test_the_density_rule_is_the_one_asked_for_and_is_in_the_report(measured, tmp_path, rule):
    report = read_report(quickly(measured, tmp_path / "run", density=rule))
    assert report.settings["fit"]["density"]["name"] == rule


def test_an_unknown_density_rule_is_refused_and_writes_nothing(measured, tmp_path):
    with pytest.raises(InputError, match="no density rule 'abc'"):
        reconstruct.run(measured, tmp_path / "run", density="abc")
    assert not (tmp_path / "run").exists()


def test_components_are_switched_off_by_name(measured, tmp_path):
    names = ("opacity-regulation", "pose-refinement")
    fit = read_report(quickly(measured, tmp_path / "run", without=names)).settings["fit"]
    assert fit["loss"]["opacity"] == 0
    assert fit["poses"]["refine"] is False


def test_weights_are_trusted_when_asked_for(plain, measured, tmp_path):
    assert plain.settings["brightness"]["rounds"] == BrightnessSettings().rounds
    trusted = read_report(quickly(measured, tmp_path / "run", trust_weights=True))
    assert trusted.settings["brightness"]["rounds"] == 0


def test_an_unknown_component_is_refused_and_writes_nothing(measured, tmp_path):
    with pytest.raises(InputError, match="no component 'luck'"):
        reconstruct.run(measured, tmp_path / "run", without=("luck",))
    assert not (tmp_path / "run").exists()


def test_a_plan_is_printed_and_nothing_is_fitted_or_written(measured, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("gs2ci.reconstruct.hypotheses.race.Race.run", lambda *_: pytest.fail("fitted"))
    quickly(measured, tmp_path / "run", explain_plan=True, fits=2)
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("fit along the path of tracks") for line in lines)
    assert any(line.startswith("if: a moving scene") for line in lines)
    assert any(line.startswith("in all") and "at most" in line for line in lines)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("more", [{"every": True}, {"budget": "60s"}])
def test_a_plan_of_many_exposures_or_within_a_budget_is_refused(measured, tmp_path, more):
    with pytest.raises(InputError, match="--explain-plan"):
        reconstruct.run(measured, tmp_path / "run", explain_plan=True, **more)
