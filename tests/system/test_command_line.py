"""The command line as a user runs it: a foreign file in, a run folder out, and errors that state a remedy."""

import io
import os
import py_compile
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci import __version__, cli
from gs2ci.evaluate.report import read_report
from tests.patience import HANG_S

VIEWS, HEIGHT, WIDTH = 4, 32, 40


def gs2ci(*arguments, folder):
    """Run the command in a process of its own; returns what it did."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "COLUMNS": "100"}
    return subprocess.run(
        [sys.executable, "-m", "gs2ci.cli", *map(str, arguments)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def typed(monkeypatch, *arguments):
    """Run the command in this process; returns the exit status."""
    monkeypatch.setattr(sys, "argv", ["gs2ci", *map(str, arguments)])
    try:
        return cli.main()
    except SystemExit as end:  # the parser's own way out, for --help and misspelt options
        return end.code


@pytest.fixture(scope="module")
def measurement(tmp_path_factory):
    """An .npz as the field exchanges them."""
    rng = np.random.default_rng(0)
    picture = gaussian_filter(rng.random((HEIGHT, WIDTH + VIEWS)), 1.2)
    picture = (picture - picture.min()) / np.ptp(picture)
    passing = [picture[:, i : i + WIDTH] for i in range(VIEWS)]
    truth = np.repeat(np.stack(passing)[..., None], 3, axis=3).astype(np.float32)
    masks = (rng.random((VIEWS, HEIGHT, WIDTH)) < 0.4).astype(np.float32)
    camera = np.array([[40.0, 0, WIDTH / 2], [0, 40, HEIGHT / 2], [0, 0, 1]])
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    poses[:, 0, 3] = 0.02 * np.arange(VIEWS)
    path = tmp_path_factory.mktemp("field") / "measurement.npz"
    coded = (masks[..., None] * truth).sum(axis=0)
    np.savez(path, meas=coded, masks=masks, truth=truth, K=camera, world_to_camera=poses)
    return path


@pytest.mark.parametrize(
    ("option", "value"), [("--json", "False"), ("--json", "true"), ("--overwrite", ""), ("--no-json", "0")]
)
def test_an_option_without_a_value_refuses_one(monkeypatch, capsys, tmp_path, option, value):
    """The parser would set it, and take the value for one more file."""
    monkeypatch.chdir(tmp_path)
    assert typed(monkeypatch, "reconstruct", "shot.h5", f"{option}={value}") == cli.EXIT_USER_ERROR
    said = capsys.readouterr().err
    assert f"{option} has no value, and was given {value!r}" in " ".join(said.split())
    assert not list(tmp_path.iterdir())


def test_a_cut_file_of_byte_code_is_named(monkeypatch, capsys, tmp_path):
    (tmp_path / "cut_short.py").write_text("def run(): ...\n")
    kept = Path(py_compile.compile(str(tmp_path / "cut_short.py"), doraise=True))
    kept.write_bytes(kept.read_bytes()[:-10])
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(cli.COMMANDS, "compile", ("cut_short", ""))
    assert typed(monkeypatch, "compile") == cli.EXIT_USER_ERROR
    assert f"{kept}, which Python keeps of a module, is cut short what to do: delete it" in " ".join(
        capsys.readouterr().err.split()
    )


def test_an_end_of_input_within_a_command_is_an_error_of_its_own(monkeypatch, tmp_path):
    (tmp_path / "asks.py").write_text("def run() -> None:\n    raise EOFError('no answer')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(cli.COMMANDS, "compile", ("asks", ""))
    with pytest.raises(EOFError, match="no answer"):
        typed(monkeypatch, "compile")


@pytest.fixture(scope="module")
def bench(measurement):
    """A folder in which the measurement was imported and reconstructed by the command line."""
    folder = measurement.parent
    imported = gs2ci("import", measurement.name, "-o", "shot.h5", folder=folder)
    assert imported.returncode == 0, imported.stderr
    assert "1 shot in shot.h5" in imported.stdout
    done = gs2ci("reconstruct", "shot.h5", "-o", "run", "--iterations", 60, "--seed", 3, folder=folder)
    assert done.returncode == 0, done.stderr
    return folder, done


def test_from_a_foreign_file_to_a_run_folder(bench):
    folder, _ = bench
    run = folder / "run"
    parts = (
        "report.json report.html overview.png given.npz views.npy views scene.ply cameras.json colmap decode.npy "
        "scene_views.npy depth.npy depth_spread.npy depth_confidence.npy disagreement.npy views_error.npy"
    )
    # Whether so small a picture tells depth, and whether anything settles its order, goes by a processor's rounding.
    of_depth = {"points.ply", "depth_error.npy", "depth_other.npy"}
    assert set(parts.split()) <= {path.name for path in run.iterdir()} <= {*parts.split(), *of_depth}
    report = read_report(run)
    assert report.seed == 3
    assert report.settings["fit"]["iterations"] == 60
    assert report.psnr_db.mean >= report.decode.psnr_db.mean
    assert {"total", "decode", "geometry", "fit"} <= set(report.seconds)
    assert np.load(run / "views.npy").shape == (VIEWS, HEIGHT, WIDTH, 3)
    assert len(list((run / "views").glob("*.png"))) == VIEWS
    assert sorted(path.name for path in folder.iterdir()) == ["measurement.npz", "run", "shot.h5", "shot.json"]


def test_what_is_printed_names_the_figures_and_where_to_look(bench):
    _, done = bench
    for words in ("decode", "geometry", "fit", "PSNR", "held-out", "run/report.html", "run/scene.ply"):
        assert words in done.stdout
    assert "\x1b[" not in done.stdout
    assert "Traceback" not in done.stderr


def test_a_run_folder_that_exists_is_refused_before_any_work(bench, monkeypatch, capsys):
    folder, _ = bench
    monkeypatch.chdir(folder)
    before = (folder / "run" / "report.json").read_bytes()
    assert typed(monkeypatch, "reconstruct", "shot.h5", "-o", "run") == 2
    told = capsys.readouterr()
    assert "error: run exists and is not empty" in told.err
    assert "what to do: " in told.err
    assert "--overwrite" in told.err
    assert "decode" not in told.out
    assert (folder / "run" / "report.json").read_bytes() == before


def test_an_error_in_a_process_of_its_own_ends_with_status_2_and_without_a_traceback(tmp_path):
    refused = gs2ci("import", "nowhere.npz", "-o", "shot.h5", folder=tmp_path)
    assert refused.returncode == 2
    assert "nowhere.npz" in refused.stderr
    assert "Traceback" not in refused.stderr
    assert list(tmp_path.iterdir()) == []


def test_nobody_hears_of_a_reader_that_has_seen_enough():
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    words = [sys.executable, "-m", "gs2ci", "import", "--help"]
    with subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        child.stdout.close()
        assert child.stderr.read() == ""
    assert child.returncode == cli.EXIT_UNREAD


@pytest.mark.parametrize(
    ("encoding", "errors"),
    # The last are Python's own of a locale without a character set.
    [("utf-8", "strict"), ("ascii", "strict"), ("latin-1", "strict"), ("ascii", "surrogateescape")],
)
def test_what_a_terminal_has_no_character_for_is_printed_all_the_same(encoding, errors, monkeypatch):
    seen = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(seen, encoding=encoding, errors=errors))
    monkeypatch.setattr(cli, "_usage", lambda: "m\udce4.ply is written, ± 1\n")
    assert typed(monkeypatch, "--help") == 0
    assert seen.getvalue().decode(encoding).startswith("m\\udce4.ply is written, ")


@pytest.mark.parametrize("arguments", [["reconstruct", "a" * 300], ["import", "a" * 300, "-o", "s.h5"]])
def test_a_name_that_the_disk_cannot_have_is_refused_without_a_traceback(arguments, monkeypatch, capsys):
    assert typed(monkeypatch, *arguments) == 2
    told = capsys.readouterr().err
    assert "error: [Errno 36] File name too long" in told
    assert "what to do: check the name" in told


WAITING = """
import os, signal, sys, time
from types import SimpleNamespace
from gs2ci import cli

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup it is ignored, and stays so

