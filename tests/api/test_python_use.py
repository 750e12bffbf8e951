"""Using gs2ci from Python as a user does: arrays in, runs out, interruptions, notebooks, the same errors."""

import json
import signal
import sys
import webbrowser
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import gs2ci
import gs2ci.commands.reconstruct
from gs2ci import cli, commands
from gs2ci.api import display
from gs2ci.api.display import NotebookDisplay, QuietDisplay, interrupted_within, open_display
from gs2ci.api.runs import Run
from gs2ci.core.findings import Code
from gs2ci.evaluate.run_folder import write_run
from gs2ci.render import devices
from gs2ci.render.cards import Card, Cuda
from gs2ci.render.devices import CudaProbe

pytestmark = pytest.mark.usefixtures("undrawn")


def test_a_shot_is_made_of_arrays_of_any_kind():
    masks = np.arange(4 * 6 * 8).reshape(4, 6, 8) % 3 == 0
    mine = gs2ci.Shot(np.ones((6, 8, 1)), masks, intrinsics=[[9, 0, 4], [0, 9, 3], [0, 0, 1]]).check()
    theirs = gs2ci.Shot(
        torch.ones(6, 8, 1, requires_grad=True), torch.from_numpy(masks), torch.ones(4), intrinsics=mine.intrinsics
    ).check()
    for name, kind in (("measurement", "f4"), ("masks", "f4"), ("weights", "f4"), ("intrinsics", "f8")):
        assert getattr(mine, name).dtype == kind
        np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name))


def test_what_holds_no_numbers_is_refused():
    with pytest.raises(gs2ci.InputError, match=r"masks of a shot is str.*allowed: a numpy array, a torch tensor"):
        gs2ci.Shot(np.ones((6, 8, 1)), "masks.npy")
    for other in (np.ones((6, 8, 1)) * 1j, np.array(None), np.array([None, 1]), [["1", "2"]]):
        with pytest.raises(gs2ci.InputError, match=r"masks of a shot is .*allowed: .* nested lists of real numbers"):
            gs2ci.Shot(np.ones((6, 8, 1)), other)
    ones = torch.ones(4, 6, 8)
    for other in (ones.to("meta"), ones.to_sparse(), ones.bfloat16(), torch._neg_view(ones)):
        with pytest.raises(gs2ci.InputError, match=r"masks of a shot is Tensor, no array of numbers: .*torch tensor"):
            gs2ci.Shot(np.ones((6, 8, 1)), other)
        with pytest.raises(gs2ci.InputError, match="--truth is Tensor, no array of numbers"):
            gs2ci.import_file("measurement.npz", truth=other)
    with pytest.raises(gs2ci.InputError, match="--poses is object"):
        gs2ci.import_file("measurement.npz", poses=object())


def test_arguments_of_another_kind_are_refused_by_their_type():
    shot = gs2ci.Shot(np.ones((6, 8)), np.ones((4, 6, 8)))
    with pytest.raises(gs2ci.InputError, match=r"has shape \[6, 8\].*as picture\[\.\.\., None\]"):
        shot.check()
    with pytest.raises(gs2ci.InputError, match=r"Shot where a path is expected.*the path comes first"):
        gs2ci.save(shot, "shot.h5")
    for call in (gs2ci.load, gs2ci.reconstruct):
        with pytest.raises(gs2ci.InputError, match=r"ndarray where a path is expected.*gs2ci\.Shot"):
            call(np.ones((6, 8)))
    with pytest.raises(gs2ci.InputError, match="--seed few; allowed: a whole number"):
        gs2ci.reconstruct(shot, seed="few")
    with pytest.raises(gs2ci.InputError, match="--focal-px 'few'; allowed: a finite number"):
        gs2ci.reconstruct(shot, focal_px="few")


