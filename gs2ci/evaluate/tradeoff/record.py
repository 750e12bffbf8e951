"""The record of a trade-off for the page of a run: `tradeoff.json`, schema `gs2ci.tradeoff/1`.

Here: the record, its writing, and its reading as untrusted input. Not here: making it of trials (`pages.py`), its
section (`gs2ci.evaluate.pages.tradeoff_section`).

The sentences are stored as text, so that a page made years later needs neither the solver nor the trials' version.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal, get_args

from gs2ci.core.errors import StorageError
from gs2ci.core.json_text import as_json, parse_json
from gs2ci.core.whole_file import write_whole
from gs2ci.evaluate.wording import UNKNOWN

Measure = Literal["psnr_db", "heldout_db"]

SCHEMA: Final = "gs2ci.tradeoff/1"
RECORD_NAME: Final = "tradeoff.json"
TITLES: Final[dict[Measure, str]] = {"psnr_db": "PSNR, dB", "heldout_db": "held-out pixels, dB"}
HEADINGS: Final = ("", "s", "PSNR, dB", "SSIM", "nATE", "held-out, dB", "iterations", "Gaussians")
# A record takes some ten thousand bytes.
LIMIT_BYTES: Final = 2**20
# Far beyond any figure of a trial; axes with larger values could overflow.
LARGEST: Final = 1e12
LEAST_S: Final = 1e-6


@dataclass(frozen=True)
class Tried:
    """One trial and its figures; None if they are not known.

    Args:
        trial: Its name.
        knob: What it changes.
        seconds: From the measurement to the views.
        psnr_db: Against the truth.
        ssim: Against the truth.
        nate: Error of the camera path.
        heldout_db: By pixels of the measurement that no trial saw.
        iterations: Iterations of the fit.
        gaussians: Number of Gaussians at its end.
        unbeaten: Whether no other is both quicker and better.
    """

    trial: str
    knob: str
    seconds: float
    psnr_db: float | None
    ssim: float | None
    nate: float | None
    heldout_db: float | None
    iterations: int
    gaussians: int
    unbeaten: bool

    @property
    def cells(self) -> tuple[str, ...]:
        """Get the figures as they stand under `HEADINGS`, the name left out."""
        figures = ((self.psnr_db, 2), (self.ssim, 4), (self.nate, 4), (self.heldout_db, 2))
        shown = [UNKNOWN if figure is None else f"{figure:.{digits}f}" for figure, digits in figures]
        return (f"{self.seconds:.1f}", *shown, f"{self.iterations}", f"{self.gaussians}")


@dataclass(frozen=True)
class TradeoffRecord:
    """Accuracy against time, for one shot on one machine.

    Args:
        name: Name of the shot.
        measure: The measure by which trials are compared; None if their quality is not known.
        sentences: The results in words.
        trials: Those that succeeded, in their order.
        command: The command that repeats this.
        machine: The machine on which the trials ran.
        versions: Versions of the programs.
    """

    name: str
    measure: Measure | None
    sentences: tuple[str, ...]
    trials: tuple[Tried, ...]
    command: str
    machine: Mapping[str, str | int]
    versions: Mapping[str, str]


def write_record(folder: Path, record: TradeoffRecord) -> Path:
    """Write the record into a folder, completely or not at all; return its path.

    Raises:
        StorageError: The disk refuses.
    """
    text = as_json({"schema": SCHEMA, **asdict(record)})
    return write_whole(Path(folder) / RECORD_NAME, text)


def read_record(folder: Path) -> TradeoffRecord | None:
    """Read the record of a folder, or None if it has none.

    Raises:
        StorageError: It is truncated, too large, of another schema, or its values are invalid.
    """
    path = Path(folder) / RECORD_NAME
    if not path.exists():
        return None
    try:
        if path.stat().st_size > LIMIT_BYTES:
            raise ValueError(f"it has {path.stat().st_size} bytes, more than {LIMIT_BYTES}")
        return _record(parse_json(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise StorageError(
            f"{path} cannot be read: {type(error).__name__}: {error}",
            allowed=f"what `gs2ci tradeoff --report` writes, schema {SCHEMA}",
            remedy="delete it, or run `gs2ci tradeoff` again",
        ) from error


def _record(held: Any) -> TradeoffRecord:
    if held["schema"] != SCHEMA:
        raise ValueError(f"it has schema {held['schema']!r}")
    if held["measure"] not in (None, *get_args(Measure)):
        raise ValueError(f"measure {held['measure']!r}")
    return TradeoffRecord(
        name=_text(held["name"]),
        measure=held["measure"],
        sentences=tuple(_text(sentence) for sentence in held["sentences"]),
        trials=tuple(_tried(trial) for trial in held["trials"]),
        command=_text(held["command"]),
        machine={_text(key): _plain(value) for key, value in held["machine"].items()},
        versions={_text(key): _text(value) for key, value in held["versions"].items()},
    )


def _tried(held: Any) -> Tried:
    seconds = _figure(held["seconds"])
    if seconds is None or seconds < LEAST_S:
        raise ValueError(f"{held['seconds']!r} seconds")
    if not isinstance(held["unbeaten"], bool):
        raise ValueError(f"unbeaten {held['unbeaten']!r}")
    return Tried(
        trial=_text(held["trial"]),
        knob=_text(held["knob"]),
        seconds=seconds,
        psnr_db=_figure(held["psnr_db"]),
        ssim=_figure(held["ssim"]),
        nate=_figure(held["nate"]),
        heldout_db=_figure(held["heldout_db"]),
        iterations=_count(held["iterations"]),
        gaussians=_count(held["gaussians"]),
        unbeaten=held["unbeaten"],
    )


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} instead of a text")
    return value


def _plain(value: Any) -> str | int:
    return value if isinstance(value, int) and abs(value) <= LARGEST else _text(value)


def _figure(value: Any) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST:
        raise ValueError(f"{value!r} instead of a number")
    return float(value)


def _count(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= LARGEST:
        raise ValueError(f"{value!r} instead of a count")
    return value
