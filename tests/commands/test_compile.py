"""What the command does with its small exposure; that it compiles everything is measured by hand (docs/decisions)."""

from gs2ci.api import preparing, reconstruction
from gs2ci.commands import compile as compiling
from gs2ci.core.storage import read_shot


def test_a_small_exposure_is_taken_and_reconstructed_in_a_folder_that_goes(monkeypatch, capsys):
    seen = {}
    # Half its size, of a width that is a multiple of 4, as of real cameras: `make install` takes the whole one.
    monkeypatch.setattr(preparing, "SIZE", (34, 52))

    class Run:
        interrupted = False

        def save(self, folder):
            seen["folder"] = folder.parent

    def recover(shot, *, iterations, progress):
        seen["shot"], seen["iterations"] = read_shot(shot), iterations
        return Run()

    monkeypatch.setattr(reconstruction, "reconstruct", recover)
    assert compiling.run() >= 0
    assert seen["shot"].size == preparing.SIZE
    assert seen["shot"].views == preparing.VIEWS
    # Surfaces are sought from a quarter of the schedule on, and held-out pixels looked at every fiftieth iteration.
    assert seen["iterations"] >= 50
    assert not seen["folder"].exists()
    # Its standing in `make install` is one line.
    assert capsys.readouterr().out.count("\n") == 1
