"""What leaving a mechanism out costs: its cells beside the default's, of the same case and the same seed.

Here: the differences, the rule that they are judged by (CONTRIBUTING, "How to change quality"), and the table. Not
here: the cells (`catalogue`), the mechanisms (`gs2ci.reconstruct.mechanisms`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any, Final

from gs2ci.core.whole_file import write_whole
from gs2ci.evaluate.tradeoff.store import Row
from gs2ci.reconstruct.mechanisms import MECHANISMS
from tests.tables.catalogue import TableEntry, compared_with
from tests.tables.variants import IN_ONE_FIT, MECHANISM_LINES, MECHANISM_LINES_IN_ONE_FIT

QUALITIES: Final = {
    "psnr_db": "views",
    "scene_psnr_db": "scene",
    "between_psnr_db": "between",
    "beyond_psnr_db": "beyond",
}
_TITLES: Final = (
    *("mechanism", "in", "pairs"),
    *(f"{title}, dB" for title in QUALITIES.values()),
    *("most, dB", "least, dB", "depth, ×", "rank", "path", "order", "held out, ×", "verdicts", "time, ×", "stays"),
)
# The rule: what is enough in the mean of a column, and what is enough on at least so many measurements.
_MEAN_DB: Final = 0.05
_ONE_DB: Final = 0.3
_LEAST_MEASUREMENTS: Final = 2
# A path with at most this error, as a share of its extent, is right.
_RIGHT_PATH: Final = 0.1


@dataclass(frozen=True)
class Cost:
    """What one measurement loses without a mechanism.

    Args:
        case: The measurement.
        db: By column, dB; positive if the default is better.
        depth: The median error of depth without it over that with it; None without a true depth.
        rank: By how much the rank correlation of depth is smaller without it.
        path: +1 if only the default's path is right, -1 if only the other's is, else 0.
        order: Likewise for the order of depth.
        heldout: The held-out residual without it over that with it.
        verdict: Whether another kind of views is delivered.
        silent: Whether it turns the path or the depth inside out and the run says no more than with it.
        seconds: Processor seconds without it over those with it.
    """

    case: str
    db: Mapping[str, float]
    depth: float | None
    rank: float | None
    path: int
    order: int
    heldout: float | None
    verdict: bool
    silent: bool
    seconds: float


@dataclass(frozen=True)
class Costs:
    """What leaving a mechanism out costs on all measurements of a table.

    Args:
        line: The table's line without it.
        costs: Of each measurement and seed.
        failed: How many cells of the pairs failed.
    """

    line: str
    costs: tuple[Cost, ...]
    failed: int = 0

    def mean_db(self, key: str) -> float | None:
        """Return the mean cost of a column, dB; None if no measurement has it."""
        known = [cost.db[key] for cost in self.costs if key in cost.db]
        return fmean(known) if known else None

    @property
    def reasons(self) -> tuple[str, ...]:
        """Get the reasons why the mechanism stays by the rule; none: it does not hold."""
        means = {title: self.mean_db(key) or 0.0 for key, title in QUALITIES.items()}
        found = [f"{title} {mean:+.2f} dB" for title, mean in means.items() if mean >= _MEAN_DB]
        for key, title in QUALITIES.items():
            cases = {cost.case for cost in self.costs if cost.db.get(key, 0.0) >= _ONE_DB}
            found += [f"{title} ≥ {_ONE_DB} dB on {len(cases)}"] if len(cases) >= _LEAST_MEASUREMENTS else []
        for name in ("path", "order"):
            won = {cost.case for cost in self.costs if getattr(cost, name) > 0}
            found += [f"right {name} on {len(won)}"] if len(won) >= _LEAST_MEASUREMENTS else []
        return (*found, *([f"silently wrong on {n}"] if (n := sum(cost.silent for cost in self.costs)) else []))


def paired(entries: Sequence[TableEntry], rows: Sequence[Row]) -> list[Costs]:
    """Compare the cells of each line with the default's of the same case and seed."""
    at: dict[tuple[str, str, int], Row] = {
        (entry.line, entry.case, entry.cell.arguments["seed"]): row for entry, row in zip(entries, rows, strict=True)
    }
    found = []
    lines = MECHANISM_LINES | MECHANISM_LINES_IN_ONE_FIT
    for line in dict.fromkeys(entry.line for entry in entries if entry.line in lines):
        pairs = [
            (case, at.get((compared_with(line), case, seed), {"error": "not made"}), row)
            for (name, case, seed), row in at.items()
            if name == line
        ]
        costs = [_cost(case, base, row) for case, base, row in pairs if "error" not in base and "error" not in row]
        found.append(Costs(line, tuple(costs), len(pairs) - len(costs)))
    return found