@pytest.mark.parametrize(
    ("option", "others"),
    [
        ("geometry", (np.tile(np.eye(4), (4, 1, 1)), 3)),
        ("prior", (3, True)),
        ("distance", (3,)),
        ("device", (0,)),
        ("fine", ("yes", None)),
        ("trust_weights", ("no", 1)),
        ("without", ("poses", None)),
        ("density", (3, object())),
    ],
)
def test_options_of_another_kind_are_refused_by_their_type_before_anything_is_computed(option, others):
    shot = gs2ci.Shot(np.ones((6, 8, 1)), np.ones((4, 6, 8)))
    for other in others:
        with pytest.raises(gs2ci.InputError, match=f"--{option.replace('_', '-')} is {type(other).__name__}; allowed"):
            gs2ci.reconstruct(shot, progress=gs2ci.Silent(), **{option: other})


def test_poses_in_place_of_their_source_are_told_where_they_belong():
    shot = gs2ci.Shot(np.ones((6, 8, 1)), np.ones((4, 6, 8)))
    with pytest.raises(gs2ci.InputError, match=r"--geometry is ndarray.*as telemetry_world_to_camera"):
        gs2ci.reconstruct(shot, geometry=np.tile(np.eye(4), (4, 1, 1)), progress=gs2ci.Silent())


def test_a_preset_of_another_kind_is_refused():
    shot = gs2ci.Shot(np.ones((6, 8, 1)), np.ones((4, 6, 8)))
    with pytest.raises(gs2ci.InputError, match="no preset \\['draft'\\]"):
        gs2ci.reconstruct(shot, preset=["draft"], progress=gs2ci.Silent())


def test_true_poses_that_are_no_rigid_motions_are_refused_before_the_fit():
    scaled = np.tile(np.diag([2.0, 2, 2, 1]), (4, 1, 1))
    shot = gs2ci.Shot(np.ones((6, 8, 1)), np.ones((4, 6, 8)), truth=gs2ci.Truth(world_to_camera=scaled)).check()
    with pytest.raises(gs2ci.InputError, match="true poses are no rigid motions"):
        gs2ci.reconstruct(shot, progress=gs2ci.Silent())


def test_what_is_no_path_is_refused_wherever_one_is_expected(examples):
    array = np.ones((6, 8))
    for call in (
        lambda: gs2ci.import_file(array),
        lambda: gs2ci.import_file("measurement.npz", array),
        lambda: gs2ci.load("measurement.npz", array),
        lambda: gs2ci.recover(array),
        lambda: gs2ci.recover("interrupted.h5.partial", array),
        lambda: gs2ci.open_run(array),
        lambda: gs2ci.open_run("run").save(array),
        lambda: gs2ci.measure(array, (1, 1), (2, 2)),
        lambda: gs2ci.evaluate(array, "shot.h5"),
        lambda: gs2ci.evaluate("run", "shot.h5", novel=array),
    ):
        with pytest.raises(gs2ci.InputError, match="ndarray where a path is expected"):
            call()


def test_true_depth_that_is_no_numbers_is_refused(examples):
    for other in ([["near", "far"]], np.ones((4, 24, 32)) * 1j, np.ones((4, 24, 32), bool), 3.0):
        with pytest.raises(gs2ci.InputError, match=r"depth holds no depth but .*allowed: real numbers of shape"):
            gs2ci.evaluate("run", "shot.h5", depth=other)


def test_what_is_no_shot_is_not_saved(examples):
    for other in (np.ones((6, 8)), None, "shot.h5", [gs2ci.load("shot.h5"), 3]):
        with pytest.raises(gs2ci.InputError, match=rf"{type(other).__name__} where shots are expected.*gs2ci\.Shot"):
            gs2ci.save("other.h5", other)
    assert not (examples / "other.h5").exists()


