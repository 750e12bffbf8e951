"""A joint run that is killed goes on where it was, to the same bits; what is kept of anything else is not used."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gs2ci.core.errors import StorageError
from gs2ci.core.findings import Code
from gs2ci.core.halt import Halt
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.exposures import joint, unfinished
from gs2ci.reconstruct.exposures.joint import reconstruct_together
from gs2ci.reconstruct.exposures.unfinished import Unfinished, arrays_of, key_of, key_of_run
from gs2ci.reconstruct.presets.named import preset
from gs2ci.reconstruct.registration.register import RegistrationSettings
from tests.exposed_rooms import adjacent, room

SIZE = (32, 40)
KILLS = 10


def settings():
    """Return a short schedule with everything in it: density rules, looks, two searches for surfaces."""
    short = replace(preset("draft"), registration=RegistrationSettings("off"))
    fit = replace(short.fit, iterations=48, densify_every=8, hold_out=short.fit.hold_out.looking(8))
    return replace(short, fit=fit)


def exposures():
    return adjacent(room(0, SIZE), SIZE, 0, 3, noise=0.01)


class Killed(BaseException):
    """What no part of a run catches."""


class Life(Silent):
    """Ends a run after so many events; remembers what was said."""

    def __init__(self, events=None):
        self.left, self.said, self.stages = events, [], []

    def _live(self):
        if self.left is not None:
            self.left -= 1
            if self.left < 0:
                raise Killed

    def stage(self, name, total=None):
        self.stages.append(name)
        self._live()

    def step(self, *_, **__):
        self._live()

    def say(self, sentence):
        self.said.append(sentence)


def run(folder, life=None, given=None, how=None, **options):
    return reconstruct_together(given or exposures(), how or settings(), life or Silent(), unfinished=folder, **options)


def numbers(result):
    arrays = (result.views, result.scene_views, result.depth, result.world_to_camera, result.uncertainty.views)
    looks = [(point.iteration, point.loss, point.heldout, point.gaussians) for point in result.curve]
    return [array.tobytes() for array in arrays], looks, result.stopped


@pytest.fixture(scope="module")
def whole():
    """The numbers of a run that nothing kept or killed."""
    return numbers(reconstruct_together(exposures(), settings()).result)


def until_killed(folder, rng):
    """Draw how many events a life lasts: an exposure or so at first, then some iterations."""
    return int(rng.integers(2, 12) if (folder / "fit.kept").exists() else rng.integers(15, 45))


def test_a_run_killed_ten_times_ends_as_one_that_was_not(whole, tmp_path, monkeypatch):
    monkeypatch.setattr(Unfinished, "is_due", lambda _: True)
    folder, rng, lives, kept = tmp_path / "kept", np.random.default_rng(0), [], []
    for _ in range(KILLS):
        lives.append(Life(until_killed(folder, rng)))
        with pytest.raises(Killed):
            run(folder, lives[-1])
        kept.append(len(list(folder.glob("*.kept"))))
    lives.append(Life())
    assert numbers(run(folder, lives[-1]).result) == whole
    goes_on = [any("goes on" in sentence for sentence in life.said) for life in lives]
    assert goes_on == [False, *(count > 0 for count in kept)]
    assert (folder / "fit.kept").exists()
    # What was done is not done again.
    assert "decode" not in lives[-1].stages


def test_a_run_whose_fit_is_kept_now_and_then_repeats_what_is_missing(whole, tmp_path, monkeypatch):
    due = iter(number % 17 == 16 for number in range(10_000))
    monkeypatch.setattr(Unfinished, "is_due", lambda _: next(due))
    for events in (75, 40, 60):
        with pytest.raises(Killed):
            run(tmp_path / "kept", Life(events))
    assert numbers(run(tmp_path / "kept").result) == whole


_PROGRAM = """
import sys
from pathlib import Path
import numpy as np
from gs2ci.reconstruct.exposures.unfinished import Unfinished
from tests.reconstruct.exposures import test_unfinished as own

class Told(own.Life):
    def _live(self):
        print("event", flush=True)

