"""Accuracy against time, for one shot: `tradeoff`.

Here: the order of running trials and reporting. Not here: either of these (`gs2ci.evaluate.tradeoff`).
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gs2ci.api.display import shown
from gs2ci.api.options import check_seed, every
from gs2ci.core.durations import parse_duration_s
from gs2ci.core.errors import Gs2ciError, InputError
from gs2ci.core.json_text import as_json
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.core.whole_file import check_place, write_whole

if TYPE_CHECKING:
    from gs2ci.evaluate.tradeoff.pages import Tradeoff
    from gs2ci.evaluate.tradeoff.store import Row
    from gs2ci.evaluate.tradeoff.trials import TradeoffTrial


@dataclass(frozen=True)
class TradeoffFound:
    """Accuracy against time for one shot.

    Args:
        found: The trials' figures.
        text: The same as markdown.
        pages: The files that were written; last the run's page, if there is one.
    """

    found: "Tradeoff"
    text: str
    pages: list[Path]

    def _repr_markdown_(self) -> str:
        return self.text


def tradeoff(
    shot: Shot | str | Path,
    output: str | Path = "tradeoff",
    *,
    index: int = 0,
    knobs: Sequence[str] = (),
    most: str = "15min",
    seed: int = 42,
    report: str | Path | None = None,
    fresh: bool = False,
    command: str = "",
    progress: Progress | None = None,
) -> TradeoffFound:
    """Try presets and settings on one measurement, and report the seconds per decibel of each step.

    Finished trials are kept in `<output>/cells`: a repeated call continues where an interrupted one stopped, and tries
    failed trials again.

    Args:
        shot: A shot file; or a shot.
        output: Folder for CSV, section, page and the finished trials.
        index: Which shot of the file.
        knobs: What to vary, one thing at a time: preset (decode only, draft, standard, paper), resolution,
            fits, iterations, population, start, "decode steps", "first look", "depth planes", windows, "list reuse",
            precision; by default all of them. And exposures: 1, 2, 4, … of a file's exposures together, judged by the
            views of the one that `index` names, and what one more is worth.
        most: Skip trials that are expected to take longer than this, from how long the standard took. Decode alone,
            draft and standard are always tried.
        seed: Seed of every random draw.
        report: A run folder of the same shot: its report.html gets a section on what accuracy costs, and keeps it
            when `gs2ci report` rebuilds it.
        fresh: Repeat finished trials.
        command: The command that repeats this, for the pages.
        progress: Receives the trials.

    Raises:
        InputError: A value cannot be used, or every trial fails.
        StorageError: A file cannot be read or written.

    Example:
        >>> gs2ci.tradeoff("shot.h5", "costs", knobs=("luck",))
        Traceback (most recent call last):
        gs2ci.core.errors.InputError: no knob 'luck'; ...
    """
    check_seed(seed)
    most_s, knobs = parse_duration_s(most), every(knobs)
    # Read before imports that take seconds: a missing file is reported at once.
    from gs2ci.core.storage import read_shot

    measured = shot.check() if isinstance(shot, Shot) else read_shot(Path(shot), index)
    from gs2ci.evaluate.pages.run_evidence import check_same_shot
    from gs2ci.evaluate.pages.run_page import write_run_page
    from gs2ci.evaluate.pages.tradeoff_section import tradeoff_page
    from gs2ci.evaluate.tradeoff.exposures import KNOB, exposure_trials
    from gs2ci.evaluate.tradeoff.pages import Tradeoff, markdown, record_of, write_pages
    from gs2ci.evaluate.tradeoff.record import write_record
    from gs2ci.evaluate.tradeoff.store import Store, content_key
    from gs2ci.evaluate.tradeoff.trials import BASELINE, KNOBS, chosen_trials, expected_seconds

    output = Path(output)
    trials, shots = chosen_trials(knobs or KNOBS, (KNOB,)), [measured]
    if KNOB in knobs:
        shots += [] if isinstance(shot, Shot) else _others(Path(shot), index)
        trials += exposure_trials(len(shots))
    check_place(output / "cells")
    if report is not None:
        check_same_shot(Path(report), measured)
    store, digest = Store(output / "cells", fresh=fresh), _digest(measured)
    rows: dict[str, Row] = {}
    left_out: dict[str, float] = {}
    with shown(progress) as display:
        display.stage("trials", len(trials))
        for done, trial in enumerate(trials, 1):
            standard_s = rows.get(BASELINE, {}).get("seconds")
            expected_s = 0.0 if standard_s is None else expected_seconds(trial, standard_s)
            exposures = {} if trial.knob != KNOB else {"exposures": [_digest(one) for one in shots[: trial.exposures]]}
            key = content_key(trial.name, {"shot": digest, "seed": seed, **exposures})
            row = store.get(key)
            if (row is None or "error" in row) and expected_s <= most_s:
                row = _row(shots, trial, seed)
                store.put(key, row)
            if row is None:
                left_out[trial.name] = expected_s
            else:
                rows[trial.name] = {"trial": trial.name, "knob": trial.knob, **row}
            display.step(done)
    if all("error" in row for row in rows.values()):
        first, row = next(iter(rows.items()))
        raise InputError(f"every trial failed, {first!r} because of: {row['error']}")
    found = Tradeoff(measured.name, list(rows.values()), left_out, command)
    record = record_of(found)
    pages = [*write_pages(output, found), write_whole(output / "tradeoff.html", tradeoff_page(record))]
    if report is not None:
        write_record(Path(report), record)
        pages.append(write_run_page(Path(report)))
    return TradeoffFound(found, markdown(found), pages)


def _others(path: Path, index: int) -> list[Shot]:
    """Read the other exposures of a file."""
    from gs2ci.core.storage import count_shots, read_shot

    return [read_shot(path, other) for other in range(count_shots(path)) if other != index]


def _row(shots: Sequence[Shot], trial: "TradeoffTrial", seed: int) -> "Row":
    """Run one trial; an error of ours becomes a row that states it, so that one trial that fails does not end all."""
    from gs2ci.evaluate.tradeoff import exposures, trials

    try:
        if trial.knob == exposures.KNOB:
            return exposures.tried_together(shots, trial, seed)
        return trials.tried(shots[0], trial, seed)
    except Gs2ciError as error:
        return {"error": str(error)}


def _digest(shot: Shot) -> str:
    """Hash a shot and its truth."""
    digest = hashlib.sha256()
    for part in (shot, shot.truth):
        for name, value in vars(part).items():
            if isinstance(value, np.ndarray):
                digest.update(f"{name} {value.shape}".encode())
                digest.update(value.tobytes())
            elif name != "truth":
                digest.update(as_json([name, value]).encode())
    return digest.hexdigest()