def test_counts_and_lists_of_another_kind_are_refused(examples):
    for file in ("measurement.npz", "shot.h5"):
        for index in ("0", 0.5, -1):
            with pytest.raises(gs2ci.InputError, match=f"--index {index}; allowed: a whole number from 0"):
                gs2ci.load(file, index=index)
    for view in (0, 1.0, "1", 5):
        with pytest.raises(gs2ci.InputError, match=f"--view {view}; allowed: a whole number from 1 to 4"):
            gs2ci.measure("run", (1, 1), (2, 2), view=view)
    for distortion in (None, 0.1):
        with pytest.raises(gs2ci.InputError, match=f"--distortion {distortion}; allowed: a list: k1 k2 p1 p2"):
            gs2ci.load("measurement.npz", focal_px=40.0, distortion=distortion)


def test_a_shot_file_takes_no_guesses_beside_it_and_a_foreign_one_tells_them(examples):
    with pytest.raises(gs2ci.InputError, match=r"shot.h5 is a shot file.*leave focal_px out"):
        gs2ci.load("shot.h5", focal_px=3.0)
    assert gs2ci.load("measurement.npz").provenance["guesses"]
    with pytest.raises(gs2ci.InputError, match="no measurement 3"):
        gs2ci.load("measurement.npz", index=3)


def test_a_shot_is_saved_once_unless_told_otherwise(examples):
    shot = gs2ci.load("shot.h5")
    gs2ci.save("two.h5", [shot, replace(shot, measurement=2 * shot.measurement)])
    with pytest.raises(gs2ci.StorageError, match=r"two\.h5"):
        gs2ci.save("two.h5", shot)
    gs2ci.save("two.h5", shot, overwrite=True)


def test_a_run_in_memory_is_the_run_that_was_saved(examples, filled):
    shot = gs2ci.load("shot.h5")
    run = gs2ci.reconstruct(shot, "draft", iterations=2, progress=gs2ci.Silent())
    assert run.folder is None
    with pytest.raises(gs2ci.StorageError, match=r"no folder yet.*save"):
        run.page()
    with pytest.raises(gs2ci.InputError, match=r"no folder yet.*save"):
        gs2ci.measure(run, (1, 1), (2, 2))
    assert "<!doctype html>" in run.page("page.html").read_text().lower()
    assert run.save("mine") == run.folder
    again = gs2ci.open_run("mine")
    for name in ("views", "path", "decode", "scene_views", "depth", "depth_spread", "depth_confidence", "views_error"):
        np.testing.assert_allclose(getattr(again, name), getattr(run, name), atol=1e-9)
    torch.testing.assert_close(again.scene.means, run.scene.means.float())
    assert again.report.psnr_db == run.report.psnr_db
    assert gs2ci.open_run(again.save("copy")).report == again.report
    assert again.save("mine") == run.folder
    with pytest.raises(gs2ci.StorageError, match="mine"):
        gs2ci.open_run("copy").save("mine")
    (examples / "copy" / "decode.npy").write_bytes(b"")
    with pytest.raises(gs2ci.StorageError, match="cannot be read as a run"):
        gs2ci.open_run("copy")
    (examples / "copy" / "decode.npy").unlink()
    with pytest.raises(gs2ci.StorageError, match=r"read as a run: copy/decode\.npy: No such file or directory;"):
        gs2ci.open_run("copy")


class Stopped(gs2ci.Silent):
    """A user who presses Ctrl-C at the third step of a stage."""

    def step(self, done, **figures):
        if done >= 3:
            raise KeyboardInterrupt


def test_an_interruption_leaves_everything_usable(examples):
    shot = gs2ci.load("shot.h5")
    before = shot.measurement.copy()
    with pytest.raises(KeyboardInterrupt):
        gs2ci.reconstruct(shot, "draft", iterations=8, progress=Stopped())
    np.testing.assert_array_equal(shot.measurement, before)
    again = gs2ci.decode(shot, iterations=4, progress=gs2ci.Silent())
    assert np.isfinite(again.views).all()
    with gs2ci.open_rig("rig.toml") as rig:
        with pytest.raises(KeyboardInterrupt):
            rig.calibrate("bench.cal.h5", "dark-flat", progress=Stopped())
        assert not (examples / "bench.cal.h5").exists()
        assert rig.capture(progress=gs2ci.Silent()).views == 4


