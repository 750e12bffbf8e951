"""The Pareto front of the trials, and what the next decibel costs, in words.

Here: the front, its prices, how well held-out pixels predict the true order, and the sentences about all this.
Not here: the trials (`trials.py`), files (`pages.py`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from scipy.stats import kendalltau

from gs2ci.core.durations import spoken_duration
from gs2ci.evaluate.tradeoff.record import Measure
from gs2ci.evaluate.tradeoff.store import Row
from gs2ci.evaluate.tradeoff.trials import BASELINE

# Smaller than the spread over seeds: not mentioned.
NEGLIGIBLE_DB: Final = 0.05
_LEAST_TO_ORDER: Final = 3


@dataclass(frozen=True)
class Agreement:
    """How well held-out pixels predict the true order of trials.

    Args:
        tau: Kendall's rank correlation of both, −1 to 1; None if all are equal.
        regret_db: The loss if the trial that the held-out pixels prefer is taken instead of the truly best.
        trials: How many were compared.
    """

    tau: float | None
    regret_db: float
    trials: int


def measure_of(rows: Sequence[Row]) -> Measure | None:
    """Choose the measure of quality: the truth if it is known, otherwise held-out pixels; None without either."""
    measures: tuple[Measure, ...] = ("psnr_db", "heldout_db")
    for measure in measures:
        if any(row.get(measure) is not None for row in rows):
            return measure
    return None


def pareto(rows: Sequence[Row], measure: Measure) -> list[Row]:
    """Return the Pareto front: the rows that no other beats in both time and quality, from the quickest."""
    front: list[Row] = []
    known = [row for row in rows if row.get(measure) is not None]
    for row in sorted(known, key=lambda row: (row["seconds"], -row[measure])):
        if not front or row[measure] > front[-1][measure]:
            front.append(row)
    return front


def agreement(rows: Sequence[Row]) -> Agreement | None:
    """Compare the order by held-out pixels with the true one; None with fewer than three trials that have both."""
    both = [row for row in rows if row.get("psnr_db") is not None and row.get("heldout_db") is not None]
    if len(both) < _LEAST_TO_ORDER:
        return None
    true, judged = [row["psnr_db"] for row in both], [row["heldout_db"] for row in both]
    tau = float(kendalltau(true, judged).statistic) if len(set(true)) > 1 and len(set(judged)) > 1 else None
    preferred = max(both, key=lambda row: row["heldout_db"])
    return Agreement(tau, max(true) - preferred["psnr_db"], len(both))


def sentences(rows: Sequence[Row]) -> list[str]:
    """Return sentences on what quality costs and what the next decibel would cost, from the rows of all trials."""
    measure = measure_of(rows)
    if measure is None:
        return ["Without a truth and without held-out pixels the quality is unknown; only times can be compared."]
    front = pareto(rows, measure)
    spoken = [_quickest_sentence(front[0], measure), *(_step(a, b, measure) for a, b in pairwise(front))]
    return [*spoken, _next_decibel(rows, front, measure), *_trust(rows, measure)]


def _quickest_sentence(row: Row, measure: Measure) -> str:
    return f"{_named(row)}: {row[measure]:.2f} dB in {spoken_duration(row['seconds'])}, the quickest of all."


def _step(before: Row, after: Row, measure: Measure) -> str:
    gain, seconds = after[measure] - before[measure], after["seconds"] - before["seconds"]
    price = "" if gain < NEGLIGIBLE_DB else f", {spoken_duration(seconds / gain)} for each decibel"
    return (
        f"{_named(after)}: {gain:.2f} dB more than {before['trial']} for {spoken_duration(seconds)} more{price} "
        f"({after[measure]:.2f} dB in {spoken_duration(after['seconds'])})."
    )


def _next_decibel(rows: Sequence[Row], front: Sequence[Row], measure: Measure) -> str:
    """Return a sentence on what more than the standard costs; if that was not tried, more than the best."""
    base = next((row for row in rows if row["trial"] == BASELINE and row.get(measure) is not None), front[-1])
    better = [row for row in front if row[measure] - base[measure] >= NEGLIGIBLE_DB]
    if not better:
        return f"No trial is noticeably better than {base['trial']}, {base[measure]:.2f} dB."
    dearer = [row for row in better if row["seconds"] > base["seconds"]]
    if not dearer:
        cheapest = better[0]
        return (
            f"The standard is not worth its time here: {cheapest['trial']} gives "
            f"{cheapest[measure] - base[measure]:.2f} dB more in "
            f"{spoken_duration(base['seconds'] - cheapest['seconds'])} less."
        )
    # The least seconds per decibel among all that go beyond the standard.
    chosen = min(dearer, key=lambda row: (row["seconds"] - base["seconds"]) / (row[measure] - base[measure]))
    gain, seconds = chosen[measure] - base[measure], chosen["seconds"] - base["seconds"]
    most = max(row[measure] for row in better) - base[measure]
    whole = "" if most >= 1 else f"; no trial gains a whole decibel, the largest gain is {most:.2f} dB"
    return (
        f"The next decibel after {base['trial']} costs {spoken_duration(seconds / gain)} at the rate of "
        f"{chosen['trial']}, which gives {gain:.2f} dB for {spoken_duration(seconds)}{whole}."
    )


def _trust(rows: Sequence[Row], measure: Measure) -> list[str]:
    """Return a sentence on how well decibels of held-out pixels agree with those of the truth."""
    if measure == "heldout_db":
        return [
            "The truth is not known: decibels measure how well the measurement is predicted at pixels that no trial "
            "saw. The measurement's noise limits them, and their order of trials is more reliable than their "
            "differences."
        ]
    found = agreement(rows)
    if found is None or found.tau is None:
        return []
    return [
        f"Held-out pixels of the measurement alone would have ordered these {found.trials} trials with a rank "
        f"correlation (Kendall's tau) of {found.tau:.2f}; the best by them is {found.regret_db:.2f} dB below the "
        "truly best."
    ]


def _named(row: Row) -> str:
    name = str(row["trial"])
    return name[:1].upper() + name[1:]