def _cost(case: str, base: Row, without: Row) -> Cost:
    known = [key for key in QUALITIES if base.get(key) is not None and without.get(key) is not None]
    rank = _difference(base, without, "depth_rank")
    lost = bool(without.get("failure")) and not base.get("failure")
    return Cost(
        case,
        {key: float(base[key]) - float(without[key]) for key in known},
        _ratio(base, without, "depth_px") or _ratio(base, without, "depth_rel_percent"),
        rank,
        _is_right(base, "nate") - _is_right(without, "nate"),
        _has_order(base) - _has_order(without),
        _ratio(base, without, "heldout_rms"),
        base.get("verdict") != without.get("verdict"),
        lost and set(without.get("codes", ())) <= set(base.get("codes", ())),
        _ratio(base, without, "processor_seconds") or 1.0,
    )


def _difference(base: Row, without: Row, key: str) -> float | None:
    if base.get(key) is None or without.get(key) is None:
        return None
    return float(base[key]) - float(without[key])


def _ratio(base: Row, without: Row, key: str) -> float | None:
    return float(without[key]) / float(base[key]) if base.get(key) and without.get(key) is not None else None


def _is_right(row: Row, key: str) -> int:
    value: Any = row.get(key)
    return int(value is not None and value <= _RIGHT_PATH)


def _has_order(row: Row) -> int:
    """Tell whether the order of depth is right; none is found where depth remains a plane."""
    rank: Any = row.get("depth_rank")
    return int(rank is not None and rank > 0 and not row.get("failure"))


def paired_markdown(costs: Sequence[Costs], command: str) -> str:
    """Lay the costs out: one line per mechanism, and whether it stays by the rule."""
    decisions = {f"no {one.name}": one.decision for one in MECHANISMS}
    lines = [
        "# What leaving a mechanism out costs",
        "",
        f"`{command}`. Positive: the default is better. Means over pairs of the same measurement and seed; *most* and "
        "*least* are of views; × are means of ratios, without over with; *path* and *order*: measurements on which "
        "only the default is right, less those on which only the other is.",
        "",
        "| " + " | ".join(_TITLES) + " |",
        "|---|" + "---:|" * (len(_TITLES) - 2) + "---|",
    ]
    for one in costs:
        plain = one.line.removeprefix(IN_ONE_FIT)
        name = plain.removeprefix("no ") + (", in one fit" if plain != one.line else "")
        named = [name, decisions.get(plain, "")]
        lines.append("| " + " | ".join((*named, *_cells(one), "; ".join(one.reasons) or "no")) + " |")
    return "\n".join(lines) + "\n"


def _cells(one: Costs) -> list[str]:
    costs = one.costs
    return [
        str(len(costs)) + (f" ({one.failed} failed)" if one.failed else ""),
        *(_signed(one.mean_db(key)) for key in QUALITIES),
        _extreme(one, best=True),
        _extreme(one, best=False),
        _plain(_mean([cost.depth for cost in costs])),
        _signed(_mean([cost.rank for cost in costs])),
        f"{sum(cost.path for cost in costs):+d}",
        f"{sum(cost.order for cost in costs):+d}",
        _plain(_mean([cost.heldout for cost in costs])),
        str(sum(cost.verdict for cost in costs)),
        _plain(_mean([cost.seconds for cost in costs])),
    ]


def write_paired(folder: Path, costs: Sequence[Costs], command: str) -> Path:
    """Write `mechanisms-costs.md`; return its path.

    Raises:
        StorageError: The disk refuses.
    """
    return write_whole(folder / "mechanisms-costs.md", paired_markdown(costs, command), parents=True)


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return fmean(known) if known else None


def _signed(value: float | None) -> str:
    return "–" if value is None else f"{value:+.2f}"


def _plain(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _extreme(one: Costs, *, best: bool) -> str:
    known = [(cost.db["psnr_db"], cost.case) for cost in one.costs if "psnr_db" in cost.db]
    if not known:
        return "–"
    db, case = (max if best else min)(known)
    return f"{db:+.2f} ({case})"