@pytest.mark.parametrize("more", ["shots = 4\nburst = 4", "shots = 6\nburst = 2"])
def test_one_exposure_is_taken_on_a_bench_that_takes_several_in_a_burst(examples, more):
    rig = examples / "rig.toml"
    rig.write_text(rig.read_text().replace("masks = 4", f"masks = 4\n{more}"))
    with gs2ci.open_rig("rig.toml") as opened:
        assert opened.capture(progress=gs2ci.Silent()).truth.views.shape[0] == 4


class Interrupting(gs2ci.Silent):
    """Presses Ctrl-C after so many steps of the fit, and once more at any later step where asked to."""

    def __init__(self, after, again=False):
        super().__init__()
        self.after, self.again, self.name, self.stages = after, again, "", []

    def stage(self, name, total=None):
        self.name = name
        self.stages.append(name)

    def step(self, done, **figures):
        if self.name == "fit" and (done == self.after or (self.again and done > self.after)):
            signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize("fits", [1, 2])
def test_an_interruption_of_the_fit_hands_over_the_best_so_far(examples, fits):
    shot = gs2ci.load("shot.h5")
    listener = Interrupting(after=5)
    run = gs2ci.reconstruct(shot, iterations=400, fits=fits, geometry="tracks", progress=listener)
    assert run.interrupted
    assert run.report.stopped.code is Code.FIT_INTERRUPTED
    # The one that was told ends an iteration later; its companion, where there is one, when it sees it.
    assert 5 <= run.report.stopped.figures["iterations"] < 100
    assert listener.stages.count("fit") == 1, "nothing more was tried"
    assert np.isfinite(run.views).all()
    assert run.report.verdict in ("refined", "scene", "decode")
    assert gs2ci.open_run(run.save("stopped")).interrupted
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_interruption_raises(examples):
    with pytest.raises(KeyboardInterrupt):
        gs2ci.reconstruct("shot.h5", iterations=400, fits=1, progress=Interrupting(after=5, again=True))
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("refusals", [1, 2])
def test_a_run_that_its_place_refuses_in_the_end_is_kept_elsewhere(examples, monkeypatch, tmp_path, capsys, refusals):
    refused = []

    def full(folder, *arguments, **options):
        if len(refused) < refusals:
            refused.append(folder)
            raise gs2ci.StorageError(f"{folder.name} cannot be written: No space left on device")
        return write_run(folder, *arguments, **options)

    monkeypatch.setattr("gs2ci.evaluate.run_folder.write_run", full)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["gs2ci", "reconstruct", "shot.h5", "-o", "full", "--preset", "draft"])
    assert cli.main() == cli.EXIT_USER_ERROR
    told = capsys.readouterr().err
    assert "error: full cannot be written: No space left on device\n" in told
    assert not (examples / "full").exists()
    if refusals == 1:
        (kept,) = tmp_path.glob("full-*")
        assert f"what to do: the run is in {kept}: move it from there\n" in told
        assert gs2ci.open_run(kept).views.shape[0] == 4
    else:
        assert not list(tmp_path.glob("full-*"))


class InterruptingLate(gs2ci.Silent):
    """Presses Ctrl-C at once where the run is about to be written."""

    def __init__(self):
        super().__init__()
        self.told = []

    def say(self, text):
        self.told.append(text)


@pytest.mark.parametrize("times", [1, 2])
def test_a_run_that_is_being_written_when_it_is_interrupted_is_written_first(examples, monkeypatch, times):
    listener, save = InterruptingLate(), Run.save

    def interrupted(run, *arguments, **options):
        for _ in range(times):
            signal.raise_signal(signal.SIGINT)
        return save(run, *arguments, **options)

    monkeypatch.setattr(commands.reconstruct, "open_display", lambda: display.shown(listener))
    monkeypatch.setattr(Run, "save", interrupted)
    monkeypatch.setattr(sys, "argv", ["gs2ci", "reconstruct", "shot.h5", "-o", "late", "--preset", "draft"])
    assert cli.main() == cli.EXIT_INTERRUPTED
    assert listener.told[-1] == "The result is being written; a second interruption discards it."
    assert (examples / "late").exists() == (times == 1)
    assert times == 2 or not gs2ci.open_run("late").interrupted


