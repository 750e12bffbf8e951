"""Trials of several exposures together: which, their figures, what the next one is worth."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.tradeoff import exposures
from gs2ci.evaluate.tradeoff.exposures import (
    KNOB,
    capture_s,
    exposure_sentences,
    exposure_trials,
    next_exposure,
    tried_together,
)
from gs2ci.evaluate.tradeoff.trials import TRIALS, expected_seconds
from gs2ci.reconstruct.registration.register import Registered

VIEWS = np.full((2, 8, 8, 1), 0.5, np.float32)


def shot(number, **provenance):
    masks = np.random.default_rng(number).random((2, 8, 8)) < 0.5
    measurement = (masks[..., None] * VIEWS).sum(axis=0).astype(np.float32)
    truth = Truth(views=VIEWS, world_to_camera=np.tile(np.eye(4), (2, 1, 1)))
    return Shot(measurement, masks, truth=truth, name=f"shot {number}", provenance=provenance)


def row(number, db, seconds, capture=None, **others):
    return {"trial": exposures._name(number), "knob": KNOB, "exposures": number, "psnr_db": db, "seconds": seconds,
            "capture_s": capture, **others}  # fmt: skip


@pytest.mark.parametrize(("count", "numbers"), [(2, [1, 2]), (3, [1, 2, 3]), (8, [1, 2, 4, 8]), (11, [1, 2, 4, 8, 11])])
def test_numbers_double_up_to_all(count, numbers):
    trials = exposure_trials(count)
    assert [trial.exposures for trial in trials] == numbers
    assert trials[0].name == "1 exposure"
    assert trials[-1].name == f"{count} exposures"
    assert expected_seconds(trials[-1], 10.0) == pytest.approx(10.0 * count * 1 / 2)


def test_a_single_exposure_has_no_trials():
    with pytest.raises(InputError, match="1 exposure"):
        exposure_trials(1)


@pytest.fixture
def together(monkeypatch):
    """Stand in for the reconstruction: views that are better the more exposures there are."""
    given = []

    def instead(shots, settings):
        given.append((shots, settings))
        part = SimpleNamespace(
            views=VIEWS + np.float32(0.1 / len(shots)),
            exposed_views=None,
            brightness=None,
            curve=(),
            gaussians=7,
            world_to_camera=np.tile(np.eye(4), (2, 1, 1)),
        )
        return SimpleNamespace(parts=(part,), left_out=())

    monkeypatch.setattr(exposures, "reconstruct_together", instead)
    return given


def test_the_first_exposure_judges_and_its_judging_pixels_are_seen_by_no_trial(together):
    shots = [shot(number, exposure_s=0.5) for number in range(4)]
    ticks = iter([3.0, 10.0])
    found = tried_together(shots, exposure_trials(4)[1], 42, lambda: next(ticks))
    ((seen, settings),) = together
    assert len(seen) == 2
    assert settings.seed == 42
    hidden = ~seen[0].masks.any(axis=0) & shots[0].masks.astype(bool).any(axis=0)
    assert hidden.sum() == 1
    assert np.array_equal(seen[1].masks.any(axis=0), shots[1].masks.astype(bool).any(axis=0) & ~hidden)
    assert found["psnr_db"] == pytest.approx(26.02, abs=0.01)
    assert (found["seconds"], found["capture_s"], found["exposures"]) == (7.0, 1.0, 2)
    assert found["heldout_db"] is not None


def test_unseen_pixels_are_judged_through_the_masks_that_were_corrected(together, monkeypatch):
    """As of every other trial; through the masks as stated, a right result seems to explain nothing."""
    right, other = shot(0), shot(1)
    monkeypatch.setattr(
        exposures, "register", lambda given, settings, seed: Registered(replace(given, masks=right.masks))
    )
    found = tried_together([replace(right, masks=1 - right.masks), other], exposure_trials(2)[0], 0)
    assert found["heldout_db"] == pytest.approx(tried_together([right, other], exposure_trials(2)[0], 0)["heldout_db"])
    assert found["heldout_db"] > 10


def test_without_a_truth_the_unseen_pixels_judge_alone(together):
    shots = [replace(shot(number), truth=Truth()) for number in range(2)]
    found = tried_together(shots, exposure_trials(2)[1], 0)
    assert (found["psnr_db"], found["ssim"], found["nate"]) == (None, None, None)
    assert found["heldout_db"] > 15


def test_seconds_of_capture_are_stated_by_all_or_unknown():
    assert capture_s([shot(0, exposure_s=0.25), shot(1, exposure_s=0.5)]) == 0.75
    assert capture_s([shot(0, exposure_s=0.25), shot(1)]) is None


def test_the_next_exposure_is_worth_what_noise_that_falls_with_their_number_leaves():
    # Half of the error with one exposure stays.
    errors = {n: 0.5 + 0.5 / n for n in (1, 2, 4)}
    rows = [row(n, -10 * np.log10(error), 10.0 * n, 0.2 * n) for n, error in errors.items()]
    worth = next_exposure(rows, "psnr_db")
    assert worth.gain_db == pytest.approx(10 * np.log10(errors[4] / (0.5 + 0.5 / 5)))
    assert worth.seconds == pytest.approx(10.0)
    assert worth.capture_s == pytest.approx(0.2)
    assert next_exposure(rows[:1], "psnr_db") is None


def test_exposures_that_help_nothing_are_worth_nothing():
    assert next_exposure([row(1, 30.0, 1.0), row(2, 29.0, 2.0)], "psnr_db").gain_db == 0


def test_sentences_name_capture_and_computing_and_what_is_next():
    rows = [row(2, 31.0, 25.0, 0.4), row(1, 30.0, 10.0, 0.2), {"trial": "standard", "knob": "preset", "psnr_db": 9.0}]
    said = exposure_sentences(rows, "psnr_db")
    assert said[0] == "1 exposure: 30.00 dB for 0.2 s of capture and 10 s of computing."
    assert said[1].startswith("2 exposures: 31.00 dB for 0.4 s of capture and 25 s")
    assert said[2].startswith("The next exposure after 2 is worth about 0.")
    assert exposure_sentences(rows, None) == []
    assert exposure_sentences(rows[2:], "psnr_db") == []
    assert "of capture" not in exposure_sentences([row(1, 30.0, 10.0)], "psnr_db")[0]


def test_only_those_who_ask_for_exposures_try_them():
    assert KNOB not in {trial.knob for trial in TRIALS.values()}
