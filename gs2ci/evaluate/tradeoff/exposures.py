"""Quality against the number of exposures that are reconstructed together: trials, and what the next one is worth.

Each trial takes the first exposures of the file, that which was asked for among them as the first, and is judged by the
views of this one: against their truth, and by pixels of its measurement that no trial saw. Here: these trials, their
sentences. Not here: other settings (`trials`), the chart (`gs2ci.evaluate.pages.tradeoff_section`), the reconstruction
(`gs2ci.reconstruct.exposures.joint`).
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gs2ci.core.durations import spoken_duration
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.evaluate.tradeoff.record import Measure
from gs2ci.evaluate.tradeoff.store import Row
from gs2ci.evaluate.tradeoff.trials import BASELINE, JUDGED_SHARE, JUDGES, TradeoffTrial, Treated, figures
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.exposures.joint import reconstruct_together
from gs2ci.reconstruct.measurement.coding import without_pixels
from gs2ci.reconstruct.measurement.holdout import Holdout, choose_heldout
from gs2ci.reconstruct.presets.named import PRESETS
from gs2ci.reconstruct.registration.register import register

KNOB: Final = "exposures"


def exposure_trials(count: int) -> list[TradeoffTrial]:
    """Return the trials of a file of so many exposures: 1, 2, 4, … and all of them together.

    Raises:
        InputError: There is only one.
    """
    if count < 2:
        raise InputError(
            f"--knobs {KNOB} with {count} exposure",
            allowed="a shot file with two or more exposures of one scene",
            remedy="capture more of them (`gs2ci capture --shots 8`)",
        )
    numbers = [2**k for k in range(count.bit_length()) if 2**k < count] + [count]
    return [TradeoffTrial(_name(number), KNOB, PRESETS[BASELINE], exposures=number) for number in numbers]


def _name(number: int) -> str:
    return "1 exposure" if number == 1 else f"{number} exposures"


def tried_together(
    shots: Sequence[Shot], trial: TradeoffTrial, seed: int, clock: Callable[[], float] = time.monotonic
) -> Row:
    """Run a trial on exposures, judged by the first; figures as of `trials.tried`, with the seconds of capture.

    Raises:
        Gs2ciError: The exposures cannot be reconstructed together.
    """
    chosen = list(shots[: trial.exposures])
    began_s = clock()
    # Before pixels are taken away, which would seem to be dark. Exposures under the same masks keep the same ones: they
    # have to hold out the same pixels of their own.
    registered = [register(one, trial.settings.registration, seed=seed) for one in chosen]
    first, truth = registered[0].shot, chosen[0].truth
    alike = [np.array_equal(one.masks, chosen[0].masks) for one in chosen]
    right = [
        replace(one.shot, masks=first.masks) if same else one.shot for one, same in zip(registered, alike, strict=True)
    ]
    # Of no exposure is a judging pixel seen: a repeat under the same masks would tell its reading.
    pixels = choose_heldout(first, JUDGED_SHARE, seed ^ JUDGES, registered[0].averaged)
    joint = reconstruct_together([without_pixels(one, pixels) for one in right], replace(trial.settings, seed=seed))
    seconds = clock() - began_s
    part = joint.parts[0]
    lit = first.weights_by(part.brightness)
    coded = part.views if part.exposed_views is None else part.exposed_views
    path = truth.world_to_camera
    details: Row = {
        "iterations": part.curve[-1].iteration if part.curve else 0,
        "gaussians": part.gaussians,
        "nate": None if path is None else trajectory_errors(part.world_to_camera, path).nate,
        "exposures": trial.exposures - len(joint.left_out),
        "capture_s": capture_s(chosen),
    }
    judging = Holdout(replace(first, weights=lit, truth=truth), pixels)
    return figures(trial, seconds, Treated(part.views, coded, lit, details), judging)


def capture_s(shots: Sequence[Shot]) -> float | None:
    """Return the time that exposures took together, s, as their files state it; None if one does not."""
    stated = [shot.provenance.get("exposure_s") for shot in shots]
    known = [float(value) for value in stated if isinstance(value, int | float)]
    return sum(known) if len(known) == len(stated) else None


@dataclass(frozen=True)
class NextExposure:
    """What one more exposure is expected to be worth.

    Args:
        gain_db: More than with all that were tried.
        seconds: Of computing.
        capture_s: Of capture; None if it is not known.
    """

    gain_db: float
    seconds: float
    capture_s: float | None


def next_exposure(rows: Sequence[Row], measure: Measure) -> NextExposure | None:
    """Expect what one more exposure gives, from the last two trials; None with fewer.

    The mean square error is taken as a part that stays and one that falls with the number of exposures, as that of
    noise does.
    """
    known = _known(rows, measure)
    if len(known) < 2:
        return None
    (few, before), (many, after) = ((row["exposures"], row) for row in known[-2:])
    errors = [10 ** (-row[measure] / 10) for row in (before, after)]
    falling = max(0.0, (errors[0] - errors[1]) / (1 / few - 1 / many))
    stays = max(errors[1] - falling / many, 0.0)
    expected = stays + falling / (many + 1)
    capture = after.get("capture_s")
    return NextExposure(
        gain_db=10 * math.log10(errors[1] / expected),
        seconds=max(0.0, (after["seconds"] - before["seconds"]) / (many - few)),
        capture_s=None if capture is None else capture / many,
    )


def exposure_sentences(rows: Sequence[Row], measure: Measure | None) -> list[str]:
    """Return sentences on what each number of exposures gave, and what the next one is worth; none without trials."""
    if measure is None:
        return []
    known = _known(rows, measure)
    said = []
    for row in known:
        capture = row.get("capture_s")
        took = "" if capture is None else f"{spoken_duration(capture)} of capture and "
        said.append(f"{row['trial']}: {row[measure]:.2f} dB for {took}{spoken_duration(row['seconds'])} of computing.")
    worth = next_exposure(rows, measure)
    if worth is not None:
        took = "" if worth.capture_s is None else f"{spoken_duration(worth.capture_s)} of capture and "
        said.append(
            f"The next exposure after {known[-1]['exposures']} is worth about {worth.gain_db:.2f} dB, for {took}"
            f"about {spoken_duration(worth.seconds)} of computing."
        )
    return said


def _known(rows: Sequence[Row], measure: Measure) -> list[Row]:
    """Return the rows of exposures whose quality is known, one for each number, fewest first."""
    own = {row["exposures"]: row for row in rows if row.get("knob") == KNOB and row.get(measure) is not None}
    return [own[number] for number in sorted(own)]