def test_an_interrupted_command_writes_its_run_and_says_so_by_its_status(examples, monkeypatch, capsys):
    monkeypatch.setattr(commands.reconstruct, "open_display", lambda: display.shown(Interrupting(after=3)))
    monkeypatch.setattr(sys, "argv", ["gs2ci", "reconstruct", "shot.h5", "-o", "early", "--json"])
    assert cli.main() == cli.EXIT_INTERRUPTED
    answer = json.loads(capsys.readouterr().out)
    assert answer["stopped"]["code"] == "fit_interrupted"
    assert gs2ci.open_run("early").interrupted


def test_an_interruption_that_compiled_code_hides_is_one():
    def entered():
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise SystemError("dispatcher") from error

    with pytest.raises(KeyboardInterrupt), interrupted_within():
        entered()
    with pytest.raises(SystemError), interrupted_within():
        raise SystemError("another")


@pytest.mark.parametrize(
    ("call", "arguments", "command"),
    [
        (gs2ci.reconstruct, {"shot": "shot.h5", "iterations": 0}, "reconstruct shot.h5 --iterations 0"),
        (gs2ci.reconstruct, {"shot": "no.h5"}, "reconstruct no.h5"),
        (gs2ci.reconstruct, {"shot": "shot.h5", "device": "cuda:77"}, "reconstruct shot.h5 -o other --device cuda:77"),
        (gs2ci.decode, {"shot": "shot.h5", "denoiser": "tv"}, "decode shot.h5 --denoiser tv"),
        (gs2ci.measure, {"run": "run", "one": (99, 0), "other": (1, 1)}, "measure run 99,0 1,1"),
        (gs2ci.plan, {"rig": "rig.toml", "tolerance_dn": 0.0}, "plan rig.toml --tolerance-dn 0"),
        (gs2ci.evaluate, {"run": "run", "shot": "shot.h5", "electrons": 5.0}, "evaluate run shot.h5 --electrons 5"),
    ],
)
def test_errors_say_the_same_as_on_the_command_line(call, arguments, command, examples, request, capsys):
    with pytest.raises(gs2ci.Gs2ciError) as refused:
        call(**arguments)
    typed = request.getfixturevalue("gs2ci")
    assert typed(*command.split()) == 2
    assert f"error: {refused.value.problem}" in capsys.readouterr().err


def test_words_that_the_parser_would_refuse_are_refused(examples):
    shot = gs2ci.load("shot.h5")
    for wrong in ({"preset": "quick"}, {"proxy": "tv"}, {"registration": "on"}, {"device": "gpu"}):
        with pytest.raises(gs2ci.InputError, match=next(iter(wrong.values()))):
            gs2ci.reconstruct(shot, progress=gs2ci.Silent(), **wrong)
    for wrong in ({"bad_pixels": "Refuse"}, {"meas_layout": "RGB"}, {"mask_axis": 0}):
        for call in (gs2ci.load, gs2ci.import_file):
            (name,), (word,) = wrong, wrong.values()
            with pytest.raises(gs2ci.InputError, match=f"--{name.replace('_', '-')} {word}; allowed: (refuse|auto), "):
                call("measurement.npz", **wrong)
    with pytest.raises(gs2ci.InputError, match="no method"):
        gs2ci.decode(shot, "tv")
    with pytest.raises(gs2ci.InputError, match="network"):
        gs2ci.export_model("unet", "weights.pth")


OLD_CARD = Cuda((13, 0), (13, 0), (7, 5), (Card("cuda:0", "NVIDIA GeForce GTX 1080", (6, 1), 8192, 8000),))