Unfinished.is_due = lambda _: True
result = own.run(Path(sys.argv[1]), Told()).result
np.savez(sys.argv[2], views=result.views, depth=result.depth, path=result.world_to_camera)
"""


@pytest.mark.nightly
@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGKILL")
def test_a_process_killed_ten_times_at_random_leaves_the_same_result(whole, tmp_path):
    command = [sys.executable, "-c", _PROGRAM, str(tmp_path / "kept"), str(tmp_path / "found.npz")]
    rng = np.random.default_rng(1)
    for _ in range(KILLS):
        with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=Path(__file__).parents[3]) as process:
            for _ in range(until_killed(tmp_path / "kept", rng)):
                assert process.stdout.readline() == b"event\n"
            process.send_signal(signal.SIGKILL)
            assert process.wait() == -signal.SIGKILL
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=Path(__file__).parents[3])
    with np.load(tmp_path / "found.npz") as found:
        assert found["views"].tobytes() == whole[0][0]
        assert found["path"].tobytes() == whole[0][3]


@pytest.fixture
def begun(tmp_path):
    """What a run leaves that is killed after its first exposure."""
    with pytest.raises(Killed):
        run(tmp_path / "kept", Life(30))
    assert (tmp_path / "kept" / "exposure-000.kept").exists()
    return tmp_path / "kept"


@pytest.mark.parametrize("what", ["exposures", "settings"])
def test_other_exposures_or_settings_begin_anew_and_say_so(begun, what):
    given, how, life = exposures(), settings(), Life(0)
    if what == "exposures":
        given = [replace(shot, measurement=shot.measurement + np.float32(1e-3)) for shot in given]
    else:
        how = replace(how, seed=1)
    with pytest.raises(Killed):
        run(begun, life, given, how)
    assert any("is of other exposures, settings or version" in sentence for sentence in life.said)
    assert not list(begun.glob("*"))


def test_a_damaged_file_is_made_again(begun, whole):
    path = begun / "exposure-000.kept"
    path.write_bytes(path.read_bytes()[:-100])
    (begun / "fit.kept").write_bytes(b"words")
    assert numbers(run(begun).result) == whole
    content = path.read_bytes()
    assert Unfinished(begun, key_of(content)).load("exposure-000", arrays_of(exposures()[0])) is not None


def test_what_vanishes_while_a_run_works_is_said(tmp_path):
    kept = Unfinished(tmp_path / "kept", "key")
    read = kept.done("places", lambda: 3)
    assert read() == 3
    (tmp_path / "kept" / "places.kept").unlink()
    with pytest.raises(StorageError, match="gone or damaged"):
        read()


def test_a_file_that_cannot_be_read_is_said(tmp_path, monkeypatch):
    kept = Unfinished(tmp_path / "kept", "key")
    kept.save("places", 3)

    def refuses(_path):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(Path, "read_bytes", refuses)
    with pytest.raises(StorageError, match="Input/output error"):
        kept.load("places")


def test_a_folder_that_is_something_else_is_left_alone(tmp_path):
    (tmp_path / "file").write_text("words")
    with pytest.raises(StorageError, match="not a folder"):
        run(tmp_path / "file")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("words")
    with pytest.raises(StorageError, match=r"thesis\.tex, which is no part of one"):
        run(tmp_path / "mine")
    unfinished.remove(tmp_path / "mine")
    assert (tmp_path / "mine" / "thesis.tex").exists()
    unfinished.remove(tmp_path / "missing")


def test_the_key_depends_on_every_array_and_setting():
    shots = exposures()
    key = key_of_run(shots, settings())
    assert key == key_of_run(exposures(), settings())
    assert key != key_of_run(shots[:2], settings())
    assert key != key_of_run([*shots[:2], replace(shots[2], weights=shots[2].weights * 2)], settings())
    assert key != key_of_run([*shots[:2], replace(shots[2], name="other")], settings())
    assert key != key_of_run(shots, replace(settings(), uncertainty=False))


def test_what_was_asked_to_end_early_is_not_kept_as_done(tmp_path, whole):
    halt = Halt()

    class Asks(Life):
        def step(self, iteration, **figures):
            if "loss" in figures and iteration == 20:
                assert halt.ask()

    ended = run(tmp_path / "kept", Asks(), halt=halt).result
    assert ended.curve[-1].iteration == 21
    assert [note.code for note in ended.notes if note.code is Code.INTERRUPTED] == [Code.INTERRUPTED]
    assert not list((tmp_path / "kept").glob("part*"))
    assert numbers(run(tmp_path / "kept").result) == whole


def test_a_second_run_on_the_same_output_is_refused_while_the_first_works(begun):
    other = Unfinished(begun, "key")
    with other.alone(), pytest.raises(StorageError, match="another reconstruction works in"):
        run(begun)
    with pytest.raises(Killed):
        run(begun, Life(0))


def test_a_run_that_keeps_nothing_leaves_no_folder(tmp_path):
    with pytest.raises(Killed):
        run(tmp_path / "kept", Life(0))
    assert not (tmp_path / "kept").exists()


def test_time_counts_on(tmp_path, monkeypatch):
    monkeypatch.setattr(joint.Unfinished, "is_due", lambda _: True)
    with pytest.raises(Killed):
        run(tmp_path / "kept", Life(75))
    key = key_of((tmp_path / "kept" / "exposure-000.kept").read_bytes())
    Unfinished(tmp_path / "kept", key).save("clock", 1000.0)
    found = run(tmp_path / "kept").result
    assert found.seconds["total"] > 1000
    assert found.curve[-1].seconds > 1000


def test_one_exposure_keeps_nothing(tmp_path):
    run(tmp_path / "kept", given=exposures()[:1])
    assert not (tmp_path / "kept").exists()