def run() -> None:
    "Wait."
    try:
        print("ready", flush=True)
        time.sleep(3600)
    finally:
        print("put to rest", flush=True)

sys.modules["waiting"] = SimpleNamespace(run=run)
cli.COMMANDS["wait"] = ("waiting", "")
sys.argv = ["gs2ci", "wait"]
sys.exit(cli.main())
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_command_that_is_told_to_end_puts_its_bench_to_rest_first(number):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen([sys.executable, "-c", WAITING], env=environment, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout.readline() == "ready\n"
        child.send_signal(number)
        rest, _ = child.communicate(timeout=HANG_S)
    assert rest == "put to rest\n"
    assert child.returncode == 128 + number


def test_a_command_whose_terminal_was_closed_puts_its_bench_to_rest():
    """It refuses what is printed on the way, and a shell and the system both send the signal: neither ends the rest."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    ours, terminal = os.openpty()
    lines = WAITING.replace(
        'print("put to rest", flush=True)', 'os.kill(os.getpid(), 1); print("resting", flush=True); sys.exit(77)'
    )
    with subprocess.Popen([sys.executable, "-c", lines], env=environment, stdout=terminal, stderr=terminal) as child:
        os.close(terminal)
        assert os.read(ours, 5) == b"ready"
        os.close(ours)
        child.send_signal(signal.SIGHUP)
        assert child.wait(HANG_S) == 77


def test_a_folder_is_not_called_a_missing_file(tmp_path, monkeypatch, capsys):
    """As when run folder and shot file are given in the wrong order."""
    monkeypatch.chdir(tmp_path)
    Path("run").mkdir()
    assert typed(monkeypatch, "evaluate", "shot.h5", "run") == 2
    assert "error: run: is a folder" in capsys.readouterr().err


def test_a_missing_run_is_said_once_and_in_words(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert typed(monkeypatch, "report", "nowhere") == 2
    assert "error: nowhere/report.json cannot be read: No such file or directory\n" in capsys.readouterr().err


def test_help_fits_a_terminal_and_names_values_plainly(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    assert typed(monkeypatch, "help") == 0
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 80
    assert typed(monkeypatch, "import", "--help") == 0
    told = capsys.readouterr().out
    assert "FILE [MASKS]" in told
    assert "--focal-px FLOAT" in told
    assert "{None}|" not in told
    assert "--cfa {RGGB,BGGR,GRBG,GBRG}" in told
    # What stands before the arguments ends at the terminal's width, between words.
    about = [line for line in told.split("\n\n")[1:3] for line in line.splitlines()]
    assert len(about) > 3
    assert max(map(len, about)) <= 80
    # An argument's text is one paragraph, wherever the docstring's lines end.
    assert typed(monkeypatch, "tradeoff", "--help") == 0
    told = capsys.readouterr().out
    assert "and keeps it when `gs2ci report`" in " ".join(told.split())
    assert not any(line.rstrip(" │").endswith("and keeps it") for line in told.splitlines())


@pytest.mark.parametrize("value", ["None", "200"])
def test_an_option_that_may_be_left_out_takes_its_value_or_none(bench, tmp_path, monkeypatch, value):
    folder, _ = bench
    monkeypatch.chdir(tmp_path)
    source = folder / "measurement.npz"
    assert typed(monkeypatch, "import", source, "-o", "a.h5", "--saturation", value) == 0


def test_the_package_runs_as_the_command_does(tmp_path):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    words = [sys.executable, "-m", "gs2ci", "--version"]
    told = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert told.stdout == f"gs2ci {__version__}\n"


@pytest.mark.parametrize(("written", "meant"), [("recon", "reconstruct"), ("recontruct", "reconstruct"), ("xyz", "")])
def test_a_misspelt_command_is_answered_with_the_nearest(monkeypatch, capsys, written, meant):
    assert typed(monkeypatch, written) == 2
    told = capsys.readouterr().err
    assert (f"did you mean {meant!r}?" in told) if meant else ("did you mean" not in told)


def test_an_unknown_command_is_refused_with_the_known_ones(monkeypatch, capsys):
    assert typed(monkeypatch, "recontruct") == 2
    told = capsys.readouterr().err
    assert "recontruct" in told
    for name in cli.COMMANDS:
        assert name in told


@pytest.mark.parametrize("command", ["import", "reconstruct"])
def test_a_missing_file_is_refused_by_name(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert typed(monkeypatch, command, "nowhere.h5", "-o", "out.h5") == 2
    assert "error: nowhere.h5" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["import", "reconstruct"])
@pytest.mark.parametrize("content", [b"", b"not a measurement", bytes(range(256)) * 40])
def test_a_file_of_another_kind_is_refused_by_name(command, content, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    name = "bad.npz" if command == "import" else "bad.h5"
    Path(name).write_bytes(content)
    assert typed(monkeypatch, command, name, "-o", "out.h5") == 2
    assert f"error: {name}" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize(
    "arguments",
    [
        ("--iterations", "0"),
        ("--iterations", "-5"),
        ("--seed", "-1"),
        ("--focal-px", "0"),
        ("--focal-px", "nan"),
        ("--index", "7"),
        ("--index", "-1"),
    ],
)
def test_a_value_out_of_range_is_refused_and_nothing_is_written(bench, arguments, tmp_path, monkeypatch, capsys):
    folder, _ = bench
    assert typed(monkeypatch, "reconstruct", folder / "shot.h5", "-o", tmp_path / "run", *arguments) == 2
    told = capsys.readouterr().err
    assert told.startswith("error: ")
    assert "allowed: " in told
    assert list(tmp_path.iterdir()) == []


def test_a_misspelt_option_is_refused_with_the_right_one(monkeypatch, capsys):
    assert typed(monkeypatch, "reconstruct", "shot.h5", "--iteration", "3") == 2
    told = capsys.readouterr()
    assert "--iterations" in told.err + told.out


@pytest.mark.parametrize("arguments", [(), ("-h",), ("--help",)])
def test_help_lists_every_command(arguments, monkeypatch, capsys):
    assert typed(monkeypatch, *arguments) == 0
    told = capsys.readouterr().out
    for name, (_, what) in cli.COMMANDS.items():
        assert f"gs2ci {name}" in told
        assert what in told


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_every_command_explains_itself(command, monkeypatch, capsys):
    assert typed(monkeypatch, command, "--help") == 0
    told = capsys.readouterr().out
    assert f"gs2ci {command}" in told
    assert len(told.splitlines()) > 5
    # Where nothing is the default, the text says what is done without the option.
    assert "default: None" not in told
    assert "default: )" not in told


def test_help_on_a_command_may_be_asked_for_in_either_order(monkeypatch, capsys):
    assert typed(monkeypatch, "help", "decode") == 0
    told = capsys.readouterr().out
    assert typed(monkeypatch, "decode", "--help") == 0
    assert capsys.readouterr().out == told


def test_the_version_is_the_packages(tmp_path):
    told = gs2ci("--version", folder=tmp_path)
    assert told.returncode == 0
    assert told.stdout == f"gs2ci {__version__}\n"


def test_an_interruption_is_said_in_one_line(monkeypatch, capsys):
    def interrupt(name):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli.importlib, "import_module", interrupt)
    assert typed(monkeypatch, "demo") == cli.EXIT_INTERRUPTED
    assert capsys.readouterr().err.count("\n") == 1


def test_a_machine_that_is_too_small_is_an_error_and_no_traceback(monkeypatch, capsys):
    def exhaust(name):
        raise MemoryError("Unable to allocate 38.6 GiB")

    monkeypatch.setattr(cli.importlib, "import_module", exhaust)
    assert typed(monkeypatch, "demo") == cli.EXIT_USER_ERROR
    assert "error: out of memory: Unable to allocate 38.6 GiB\nwhat to do: " in capsys.readouterr().err


def test_an_interruption_in_compiled_code_is_said_in_one_line_too(monkeypatch, capsys):
    """Numba makes a SystemError of it, several deep."""

    def interrupt(name):
        try:
            try:
                raise KeyboardInterrupt
            except KeyboardInterrupt as error:
                raise SystemError("unpickle returned a result with an exception set") from error
        except SystemError as error:
            raise SystemError("dispatcher returned a result with an exception set") from error

    monkeypatch.setattr(cli.importlib, "import_module", interrupt)
    assert typed(monkeypatch, "demo") == cli.EXIT_INTERRUPTED
    assert capsys.readouterr().err.count("\n") == 1


def test_an_error_of_compiled_code_itself_is_not_taken_for_an_interruption(monkeypatch):
    def fail(name):
        raise SystemError("bad call")

    monkeypatch.setattr(cli.importlib, "import_module", fail)
    with pytest.raises(SystemError, match="bad call"):
        typed(monkeypatch, "demo")


HELPED = """
import sys
from gs2ci import cli

for words in [[], *([name, "--help"] for name in cli.COMMANDS), ["decode", "shot.h5", "--iterations", "0"],
              ["reconstruct", "--nonsense"], ["capture", "--rig", "rig.toml", "--shots", "-1"], ["models", "nonsense"],
              *([name, "nowhere.h5"] for name in ("reconstruct", "decode", "tradeoff", "recover"))]:
    sys.argv = ["gs2ci", *words]
    try:
        cli.main()
    except SystemExit:
        pass
heavy = "torch numba scipy cv2 skimage matplotlib pycolmap onnxruntime pydantic gs2ci_sims gs2ci_calibration"
sys.exit(" ".join(name for name in heavy.split() if name in sys.modules) or None)
"""


def test_help_refused_options_and_missing_files_load_nothing_that_does_the_work():
    """Loading it takes seconds, for which nobody waits who only asks."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", HELPED], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