def test_a_run_says_what_rendered_and_what_kept_a_card_from_it(examples, monkeypatch):
    monkeypatch.setattr(devices, "CudaProbe", lambda: CudaProbe(lambda: True, lambda: OLD_CARD))
    run = gs2ci.reconstruct("shot.h5", "draft", iterations=2, progress=gs2ci.Silent())
    assert run.report.device == "cpu"
    assert run.report.found(Code.GPU_TOO_OLD).sentence.startswith("cuda:0 (NVIDIA GeForce GTX 1080) has compute")
    with pytest.raises(gs2ci.InputError, match=r"--device cuda: cuda:0 .* has compute capability 6\.1"):
        gs2ci.reconstruct("shot.h5", "draft", device="cuda", progress=gs2ci.Silent())
    chosen = gs2ci.reconstruct("shot.h5", "draft", iterations=2, device="cpu", progress=gs2ci.Silent())
    assert chosen.report.found(Code.GPU_TOO_OLD) is None
    np.testing.assert_array_equal(chosen.views, run.views)


def test_devices_that_render_are_found_beside_those_of_a_bench(monkeypatch):
    monkeypatch.setattr(devices, "CudaProbe", lambda: CudaProbe(lambda: True, lambda: OLD_CARD))
    computing = [found for found in gs2ci.find_devices() if found[0] == "compute"]
    assert [port for _, port, _ in computing] == ["cpu", "cuda:0"]
    assert "7.5 is needed" in computing[1][2]


def test_the_number_of_shots_of_one_plan_is_not_that_of_the_next(examples):
    with gs2ci.open_rig("rig.toml") as rig:
        assert rig.plan(shots=3, progress=gs2ci.Silent()).plan.settings.shots == 3
        rig.record("one.h5", progress=gs2ci.Silent())
    assert gs2ci.load("one.h5").truth.views is not None
    with pytest.raises(gs2ci.StorageError):
        gs2ci.load("one.h5", index=1)


def test_showing_a_run_opens_its_page_in_the_browser(examples, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)
    gs2ci.open_run("run").show()
    assert opened == [(examples / "run" / "report.html").as_uri()]


@pytest.fixture
def notebook(monkeypatch):
    """Be a notebook's kernel; returns what it was told to show."""
    shown = []

    class Handle:
        def update(self, drawn):
            shown.append(drawn.data)

    module = SimpleNamespace(
        HTML=lambda text: SimpleNamespace(data=text),
        display=lambda drawn, **how: shown.append(drawn.data) or Handle(),
    )
    monkeypatch.setitem(
        sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=1), display=module)
    )
    monkeypatch.setitem(sys.modules, "IPython.display", module)
    return shown


def test_a_notebook_shows_a_bar_in_place_and_the_page_in_a_frame(notebook, examples):
    assert isinstance(open_display(), NotebookDisplay)
    with open_display() as progress:
        progress.stage("fit", 10)
        progress.say("a <sentence>")
        progress.expect(4)
        progress.step(2, psnr_db=20.0)
        progress.finish()
    assert '<progress max="2" value="2">' in notebook[-1]  # full, at the steps that it took
    assert "a &lt;sentence&gt;" in notebook[-1]
    gs2ci.open_run("run").show()
    assert notebook[-1].startswith('<iframe srcdoc="&lt;!doctype html&gt;')
    assert len(notebook[-1]) > 10_000


def test_silence_can_be_asked_for(monkeypatch, capsys):
    monkeypatch.setenv(display.QUIET_VARIABLE, "1")
    assert isinstance(open_display(), QuietDisplay)
    with open_display() as quiet:
        quiet.stage("fit", 3)
        quiet.expect(2)
        quiet.step(1)
        quiet.say("a sentence")
        quiet.finish()
    assert capsys.readouterr().out == ""
    monkeypatch.setattr("builtins.input", lambda: "")
    quiet.ask("put the lens cap on")
    assert "lens cap" in capsys.readouterr().err
