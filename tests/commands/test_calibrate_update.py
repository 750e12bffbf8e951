"""`gs2ci calibrate update` as a user types it."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci.commands import capture
from gs2ci.core.storage import write_shots
from gs2ci.rig import updating
from gs2ci_calibration.bundle import Bundle, read_bundle, write_bundle
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_drivers.plan import Mode
from tests.reconstruct.registration.warps import warped
from tests.rig.test_updating import SIZE, shot_through


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A bundle, and a shot file with two shots through masks half a pixel off."""
    monkeypatch.chdir(tmp_path)
    masks = (np.random.default_rng(5).random((6, *SIZE)) < 0.33).astype(np.float32)
    write_bundle(Path("b.cal.h5"), Bundle(sections={"masks": Section("masks", {"masks": Estimate(masks, 0.001, "1")})}))
    were = warped(masks, right_px=0.5)
    write_shots(Path("s.h5"), [shot_through(were, masks, seed)[1] for seed in range(2)])
    write_shots(Path("right.h5"), [shot_through(masks, masks)[1]])
    return tmp_path


def test_update_says_what_it_found_corrects_the_bundle_and_keeps_the_old_one(files, capsys, gs2ci):
    before = read_bundle(Path("b.cal.h5")).sections["masks"].array("masks")
    assert gs2ci("calibrate", "update", "b.cal.h5", "s.h5") == 0
    said = capsys.readouterr().out
    assert "corrected" in said
    assert "by 2 shots" in said
    (kept,) = files.glob("b.cal.until-*.h5")
    assert np.array_equal(read_bundle(kept).sections["masks"].array("masks"), before)
    assert not np.array_equal(read_bundle(Path("b.cal.h5")).sections["masks"].array("masks"), before)


def test_update_of_a_right_bundle_changes_nothing_and_says_so(files, capsys, gs2ci):
    assert gs2ci("calibrate", "update", "b.cal.h5", "right.h5") == 0
    assert "nothing was changed" in capsys.readouterr().out
    assert not list(files.glob("b.cal.until-*"))


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("s.h5", "WARNING: shot 1: masks are displaced by up to 0.5"),
        ("right.h5", "shot 1: masks within 0.0"),
        ("dark.h5", "not show"),
    ],
)
def test_a_capture_says_how_far_masks_had_moved(files, capsys, file, words):
    bundle = read_bundle(Path("b.cal.h5"))
    masks = bundle.sections["masks"].array("masks")
    write_shots(Path("dark.h5"), [shot_through(masks, masks, light=0.0)[1]])
    plan = SimpleNamespace(settings=SimpleNamespace(mode=Mode.GATE))
    prepared = SimpleNamespace(calibrated=SimpleNamespace(bundle=bundle), plan=plan)
    capture._say_where_masks_were(Path(file), prepared)
    assert words in capsys.readouterr().out


def test_a_capture_is_silent_about_masks_without_a_bundle_or_what_registers_them(files, capsys, monkeypatch):
    bundle = SimpleNamespace(bundle=read_bundle(Path("b.cal.h5")))
    monkeypatch.setattr(updating, "find_spec", lambda name: None)
    for calibrated in (None, bundle):
        plan = SimpleNamespace(settings=SimpleNamespace(mode=Mode.GATE))
        capture._say_where_masks_were(Path("s.h5"), SimpleNamespace(calibrated=calibrated, plan=plan))
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("update", "b.cal.h5"), "a bundle and one shot file or several"),
        (("update",), "a bundle and one shot file or several"),
        (("masks",), "no rig file"),
        (("masks", "b.cal.h5", "--rig", "rig.toml"), "b.cal.h5 is not needed"),
    ],
)
def test_what_is_missing_or_too_much_is_said(files, capsys, gs2ci, arguments, words):
    assert gs2ci("calibrate", *arguments) == 2
    assert words in " ".join(capsys.readouterr().err.split())
