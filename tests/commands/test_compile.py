"""What the command does with its small exposure; that it compiles everything is measured by hand (docs/decisions)."""

import tomllib

from gs2ci.commands import capture, reconstruct
from gs2ci.commands import compile as compiling


def test_a_small_exposure_is_taken_and_reconstructed_in_a_folder_that_goes(monkeypatch, capsys):
    seen = {}

    def take(*, rig, out):
        seen["rig"] = tomllib.loads(rig.read_text(encoding="utf-8"))
        out.write_bytes(b"a shot")

    def recover(shot, output, *, iterations):
        seen["shot"], seen["folder"], seen["iterations"] = shot.read_bytes(), output.parent, iterations

    monkeypatch.setattr(capture, "run", take)
    monkeypatch.setattr(reconstruct, "run", recover)
    assert compiling.run() >= 0
    assert (seen["rig"]["world"]["height"], seen["rig"]["world"]["width"]) == compiling.SIZE
    assert seen["shot"] == b"a shot"
    # Surfaces are sought from two fifths of the schedule on, and held-out pixels looked at every fiftieth iteration.
    assert seen["iterations"] >= 50
    assert not seen["folder"].exists()
    assert "All kernels are compiled" in capsys.readouterr().out
